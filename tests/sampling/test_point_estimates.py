"""Estimates of one theta against exact ones: EM, the optimiser on the evidence, and residuals against the true path."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import kalman
from oracles.random_walk_model import rail_log, rail_model
from scipy import optimize

from pmcl.calibration import PointEstimate, RunOptions
from pmcl.calibration.em import ExpectationMaximisation
from pmcl.calibration.optimiser import EvidenceOptimiser
from pmcl.calibration.prior_mean import PriorMean
from pmcl.calibration.truth import TrueResiduals
from pmcl.errors import ModelError
from pmcl.geometry import wrap
from pmcl.models.motions.increments.motion import GrowingIncrementNoise
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.sampling.point_estimates import likeliest_along, line_hessian
from pmcl.sampling.transforms import Unconstrained
from pmcl.simulations import simulate_landmark_field

OPTIONS = RunOptions(draws=10, chains=2, seed=3, attributes={"note": "kept"})


@pytest.fixture(scope="module")
def bound():
    return rail_model().bind(rail_log(60, seed=5, missing=(3, 20)))


@pytest.fixture(scope="module")
def exact(bound):
    """Maximum likelihood estimate of (q, r), and its standard errors, by the Kalman filter."""
    model = kalman.linear_model(bound.tables(bound.prior_mean())[0])

    def log_evidence(u):
        return float(kalman.log_evidence(model, *np.exp(u)))

    found = optimize.minimize(lambda u: -log_evidence(u), np.log([0.5, 0.4]), tol=1e-10)
    information = -line_hessian(log_evidence, found.x, 1e-3)
    theta = np.exp(found.x)
    return theta, theta * np.sqrt(np.diag(np.linalg.inv(information)))


@pytest.mark.parametrize(("factor", "is_fixed"), [(1.0, True), (1.3, False)])
def test_the_fixed_point_of_em_is_the_maximum_likelihood_estimate(bound, exact, factor, is_fixed):
    """One M step along exact draws of the path: it stays at the maximum, and leaves any other theta."""
    theta = factor * exact[0]
    mean, covariance = kalman.path_posterior(kalman.linear_model(bound.tables(theta)[0]), *theta)
    rng = np.random.default_rng(1)
    paths = mean + rng.standard_normal((2000, mean.size)) @ np.linalg.cholesky(covariance).T
    found = likeliest_along(bound, theta, Unconstrained(bound.parameters), [paths[..., None]])
    # A sum of squares of 60 residuals along 2000 paths is known to some 0.4 per cent.
    assert (np.abs(found / theta - 1.0).max() < 0.01) == is_fixed, found / theta


def test_em_ends_near_the_maximum_of_the_exact_likelihood(bound, exact):
    """Within its Monte Carlo error; and the standard errors are those of the exact likelihood there."""
    theta, error = exact
    found = ExpectationMaximisation(particles=200, iterations=40, paths=30).run(bound, OPTIONS)
    assert isinstance(found, PointEstimate)
    assert (np.abs(found.theta - theta) < 0.5 * error).all(), (found.theta, theta, error)
    np.testing.assert_allclose(found.standard_error, error, rtol=0.35)
    assert found.settings["note"] == "kept"


def test_em_that_filters_in_place_of_smoothing_ends_elsewhere(bound, exact, monkeypatch):
    """The paths of an E step must know the later readings: drawn from the filter alone, row by row, they are rough."""
    from pmcl.sampling import expectation

    def filtered_rows(tables, filtered, paths, rng):
        rows = len(filtered.particles)
        drawn = np.empty((paths, rows, filtered.particles.shape[1]))
        for t in range(rows):
            chosen = rng.choice(filtered.particles.shape[2], size=paths, p=filtered.weights(t))
            drawn[:, t] = filtered.particles[t][:, chosen].T
        return drawn

    monkeypatch.setattr(expectation, "draw_paths", filtered_rows)
    theta, error = exact
    found = ExpectationMaximisation(particles=100, iterations=10, paths=10).run(bound, OPTIONS)
    assert np.abs(found.theta - theta).max() > 1.0 * error.max()


def test_the_optimiser_finds_the_maximum_of_the_evidence(bound, exact):
    theta, error = exact
    found = EvidenceOptimiser(particles=400, evaluations=120).run(bound, OPTIONS)
    # The maximum is that of one set of random numbers.
    assert (np.abs(found.theta - theta) < 0.6 * error).all(), (found.theta, theta, error)
    assert ((found.standard_error > 0.5 * error) & (found.standard_error < 2.0 * error)).all()


def test_the_prior_mean_reads_no_log(bound):
    found = PriorMean().run(bound, OPTIONS)
    np.testing.assert_array_equal(found.theta, bound.prior_mean())
    np.testing.assert_allclose(found.standard_error, [p.prior.std() for p in bound.parameters])


def test_the_oracle_has_the_root_mean_square_residuals():
    log = simulate_landmark_field(50, seed=2)
    bound = default_model(log).bind(log)
    found = TrueResiduals().run(bound, OPTIONS)
    path = np.array(log.true_poses)
    turn = wrap(np.diff(path[:, 2])) - log.odometry[1:, 2]
    by_name = dict(zip(found.names, found.theta, strict=True))
    assert by_name["sigma_turn"] == pytest.approx(np.sqrt(np.mean(turn**2)))
    distance = np.hypot(*np.moveaxis(path[:, None, :2] - log.landmarks.positions, -1, 0))
    residual = (log.landmark_range - distance)[~np.isnan(log.landmark_range)]
    assert by_name["sigma_landmark_range"] == pytest.approx(np.sqrt(np.mean(residual**2)))
    # The error of a standard deviation that n Gaussian residuals tell is itself over the root of 2 n.
    error = dict(zip(found.names, found.standard_error, strict=True))
    assert error["sigma_turn"] == pytest.approx(by_name["sigma_turn"] / np.sqrt(2 * turn.size), rel=0.01)
    assert found.settings["oracle"] is True


def test_the_oracle_needs_the_truth(bound):
    with pytest.raises(ModelError, match="expected the true pose of every row"):
        TrueResiduals().run(bound, OPTIONS)


def test_parameters_without_a_formula_are_searched_for():
    """Noise that grows: at the maximum the gradient of the log density along the path is zero."""
    log = simulate_landmark_field(60, seed=2)
    model = RobotModel(GrowingIncrementNoise(), default_model(log).sensors)
    bound = model.bind(log)
    path = np.array(log.true_poses)
    path[:, 2] = np.unwrap(path[:, 2])
    transform = Unconstrained(bound.parameters)
    theta = likeliest_along(bound, bound.prior_mean(), transform, [path[None]], exact=True)
    from pmcl.sampling.point_estimates import mean_log_joint

    best = mean_log_joint(bound, theta, [path[None]])
    for k in range(theta.size):
        for factor in (0.9, 1.1):
            other = theta.copy()
            other[k] *= factor
            assert mean_log_joint(bound, other, [path[None]]) < best + 1e-3
