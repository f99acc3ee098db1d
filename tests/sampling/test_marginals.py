"""Shapes of single parameters."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from pmcl.sampling.marginals import Marginals, marginals_of

# mypy: disable-error-code="no-untyped-def"

SKEWED = Marginals(np.array([0.5, -2.0]), np.array([2.0, 0.1]), np.array([-0.6, 0.4]), np.array([0.7, 1.4]))


def test_values_go_there_and_back():
    z = np.random.default_rng(1).standard_normal((50, 2)) * 3.0
    np.testing.assert_allclose(SKEWED.to_normal(SKEWED.from_normal(z)), z, rtol=1e-9, atol=1e-9)


def test_slope_against_finite_differences():
    u = SKEWED.from_normal(np.random.default_rng(2).standard_normal((20, 2)))
    step = 1e-6 * SKEWED.scale
    slope = (SKEWED.to_normal(u + step) - SKEWED.to_normal(u - step)) / (2.0 * step)
    normal, log_slope = SKEWED.to_normal_with_slope(u)
    np.testing.assert_allclose(normal, SKEWED.to_normal(u), rtol=1e-12)
    np.testing.assert_allclose(log_slope, np.log(slope).sum(axis=1), atol=1e-6)


def test_draws_of_a_normal_distribution_have_no_shape():
    fitted = marginals_of(np.random.default_rng(3).normal(2.0, 0.1, (20_000, 1)))
    z = np.linspace(-2.0, 2.0, 9)[:, None]
    np.testing.assert_allclose(fitted.from_normal(z), 2.0 + 0.1 * z, atol=0.006)


@pytest.mark.parametrize("draws", [200, 5000])
def test_a_noise_that_may_be_nearly_zero_becomes_normal(draws):
    """Its logarithm has a long tail to the left."""
    noise = stats.truncnorm(-2.0, np.inf, loc=0.026, scale=0.013)
    fitted = marginals_of(np.log(noise.rvs((draws, 1), random_state=4)))
    later = np.log(noise.rvs((20_000, 1), random_state=5))
    before, after = stats.skew(later)[0], stats.skew(fitted.to_normal(later))[0]
    assert before < -1.5
    assert abs(after) < 0.5
    assert stats.kurtosis(fitted.to_normal(later))[0] < 0.2 * stats.kurtosis(later)[0]


@pytest.mark.parametrize("values", [[1.0], [1.0, 1.0, 1.0], [0.0, 1e9, 1.0, 2.0]])
def test_few_and_odd_draws_give_a_shape(values):
    fitted = marginals_of(np.array(values)[:, None])
    there = fitted.from_normal(np.array([[-2.0], [0.0], [2.0]]))
    assert np.isfinite(there).all()
    assert (np.diff(there[:, 0]) > 0.0).all()


def test_tails_are_never_lighter_than_normal_ones():
    """Draws that lack their tails must not make proposals that lack them: chains would stay where those never lead."""
    fitted = marginals_of(np.random.default_rng(6).uniform(-1.0, 1.0, (240, 1)))
    assert fitted.tail[0] <= 1.0
    assert np.abs(fitted.from_normal(np.array([[-4.0], [4.0]]))).min() > 1.5
