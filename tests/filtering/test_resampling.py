"""Normalising, drawing and resampling, with the weights that break such code."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from pmcl.engine.compile import entry
from pmcl.filtering.kernels.resampling import SCHEMES, draw_index, multinomial_into, resample
from pmcl.filtering.kernels.weighing import ALL_ZERO, FINE, NOT_A_NUMBER, normalise

# mypy: disable-error-code="no-untyped-def"

# Zero at both ends and in the middle, one far above the others, one far below.
WEIGHTS = np.array([0.0, 0.3, 1e-12, 2.5, 0.0, 0.7, 1.0, 0.05, 0.45, 0.0])


@entry
def count_children(scheme, weights, weight_sum, rng, repeats, counts, squares):
    """Sum the numbers of children of each particle, and their squares, over repeated resampling."""
    n = weights.size
    ancestors, scratch, children = np.empty(n, np.int64), np.empty((2, n)), np.empty(n)
    for _ in range(repeats):
        resample(scheme, weights, weight_sum, rng, ancestors, scratch)
        for i in range(n):
            children[i] = 0.0
        for i in range(n):
            children[ancestors[i]] += 1.0
        for i in range(n):
            counts[i] += children[i]
            squares[i] += children[i] ** 2


@entry
def count_draws(weights, weight_sum, rng, repeats, counts):
    for _ in range(repeats):
        counts[draw_index(weights, weight_sum, rng)] += 1.0


@entry
def resample_once(scheme, weights, weight_sum, rng, ancestors, scratch):
    resample(scheme, weights, weight_sum, rng, ancestors, scratch)


@entry
def multinomial_from(weights, weight_sum, rng, first, ancestors, scratch):
    multinomial_into(weights, weight_sum, rng, first, ancestors, scratch)


def _children(scheme, weights, rng, repeats=100_000, weight_sum=None):
    counts, squares = np.zeros(weights.size), np.zeros(weights.size)
    total = float(weights.sum()) if weight_sum is None else weight_sum
    count_children(SCHEMES[scheme], weights, total, rng, repeats, counts, squares)
    mean = counts / repeats
    mcse = np.sqrt(np.maximum(squares / repeats - mean**2, 0.0) / repeats)
    return mean, mcse


@pytest.mark.parametrize("scheme", SCHEMES)
def test_expected_numbers_of_children_are_exact(scheme, rng):
    """Unbiased within 5 Monte Carlo standard errors; the smallest bias that matters, 1 % of a child, is 8 of them."""
    mean, mcse = _children(scheme, WEIGHTS, rng)
    expected = WEIGHTS.size * WEIGHTS / WEIGHTS.sum()
    assert (np.abs(mean - expected) <= 5.0 * mcse + 1e-9).all(), (mean - expected) / np.maximum(mcse, 1e-12)
    assert 0.01 * WEIGHTS.size > 8.0 * mcse.max()


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_wrong_weight_is_noticed(scheme, rng):
    """The same comparison fails for weights that differ by two per cent of a child."""
    skewed = WEIGHTS.copy()
    skewed[1] += 0.01
    mean, mcse = _children(scheme, skewed, rng)
    expected = WEIGHTS.size * WEIGHTS / WEIGHTS.sum()
    assert (np.abs(mean - expected) > 5.0 * mcse + 1e-9).any()


@pytest.mark.parametrize("scheme", SCHEMES)
def test_schemes_differ_in_variance_as_they_should(scheme, rng):
    """Numbers of children are binomial for multinomial resampling, and scatter less for the other schemes."""
    weights = np.array([0.5, 1.5, 1.0, 0.25, 0.75])
    _, mcse = _children(scheme, weights, rng, repeats=20_000)
    variance = mcse**2 * 20_000
    share = weights / weights.sum()
    binomial = 5.0 * share * (1.0 - share)
    if scheme == "multinomial":
        np.testing.assert_allclose(variance, binomial, rtol=0.1)
    else:
        assert variance.sum() < 0.8 * binomial.sum()


@pytest.mark.parametrize("scheme", SCHEMES)
def test_zero_weights_have_no_children(scheme, rng):
    mean, _ = _children(scheme, WEIGHTS, rng, repeats=20_000)
    np.testing.assert_array_equal(mean[WEIGHTS == 0.0], 0.0)
    lonely = np.zeros(7)
    lonely[3] = 1e-300
    mean, _ = _children(scheme, lonely, rng, repeats=100)
    np.testing.assert_array_equal(mean, 7.0 * (lonely > 0.0))


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("excess", [1e-12, 1e-3])
def test_a_sum_above_that_of_the_weights_leads_to_no_zero_weight(scheme, excess, rng):
    """Rounding makes weights sum to less than what was computed: the search must stop at the last positive one."""
    weights = np.array([0.25, 0.25, 0.5, 0.0, 0.0])
    mean, _ = _children(scheme, weights, rng, repeats=20_000, weight_sum=1.0 + excess)
    np.testing.assert_array_equal(mean[3:], 0.0)
    assert mean.sum() == pytest.approx(5.0)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_one_particle_is_its_own_parent(scheme, rng):
    ancestors = np.full(1, -1, dtype=np.int64)
    resample_once(SCHEMES[scheme], np.array([0.3]), 0.3, rng, ancestors, np.empty((2, 1)))
    assert ancestors[0] == 0


def test_multinomial_leaves_the_kept_slot_alone(rng):
    ancestors = np.full(6, -1, dtype=np.int64)
    multinomial_from(np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), 1.0, rng, 1, ancestors, np.empty((2, 6)))
    np.testing.assert_array_equal(ancestors, [-1, 2, 2, 2, 2, 2])


def test_free_ancestors_of_the_conditional_filter_are_independent(rng):
    """Number of children among n - 1 free slots: binomial mean and variance, whatever the kept slot does."""
    weights, repeats = np.array([0.2, 0.5, 0.3]), 20_000
    ancestors, children = np.empty(3, dtype=np.int64), np.zeros((repeats, 3))
    for k in range(repeats):
        multinomial_from(weights, 1.0, rng, 1, ancestors, np.empty((2, 3)))
        children[k] = np.bincount(ancestors[1:], minlength=3)
    observed = [np.count_nonzero((children == pattern).all(axis=1)) for pattern in _patterns()]
    expected = [repeats * stats.multinomial.pmf(pattern, 2, weights) for pattern in _patterns()]
    assert stats.chisquare(observed, expected).pvalue > 1e-6


def _patterns():
    return [(a, b, 2 - a - b) for a in range(3) for b in range(3 - a)]


def test_draw_index_frequencies(rng):
    counts = np.zeros(WEIGHTS.size)
    count_draws(WEIGHTS, float(WEIGHTS.sum()), rng, 200_000, counts)
    np.testing.assert_array_equal(counts[WEIGHTS == 0.0], 0.0)
    likely = WEIGHTS > 1e-6
    expected = 200_000 * WEIGHTS[likely] / WEIGHTS.sum()
    assert np.abs(counts[likely].sum() - 200_000) <= 1
    assert stats.chisquare(counts[likely], expected * counts[likely].sum() / expected.sum()).pvalue > 1e-6


def test_draw_index_never_runs_past_the_last_positive_weight(rng):
    counts = np.zeros(4)
    count_draws(np.array([0.0, 0.4, 0.6, 0.0]), 1.5, rng, 10_000, counts)
    assert counts[0] == counts[3] == 0.0


def _normalise(log_weights):
    log_weights = np.asarray(log_weights, dtype=float)
    kept, weights = log_weights.copy(), np.empty_like(log_weights)
    status, greatest, total = normalise(log_weights, weights)
    np.testing.assert_array_equal(log_weights, kept)
    return status, greatest, total, weights


@pytest.mark.parametrize(
    "log_weights",
    [
        [0.0],
        [-1e4, -1e4 - 1.0, -1e4 + 2.0],
        [700.0, 710.0, 1e5],
        [-np.inf, -3.0, -np.inf],
        [-1e300, -1.0],
        [5e-324, -5e-324, 0.0],
        np.linspace(-750.0, 0.0, 33),
    ],
)
def test_normalised_weights(log_weights):
    status, greatest, total, weights = _normalise(log_weights)
    log_weights = np.asarray(log_weights, dtype=float)
    assert status == FINE
    assert greatest == log_weights.max()
    expected = np.exp(log_weights - greatest)
    # What is 700 nats below the best counts as nothing.
    expected[log_weights - greatest < -700.0] = 0.0
    np.testing.assert_allclose(weights, expected, rtol=1e-14)
    assert total == pytest.approx(expected.sum(), rel=1e-14)


@pytest.mark.parametrize("n", [1, 2, 9, 64])
def test_weights_that_are_all_zero_are_an_answer_of_their_own(n):
    assert _normalise(np.full(n, -np.inf))[0] == ALL_ZERO


@pytest.mark.parametrize("n", [1, 2, 9, 64])
def test_one_weight_that_is_no_number_is_found_wherever_it_is(n):
    for k in range(n):
        log_weights = np.linspace(-3.0, 0.0, n)
        log_weights[k] = np.nan
        assert _normalise(log_weights)[0] == NOT_A_NUMBER
        log_weights[(k + 1) % n] = np.nan if n == 1 else -np.inf
        assert _normalise(log_weights)[0] == NOT_A_NUMBER


def test_a_weight_of_plus_infinity_is_no_answer():
    # exp(inf - inf) is not a number; a density of inf must not become a particle of weight zero.
    assert _normalise([0.0, np.inf, 1.0])[0] == NOT_A_NUMBER
