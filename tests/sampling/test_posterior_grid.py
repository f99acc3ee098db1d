"""Posterior of theta from whole sweeps against the exact posterior on a grid, where the path can be integrated out.

Compared are means, squares and the product of the two parameters (so standard deviations and correlation too), and
the score: for exact draws of parameters and path together its mean is zero. Means alone do not show a wrong order of
Gibbs blocks.
"""

from __future__ import annotations

import zlib
from functools import partial

import numpy as np
import pytest
from oracles import kalman
from oracles.amigobot_model import amigobot_log, tight_model
from oracles.monte_carlo import SHARPNESS, TOLERANCE, chain_standard_error
from oracles.random_walk_model import rail_log, rail_model
from oracles.sweeps import first_state, run_chain, run_chains

from pmcl.filtering.particle_filter import make_rng, update_path
from pmcl.sampling.marginals import Marginals
from pmcl.sampling.metropolis import update_theta
from pmcl.sampling.schedule import Schedule
from pmcl.sampling.sweep import SweepSettings, step
from pmcl.sampling.transport import Proposal, linearised_at

T = 30
# Biases that matter, in posterior standard deviations: of means, squares, the product, and of the score (whose own
# standard deviation is about 8).
MATTERS = np.array([0.25, 0.25, 0.4, 0.4, 0.3, 1.0, 1.0])


@pytest.fixture(scope="module")
def bound():
    return rail_model().bind(rail_log(T, seed=3, missing=(7,)))


@pytest.fixture(scope="module")
def exact(bound):
    tables = bound.tables(bound.prior_mean())[0]

    def log_prior(q, r):
        return bound.parameters[0].prior.logpdf(q) + bound.parameters[1].prior.logpdf(r)

    return kalman.grid_posterior(kalman.linear_model(tables), log_prior)


@pytest.fixture
def seeds(request):
    """Four seeds from the test's name."""
    return [zlib.crc32(f"{request.node.name} {k}".encode()) for k in range(4)]


def _score(bound, thetas, paths):
    """Derivative of log p(theta, path, readings) by the logs of both parameters, (..., 2)."""
    motion, sensor = bound.parts[0][1], bound.parts[0][2]
    x, (q, r) = paths[..., 0], np.moveaxis(thetas, -1, 0)
    steps = x[..., 1:] - motion.coefficient * x[..., :-1] - motion.control[1:]
    residual = (sensor.reading - x)[..., ~np.isnan(sensor.reading)]
    # The prior is gamma(3, scale 0.2); 3 and not 2 because the density of the logs has a Jacobian.
    of_steps = (steps**2).sum(axis=-1) / q**2 - steps.shape[-1] + 3.0 - q / 0.2
    of_readings = (residual**2).sum(axis=-1) / r**2 - residual.shape[-1] + 3.0 - r / 0.2
    return np.stack([of_steps, of_readings], axis=-1)


def _deviations(bound, exact, made):
    """What must have mean zero, (chains, draws, 7): see MATTERS. The first twentieth is burn-in."""
    thetas, paths = (np.array(column)[:, len(made[0][0]) // 20 :] for column in zip(*made, strict=True))
    z = (thetas - exact.mean) / exact.std
    product = z[..., :1] * z[..., 1:] - exact.correlation
    return np.concatenate([z, z**2 - 1.0, product, _score(bound, thetas, paths)], axis=-1)


def _off(
    bound, exact, settings, seeds, draws, *, transported=False, step=step, schedule=Schedule(), marginals=None,  # noqa: B008
):  # fmt: skip
    transport = None
    if transported:
        root = np.linalg.cholesky([[0.1, -0.06], [-0.06, 0.1]])
        proposal = Proposal(1.5 * root, np.log([0.5, 0.45]), root)
        if marginals is not None:
            proposal = Proposal(1.5 * root, np.zeros(2), np.linalg.cholesky([[1.0, -0.6], [-0.6, 1.0]]), marginals)
        transport = linearised_at(bound, np.array([0.5, 0.4]), [np.full((T, 1), 50.0)], proposal, schedule)
    state = first_state(bound, np.array([0.5, 0.4]), np.full((T, 1), 50.0))
    _chain(bound, settings, transport, state, 2, step, 0)  # compiles here, not in each process
    deviations = _deviations(
        bound, exact, run_chains(partial(_chain, bound, settings, transport, state, draws, step), seeds)
    )
    error = chain_standard_error(deviations)
    return deviations.mean(axis=(0, 1)) / error, MATTERS / error


def _chain(bound, settings, transport, state, draws, step, seed):
    return run_chain(bound, settings, transport, state, draws, seed, step)


@pytest.mark.parametrize(
    ("transported", "sweeps"),
    [pytest.param(True, 1, marks=pytest.mark.slow), pytest.param(False, 5, marks=pytest.mark.long)],
)
def test_conditional_sweeps_have_the_exact_posterior(bound, exact, seeds, transported, sweeps):
    """With 20 particles only, four chains."""
    settings = SweepSettings("conditional", 20, 3, 4, sweeps)
    off, sharpness = _off(bound, exact, settings, seeds, 2200, transported=transported)
    # Without transport the chain mixes slowly: what can be seen is half as sharp again.
    assert sharpness.min() >= (SHARPNESS if transported else SHARPNESS / 1.6), sharpness.round(1)
    assert np.abs(off).max() <= TOLERANCE, off.round(1)


@pytest.mark.slow
def test_sweeps_that_seldom_use_particles_have_it_too(bound, exact, seeds):
    schedule = Schedule(walk_share=0.2, path_share=0.2, redraw_share=0.6, block=7)
    settings = SweepSettings("conditional", 20, 3, 5)
    off, sharpness = _off(bound, exact, settings, seeds, 2200, transported=True, schedule=schedule)
    assert sharpness.min() >= SHARPNESS, sharpness.round(1)
    assert np.abs(off).max() <= TOLERANCE, off.round(1)


class ForgottenSlope(Marginals):
    """Shapes whose proposals are not corrected for."""

    def to_normal_with_slope(self, u):
        return self.to_normal(u), np.asarray(0.0)


SHAPES = (np.log([0.5, 0.45]), np.array([0.3, 0.35]), np.array([0.5, -0.7]), np.array([0.8, 1.2]))


@pytest.mark.slow
def test_sweeps_whose_proposals_have_a_shape_have_it_too(bound, exact, seeds):
    """Proposals more skewed than the posterior, and to the other side: only their correction makes them right."""
    schedule = Schedule(walk_share=0.2, path_share=0.2)
    settings, law = SweepSettings("conditional", 20, 3, 5), {"transported": True, "schedule": schedule}
    off, sharpness = _off(bound, exact, settings, seeds, 2200, **law, marginals=Marginals(*SHAPES))
    assert sharpness.min() >= SHARPNESS, sharpness.round(1)
    assert np.abs(off).max() <= TOLERANCE, off.round(1)
    off, _ = _off(bound, exact, settings, seeds, 1200, **law, marginals=ForgottenSlope(*SHAPES))
    assert np.abs(off).max() > TOLERANCE, off.round(1)


@pytest.mark.long
def test_smoothing_sweeps_need_many_particles(bound, exact, seeds):
    """The paper's kernel: with 500 particles nothing is to be seen, with 20 the same comparison fails."""
    off, _ = _off(bound, exact, SweepSettings("smoothing", 500, 3, 4), seeds, 1200, transported=True)
    assert np.abs(off).max() <= TOLERANCE, off.round(1)
    off, _ = _off(bound, exact, SweepSettings("smoothing", 20, 3, 0), seeds, 1200)
    assert np.abs(off[:2]).max() > TOLERANCE, off.round(1)


def _previous_theta(bound, settings, transport, transform, state, seed):
    """A sweep in the wrong order: the new path is drawn given the theta that the new theta has just replaced."""
    rng, path = make_rng(seed), state.path.copy()
    tables = bound.tables(state.theta)
    theta, _, _ = update_theta(
        bound, state.theta, tables, [state.path], state.log_step, settings.metropolis_steps, 0.0, rng
    )
    update_path(tables[0], path, T, settings.particles, rng, "conditional")
    return state._replace(theta=theta, path=path), None


@pytest.mark.slow
def test_a_path_drawn_with_the_previous_theta_is_noticed(bound, exact, seeds):
    off, _ = _off(bound, exact, SweepSettings("conditional", 20, 3, 0), seeds, 2500, step=_previous_theta)
    assert np.abs(off).max() > TOLERANCE, off.round(1)


# Range beams against walls: there is no exact answer, but transport must not change the posterior.


def _wall_chain(bound, transport, state, seed):
    settings = SweepSettings("conditional", 12, 5, 4)
    return run_chain(bound, settings, transport, state, 2500, seed)[0]


@pytest.mark.slow
def test_transport_does_not_change_the_posterior_of_a_wall_model(seeds):
    log = amigobot_log(8, seed=8)
    bound, reference = tight_model().bind(log), np.array(log.true_poses)
    theta = bound.prior_mean()
    proposal = Proposal(0.25 * np.eye(4), np.log(theta), 0.35 * np.eye(4))
    transport = linearised_at(bound, theta, [reference], proposal)
    state = first_state(bound, theta, reference)
    with_transport, without = (
        np.log(np.array(run_chains(partial(_wall_chain, bound, moves, state), seeds))[:, 100:])
        for moves in (transport, None)
    )
    centre, spread = with_transport.mean(axis=(0, 1)), with_transport.std(axis=(0, 1))
    features = [
        np.concatenate([(x - centre) / spread, ((x - centre) / spread) ** 2], axis=-1)
        for x in (with_transport, without)
    ]
    error = np.hypot(*(chain_standard_error(f) for f in features))
    assert error.max() < 0.5 / SHARPNESS
    off = (features[0].mean(axis=(0, 1)) - features[1].mean(axis=(0, 1))) / error
    assert np.abs(off).max() <= TOLERANCE, off.round(1)
