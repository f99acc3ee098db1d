"""An echo from a known distance: Gaussian or Student t around what is expected, clipped to the range, and rounded.

A clipped reading has a probability instead of a density. The density of a rounded one is constant over its cell. A
sensor that rounds also prints 0 and its greatest range for echoes that lie less than half a step inside.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.compile import kernel
from pmcl.engine.contract import NOT_ASKED
from pmcl.engine.student import (
    interval_probability,
    log_upper_tail,
    student_constant,
    student_logpdf,
    upper_tail,
)
from pmcl.engine.vector_math import log_into, upper_tail_into
from pmcl.models.sensors.range_beams.table import RangeBeams, extras_of

__all__ = ["below_is_costly", "draw_echo", "echo_below", "echo_below_into", "echo_logpdf", "echo_logpdf_into"]

Float = NDArray[np.float64]

# Multiples of a step are computed with this error, as a share of the step.
_ROUNDING_ERROR = 1e-6


@kernel
def _ends(sensor):
    """Return below what echoes are printed as 0, and from where on as the greatest range [m].

    The greatest range may lie between two multiples of the step; if it is the lower one's own cell that it lies in,
    only echoes beyond it are printed as the greatest range.
    """
    step, longest = sensor.extras.step, sensor.max_range
    if step == 0.0:
        return 0.0, longest
    last = math.floor(longest / step + 0.5) * step
    return 0.5 * step, (last - 0.5 * step if last > longest - _ROUNDING_ERROR * step else longest)


@kernel
def _cell(sensor, z):
    """Return the cell of a rounded reading between the two ends, cut to where readings may lie."""
    centre = math.floor(z / sensor.extras.step + 0.5) * sensor.extras.step
    return centre - 0.5 * sensor.extras.step, min(centre + 0.5 * sensor.extras.step, sensor.max_range)


@kernel
def _clipped_or_rounded_logpdf(sensor, z, centre, std):
    tail = sensor.extras.tail
    shortest, longest = _ends(sensor)
    if z <= 0.0 or z < shortest:
        return log_upper_tail((centre - shortest) / std, tail)
    if z >= longest:
        return log_upper_tail((longest - centre) / std, tail)
    low, high = _cell(sensor, z)
    return interval_probability((low - centre) / std, (high - centre) / std, tail) - math.log(high - low)


@kernel
def echo_logpdf(sensor, z, centre, std):
    """Return the log density of one echo around `centre` [m] with scale `std` [m]."""
    if z <= 0.0 or z >= sensor.max_range or sensor.extras.step > 0.0:
        return _clipped_or_rounded_logpdf(sensor, z, centre, std)
    return student_logpdf((z - centre) / std, sensor.extras.tail, student_constant(sensor.extras.tail)) - math.log(std)


@kernel
def echo_logpdf_into(sensor, n, z, centre, std, even, draft, out):
    """Write the log density of n echoes into `out`; NaN where `z` is NaN.

    `even` says that `std` is one number; `draft` is work space.
    """
    tail, constant = sensor.extras.tail, student_constant(sensor.extras.tail)
    if even:
        level = math.log(std[0])
        for i in range(n):
            out[i] = level
    else:
        log_into(std, out)
    if tail > 0.0:
        for i in range(n):
            r = (z[i] - centre[i]) / std[i]
            draft[i] = 1.0 + tail * r * r
        log_into(draft, draft)
        power = 0.5 * (1.0 / tail + 1.0)
        for i in range(n):
            out[i] = constant - power * draft[i] - out[i]
    else:
        for i in range(n):
            r = (z[i] - centre[i]) / std[i]
            out[i] = constant - out[i] - 0.5 * r * r
    # Most rows hold no clipped reading, and a loop that only looks for them is a vector loop.
    clipped = False
    for i in range(n):
        clipped |= (z[i] <= 0.0) | (z[i] >= sensor.max_range)
    if not (clipped or sensor.extras.step > 0.0):
        return
    for i in range(n):
        if z[i] <= 0.0 or z[i] >= sensor.max_range or (sensor.extras.step > 0.0 and z[i] > 0.0):
            out[i] = _clipped_or_rounded_logpdf(sensor, z[i], centre[i], std[i])


@kernel
def echo_below(sensor, z, centre, std):
    """Return the probabilities that an echo reads less than `z`, and less or the same."""
    tail = sensor.extras.tail
    shortest, longest = _ends(sensor)
    if z <= 0.0 or z < shortest:
        return 0.0, upper_tail((centre - shortest) / std, tail)
    if z >= longest:
        return upper_tail((centre - longest) / std, tail), 1.0
    if sensor.extras.step > 0.0:
        low, high = _cell(sensor, z)
        return upper_tail((centre - low) / std, tail), upper_tail((centre - high) / std, tail)
    value = upper_tail((centre - z) / std, tail)
    return value, value


@kernel
def below_is_costly(sensor):
    """Return whether the distribution function of an echo costs much more than its density."""
    return sensor.extras.tail > 0.0 or sensor.extras.step > 0.0


@kernel
def echo_below_into(sensor, z, centre, std, draft, low, high):
    """Write the probabilities that echoes read less than `z`, and less or the same; `draft` is work space.

    Where these are costly, columns are left alone whose `low` says that they are not asked.
    """
    n, longest = low.size, sensor.max_range
    if below_is_costly(sensor):
        for i in range(n):
            if low[i] != NOT_ASKED:
                low[i], high[i] = echo_below(sensor, z, centre[i], std[i])
        return
    reached = min(max(z, 0.0), longest)
    for i in range(n):
        draft[i] = (centre[i] - reached) / std[i]
    upper_tail_into(draft, low)
    for i in range(n):
        high[i] = 1.0 if z >= longest else low[i]
        low[i] = 0.0 if z <= 0.0 else low[i]


def draw_echo(table: RangeBeams, centre: Float, std: Float, rng: np.random.Generator) -> Float:
    """Draw echoes around `centre` [m] with scale `std` [m], arrays of one shape."""
    tail, noise = extras_of(table).tail, rng.standard_normal(np.shape(centre))
    if tail > 0.0:
        noise *= np.sqrt((0.5 / tail) / rng.standard_gamma(0.5 / tail, np.shape(centre)))
    return _rounded(table, np.clip(centre + std * noise, 0.0, table.max_range))


def _rounded(table: RangeBeams, reading: Float) -> Float:
    """Return the multiple of the step next to each reading; the greatest range is printed as it is."""
    step, longest = extras_of(table).step, table.max_range
    if step == 0.0:
        return reading
    centre = np.floor(reading / step + 0.5) * step
    return np.where((reading < longest) & (centre < longest - _ROUNDING_ERROR * step), centre, longest)
