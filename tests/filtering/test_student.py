"""Student's t by the inverse of its degrees of freedom, against scipy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from pmcl.engine.compile import entry
from pmcl.engine.student import (
    LEAST_INVERSE,
    interval_probability,
    log_upper_tail,
    logs_of_deviations,
    student_constant,
    student_deviation,
    student_logpdf,
    upper_tail,
)

TAILS = [0.0, 1e-12, 1e-6, 9e-5, 2e-4, 1e-3, 0.03, 0.1, 0.25, 0.45, 0.5]
X = np.concatenate([-np.geomspace(1e-3, 40.0, 25), [0.0], np.geomspace(1e-3, 40.0, 25)])


def law(a):
    return stats.norm() if a == 0.0 else stats.t(1.0 / a)


@pytest.mark.parametrize("a", TAILS)
def test_density(a):
    constant = student_constant(a)
    np.testing.assert_allclose([student_logpdf(x, a, constant) for x in X], law(a).logpdf(X), rtol=1e-7, atol=1e-9)


@entry
def density_of_three(r, a):
    out, draft = np.empty(r.shape[1]), np.empty(r.shape[1])
    for i in range(out.size):
        out[i] = student_deviation(r[0, i], r[1, i], r[2, i], a)
    logs_of_deviations(out, a, 3.0 * student_constant(a), draft)
    return out


@pytest.mark.parametrize("a", [0.0, LEAST_INVERSE, *(a for a in TAILS if a > LEAST_INVERSE)])
def test_density_of_three_at_once(a, rng):
    r = rng.permuted(np.stack([X, X, X]), axis=1)
    exact = law(a).logpdf(r).sum(axis=0)
    # Rounding of 1 + a r^2 counts where a is next to nothing.
    np.testing.assert_allclose(density_of_three(r, a), exact, rtol=1e-7, atol=1e-15 / a if a else 1e-9)


@pytest.mark.parametrize("a", TAILS)
def test_tail(a):
    # Between the normal law and 1 / a = 10^4 the tail is an approximation, off by a few parts in ten thousand far out.
    rtol = 3e-3 if 0.0 < a < 1e-4 else 1e-9
    mid = np.abs(X) < 6.0
    np.testing.assert_allclose([upper_tail(x, a) for x in X[mid]], law(a).sf(X[mid]), rtol=rtol)
    exact = law(a).logsf(X) if a == 0.0 else np.log(law(a).sf(X))
    found = np.array([log_upper_tail(x, a) for x in X])
    np.testing.assert_allclose(found[np.isfinite(exact)], exact[np.isfinite(exact)], rtol=max(rtol, 1e-7), atol=1e-13)


@pytest.mark.parametrize("a", TAILS)
@pytest.mark.parametrize(("low", "high"), [(-0.3, 0.2), (1.0, 1.2), (-3.0, -2.9), (-1.0, 4.0), (7.0, 7.5), (-0.1, 9.0)])
def test_interval(a, low, high):
    exact = law(a).sf(low) - law(a).sf(high) if low > 0.0 else law(a).cdf(high) - law(a).cdf(low)
    rtol = 3e-3 if 0.0 < a < 1e-4 else 1e-8
    assert math.exp(interval_probability(low, high, a)) == pytest.approx(exact, rel=rtol)


def test_interval_far_out_is_a_number():
    for low in (30.0, -31.0):
        value = interval_probability(low, low + 1.0, 0.0)
        exact = stats.norm.logsf(30.0) + math.log1p(-math.exp(stats.norm.logsf(31.0) - stats.norm.logsf(30.0)))
        assert value == pytest.approx(exact, rel=1e-6)
