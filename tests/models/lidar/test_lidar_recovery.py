"""Parameters of simulated lidars are found again, at the rate that their intervals claim."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from pmcl.engine.compile import entry
from pmcl.engine.residuals import theta_logpdf
from pmcl.models import Lidar
from pmcl.simulations.lidar_room import simulate_lidar_room

LOGS = 40
# Intervals with 90 % probability miss in 4 of 40 logs; 10 or more happen in 5 of 1000 such tests.
MOST_MISSED = int(stats.binom.ppf(0.995, LOGS, 0.1))


@entry
def density_on_grid(statistics, points):
    """Return the log density of each of `points` (N, d)."""
    values = np.empty(points.shape[0])
    for k in range(points.shape[0]):
        values[k] = theta_logpdf(statistics, points[k])
    return values


def quantile_of_truth(sensor, seed, parameter, truth, exponent=1.0):
    """Return the posterior probability of less than the true value, the path and all other parameters being known."""
    log = simulate_lidar_room(12, seed, {parameter.name: truth}, sensor=sensor, n_rays=20)
    names = [each.name for each in sensor.parameters]
    theta = np.array([log.true_theta[name] for name in names])
    bound = Lidar(model=sensor.model, exponent=exponent).bind(log)
    table = bound.table(theta)
    path = log.true_poses.copy()
    statistics = bound.statistics(table, path, Lidar.ideal_readings(table, path), np.arange(theta.size), theta)
    # In equal steps of prior probability the posterior is the likelihood.
    probability = (np.arange(4000) + 0.5) / 4000
    points = np.tile(theta, (probability.size, 1))
    points[:, names.index(parameter.name)] = parameter.prior.ppf(probability)
    logp = density_on_grid(statistics, points)
    posterior = np.exp(logp - logp.max())
    below = posterior[parameter.prior.ppf(probability) < truth].sum()
    return below / posterior.sum()


def quantiles(name, exponent=1.0):
    """Return the quantile of the truth in each log's posterior; truths are drawn from the middle of the prior."""
    sensor = Lidar(model="beam", exponent=1.0)
    (parameter,) = (each for each in sensor.parameters if each.name == name)
    rng = np.random.default_rng(7)
    truths = parameter.prior.ppf(rng.uniform(0.05, 0.6, LOGS))
    return np.array([quantile_of_truth(sensor, seed, parameter, truth, exponent) for seed, truth in enumerate(truths)])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sigma_hit", "z_rand", "z_short", "z_max"])
def test_intervals_of_independent_beams_hold(name):
    found = quantiles(name)
    assert np.count_nonzero((found < 0.05) | (found > 0.95)) <= MOST_MISSED
    # They are not too wide either: half of the truths lie outside the middle half.
    assert 9 <= np.count_nonzero((found < 0.25) | (found > 0.75)) <= 31


@pytest.mark.slow
def test_tempered_intervals_of_independent_beams_are_wider():
    """The negative control: readings that count less make intervals too wide where beams are independent."""
    found = quantiles("sigma_hit", exponent=2 / 20)
    assert np.count_nonzero((found < 0.25) | (found > 0.75)) < 9
