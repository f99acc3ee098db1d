"""The Kalman family: exact where the model is linear and Gaussian, close where it is nearly so, biased elsewhere."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import kalman as oracle
from oracles.monte_carlo import TOLERANCE, chain_standard_error
from oracles.random_walk_model import rail_log, rail_model

from pmcl.calibration import RunOptions
from pmcl.calibration.kalman import ExtendedKalman, UnscentedKalman
from pmcl.errors import ModelError
from pmcl.filtering.particle_filter import make_rng, run_filter
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.models.starts.belief import StartBelief
from pmcl.sampling.kalman import KalmanTarget, draw_path, kalman_filter
from pmcl.simulations import simulate_landmark_field
from pmcl.simulations.amigobot import simulate_amigobot

pytestmark = pytest.mark.slow  # compiling kernels that no other test needs takes most of the time

T = 25
THETAS = [(0.5, 0.4), (0.2, 0.7), (1.1, 0.05)]


@pytest.fixture(scope="module")
def bound():
    return rail_model().bind(rail_log(T, seed=3, missing=(4, 7)))


@pytest.mark.parametrize("unscented", [False, True])
@pytest.mark.parametrize("theta", THETAS)
def test_a_linear_model_is_filtered_exactly(bound, theta, unscented, rng):
    tables = bound.tables(np.array(theta))[0]
    model = oracle.linear_model(tables)
    exact = oracle.filtered(model, *theta)
    found = kalman_filter(tables, 50.0 + rng.standard_normal((T, 1)), unscented=unscented)
    np.testing.assert_allclose(found.increments, exact.log_score, atol=1e-9)
    np.testing.assert_allclose(found.filtered[:, 0], exact.mean, atol=1e-9)
    np.testing.assert_allclose(found.covariance[:, 0, 0], exact.variance, atol=1e-9)
    assert found.log_evidence == pytest.approx(float(oracle.log_evidence(model, *theta)), abs=1e-8)


def _true_path(log):
    path = np.array(log.true_poses)
    path[:, 2] = np.unwrap(path[:, 2])
    return path


def test_paths_have_the_law_of_the_exact_smoother(bound):
    tables = bound.tables(np.array(THETAS[0]))[0]
    mean, covariance = oracle.path_posterior(oracle.linear_model(tables), *THETAS[0])
    found = kalman_filter(tables, np.full((T, 1), 50.0), unscented=False)
    rng = make_rng(3)
    root = np.linalg.cholesky(covariance)
    z = np.array([np.linalg.solve(root, draw_path(found, rng)[:, 0] - mean) for _ in range(1500)])
    assert np.abs(z.mean(axis=0)).max() < TOLERANCE / np.sqrt(1500)
    assert np.abs(z.T @ z / 1500 - np.eye(T)).max() < TOLERANCE * np.sqrt(2.0 / 1500)


@pytest.mark.parametrize("unscented", [False, True])
def test_it_foresees_a_landmark_field_as_particles_do(unscented):
    """Nearly Gaussian: within a few nats of 100 rows' evidence, of which an error in any step would cost hundreds."""
    log = simulate_landmark_field(100, seed=1, bearings=True)
    bound = default_model(log).bind(log)
    theta = np.array([log.true_theta[name] for name in bound.names])
    tables = bound.tables(theta)[0]
    particles = run_filter(tables, 100, 3000, make_rng(1)).log_evidence
    found = kalman_filter(tables, _true_path(log), unscented=unscented)
    assert found.log_evidence == pytest.approx(particles, abs=3.0)
    away = kalman_filter(tables, _true_path(log) + 0.05, unscented=unscented)
    assert away.log_evidence == pytest.approx(found.log_evidence, abs=1e-3), "the fixed point owes nothing to its start"


def test_sigma_points_see_what_slopes_do_not():
    """With poor readings and sharp turns the belief bends: there the unscented filter is nearer to the particles'."""
    log = simulate_landmark_field(120, seed=4, theta={"sigma_turn": 0.3, "sigma_landmark_range": 1.0})
    bound = default_model(log).bind(log)
    theta = np.array([log.true_theta[name] for name in bound.names])
    tables = bound.tables(theta)[0]
    particles = np.mean([run_filter(tables, 120, 8000, make_rng(k)).log_evidence for k in range(3)])
    extended, unscented = (
        kalman_filter(tables, _true_path(log), unscented=each).log_evidence for each in (False, True)
    )
    assert abs(unscented - particles) < abs(extended - particles)


@pytest.mark.parametrize("method", [ExtendedKalman, UnscentedKalman])
def test_the_posterior_of_a_linear_model_is_exact(method):
    bound = rail_model().bind(rail_log(12, seed=3))

    def log_prior(q, r):
        return bound.parameters[0].prior.logpdf(q) + bound.parameters[1].prior.logpdf(r)

    model = oracle.linear_model(bound.tables(bound.prior_mean())[0])
    exact = oracle.grid_posterior(model, log_prior, top=(4.0, 4.0))
    chains = method(proposals_per_draw=5).run(bound, RunOptions(draws=1000, chains=4, seed=1, trajectories=2))
    z = (chains.theta - exact.mean) / exact.std
    features = np.concatenate([z, z**2 - 1.0, z[..., :1] * z[..., 1:] - exact.correlation], axis=-1)
    error = chain_standard_error(features, batches=5)
    assert error[:2].max() < 0.06
    assert np.abs(features.mean(axis=(0, 1)) / error).max() < TOLERANCE


def test_a_robot_that_may_be_anywhere_is_refused():
    log = simulate_amigobot(20.0, seed=1)
    model = default_model(log)
    somewhere = RobotModel(model.motion, model.sensors, StartBelief(std=(np.inf, np.inf, np.inf)))
    bound = somewhere.bind(log)
    with pytest.raises(ModelError, match="expected a start that is roughly known"):
        KalmanTarget(bound, [np.array(log.true_poses)], unscented=False)
