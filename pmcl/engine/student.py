"""Student's t and the normal distribution by one parameter: the inverse a of the degrees of freedom, 0 for the normal.

The noise is a standard variable in units of its scale (not of its standard deviation): what a changes is how often it
strays far.
"""

from __future__ import annotations

import math

from pmcl.engine.compile import kernel
from pmcl.engine.scalars import HALF_LOG_2PI
from pmcl.engine.vector_math import log_into

__all__ = [
    "LEAST_INVERSE", "interval_probability", "log_normal_tail", "log_upper_tail", "logs_of_deviations",
    "student_constant", "student_deviation", "student_logpdf", "upper_tail",
]  # fmt: skip

# Below this, differences of log gamma functions lose more digits than the series in a leaves out.
_NEARLY_NORMAL = 1e-4
_TINY = 1e-300
LEAST_INVERSE = 1e-10
"""Below this inverse of the degrees of freedom Student's t counts as normal for three deviates at once: log densities
ten standard deviations out differ by less than 1e-6 nat, and rounding of 1 + a r^2 would cost more."""


@kernel
def log_normal_tail(x):
    """Return the log of the probability that a standard normal exceeds x, also far out in the tail."""
    if x < 25.0:
        return math.log(0.5 * math.erfc(x * math.sqrt(0.5)))
    return -0.5 * x * x - math.log(x) - HALF_LOG_2PI - 1.0 / (x * x)


@kernel
def student_constant(a):
    """Return the log density at zero."""
    if a <= 0.0:
        return -HALF_LOG_2PI
    if a < _NEARLY_NORMAL:
        # Stirling's series for log gamma((v + 1) / 2) - log gamma(v / 2) - log(v / 2) / 2, v = 1 / a.
        return -HALF_LOG_2PI - 0.25 * a + a**3 / 24.0
    half = 0.5 / a
    return math.lgamma(half + 0.5) - math.lgamma(half) + 0.5 * math.log(a / math.pi)


@kernel
def student_logpdf(r, a, constant):
    """Return the log density at r; `constant` is that at zero."""
    if a <= 0.0:
        return constant - 0.5 * r * r
    return constant - 0.5 * (1.0 / a + 1.0) * math.log1p(a * r * r)


@kernel
def student_deviation(f, g, h, a):
    """Return how far three independent deviates lie out: :func:`logs_of_deviations` makes log densities of it."""
    if a <= 0.0:
        return f * f + g * g + h * h
    return (1.0 + a * f * f) * (1.0 + a * g * g) * (1.0 + a * h * h)


@kernel
def logs_of_deviations(deviation, a, constant, draft):
    """Turn deviations, in place, into log densities of three deviates; `constant` is three times that at zero.

    One logarithm serves all three. `a` must be zero, or no less than :data:`LEAST_INVERSE`.
    """
    if a <= 0.0:
        for i in range(deviation.size):
            deviation[i] = constant - 0.5 * deviation[i]
    else:
        power = 0.5 * (1.0 / a + 1.0)
        log_into(deviation, draft)
        for i in range(deviation.size):
            deviation[i] = constant - power * draft[i]


@kernel
def _beta_fraction(x, p, q):
    """Return the continued fraction of the incomplete beta function (Lentz's method; DLMF 8.17.22)."""
    c, d = 1.0, 1.0 - (p + q) * x / (p + 1.0)
    d = 1.0 / (d if abs(d) > _TINY else _TINY)
    value = d
    for m in range(1, 500):
        for odd in range(2):
            if odd == 0:
                term = m * (q - m) * x / ((p + 2.0 * m - 1.0) * (p + 2.0 * m))
            else:
                term = -(p + m) * (p + q + m) * x / ((p + 2.0 * m) * (p + 2.0 * m + 1.0))
            d = 1.0 + term * d
            d = 1.0 / (d if abs(d) > _TINY else _TINY)
            c = 1.0 + term / c
            c = c if abs(c) > _TINY else _TINY
            factor = c * d
            value *= factor
        if abs(factor - 1.0) < 1e-15:
            break
    return value


@kernel
def _log_incomplete_beta(x, complement, p, q):
    """Return the log of the regularised incomplete beta function I_x(p, q); `complement` is 1 - x."""
    if x <= 0.0:
        return -math.inf
    if complement <= 0.0:
        return 0.0
    log_front = math.lgamma(p + q) - math.lgamma(p) - math.lgamma(q) + p * math.log(x) + q * math.log(complement)
    if x < (p + 1.0) / (p + q + 2.0):
        return log_front - math.log(p) + math.log(_beta_fraction(x, p, q))
    return math.log1p(-math.exp(log_front - math.log(q) + math.log(_beta_fraction(complement, q, p))))


@kernel
def log_upper_tail(x, a):
    """Return the log of the probability of a value beyond x."""
    if a < _NEARLY_NORMAL:
        # Wallace, Bounds on normal approximations to Student's and the chi-square distributions, 1959.
        z = x if a <= 0.0 else math.copysign((8.0 + a) / (8.0 + 3.0 * a) * math.sqrt(math.log1p(a * x * x) / a), x)
        return log_normal_tail(z)
    if x == 0.0:
        return math.log(0.5)
    ratio = a * x * x
    far = 0.5 * math.exp(_log_incomplete_beta(1.0 / (1.0 + ratio), ratio / (1.0 + ratio), 0.5 / a, 0.5))
    return math.log(far) if x > 0.0 else math.log1p(-far)


@kernel
def upper_tail(x, a):
    """Return the probability of a value beyond x."""
    if a <= 0.0:
        return 0.5 * math.erfc(x * math.sqrt(0.5))
    return math.exp(log_upper_tail(x, a))


@kernel
def interval_probability(low, high, a):
    """Return the log of the probability of a value between `low` and `high`."""
    if low + high < 0.0:
        low, high = -high, -low
    near, far = upper_tail(low, a), upper_tail(high, a)
    if near > 1e-200:
        # Both are on the same side, or `near` is one half or more: the difference keeps its digits.
        return math.log(max(near - far, 1e-16 * near))
    log_near, log_far = log_upper_tail(low, a), log_upper_tail(high, a)
    return log_near + math.log1p(-math.exp(min(log_far - log_near, -1e-16)))
