"""The echo of the wall that a beam points at: what it should read, given the echo that the same beam read before."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.compile import kernel
from pmcl.geometry import late_poses
from pmcl.models.sensors.range_beams.kernels.components.drawing import BeamsAlongPath, beam_std, expected_reading
from pmcl.models.sensors.range_beams.kernels.components.noise import draw_echo
from pmcl.models.sensors.range_beams.kernels.rows import BEAM_ROWS, CENTRE, EXPECTED, READING, STD, WIDTH, first_row
from pmcl.models.sensors.range_beams.linearisation import beam_lengths
from pmcl.models.sensors.range_beams.table import OPEN_RAY, RangeBeams, extras_of

__all__ = ["draw_own_echoes", "expect_own_echo"]

Float = NDArray[np.float64]

# An echo that was off by more standard deviations than this was none of the wall, and is unrelated to the next one.
_RELATED = 4.0


@kernel
def expect_own_echo(sensor, beam, first, stride, n, scratch):
    """Fill the rows READING, EXPECTED and STD of one beam, and CENTRE and WIDTH, which count the echo before in."""
    rows = scratch[first_row(sensor) :]
    z, expected, std, centre, width = rows[READING], rows[EXPECTED], rows[STD], rows[CENTRE], rows[WIDTH]
    inverse = rows[BEAM_ROWS + beam]
    far, longest = OPEN_RAY * sensor.max_range, sensor.max_range
    scale, bias, base, growth = sensor.scale[beam], sensor.bias[beam], sensor.std[beam], sensor.extras.growth[beam]
    bias_at, factor = sensor.extras.bias_at, sensor.extras.std_factor
    if stride == 0:
        value, shift, spread = sensor.reading[first, beam], bias + bias_at[first, beam], factor[first]
        for i in range(n):
            length = 1.0 / inverse[i]
            z[i] = value
            expected[i] = min(scale * length + shift, far)
            std[i] = base * spread * (1.0 + growth * min(length, longest))
            centre[i], width[i] = expected[i], std[i]
    else:
        for i in range(n):
            row = first + stride * i
            length = 1.0 / inverse[i]
            z[i] = sensor.reading[row, beam]
            expected[i] = min(scale * length + bias + bias_at[row, beam], far)
            std[i] = base * factor[row] * (1.0 + growth * min(length, longest))
            centre[i], width[i] = expected[i], std[i]
    correlation = sensor.extras.correlation[beam]
    if correlation == 0.0:
        return
    inverse_before = rows[BEAM_ROWS + 2 * sensor.reading.shape[1] + beam]
    narrower = math.sqrt(1.0 - correlation * correlation)
    for i in range(n):
        row = first + stride * i - 1
        if row < 0:
            continue
        before, length = sensor.reading[row, beam], 1.0 / inverse_before[i]
        residual = before - min(scale * length + bias + bias_at[row, beam], far)
        spread = base * factor[row] * (1.0 + growth * min(length, longest))
        if 0.0 < before < longest and abs(residual) < _RELATED * spread:
            centre[i] += correlation * residual
            width[i] *= narrower


def draw_own_echoes(
    table: RangeBeams, path: Float, beams: BeamsAlongPath, reading: Float, taken: NDArray[np.bool_],
    rng: np.random.Generator,
) -> Float:  # fmt: skip
    """Return readings (T, B) in which all that are not yet `taken` are echoes of the wall.

    Parameters
    ----------
    table : RangeBeams
        The table, with extras.
    path : ndarray, shape (T, >= 3)
        The path, without delay.
    beams : BeamsAlongPath
        The beams along it.
    reading : ndarray, shape (T, B)
        The readings that are something else [m], where `taken`.
    taken : ndarray of bool, shape (T, B)
        Which readings are.
    rng : numpy.random.Generator
        Source of randomness.
    """
    correlation = extras_of(table).correlation
    if not correlation.any():
        return np.where(taken, reading, draw_echo(table, beams.expected, beams.std, rng))
    # Row by row: each echo is drawn given the one before, and a missing row breaks the chain.
    lengths = beam_lengths(table, late_poses(path, np.zeros(len(path))))
    before, spread = expected_reading(table, lengths), beam_std(table, lengths)
    reading = reading.copy()
    for t in range(len(path)):
        centre, width = beams.expected[t].copy(), beams.std[t].copy()
        if t > 0:
            last = np.where(np.isnan(table.reading[t - 1]), np.nan, reading[t - 1])
            residual = last - before[t - 1]
            with np.errstate(invalid="ignore"):
                related = (last > 0.0) & (last < table.max_range) & (np.abs(residual) < _RELATED * spread[t - 1])
            centre += np.where(related, correlation * residual, 0.0)
            width *= np.where(related, np.sqrt(1.0 - correlation**2), 1.0)
        reading[t] = np.where(taken[t], reading[t], draw_echo(table, centre, width, rng))
    return reading
