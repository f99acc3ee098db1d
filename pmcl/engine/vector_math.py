"""Elementary functions over whole arrays, written so that the compiler turns each loop into vector instructions.

A call of ``math.exp`` or ``math.atan2`` per particle costs 10 to 40 ns and cannot be vectorised; the branch-free
loops here cost 1 to 5 ns per element. Series are Taylor expansions on a reduced argument, long enough for an error of
a few units in the last place (tested against NumPy). No randomness and no allocation.
"""

# mypy: disable-error-code="call-arg, var-annotated"
from __future__ import annotations

import math

import numpy as np
from numba import types
from numba.extending import intrinsic

from pmcl.engine.compile import kernel

__all__ = [
    "IMPOSSIBLE", "any_nonzero", "atan2_into", "bits_of", "exp_into", "extremes", "float_of", "log_into", "maximum",
    "mix_into", "sincos_into", "total", "upper_tail_into",
]  # fmt: skip

# Adding and subtracting 1.5 * 2^52 rounds to the nearest integer and leaves it in the low bits of the mantissa.
_ROUND = 6755399441055744.0
_LOG2E = 1.4426950408889634
# ln 2 and pi / 2 in two and three parts, so that the reduced argument keeps its last bits (Cody and Waite, 1980).
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_HALF_PI_1, _HALF_PI_2, _HALF_PI_3 = 1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21
_TWO_OVER_PI = 2.0 / math.pi
_SMALLEST_EXPONENT = -700.0
_TAN_PI_16, _TAN_PI_8, _TAN_3PI_16 = math.tan(math.pi / 16), math.tan(math.pi / 8), math.tan(3 * math.pi / 16)
_ONE_BITS = 1023 << 52
_MANTISSA_BITS = (1 << 52) - 1
_ALL_BUT_SIGN = (1 << 63) - 1
# Where the middle of the series for the normal distribution's tail lies.
_TAIL_MIDDLE = 3.75
# The ordered bits of minus and plus infinity.
_GREATEST = 2047 << 52
_LEAST = _ALL_BUT_SIGN ^ -(1 << 52)

IMPOSSIBLE = -1e300
"""Stands for a log density of minus infinity where two such are subtracted."""


@intrinsic
def bits_of(typing_context, x):
    """Return the 64 bits of a float as an integer."""

    def generate(context, builder, signature, arguments):
        return builder.bitcast(arguments[0], context.get_value_type(types.int64))

    return types.int64(types.float64), generate


@intrinsic
def float_of(typing_context, bits):
    """Return the float that 64 bits spell."""

    def generate(context, builder, signature, arguments):
        return builder.bitcast(arguments[0], context.get_value_type(types.float64))

    return types.float64(types.int64), generate


@kernel
def _exp(a):
    """Return exp(a) for -700 <= a <= 700."""
    rounded = a * _LOG2E + _ROUND
    k = rounded - _ROUND
    r = (a - k * _LN2_HIGH) - k * _LN2_LOW
    p = 1.0 / 6227020800.0
    p = p * r + 1.0 / 479001600.0
    p = p * r + 1.0 / 39916800.0
    p = p * r + 1.0 / 3628800.0
    p = p * r + 1.0 / 362880.0
    p = p * r + 1.0 / 40320.0
    p = p * r + 1.0 / 5040.0
    p = p * r + 1.0 / 720.0
    p = p * r + 1.0 / 120.0
    p = p * r + 1.0 / 24.0
    p = p * r + 1.0 / 6.0
    p = p * r + 0.5
    p = p * r + 1.0
    p = p * r + 1.0
    # k sits in the low bits of `rounded`: shifted up it is the exponent of 2^k.
    return p * float_of((bits_of(rounded) + 1023) << 52)


@kernel
def exp_into(x, shift, out):
    """Write exp(x - shift) into `out`; arguments below -700 give exactly 0, NaN stays NaN."""
    for i in range(x.size):
        given = x[i] - shift
        value = _exp(max(given, _SMALLEST_EXPONENT))
        vanished = 0.0 if given <= _SMALLEST_EXPONENT else np.nan
        out[i] = value if given > _SMALLEST_EXPONENT else vanished


@kernel
def log_into(x, out):
    """Write log(x) into `out` for normal numbers x > 0; 0 and subnormal numbers give -inf, negative numbers NaN."""
    for i in range(x.size):
        bits = bits_of(x[i])
        m = float_of((bits & _MANTISSA_BITS) | _ONE_BITS)
        e = float((bits >> 52) - 1023)
        high = m > 1.4142135623730951
        m = 0.5 * m if high else m
        e = e + 1.0 if high else e
        s = (m - 1.0) / (m + 1.0)
        q = s * s
        p = 2.0 / 21.0
        p = p * q + 2.0 / 19.0
        p = p * q + 2.0 / 17.0
        p = p * q + 2.0 / 15.0
        p = p * q + 2.0 / 13.0
        p = p * q + 2.0 / 11.0
        p = p * q + 2.0 / 9.0
        p = p * q + 2.0 / 7.0
        p = p * q + 2.0 / 5.0
        p = p * q + 2.0 / 3.0
        value = e * _LN2_HIGH + (e * _LN2_LOW + (s * q * p + 2.0 * s))
        value = value if x[i] >= 2.2250738585072014e-308 else (-np.inf if x[i] >= 0.0 else np.nan)
        out[i] = value if x[i] < np.inf else x[i]


@kernel
def mix_into(target, other, log_weight, log_rest, draft):
    """Replace `target` by log((1 - w) exp(target) + w exp(other)), given log w and log(1 - w); `other` is lost."""
    for i in range(target.size):
        kept, added = target[i] + log_rest, other[i] + log_weight
        high = max(kept, added)
        target[i] = high if high > -math.inf else IMPOSSIBLE
        other[i] = min(kept, added) - target[i]
    exp_into(other, 0.0, draft)
    for i in range(target.size):
        draft[i] += 1.0
    log_into(draft, other)
    for i in range(target.size):
        target[i] += other[i]


@kernel
def sincos_into(angle, sine, cosine):
    """Write sin and cos of `angle` [rad]; accurate while abs(angle) stays below about 1e5."""
    for i in range(angle.size):
        a = angle[i]
        t = a * _TWO_OVER_PI + _ROUND
        k = t - _ROUND
        r = ((a - k * _HALF_PI_1) - k * _HALF_PI_2) - k * _HALF_PI_3
        q = r * r
        s = 1.0 / 355687428096000.0
        s = s * q - 1.0 / 1307674368000.0
        s = s * q + 1.0 / 6227020800.0
        s = s * q - 1.0 / 39916800.0
        s = s * q + 1.0 / 362880.0
        s = s * q - 1.0 / 5040.0
        s = s * q + 1.0 / 120.0
        s = s * q - 1.0 / 6.0
        s = s * q * r + r
        c = 1.0 / 20922789888000.0
        c = c * q - 1.0 / 87178291200.0
        c = c * q + 1.0 / 479001600.0
        c = c * q - 1.0 / 3628800.0
        c = c * q + 1.0 / 40320.0
        c = c * q - 1.0 / 720.0
        c = c * q + 1.0 / 24.0
        c = c * q - 0.5
        c = c * q + 1.0
        # The quadrant k mod 4 chooses which of the two is the sine, and the signs, without a branch.
        quadrant = k - 4.0 * (((k * 0.25 - 0.375) + _ROUND) - _ROUND)
        odd = (quadrant == 1.0) | (quadrant == 3.0)
        sine_value = c if odd else s
        cosine_value = s if odd else c
        sine[i] = -sine_value if quadrant >= 2.0 else sine_value
        cosine[i] = -cosine_value if (quadrant == 1.0) | (quadrant == 2.0) else cosine_value


@kernel
def atan2_into(y, x, out):
    """Write the angle of the vector (x, y) in [-pi, pi] into `out`; the zero vector gives 0, NaN gives NaN."""
    for i in range(x.size):
        u, v = abs(x[i]), abs(y[i])
        big, small = max(u, v), min(u, v)
        upper = small > _TAN_PI_8 * big
        centre = _TAN_3PI_16 if upper else _TAN_PI_16
        base = 3.0 * math.pi / 16.0 if upper else math.pi / 16.0
        bottom = big + centre * small
        a = (small - centre * big) / (bottom if bottom > 0.0 else 1.0)
        q = a * a
        p = 1.0 / 25.0
        p = p * q - 1.0 / 23.0
        p = p * q + 1.0 / 21.0
        p = p * q - 1.0 / 19.0
        p = p * q + 1.0 / 17.0
        p = p * q - 1.0 / 15.0
        p = p * q + 1.0 / 13.0
        p = p * q - 1.0 / 11.0
        p = p * q + 1.0 / 9.0
        p = p * q - 1.0 / 7.0
        p = p * q + 1.0 / 5.0
        p = p * q - 1.0 / 3.0
        angle = base + (p * q * a + a)
        angle = 0.5 * math.pi - angle if v > u else angle
        angle = math.pi - angle if x[i] < 0.0 else angle
        angle = angle if u + v > 0.0 else u + v  # 0, or NaN where one of the two is no number
        out[i] = -angle if y[i] < 0.0 else angle


@kernel
def upper_tail_into(x, out):
    """Write the probability that a standard normal exceeds x into `out`; NaN stays NaN.

    With a = |x| / sqrt(2), (1 + 2 a) exp(a^2) erfc(a) is a short polynomial in (a - 3.75) / (a + 3.75) (found by
    interpolation at Chebyshev nodes; the form is that of Shepherd and Laframboise, 1981). What is left of 12 digits far
    in the tail are those of a^2 in the exponential.
    """
    for i in range(x.size):
        a = abs(x[i]) * 0.7071067811865476
        t = (a - _TAIL_MIDDLE) / (a + _TAIL_MIDDLE)
        p = -7.225260619194277e-09
        p = p * t - 2.1058029585307645e-09
        p = p * t + 5.6485840750317384e-08
        p = p * t + 1.954533452648789e-08
        p = p * t - 3.0489454436446376e-07
        p = p * t - 5.245936101287481e-08
        p = p * t + 1.815120237053282e-06
        p = p * t - 9.773343223177137e-07
        p = p * t - 1.1497032779340276e-05
        p = p * t + 2.2386157422349037e-05
        p = p * t + 5.1677107377702595e-05
        p = p * t - 0.0002901547032081452
        p = p * t + 0.00029370418978795623
        p = p * t + 0.0017556259764536124
        p = p * t - 0.009746577566606022
        p = p * t + 0.02836227740583687
        p = p * t - 0.058693398832509555
        p = p * t + 0.09230432116076455
        p = p * t - 0.10880393012673702
        p = p * t + 0.08227673849018691
        p = p * t + 0.0035854154851112235
        p = p * t - 0.14024059858554924
        p = p * t + 1.2375126308378288
        far = 0.5 * p * _exp(max(-a * a, _SMALLEST_EXPONENT)) / (1.0 + 2.0 * a)
        far = far if -a * a > _SMALLEST_EXPONENT else (0.0 if a > 1.0 else np.nan)
        out[i] = 1.0 - far if x[i] < 0.0 else far


@kernel
def _ordered(bits):
    """Map the bits of floats to integers of the same order, and back: negative floats count downward."""
    return bits ^ ((bits >> 63) & _ALL_BUT_SIGN)


@kernel
def maximum(x):
    """Return the largest element; NaN counts as larger than infinity.

    The comparisons are of integers: the compiler turns only those into vector instructions, which is nine times faster.
    """
    best = _LEAST
    for i in range(x.size):
        best = max(best, _ordered(bits_of(x[i])))
    return float_of(_ordered(best))


@kernel
def extremes(x):
    """Return the smallest and the largest element of an array without NaN."""
    low, high = _GREATEST, _LEAST
    for i in range(x.size):
        value = _ordered(bits_of(x[i]))
        low, high = min(low, value), max(high, value)
    return float_of(_ordered(low)), float_of(_ordered(high))


@kernel
def any_nonzero(x):
    """Return whether any element differs from zero."""
    found = False
    for i in range(x.size):
        found |= x[i] != 0.0
    return found


@kernel(reorder=True)
def total(x):
    """Return the sum; NaN when any element is NaN (infinities of one sign stay infinite)."""
    value = 0.0
    for i in range(x.size):
        value += x[i]
    return value
