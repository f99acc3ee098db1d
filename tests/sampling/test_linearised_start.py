"""Where chains go on after the inclusion of data: the mode of the linearised posterior, if there is more evidence."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import kalman
from oracles.random_walk_model import rail_log, rail_model
from scipy import optimize

from pmcl.filtering.particle_filter import log_joint, make_rng, update_path
from pmcl.models.robot_model import default_model
from pmcl.sampling.linearised_start import ChainAt, LinearisedStarter
from pmcl.sampling.near_mode import mode_around
from pmcl.sampling.transforms import Unconstrained
from pmcl.sampling.transport import Schedule
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field

# mypy: disable-error-code="no-untyped-def"

T = 30


@pytest.fixture(scope="module")
def bound():
    return rail_model().bind(rail_log(T, seed=3, missing=(7,)))


def chain_at(theta, path, seed=1):
    return ChainAt(np.array(theta), path, path, np.random.SeedSequence(seed))


def exact_density(bound, u):
    """The log posterior density of the logs of both noises, by a Kalman filter."""
    theta, log_jacobian = Unconstrained(bound.parameters).from_line(np.asarray(u))
    model = kalman.linear_model(bound.tables(theta)[0])
    return kalman.log_evidence(model, *theta) + bound.log_prior(theta) + log_jacobian


def test_the_mode_of_a_linear_model_is_found_from_noise_far_away(bound):
    """With the curvature there, both against a Kalman filter."""
    far = np.array([2.0, 3.0])
    found = mode_around(bound, far, [np.full((T, 1), 47.0)])
    start = Unconstrained(bound.parameters).to_line(far)
    exact = optimize.minimize(lambda u: -exact_density(bound, u), start, method="Nelder-Mead", options={"xatol": 1e-6})
    np.testing.assert_allclose(found.centre, exact.x, atol=0.02)
    steps = 0.05 * np.eye(2)
    second = [
        [
            exact_density(bound, found.centre + a + b) - exact_density(bound, found.centre + a - b)
            - exact_density(bound, found.centre - a + b) + exact_density(bound, found.centre - a - b)
            for b in steps
        ]
        for a in steps
    ]  # fmt: skip
    np.testing.assert_allclose(np.linalg.inv(found.covariance), -np.array(second) / (4 * 0.05**2), rtol=0.1, atol=0.1)
    mean, _ = kalman.path_posterior(kalman.linear_model(bound.tables(np.exp(found.centre))[0]), *np.exp(found.centre))
    np.testing.assert_allclose(found.references[0][:, 0], mean, atol=0.01)


def test_draws_of_a_linear_model_show_its_evidence_whatever_they_are(bound, rng):
    starter = LinearisedStarter(bound, Schedule())
    transport = starter(chain_at([0.5, 0.4], np.full((T, 1), 50.0))).transport
    found = [
        starter._drawn(np.array(theta), transport, [rng.standard_normal((T, 1))])[0]
        for theta in ([0.5, 0.4], [0.5, 0.4], [1.5, 0.1])
    ]
    exact = [
        kalman.log_evidence(kalman.linear_model(bound.tables(np.array(theta))[0]), *theta)
        for theta in ([0.5, 0.4], [1.5, 0.1])
    ]
    assert found[1] == pytest.approx(found[0], abs=1e-8)
    assert found[2] - found[0] == pytest.approx(exact[1] - exact[0], abs=1e-8)


@pytest.mark.parametrize("simulate", [simulate_landmark_field, simulate_amigobot])
def test_a_chain_with_too_much_noise_goes_to_the_mode(simulate):
    """Its path, drawn with five times the noise of readings, is replaced; the density is that of both."""
    log = simulate(100, seed=2) if simulate is simulate_landmark_field else simulate(100.0, 2)
    bound = default_model(log).bind(log)
    truth = np.array([log.true_theta[name] for name in bound.names])
    theta = truth * np.where([("range" in name) or ("bearing" in name) for name in bound.names], 5.0, 1.0)
    path = np.zeros((log.n_steps, 3))
    assert update_path(bound.tables(theta)[0], path, log.n_steps, 500, make_rng(3), "smoothing").succeeded
    start = LinearisedStarter(bound, Schedule())(chain_at(theta, path))
    assert start.theta is not None
    spread = np.sqrt(np.diag(start.transport.proposal.spread @ start.transport.proposal.spread.T))
    assert (np.abs(np.log(start.theta) - start.transport.proposal.centre) < 4.0 * spread).all()
    assert (np.abs(start.transport.proposal.centre - np.log(truth)) < 4.0 * spread).all()
    value = log_joint(bound.tables(start.theta)[0], start.path) + bound.log_prior(start.theta)
    assert start.log_joint == pytest.approx(value, rel=1e-12)
    assert value > log_joint(bound.tables(start.theta)[0], path) + bound.log_prior(start.theta)


def test_a_chain_stays_where_there_is_more_evidence(bound):
    """Whatever the draw, a chain at the mode itself has at least as much: its transport is made all the same."""
    mode = np.exp(mode_around(bound, np.array([0.5, 0.4]), [np.full((T, 1), 50.0)]).centre)
    model = [kalman.log_evidence(kalman.linear_model(bound.tables(np.array(theta))[0]), *theta) for theta in [mode]]
    went = 0
    for seed in range(20):
        start = LinearisedStarter(bound, Schedule())(chain_at(mode, np.full((T, 1), 50.0), seed))
        assert start.transport.proposal.centre is not None
        if start.theta is not None:
            went += 1
            tables = bound.tables(start.theta)[0]
            assert kalman.log_evidence(kalman.linear_model(tables), *start.theta) > model[0]
    assert went < 10
    again = [LinearisedStarter(bound, Schedule())(chain_at([1.5, 1.5], np.full((T, 1), 50.0), 7)) for _ in range(2)]
    np.testing.assert_array_equal(again[0].theta, again[1].theta)
    np.testing.assert_array_equal(again[0].path, again[1].path)
