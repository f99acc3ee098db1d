"""The Gaussian transport move: exact bijection, right Jacobian, and nothing changed in the posterior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles import kalman
from oracles.amigobot_model import THETA, amigobot_log, tight_model
from oracles.monte_carlo import TOLERANCE, assert_agrees, off_by
from oracles.random_walk_model import rail_log, rail_model

from pmcl.engine.compile import entry
from pmcl.engine.contract import state_size
from pmcl.filtering.kernels import factorisation, linear
from pmcl.filtering.kernels.linear import Factors, factorise, refresh_blocks, standardised, transport_trial
from pmcl.filtering.particle_filter import log_joint, make_rng
from pmcl.sampling.schedule import Schedule
from pmcl.sampling.transforms import Unconstrained
from pmcl.sampling.transport import Proposal, linearised_at, transport_moves


def _linearised(bound, theta, reference):
    transport = linearised_at(bound, theta, [reference], Proposal(0.1 * np.eye(bound.dimension)))
    assert transport is not None
    return transport


@entry
def carry(motion, path, reference, factor, gain, centre, new_factor, new_gain, new_centre):
    """The path (T, D) that has the same z under the new factorisation as `path` has under the old one."""
    out, z, size = np.empty_like(path), np.empty_like(path), path.shape[1]
    linear.standardise(motion, path, reference, Factors(factor, gain, centre), z, size)
    linear.realise(motion, z, reference, Factors(new_factor, new_gain, new_centre), out, np.empty(size), size)
    return out


@entry
def eliminated(tables, linear_readings, reference, path, begin, stop, by_loops):
    """Log determinant and factors of some rows, by the code for poses or by that for states of any size."""
    n_steps, size = reference.shape[0], state_size(tables.motion)
    factors = Factors(np.zeros((n_steps, 9)), np.zeros((n_steps, 9)), np.zeros((n_steps, 3)))
    work = np.empty(48)
    if by_loops:
        value = factorisation._eliminate_any(
            tables, linear_readings, reference, path, begin, stop, factors, work, size
        )
    else:
        value = factorisation.eliminate(tables, linear_readings, reference, path, begin, stop, factors, work, size)
    return value, factors.factor, factors.gain, factors.centre


def _factors(bound, theta, transport):
    return factorise(bound.tables(theta)[0], transport.geometries[0], transport.references[0])


@pytest.fixture(scope="module")
def amigobot():
    """A bound wall-range model of five steps, its true path as reference, and the linearisation there."""
    log = amigobot_log(5, seed=5)
    bound = tight_model().bind(log)
    return bound, np.array(log.true_poses), _linearised(bound, THETA, np.array(log.true_poses))


@pytest.fixture(scope="module")
def rail():
    bound = rail_model().bind(rail_log(30, seed=3, missing=(7,)))
    return bound, _linearised(bound, np.array([0.5, 0.4]), np.full((30, 1), 50.0))


def test_the_linear_model_is_factorised_exactly(rail):
    """Mean and covariance of the path from the factors, against dense linear algebra, at several theta."""
    bound, transport = rail
    for theta in ([0.5, 0.4], [0.2, 1.1], [1.5, 0.05]):
        tables = bound.tables(np.array(theta))[0]
        mean, covariance = kalman.path_posterior(kalman.linear_model(tables), *theta)
        log_determinant, factor, gain, centre = _factors(bound, np.array(theta), transport)
        # Deviations d = centre + gain d[t+1] + factor^-T z: solve for what z -> d does.
        system = np.eye(30) - np.diag(gain[:-1, 0], 1)
        root = np.linalg.inv(system) @ np.diag(1.0 / factor[:, 0])
        np.testing.assert_allclose(50.0 + np.linalg.solve(system, centre[:, 0]), mean, rtol=1e-10)
        np.testing.assert_allclose(root @ root.T, covariance, rtol=1e-8, atol=1e-12)
        assert log_determinant == pytest.approx(-0.5 * np.linalg.slogdet(covariance)[1], rel=1e-10)


def test_a_linear_model_is_moved_from_one_smoother_to_another(rail, rng):
    """Exact draws of the path under theta become exact draws under theta'; their log weights then do not vary."""
    bound, transport = rail
    theta, new = np.array([0.5, 0.4]), np.array([0.8, 0.3])
    tables, new_tables = bound.tables(theta)[0], bound.tables(new)[0]
    mean, covariance = kalman.path_posterior(kalman.linear_model(tables), *theta)
    now, then = _factors(bound, theta, transport), _factors(bound, new, transport)
    values = []
    for _ in range(5):
        path = rng.multivariate_normal(mean, covariance)[:, None]
        moved = carry(tables.motion, path, transport.references[0], *now[1:], *then[1:])
        ratio = log_joint(new_tables, moved) - then[0] - log_joint(tables, path) + now[0]
        values.append(ratio)
    exact = kalman.log_evidence(kalman.linear_model(new_tables), *new)
    exact -= kalman.log_evidence(kalman.linear_model(tables), *theta)
    np.testing.assert_allclose(values, exact, rtol=1e-9)


@pytest.mark.parametrize(("begin", "stop"), [(0, 40), (0, 7), (7, 31), (31, 40), (12, 13)])
def test_poses_are_eliminated_as_states_of_any_size_are(begin, stop, rng):
    """Whole paths and blocks with one or two neighbours, of forty rows, so that the determinant's product is taken."""
    log = amigobot_log(40, seed=6)
    bound, reference = tight_model().bind(log), np.array(log.true_poses)
    transport = _linearised(bound, THETA, reference)
    path = reference + 0.05 * rng.standard_normal(reference.shape)
    given = (bound.tables(THETA)[0], transport.geometries[0], reference, path, begin, stop)
    poses, general = eliminated(*given, False), eliminated(*given, True)
    assert poses[0] == pytest.approx(general[0], rel=1e-12)
    lower = np.tril(np.ones((3, 3))).ravel() > 0.0  # the rest of a factor is undefined
    rows = slice(begin, stop)
    assert np.abs(general[3][rows]).max() > 1e-4
    np.testing.assert_allclose(poses[1][rows][:, lower], general[1][rows][:, lower], rtol=1e-10, atol=1e-10)
    for got, wanted in zip(poses[2:], general[2:], strict=True):
        np.testing.assert_allclose(got[rows], wanted[rows], rtol=1e-10, atol=1e-12)


def test_poses_without_enough_information_have_no_factorisation(amigobot):
    bound, reference, transport = amigobot
    tables = bound.tables(THETA)[0]
    # Readings that take information away.
    wrong = tuple(geometry._replace(weight=-1e6 * geometry.weight) for geometry in transport.geometries[0])
    for by_loops in (False, True):
        assert eliminated(tables, wrong, reference, reference, 0, 5, by_loops)[0] == -np.inf


@pytest.mark.parametrize("which", ["rail", "amigobot"])
def test_the_way_back_undoes_the_way_there(which, rail, amigobot, rng):
    bound, transport = rail if which == "rail" else amigobot[::2]
    reference = transport.references[0]
    path = reference + 0.05 * rng.standard_normal(reference.shape)
    theta = bound.prior_mean()
    motion = bound.tables(theta)[0].motion  # only its type counts
    for scale in (0.3, 0.9, 3.0):
        now, then = _factors(bound, theta, transport), _factors(bound, scale * theta, transport)
        moved = carry(motion, path, reference, *now[1:], *then[1:])
        assert np.abs(moved - path).max() > 1e-4
        np.testing.assert_allclose(carry(motion, moved, reference, *then[1:], *now[1:]), path, atol=1e-10)
        np.testing.assert_array_equal(carry(motion, path, reference, *now[1:], *now[1:]).round(12), path.round(12))


def test_jacobian_against_finite_differences(amigobot, rng):
    """Determinant of the full 15 x 15 derivative of the carried path, by numerical differentiation."""
    bound, reference, transport = amigobot
    now, then = _factors(bound, THETA, transport), _factors(bound, np.array([0.08, 0.02, 0.05, 0.15]), transport)
    motion = bound.tables(THETA)[0].motion
    path, step = reference + 0.03 * rng.standard_normal(reference.shape), 1e-5

    def moved(flat):
        return carry(motion, flat.reshape(reference.shape), reference, *now[1:], *then[1:]).ravel()

    flat = path.ravel()
    columns = [(moved(flat + unit) - moved(flat - unit)) / (2.0 * step) for unit in step * np.eye(flat.size)]
    sign, log_determinant = np.linalg.slogdet(np.array(columns).T)
    assert sign == 1.0
    assert abs(log_determinant) > 0.5
    assert log_determinant == pytest.approx(now[0] - then[0], abs=1e-6)


def test_one_call_does_what_its_parts_do(amigobot, rng):
    bound, reference, transport = amigobot
    new = np.array([0.08, 0.02, 0.05, 0.15])
    now, then = _factors(bound, THETA, transport), _factors(bound, new, transport)
    path = reference + 0.03 * rng.standard_normal(reference.shape)
    motion = bound.tables(new)[0].motion
    log_determinant, z = standardised(bound.tables(THETA)[0], transport.geometries[0], reference, path)
    assert log_determinant == pytest.approx(now[0], rel=1e-12)
    log_joint_there, log_determinant, carried = transport_trial(
        bound.tables(new)[0], transport.geometries[0], reference, z
    )
    moved = carry(motion, path, reference, *now[1:], *then[1:])
    np.testing.assert_allclose(carried, moved, rtol=1e-12)
    assert log_joint_there == pytest.approx(log_joint(bound.tables(new)[0], moved), rel=1e-12)
    assert log_determinant == pytest.approx(then[0], rel=1e-12)


def test_the_standardised_deviations_of_exact_draws_are_standard_normal(rail, rng):
    bound, transport = rail
    theta = np.array([0.5, 0.4])
    tables = bound.tables(theta)[0]
    mean, covariance = kalman.path_posterior(kalman.linear_model(tables), *theta)
    paths = rng.multivariate_normal(mean, covariance, 2000)[:, :, None]
    z = np.array([standardised(tables, transport.geometries[0], transport.references[0], path)[1] for path in paths])
    np.testing.assert_allclose(z.mean(axis=0), 0.0, atol=5.0 / np.sqrt(2000))
    np.testing.assert_allclose(np.cov(z[:, :, 0].T), np.eye(30), atol=5.0 / np.sqrt(2000))


@pytest.mark.parametrize("distance", [1e10, 1e43, 1e200])
def test_a_path_that_is_carried_too_far_is_impossible(amigobot, distance):
    """Far out the kernels' sine is no number: such a density would end the run."""
    bound, reference, transport = amigobot
    given = (bound.tables(THETA)[0], transport.geometries[0], reference)
    assert transport_trial(*given, standardised(*given, reference + distance)[1])[0] == -np.inf
    assert np.isfinite(transport_trial(*given, standardised(*given, reference)[1])[0])


@pytest.mark.parametrize("redrawn", [True, False])
@pytest.mark.parametrize("which", ["rail", "amigobot"])
def test_what_moves_return_belongs_together(which, redrawn, rail, amigobot, rng):
    """After many moves the returned joint density is that of the returned parameters and path."""
    bound, transport = rail if which == "rail" else amigobot[::2]
    theta, paths = bound.prior_mean(), [transport.references[0].copy()]
    tables = bound.tables(theta)
    transform = Unconstrained(bound.parameters)
    sfc = make_rng(int(rng.integers(2**62)))
    proposal = Proposal(0.3 * np.eye(theta.size), transform.to_line(theta), 0.4 * np.eye(theta.size))
    transport = replace(transport, proposal=proposal, schedule=Schedule(redraw_share=float(redrawn)))
    made = transport_moves(bound, theta, tables, paths, transport, transform, 200, 1.0, sfc)
    assert 0.02 < made.walk_acceptance_rate < 1.0
    assert 0.02 < made.jump_rate < 1.0
    assert made.redraw_rate > 0.1 if redrawn else np.isnan(made.redraw_rate)
    exact = bound.log_prior(made.theta) + log_joint(bound.tables(made.theta)[0], made.paths[0])
    assert made.log_joint == pytest.approx(exact, rel=1e-10)
    np.testing.assert_array_equal(paths[0], transport.references[0])


def test_walks_and_jumps_are_made_as_often_as_the_schedule_says(rail, rng):
    bound, transport = rail
    theta, path = bound.prior_mean(), transport.references[0]
    transform, sfc = Unconstrained(bound.parameters), make_rng(int(rng.integers(2**62)))
    proposal = Proposal(0.3 * np.eye(theta.size), transform.to_line(theta), 0.4 * np.eye(theta.size))
    for share, walks, jumps in ((1.0, True, False), (0.0, False, True), (0.5, True, True)):
        scheduled = replace(transport, proposal=proposal, schedule=Schedule(walk_share=share))
        made = transport_moves(bound, theta, bound.tables(theta), [path], scheduled, transform, 30, 1.0, sfc)
        assert np.isfinite(made.walk_acceptance_rate) == walks
        assert np.isfinite(made.jump_rate) == jumps


def test_proposals_outside_the_prior_are_refused(amigobot, rng):
    """Huge steps never give parameters without density, and no step at all is always accepted."""
    bound, reference, transport = amigobot
    tables = bound.tables(THETA)
    transform, sfc = Unconstrained(bound.parameters), make_rng(int(rng.integers(2**62)))
    far = transport_moves(bound, THETA, tables, [reference], transport, transform, 50, 1e3, sfc)
    assert far.walk_acceptance_rate == 0.0
    np.testing.assert_array_equal(far.theta, THETA)
    still = transport_moves(bound, THETA, tables, [reference], transport, transform, 50, 0.0, sfc)
    assert still.walk_acceptance_rate == 1.0


# The path redrawn in blocks from the linearised model


def _refreshed(bound, transport, theta, rng, runs=6000, blind=False):
    """Exact draws of the rail's path after two passes in random blocks; `blind` accepts every block."""
    tables = bound.tables(theta)[0]
    mean, covariance = kalman.path_posterior(kalman.linear_model(tables), *theta)
    paths = rng.multivariate_normal(mean, covariance, runs)
    shares = []
    for k in range(runs):
        path = np.ascontiguousarray(paths[k, :, None])
        for block in (7, 11):
            starts = np.r_[0, np.arange(1 + rng.integers(block), 30, block), 30].astype(np.int64)
            log_uniform = np.full(starts.size - 1, -1e300) if blind else np.log(rng.random(starts.size - 1))
            noise = rng.standard_normal((30, 1))
            value, share = refresh_blocks(
                tables, transport.geometries[0], transport.references[0], path, starts, noise, log_uniform
            )
            shares.append(share)
        paths[k] = path[:, 0]
    assert value == pytest.approx(log_joint(tables, path), rel=1e-10)
    x, variance = paths - mean, np.diag(covariance)
    return float(np.mean(shares)), [
        (x, 0.0 * mean, 0.15 * np.sqrt(variance)),
        (x**2, variance, 0.2 * variance),
        (x[:, 1:] * x[:, :-1], np.diag(covariance, 1), 0.2 * np.sqrt(variance[1:] * variance[:-1])),
    ]


def _poor(transport):
    """The same linearisation with readings 0.2 m off: a proposal that needs its correction."""
    ((positions,),) = transport.geometries
    return replace(transport, geometries=((positions._replace(value=positions.value - 0.2),),))


def test_blocks_of_a_linear_model_are_always_accepted(rail, rng):
    bound, transport = rail
    share, moments = _refreshed(bound, transport, np.array([0.5, 0.4]), rng)
    assert share == 1.0
    for draws, exact, matters in moments:
        assert_agrees(draws, exact, matters)


def test_blocks_from_a_poor_linearisation_keep_the_exact_law(rail, rng):
    bound, transport = rail
    share, moments = _refreshed(bound, _poor(transport), np.array([0.5, 0.4]), rng)
    assert 0.1 < share < 0.9
    for draws, exact, matters in moments:
        assert_agrees(draws, exact, matters)


def test_accepting_every_block_does_not(rail, rng):
    bound, transport = rail
    _, moments = _refreshed(bound, _poor(transport), np.array([0.5, 0.4]), rng, blind=True)
    assert max(np.max(off_by(draws, exact)) for draws, exact, _ in moments) > TOLERANCE


def test_a_sensor_without_linearisation_gives_no_transport(amigobot, monkeypatch):
    bound, reference, _ = amigobot
    room = "pmcl.models.sensors.range_beams.sensor.RangeNoise.linearise"
    monkeypatch.setattr(room, staticmethod(lambda table, reference: None))
    assert linearised_at(bound, THETA, [reference], Proposal(np.eye(4))) is None
