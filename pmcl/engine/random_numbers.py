"""Many random numbers at once: standard normal, exponential and Student deviates for a whole array.

A call of ``Generator.standard_normal`` from compiled code goes through a function pointer for each number. Here the
generator is asked twice per array, for the state of a xoroshiro128++ (Blackman and Vigna 2021) that stays in registers,
and ziggurats of 256 layers (Marsaglia and Tsang 2000) turn its 64 bits into a deviate: 8 bits choose the layer, the
others the place in it. One number in seventy falls outside its rectangle and is finished by the generator itself.
The draws are exact, and a seed determines them all. For 500 particles a number takes three quarters of the time of
NumPy's, for 25 about the same (tests/benchmarks/test_random_numbers_speed.py); a filter needs four numbers for each
particle and step, some tenth of its time.
"""

# mypy: disable-error-code="call-arg, assignment"
from __future__ import annotations

import math

import numpy as np

from pmcl.engine.compile import kernel
from pmcl.engine.vector_math import bits_of, exp_into, float_of, sincos_into

__all__ = ["exponentials_into", "normals_into", "students_into"]

_LAYERS = 256
# Below this inverse of the degrees of freedom a series in it is more exact than a difference from 1.
_NEARLY_NORMAL = 1e-8
# Where the tail begins, so that 255 rectangles and the base strip have one area and the top closes.
_NORMAL_TAIL, _EXPONENTIAL_TAIL = 3.6541528853610088, 7.69711747013104972
_STEPS = 2.0**55
_RADIANS = math.pi / _STEPS
# The finalizer of SplitMix64 spreads 53 random bits over 64.
_FIRST, _SECOND, _GOLDEN = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB), np.uint64(0x9E3779B97F4A7C15)
# By how much xoroshiro128++ turns and shifts.
_B15, _B17, _B21, _B28, _B36, _B47, _B49 = (np.uint64(bits) for bits in (15, 17, 21, 28, 36, 47, 49))
_LAYER_BITS = np.uint64(_LAYERS - 1)


def _ziggurat(density, inverse, tail, tail_area):
    """Return the layers' widths per step, their surely accepted steps, and the density at their edges (257,)."""
    area = tail * density(tail) + tail_area
    edges = [area / density(tail), tail]
    while len(edges) < _LAYERS:
        edges.append(inverse(area / edges[-1] + density(edges[-1])))
    x = np.array([*edges, 0.0])
    densities = np.array([density(value) for value in x])
    return x[:-1] / _STEPS, np.floor(x[1:] / x[:-1] * _STEPS).astype(np.int64), densities


_NORMAL_WIDTH, _NORMAL_SURE, _NORMAL_DENSITY = _ziggurat(
    lambda x: math.exp(-0.5 * x * x),
    lambda y: math.sqrt(-2.0 * math.log(y)),
    _NORMAL_TAIL,
    math.sqrt(0.5 * math.pi) * math.erfc(_NORMAL_TAIL * math.sqrt(0.5)),
)
_EXPONENTIAL_WIDTH, _EXPONENTIAL_SURE, _EXPONENTIAL_DENSITY = _ziggurat(
    lambda x: math.exp(-x), lambda y: -math.log(y), _EXPONENTIAL_TAIL, math.exp(-_EXPONENTIAL_TAIL)
)


@kernel
def _mix(bits):
    bits = (bits ^ (bits >> np.uint64(30))) * _FIRST
    bits = (bits ^ (bits >> np.uint64(27))) * _SECOND
    return bits ^ (bits >> np.uint64(31))


@kernel
def _first_state(rng):
    high, low = np.uint64(rng.random() * 2.0**53), np.uint64(rng.random() * 2.0**53)
    return _mix(high + _GOLDEN), _mix(low + _GOLDEN) | np.uint64(1)


@kernel
def _next(a, b):
    """Return 64 bits and the next state."""
    c, total = a ^ b, a + b
    bits = ((total << _B17) | (total >> _B47)) + a
    return bits, ((a << _B49) | (a >> _B15)) ^ c ^ (c << _B21), (c << _B28) | (c >> _B36)


@kernel
def _again_normal(rng, layer, value):
    """Finish a normal deviate that fell outside its layer's rectangle."""
    while True:
        if layer == 0:
            x, y = 1.0, 0.0
            while 2.0 * y < x * x:
                x, y = -math.log(1.0 - rng.random()) / _NORMAL_TAIL, -math.log(1.0 - rng.random())
            return math.copysign(_NORMAL_TAIL + x, value)
        low, high = _NORMAL_DENSITY[layer], _NORMAL_DENSITY[layer + 1]
        if low + rng.random() * (high - low) < math.exp(-0.5 * value * value):
            return value
        layer, place = int(_LAYERS * rng.random()), int(_STEPS * (2.0 * rng.random() - 1.0))
        value = place * _NORMAL_WIDTH[layer]
        if abs(place) < _NORMAL_SURE[layer]:
            return value


@kernel
def normals_into(rng, out, outside):
    """Fill `out` (rows, n) with independent standard normal deviates; `outside` (n,) is work space.

    The deviates outside their rectangles are finished after each row: calls within the loop would drive the state of
    the generator from the registers, which doubles the time.
    """
    a, b = _first_state(rng)
    for d in range(out.shape[0]):
        row = out[d]
        count = 0
        for i in range(row.size):
            bits, a, b = _next(a, b)
            layer, place = np.int64(bits & _LAYER_BITS), np.int64(bits) >> 8
            row[i] = place * _NORMAL_WIDTH[layer]
            outside[count] = float_of(_LAYERS * i + layer)
            count += abs(place) >= _NORMAL_SURE[layer]
        for k in range(count):
            i, layer = divmod(bits_of(outside[k]), _LAYERS)
            row[i] = _again_normal(rng, layer, row[i])


@kernel
def _again_exponential(rng, layer, value):
    """Finish an exponential deviate that fell outside its layer's rectangle."""
    while True:
        if layer == 0:
            return _EXPONENTIAL_TAIL - math.log(1.0 - rng.random())
        low, high = _EXPONENTIAL_DENSITY[layer], _EXPONENTIAL_DENSITY[layer + 1]
        if low + rng.random() * (high - low) < math.exp(-value):
            return value
        layer, place = int(_LAYERS * rng.random()), int(_STEPS * rng.random())
        value = place * _EXPONENTIAL_WIDTH[layer]
        if place < _EXPONENTIAL_SURE[layer]:
            return value


@kernel
def exponentials_into(rng, out, outside):
    """Fill `out` (n,) with independent standard exponential deviates; `outside` (n,) is work space."""
    a, b = _first_state(rng)
    count = 0
    for i in range(out.size):
        bits, a, b = _next(a, b)
        layer, place = np.int64(bits & _LAYER_BITS), np.int64(bits >> np.uint64(9))
        out[i] = place * _EXPONENTIAL_WIDTH[layer]
        outside[count] = float_of(_LAYERS * i + layer)
        count += place >= _EXPONENTIAL_SURE[layer]
    for k in range(count):
        i, layer = divmod(bits_of(outside[k]), _LAYERS)
        out[i] = _again_exponential(rng, layer, out[i])


@kernel
def students_into(rng, out, a, work):
    """Fill `out` (rows, n) with independent deviates of Student's t with 1 / a degrees of freedom, a > 0.

    With an exponential deviate E and a uniform angle, ``sqrt((exp(2 a E) - 1) / a) cos(angle)`` is such a deviate
    (Bailey 1994, Polar generation of random variates with the t-distribution, Mathematics of Computation 62; for a = 0
    it is the method of Box and Muller). `work` (3, n) is work space.
    """
    angle, sine, cosine = work[0], work[1], work[2]
    for d in range(out.shape[0]):
        row = out[d]
        exponentials_into(rng, row, angle)
        first, second = _first_state(rng)
        for i in range(row.size):
            bits, first, second = _next(first, second)
            angle[i] = (np.int64(bits) >> 8) * _RADIANS
        sincos_into(angle, sine, cosine)
        if a < _NEARLY_NORMAL:
            for i in range(row.size):
                row[i] = math.sqrt(2.0 * row[i] * (1.0 + a * row[i])) * cosine[i]
        else:
            for i in range(row.size):
                row[i] *= 2.0 * a
            exp_into(row, 0.0, angle)
            for i in range(row.size):
                row[i] = math.sqrt((angle[i] - 1.0) / a) * cosine[i]
