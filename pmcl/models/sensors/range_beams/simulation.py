"""Draws of range readings, written again from the definition of the table: component by component, without kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.geometry import late_poses
from pmcl.models.sensors.range_beams.linearisation import beam_lengths
from pmcl.models.sensors.range_beams.table import RangeBeams, RangeExtras

__all__ = ["simulate"]

Float = NDArray[np.float64]


def simulate(table: RangeBeams, path: Float, rng: np.random.Generator) -> RangeBeams:
    """Draw readings of beams along a path (T, >= 3); see :meth:`pmcl.models.sensor.Sensor.simulate`."""
    if isinstance(table.extras, RangeExtras):
        return _with_extras(table, path, rng)
    shape = table.reading.shape
    # A ray that meets nothing is infinitely long; the density puts it at twice the longest reading.
    expected = np.minimum(table.scale * beam_lengths(table, path) + table.bias, 2.0 * table.max_range)
    reading = np.clip(expected + table.std * rng.standard_normal(shape), 0.0, table.max_range)
    gross = rng.random(shape) < table.outlier_weight
    reading = np.where(gross, table.max_range * rng.random(shape), reading)
    return table._replace(reading=np.where(np.isnan(table.reading), np.nan, reading))


def _noise(tail: float, shape: tuple[int, ...], rng: np.random.Generator) -> Float:
    noise = rng.standard_normal(shape)
    if tail > 0.0:
        noise *= np.sqrt((0.5 / tail) / rng.standard_gamma(0.5 / tail, shape))
    return noise


def _with_extras(table: RangeBeams, path: Float, rng: np.random.Generator) -> RangeBeams:
    poses, shape, longest = late_poses(path, table.extras.lag), table.reading.shape, table.max_range
    lengths = beam_lengths(table, poses)

    def expected(of: Float) -> Float:
        return np.asarray(np.minimum(table.scale * of + table.bias + table.extras.bias_at, 2.0 * longest))

    std = table.std * table.extras.std_factor[:, None] * (1.0 + table.extras.growth * np.minimum(lengths, longest))

    def echo(centre: Float, spread: Float) -> Float:
        return _rounded(np.clip(centre + spread * _noise(table.extras.tail, np.shape(centre), rng), 0.0, longest), table)

    other = np.zeros(shape, dtype=bool)
    reading = np.zeros(shape)
    for weight, drawn in _strangers(table, poses, lengths, expected, std, echo, rng):
        # The first that comes takes the reading: the order is that of the table's definition.
        takes = ~other & (rng.random(shape) < weight)
        reading[takes], other = drawn[takes], other | takes
    own = expected(lengths)
    if not table.extras.correlation.any():
        reading = np.where(other, reading, echo(own, std))
    else:
        reading = _correlated(table, path, reading, other, own, std, echo)
    return table._replace(reading=np.where(np.isnan(table.reading), np.nan, reading))


def _strangers(
    table: RangeBeams, poses: Float, lengths: Float, expected: Any, std: Float, echo: Any, rng: np.random.Generator
) -> list[tuple[Float, Float]]:
    """Return probability and draws of everything that is not the beam's own echo, first come first."""
    shape, longest = table.reading.shape, table.max_range
    own, full = expected(lengths), np.full(shape, longest)
    incidence = np.arccos(_cosines(table, poses))
    reflected = table.extras.specular_weight / (1.0 + np.exp((table.extras.specular_angle - incidence) / 0.1))
    begins = np.maximum(own, 0.0)
    far_enough = longest - begins > 0.1 * longest
    detour = np.where(far_enough, begins + (longest - begins) * rng.random(shape), longest)
    room = np.clip(own, 0.01, longest)
    short = -table.extras.short_length * np.log1p(rng.random(shape) * np.expm1(-room / table.extras.short_length))
    strangers = [
        (np.broadcast_to(table.outlier_weight, shape), longest * rng.random(shape)),
        (np.broadcast_to(table.extras.no_echo_weight, shape), full),
        (np.broadcast_to(table.extras.short_weight, shape), short),
        (reflected, detour),
    ]
    for x, y, radius, weight in table.extras.obstacles[::-1]:
        met = _obstacle_lengths(table, poses, x, y, radius)
        strangers.append((np.where(met < lengths, weight, 0.0), echo(expected(met), std)))
    side = rng.integers(2, size=shape)
    neighbour = np.take_along_axis(
        lengths, table.extras.neighbours[np.arange(shape[1]), side.reshape(-1, shape[1])], axis=1
    )
    strangers.append((np.broadcast_to(table.extras.talk_weight, shape), echo(expected(neighbour), std)))
    return strangers


def _rounded(raw: Float, table: RangeBeams) -> Float:
    """Return the middle of the cell that each unclipped reading falls into; cells end where readings do."""
    if table.extras.step == 0.0:
        return raw
    centre = np.floor(raw / table.extras.step + 0.5) * table.extras.step
    low, high = np.maximum(centre - 0.5 * table.extras.step, 0.0), np.minimum(centre + 0.5 * table.extras.step, table.max_range)
    middle = np.where((centre > 0.0) & (centre < table.max_range), centre, 0.5 * (low + high))
    return np.where((raw > 0.0) & (raw < table.max_range), middle, raw)


def _correlated(
    table: RangeBeams, path: Float, reading: Float, other: Any, own: Float, std: Float, echo: Any
) -> Float:
    """Draw row by row, each echo given the one before; missing rows break the chain."""
    prompt = late_poses(path, np.zeros(len(path)))
    before = np.minimum(
        table.scale * beam_lengths(table, prompt) + table.bias + table.extras.bias_at, 2.0 * table.max_range
    )
    lengths = beam_lengths(table, prompt)
    spread = table.std * table.extras.std_factor[:, None] * (1.0 + table.extras.growth * np.minimum(lengths, table.max_range))
    reading = reading.copy()
    for t in range(len(path)):
        centre, width = own[t].copy(), std[t].copy()
        if t > 0:
            last = np.where(np.isnan(table.reading[t - 1]), np.nan, reading[t - 1])
            residual = last - before[t - 1]
            with np.errstate(invalid="ignore"):
                related = (last > 0.0) & (last < table.max_range) & (np.abs(residual) < 4.0 * spread[t - 1])
            centre += np.where(related, table.extras.correlation * residual, 0.0)
            width *= np.where(related, np.sqrt(1.0 - table.extras.correlation**2), 1.0)
        reading[t] = np.where(other[t], reading[t], echo(centre, width))
    return reading


def _beams_at(table: RangeBeams, poses: Float) -> tuple[Float, Float, Float, Float]:
    """Return origins and unit directions of all beams, each (T, B)."""
    c, s = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
    mount = table.beam_pose
    x = poses[:, 0, None] + c * mount[:, 0] - s * mount[:, 1]
    y = poses[:, 1, None] + s * mount[:, 0] + c * mount[:, 1]
    angle = poses[:, 2, None] + mount[:, 2]
    return x, y, np.cos(angle), np.sin(angle)


def _obstacle_lengths(table: RangeBeams, poses: Float, x: float, y: float, radius: float) -> Float:
    """Return how far each beam runs to a disc; inf where it misses, or the robot stands in it."""
    from_x, from_y, dx, dy = _beams_at(table, poses)
    along = (x - from_x) * dx + (y - from_y) * dy
    inner = radius**2 - ((x - from_x) * dy - (y - from_y) * dx) ** 2
    length = along - np.sqrt(np.maximum(inner, 0.0))
    return np.where((inner > 0.0) & (length > 0.0), length, np.inf)


def _cosines(table: RangeBeams, poses: Float) -> Float:
    """Return the cosine of the angle of incidence at the wall that each beam's middle ray meets; 1 without a wall."""
    if not table.extras.specular_weight.any():
        return np.ones(table.reading.shape)
    x, y, dx, dy = _beams_at(table, poses)
    nearest, cosine = np.full(x.shape, np.inf), np.ones(x.shape)
    for start, stop in zip(table.vertices[table.wall_start], table.vertices[table.wall_stop], strict=True):
        ex, ey = stop - start
        with np.errstate(divide="ignore", invalid="ignore"):
            determinant = dx * ey - dy * ex
            length = ((start[0] - x) * ey - (start[1] - y) * ex) / determinant
            share = ((start[0] - x) * dy - (start[1] - y) * dx) / determinant
        met = (length > 0.0) & (share >= 0.0) & (share <= 1.0) & (length < nearest)
        nearest = np.where(met, length, nearest)
        cosine = np.where(met, np.abs(determinant) / np.hypot(ex, ey), cosine)
    return np.minimum(cosine, 1.0)
