"""The evidence of a linearised model, against exact answers."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import kalman
from oracles.random_walk_model import RailSensor, rail_log, rail_model

from pmcl.filtering.linearised_evidence import LinearisedEvidence, improved
from pmcl.filtering.particle_filter import log_joint, make_rng, run_filter
from pmcl.filtering.reading_information import information_of
from pmcl.identifiability import identify
from pmcl.models.robot_model import default_model
from pmcl.sampling.approximate import curvature_at, log_posterior
from pmcl.sampling.transforms import Unconstrained
from pmcl.simulations import simulate_landmark_field

THETAS = np.array([(0.5, 0.4), (0.2, 0.7), (1.1, 0.05)])


@pytest.fixture
def rail():
    log = rail_log(40, seed=5, missing=(3, 4, 20))
    bound = rail_model().bind(log)
    return bound, kalman.linear_model(bound.tables(THETAS[0])[0])


def test_it_is_the_kalman_filters_evidence_whatever_the_reference(rail, rng):
    bound, model = rail
    exact = kalman.log_evidence(model, *THETAS.T)
    for path in (np.full((40, 1), 50.0), 50.0 + rng.standard_normal((40, 1))):
        evidence = LinearisedEvidence(bound, THETAS[0], [path])
        found = np.array([evidence(theta) for theta in THETAS])
        # Up to the constant (2 pi)^(T D / 2), which no theta changes; the terms of the sum are some 10^4 nat.
        assert found + 20.0 * np.log(2.0 * np.pi) == pytest.approx(exact, abs=1e-6)


def test_the_mean_path_is_the_smoothers(rail, rng):
    bound, model = rail
    path = 50.0 + rng.standard_normal((40, 1))
    found = LinearisedEvidence(bound, THETAS[0], [path]).mean_path(THETAS[1])
    assert found[:, 0] == pytest.approx(kalman.smoother(model, *THETAS[1])[0], abs=1e-9)


def test_the_information_is_the_second_derivative_of_the_exact_evidence(rail):
    """The path's share is subtracted: with the path known, the information would be far greater."""
    bound, model = rail
    transform = Unconstrained(bound.parameters)
    evidence = LinearisedEvidence(bound, THETAS[0], [np.full((40, 1), 50.0)])
    u = transform.to_line(THETAS[0])
    found = curvature_at(log_posterior(evidence, transform), u)

    def exact(u):
        theta, log_jacobian = transform.from_line(u)
        return float(kalman.log_evidence(model, *theta)) + bound.log_prior(theta) + log_jacobian

    step, expected = 1e-3, np.empty((2, 2))
    for i in range(2):
        for j in range(2):
            a, b = step * np.eye(2)[i], step * np.eye(2)[j]
            expected[i, j] = -(exact(u + a + b) - exact(u + a - b) - exact(u - a + b) + exact(u - a - b))
    expected /= 4.0 * step**2
    # Steps of 5 % and of 0.1 % differ by the fourth derivative.
    assert found == pytest.approx(expected, rel=0.02, abs=0.05)
    # Were the path known, each noise would be known from 39 or 37 Gaussian draws: information 2 n in its logarithm.
    assert found[0, 0] < 0.7 * 2 * 39


def test_a_sensor_without_linearisation_gives_the_same_evidence(rail, monkeypatch):
    bound, model = rail
    monkeypatch.setattr(RailSensor, "linearise", staticmethod(lambda table, reference: None))
    evidence = LinearisedEvidence(bound, THETAS[0], [np.full((40, 1), 50.0)])
    found = np.array([evidence(theta) for theta in THETAS])
    exact = kalman.log_evidence(model, *THETAS.T)
    assert found + 20.0 * np.log(2.0 * np.pi) == pytest.approx(exact, abs=1e-4)


def test_differences_of_the_density_give_the_rooms_linearisation():
    """The information matrix of landmark ranges: sum of J J' / sigma^2 over the landmarks that a row sees."""
    log = simulate_landmark_field(12, seed=3, n_landmarks=5)
    table = default_model(log).bind(log).tables(np.array([0.05, 0.03, 0.03, 0.3]))[0].sensors[0]
    path = np.array(log.true_poses)
    found = information_of(table, path)
    offset = path[:, None, :2] - log.landmarks.positions
    distance = np.hypot(*offset.transpose(2, 0, 1))
    residual = log.landmark_range - distance
    slope = offset / distance[..., None]
    assert found.shift[:, :2] == pytest.approx(np.einsum("tj,tjd->td", residual / 0.09, slope), abs=2e-3)
    assert found.shift[:, 2] == pytest.approx(0.0, abs=1e-6)
    # The Hessian of the log density holds the curvature of the distance besides, times the residual.
    along = np.einsum("tjd,tje->tde", slope, slope)
    bend = np.einsum("tj,tjde->tde", residual / distance, np.eye(2) - np.einsum("tjd,tje->tjde", slope, slope))
    assert found.precision[:, :2, :2] == pytest.approx((along - bend) / 0.09, rel=1e-2, abs=2e-2)


def test_the_better_reference_is_more_probable(rng):
    log = simulate_landmark_field(30, seed=4)
    bound = default_model(log).bind(log)
    theta = np.array([0.05, 0.03, 0.03, 0.3])
    rough = np.array(log.true_poses) + 0.1 * rng.standard_normal((30, 3))
    evidence = improved(LinearisedEvidence(bound, theta, [rough]), theta)
    tables = bound.tables(theta)[0]
    assert log_joint(tables, evidence.references[0]) > log_joint(tables, rough) + 10.0
    # And the evidence is that of a particle filter with very many particles.
    estimates = [run_filter(tables, 30, 20000, make_rng(seed)).log_evidence for seed in range(4)]
    constant = 45.0 * np.log(2.0 * np.pi)
    assert evidence(theta) + constant == pytest.approx(np.mean(estimates), abs=0.5)


def test_predicted_moments_are_those_of_a_grid(rail):
    bound, model = rail
    parameters = bound.parameters

    def log_prior(q, r):
        return parameters[0].prior.logpdf(q) + parameters[1].prior.logpdf(r)

    grid = kalman.grid_posterior(model, log_prior, top=(3.0, 3.0))
    found = identify(bound.logs[0], rail_model(), drives=False)
    std = np.array([prediction.std for prediction in found.predictions])
    mean = np.array([prediction.mean for prediction in found.predictions])
    # Five Monte Carlo standard errors of a mean and of a standard deviation.
    error = 5.0 / np.sqrt(found.effective_draws)
    assert found.effective_draws > 300.0
    assert np.abs(mean - grid.mean).max() < error * grid.std.max()
    assert std == pytest.approx(grid.std, rel=error)
