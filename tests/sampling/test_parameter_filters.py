"""Filters whose particles carry parameters: Storvik's is exact, Liu and West's nearly so on a short log."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import kalman
from oracles.monte_carlo import TOLERANCE
from oracles.random_walk_model import rail_log, rail_model

from pmcl.calibration import RunOptions
from pmcl.calibration.liu_west import LiuWest
from pmcl.calibration.storvik import Storvik
from pmcl.errors import ModelError, SamplingError
from pmcl.models.robot_model import default_model
from pmcl.sampling import parameter_filters
from pmcl.sampling.stopwatch import Stopwatch
from pmcl.simulations.amigobot import simulate_amigobot

pytestmark = pytest.mark.slow  # compiling kernels that no other test needs takes most of the time

T = 12
RUNS = RunOptions(draws=1000, chains=8, seed=2)
FEW_RUNS = RunOptions(draws=1000, chains=4, seed=2)


@pytest.fixture(scope="module")
def bound():
    return rail_model().bind(rail_log(T, seed=3, missing=(7,)))


@pytest.fixture(scope="module")
def exact(bound):
    def log_prior(q, r):
        return bound.parameters[0].prior.logpdf(q) + bound.parameters[1].prior.logpdf(r)

    return kalman.grid_posterior(kalman.linear_model(bound.tables(bound.prior_mean())[0]), log_prior, top=(4.0, 4.0))


def _features(chains, exact):
    """Means of standardised parameters, squares and product in each run, (runs, 5): all have mean zero."""
    z = (chains.theta - exact.mean) / exact.std
    return np.concatenate([z, z**2 - 1.0, z[..., :1] * z[..., 1:] - exact.correlation], axis=-1).mean(axis=1)


def test_storvik_has_the_exact_posterior(bound, exact):
    found = _features(Storvik(particles=1500).run(bound, RUNS), exact)
    error = found.std(axis=0, ddof=1) / np.sqrt(len(found))
    assert error[:2].max() < 0.1
    # With eight runs a tail of Student's t, not of a Gaussian.
    assert np.abs(found.mean(axis=0) / error).max() < 1.6 * TOLERANCE, (found.mean(axis=0), error)
    assert np.abs(found.mean(axis=0)[:2]).max() < 0.25


def test_statistics_that_forget_their_parents_are_noticed(bound, exact, monkeypatch):
    """Each particle's statistics must be those of its own path."""
    real = parameter_filters._row_statistics

    def shuffled(*arguments):
        counts, squares = real(*arguments)
        return counts, 2.0 * squares

    monkeypatch.setattr(parameter_filters, "_row_statistics", shuffled)
    wrong = _features(Storvik(particles=150).run(bound, FEW_RUNS), exact)
    assert np.abs(wrong.mean(axis=0)[:2]).max() > 0.5
    monkeypatch.undo()
    right = _features(Storvik(particles=150).run(bound, FEW_RUNS), exact)
    assert np.abs(right.mean(axis=0)[:2]).max() < 0.5


def test_row_statistics_are_numbers_and_squares_of_residuals(bound, rng):
    before, states = 50.0 + rng.standard_normal((1, 6)), 50.0 + rng.standard_normal((1, 6))
    log = parameter_filters._logs(bound)[0]
    motion, sensor = bound.parts[0][1], bound.parts[0][2]
    counts, squares = parameter_filters._row_statistics(bound, np.array([0.3, 0.2]), log, 5, before, states)
    np.testing.assert_array_equal(counts, np.ones((6, 2)))
    step = states[0] - motion.coefficient * before[0] - motion.control[5]
    np.testing.assert_allclose(squares, np.column_stack([step**2, (sensor.reading[5] - states[0]) ** 2]), rtol=1e-6)
    counts, _ = parameter_filters._row_statistics(bound, np.array([0.3, 0.2]), log, 7, before, states)
    np.testing.assert_array_equal(counts, np.tile([1.0, 0.0], (6, 1)))


def test_storvik_refuses_parameters_without_such_statistics():
    log = simulate_amigobot(12.0, seed=1, theta={"sigma_range": 0.05})
    bound = default_model(log, outliers=True).bind(log)
    with pytest.raises(ModelError, match="no sufficient statistics") as caught:
        Storvik(particles=20).run(bound, RUNS)
    assert "\n" not in str(caught.value)


def test_liu_west_is_near_the_posterior_of_a_short_log(bound, exact):
    found = _features(LiuWest(particles=500).run(bound, FEW_RUNS), exact).mean(axis=0)
    assert np.abs(found[:2]).max() < 0.4, found


def test_liu_west_is_biased_and_says_so(bound):
    """A long log: runs with few particles lie farther apart than so many independent draws would."""
    long = rail_model().bind(rail_log(150, seed=3))
    theta = LiuWest(particles=100).run(long, RUNS).theta
    means, spread = theta.mean(axis=1), theta.std(axis=1).mean(axis=0)
    assert (means.std(axis=0, ddof=1) > 3.0 * spread / np.sqrt(100)).any()
    assert "biased" in LiuWest.description


@pytest.mark.parametrize("method", [LiuWest(particles=20), Storvik(particles=20)])
def test_a_filter_that_does_not_reach_the_end_in_time_has_no_draws(bound, method):
    late = RunOptions(draws=20, chains=2, seed=4, stopwatch=Stopwatch(0.0))
    with pytest.raises(SamplingError, match="the time was over at row 0 of 12"):
        method.run(bound, late)


def test_a_run_is_a_function_of_its_seed(bound):
    method = LiuWest(particles=30)
    options = RunOptions(draws=20, chains=2, seed=4)
    first, again = method.run(bound, options), method.run(bound, options)
    np.testing.assert_array_equal(first.theta, again.theta)
    assert np.all(first.theta[0] != first.theta[1])
