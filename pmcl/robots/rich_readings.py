"""Draws from richer sensor tables, written again from their definition: component by component, without kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.filtering.predict import beam_lengths
from pmcl.geometry import wrap
from pmcl.models.rich_tables import RichLandmarks, RichRangeBeams

__all__ = ["draw_range_readings", "draw_sighting_readings"]

Float = NDArray[np.float64]


def _late(path: Float, lag: Float) -> Float:
    """Return the poses at which readings were taken; headings follow the shorter way round."""
    poses = path[:, :3].copy()
    poses[:, 2] = np.unwrap(poses[:, 2])
    step = np.diff(poses, axis=0, prepend=poses[:1])
    return np.asarray(poses - lag[: len(poses), None] * step)


def _noise(tail: float, shape: tuple[int, ...], rng: np.random.Generator) -> Float:
    noise = rng.standard_normal(shape)
    if tail > 0.0:
        noise *= np.sqrt((0.5 / tail) / rng.standard_gamma(0.5 / tail, shape))
    return noise


def draw_range_readings(table: RichRangeBeams, path: Float, rng: np.random.Generator) -> RichRangeBeams:
    """Draw readings of beams along a path (T, >= 3); see :func:`pmcl.robots.simulate.simulate_readings`."""
    poses, shape, longest = _late(path, table.lag), table.reading.shape, table.max_range
    lengths = beam_lengths(table, poses)

    def expected(of: Float) -> Float:
        return np.asarray(np.minimum(table.scale * of + table.bias + table.bias_at, 2.0 * longest))

    std = table.std * table.std_factor[:, None] * (1.0 + table.growth * np.minimum(lengths, longest))

    def echo(centre: Float, spread: Float) -> Float:
        return _rounded(np.clip(centre + spread * _noise(table.tail, np.shape(centre), rng), 0.0, longest), table)

    other = np.zeros(shape, dtype=bool)
    reading = np.zeros(shape)
    for weight, drawn in _strangers(table, poses, lengths, expected, std, echo, rng):
        # The first that comes takes the reading: the order is that of the table's definition.
        takes = ~other & (rng.random(shape) < weight)
        reading[takes], other = drawn[takes], other | takes
    own = expected(lengths)
    if not table.correlation.any():
        reading = np.where(other, reading, echo(own, std))
    else:
        reading = _correlated(table, path, reading, other, own, std, echo)
    return table._replace(reading=np.where(np.isnan(table.reading), np.nan, reading))


def _strangers(
    table: RichRangeBeams, poses: Float, lengths: Float, expected: Any, std: Float, echo: Any, rng: np.random.Generator
) -> list[tuple[Float, Float]]:
    """Return probability and draws of everything that is not the beam's own echo, first come first."""
    shape, longest = table.reading.shape, table.max_range
    own, full = expected(lengths), np.full(shape, longest)
    incidence = np.arccos(_cosines(table, poses))
    reflected = table.specular_weight / (1.0 + np.exp((table.specular_angle - incidence) / 0.1))
    begins = np.maximum(own, 0.0)
    far_enough = longest - begins > 0.1 * longest
    detour = np.where(far_enough, begins + (longest - begins) * rng.random(shape), longest)
    room = np.clip(own, 0.01, longest)
    short = -table.short_length * np.log1p(rng.random(shape) * np.expm1(-room / table.short_length))
    strangers = [
        (np.broadcast_to(table.outlier_weight, shape), longest * rng.random(shape)),
        (np.broadcast_to(table.no_echo_weight, shape), full),
        (np.broadcast_to(table.short_weight, shape), short),
        (reflected, detour),
    ]
    for x, y, radius, weight in table.obstacles[::-1]:
        met = _obstacle_lengths(table, poses, x, y, radius)
        strangers.append((np.where(met < lengths, weight, 0.0), echo(expected(met), std)))
    side = rng.integers(2, size=shape)
    neighbour = np.take_along_axis(
        lengths, table.neighbours[np.arange(shape[1]), side.reshape(-1, shape[1])], axis=1
    )
    strangers.append((np.broadcast_to(table.talk_weight, shape), echo(expected(neighbour), std)))
    return strangers


def _rounded(raw: Float, table: RichRangeBeams) -> Float:
    """Return the middle of the cell that each unclipped reading falls into; cells end where readings do."""
    if table.step == 0.0:
        return raw
    centre = np.floor(raw / table.step + 0.5) * table.step
    low, high = np.maximum(centre - 0.5 * table.step, 0.0), np.minimum(centre + 0.5 * table.step, table.max_range)
    middle = np.where((centre > 0.0) & (centre < table.max_range), centre, 0.5 * (low + high))
    return np.where((raw > 0.0) & (raw < table.max_range), middle, raw)


def _correlated(
    table: RichRangeBeams, path: Float, reading: Float, other: Any, own: Float, std: Float, echo: Any
) -> Float:
    """Draw row by row, each echo given the one before; missing rows break the chain."""
    prompt = _late(path, np.zeros(len(path)))
    before = np.minimum(
        table.scale * beam_lengths(table, prompt) + table.bias + table.bias_at, 2.0 * table.max_range
    )
    lengths = beam_lengths(table, prompt)
    spread = table.std * table.std_factor[:, None] * (1.0 + table.growth * np.minimum(lengths, table.max_range))
    reading = reading.copy()
    for t in range(len(path)):
        centre, width = own[t].copy(), std[t].copy()
        if t > 0:
            last = np.where(np.isnan(table.reading[t - 1]), np.nan, reading[t - 1])
            residual = last - before[t - 1]
            with np.errstate(invalid="ignore"):
                related = (last > 0.0) & (last < table.max_range) & (np.abs(residual) < 4.0 * spread[t - 1])
            centre += np.where(related, table.correlation * residual, 0.0)
            width *= np.where(related, np.sqrt(1.0 - table.correlation**2), 1.0)
        reading[t] = np.where(other[t], reading[t], echo(centre, width))
    return reading


def _beams_at(table: RichRangeBeams, poses: Float) -> tuple[Float, Float, Float, Float]:
    """Return origins and unit directions of all beams, each (T, B)."""
    c, s = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
    mount = table.beam_pose
    x = poses[:, 0, None] + c * mount[:, 0] - s * mount[:, 1]
    y = poses[:, 1, None] + s * mount[:, 0] + c * mount[:, 1]
    angle = poses[:, 2, None] + mount[:, 2]
    return x, y, np.cos(angle), np.sin(angle)


def _obstacle_lengths(table: RichRangeBeams, poses: Float, x: float, y: float, radius: float) -> Float:
    """Return how far each beam runs to a disc; inf where it misses, or the robot stands in it."""
    from_x, from_y, dx, dy = _beams_at(table, poses)
    along = (x - from_x) * dx + (y - from_y) * dy
    inner = radius**2 - ((x - from_x) * dy - (y - from_y) * dx) ** 2
    length = along - np.sqrt(np.maximum(inner, 0.0))
    return np.where((inner > 0.0) & (length > 0.0), length, np.inf)


def _cosines(table: RichRangeBeams, poses: Float) -> Float:
    """Return the cosine of the angle of incidence at the wall that each beam's middle ray meets; 1 without a wall."""
    if not table.specular_weight.any():
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


def draw_sighting_readings(table: RichLandmarks, path: Float, rng: np.random.Generator) -> RichLandmarks:
    """Draw sightings along a path (T, >= 3); see :func:`pmcl.robots.simulate.simulate_readings`."""
    named, n, n_landmarks = table.landmark, table.landmark.size, table.position.shape[0]
    poses = _late(path, table.lag)[table.time]
    which = named.copy()
    if n_landmarks > 1:
        misread = rng.random(n) < table.misread_weight[named]
        another = (named + rng.integers(1, n_landmarks, n)) % n_landmarks
        which = np.where(misread, another, named)
    centre, std, distance = _expected_sightings(table, which, poses)
    noise = rng.standard_normal((3, n))
    ideal_size = table.size_constant[which] / distance**2
    sound = (
        centre[0] + std[0] * noise[0],
        wrap(centre[1] + std[1] * noise[1]),
        ideal_size * (1.0 + table.size_std[which] * noise[2]),
    )
    wild = (
        table.max_range * rng.random(n),
        np.pi * (2.0 * rng.random(n) - 1.0),
        table.size_constant[named] * rng.random(n),
    )
    gross = rng.random(n) < table.outlier_weight[named]
    new = [
        np.where(np.isnan(seen), np.nan, np.where(gross, strange, plain))
        for seen, strange, plain in zip((table.range, table.bearing, table.size), wild, sound, strict=True)
    ]
    before, spread, _ = _expected_sightings(table, named, _late(path, np.zeros(len(path)))[table.time])
    plain = (which == named) & ~gross
    for channel, correlation in enumerate((table.range_correlation, table.bearing_correlation)):
        if correlation.any():
            c = correlation[named]
            _remember(table, new[channel], channel == 1, c, plain, centre[channel], std[channel] * noise[channel],
                      before[channel], spread[channel])
    return table._replace(range=new[0], bearing=new[1], size=new[2])


def _expected_sightings(table: RichLandmarks, which: Any, poses: Float) -> tuple[Float, Float, Float]:
    """Return centre and standard deviation (2, N) of distances and bearings of landmarks `which`; true distances."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    delta = table.position[which] - poses[:, :2]
    ahead = c * delta[:, 0] + s * delta[:, 1] - table.sensor_pose[0]
    aside = c * delta[:, 1] - s * delta[:, 0] - table.sensor_pose[1]
    distance, bearing = np.hypot(ahead, aside), np.arctan2(aside, ahead) - table.sensor_pose[2]
    told = distance * (1.0 - table.depth + table.depth * np.cos(bearing))
    centre = [table.range_scale[which] * told + table.range_bias[which], bearing + table.bearing_bias[which]]
    std = [
        table.range_std[which] * (1.0 + table.range_growth[which] * distance),
        table.bearing_std[which] * (1.0 + table.bearing_falloff[which] / np.maximum(distance, 0.1)),
    ]
    return np.array(centre), np.array(std), distance


def _remember(
    table: RichLandmarks, reading: Float, is_angle: bool, correlation: Float, plain: Any, centre: Float, error: Float,
    before: Float, spread: Float,
) -> None:
    """Redraw, one after another and in place, readings whose landmark was read in the row before.

    `centre` and `error` are what was drawn without memory; `before` and `spread` what the state of its own row, not
    late, would have let one expect of each reading.
    """
    last: dict[tuple[int, int], int] = {}
    for k, where in enumerate(zip(table.time.tolist(), table.landmark.tolist(), strict=True)):
        earlier = last.get((where[0] - 1, where[1]))
        last[where] = k
        if earlier is None or not plain[k]:
            continue
        residual = reading[earlier] - before[earlier]
        residual = wrap(residual) if is_angle else residual
        if not abs(residual) < 4.0 * spread[earlier] or np.isnan(reading[k]):
            continue
        drawn = centre[k] + correlation[k] * residual + np.sqrt(1.0 - correlation[k] ** 2) * error[k]
        reading[k] = wrap(drawn) if is_angle else drawn
