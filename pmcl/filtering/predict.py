"""Ideal readings along a path, and their slopes: what simulation, residuals and linearisation share."""

from __future__ import annotations

from functools import singledispatch
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.filtering.kernels.geometry import BEARING, RANGE, SIZE, ReadingGeometry, RichGeometry, pack_geometry
from pmcl.filtering.kernels.landmarks import ideal_sightings
from pmcl.filtering.kernels.rays import cast_rays
from pmcl.models.rich_tables import RichLandmarks, RichRangeBeams
from pmcl.models.tables import LandmarkSightings, RangeBeams

__all__ = ["beam_lengths", "ideal_readings", "moved_geometry", "reading_geometry"]

Float = NDArray[np.float64]

# A path may deviate from its reference by about this much; where a beam's length is not linear over that distance
# (it crosses the edge of a wall), the beam is left out of the linearisation.
_PROBE_STEP = (0.03, 0.03, 0.03)
_TINY = 1e-5


@singledispatch
def ideal_readings(table: Any, path: Float) -> Any:
    """Return what a sensor would ideally read along a path, before bias, scale and noise.

    Parameters
    ----------
    table : NamedTuple
        A sensor table.
    path : ndarray, shape (T, D)
        States; T may be less than the log's.

    Returns
    -------
    RangeBeams : ndarray, shape (T, B)
        Ray lengths [m], inf where no wall is met.
    LandmarkSightings : ndarray, shape (N, 2)
        Distance [m] and bearing in the sensor frame [rad] of each sighting up to T.
    None
        For a table type that registers nothing here; its statistics and simulation are its own business.
    """
    return None


@ideal_readings.register(RangeBeams)
@ideal_readings.register(RichRangeBeams)
def _(table: Any, path: Float) -> Float:
    return beam_lengths(table, path)


def beam_lengths(table: RangeBeams | RichRangeBeams, path: Float) -> Float:
    """Return the length of each beam's ray [m], shape (T, B), from poses `path` (T, >= 3).

    Of a beam with a width it is that of the shortest of the five rays across its cone.
    """
    lengths = _ray_lengths(table, table.beam_pose, path)
    if isinstance(table, RichRangeBeams) and table.width.any():
        for share in (-0.5, -0.25, 0.25, 0.5):
            mount = table.beam_pose.copy()
            mount[:, 2] += share * table.width
            lengths = np.minimum(lengths, _ray_lengths(table, mount, path))
    return lengths


def _ray_lengths(table: RangeBeams | RichRangeBeams, mount: Float, path: Float) -> Float:
    c, s = np.cos(path[:, 2, None]), np.sin(path[:, 2, None])
    origins = np.stack(
        [
            path[:, 0, None] + c * mount[:, 0] - s * mount[:, 1],
            path[:, 1, None] + s * mount[:, 0] + c * mount[:, 1],
            path[:, 2, None] + mount[:, 2],
        ],
        axis=-1,
    )
    return cast_rays(table.vertices, table.wall_start, table.wall_stop, origins)


@ideal_readings.register(LandmarkSightings)
@ideal_readings.register(RichLandmarks)
def _(table: Any, path: Float) -> Float:
    return np.asarray(ideal_sightings(table, np.ascontiguousarray(path)))


def _relative(table: Any, path: Float, time: NDArray[np.int64]) -> tuple[Float, Float]:
    """Return each sighted landmark in the frame of the mounted sensor, without its yaw."""
    pose = path[time]
    delta = table.position[table.landmark[: time.size]] - pose[:, :2]
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    ahead = c * delta[:, 0] + s * delta[:, 1] - table.sensor_pose[0]
    aside = c * delta[:, 1] - s * delta[:, 0] - table.sensor_pose[1]
    return ahead, aside


@singledispatch
def reading_geometry(table: Any, reference: Float) -> Any:
    """Linearise a sensor's readings once around a reference trajectory (T, D).

    Returns
    -------
    NamedTuple or None
        What :func:`pmcl.filtering.kernels.contract.linear_information` takes; None when the table type registers
        nothing here, so that no Gaussian transport is possible with it.
    """
    return None


@reading_geometry.register
def _(table: RangeBeams, reference: Float) -> ReadingGeometry:
    return _beam_geometry(table, reference)


@reading_geometry.register
def _(table: RichRangeBeams, reference: Float) -> RichGeometry:
    gross = (table.outlier_weight, table.no_echo_weight, table.short_weight, table.talk_weight)
    sound = np.prod([1.0 - weight for weight in gross], axis=0)
    rows = reference.shape[0]
    std = table.std * table.std_factor[:rows, None]
    made = _beam_geometry(
        table._replace(reading=table.reading[:rows] - table.bias_at[:rows], std=std, outlier_weight=1.0 - sound),
        reference,
    )
    made = made._replace(reading=np.ascontiguousarray(made.reading + table.bias_at[_times_of(made), made.channel]))
    return _enriched(made, reference, made.value.copy(), np.ones(made.value.size))


def _times_of(geometry: ReadingGeometry | RichGeometry) -> NDArray[np.int64]:
    return np.repeat(np.arange(geometry.first.size - 1), np.diff(geometry.first))


def _enriched(geometry: ReadingGeometry, reference: Float, distance: Float, depth: Float) -> RichGeometry:
    """Add distance, depth, and how fast the ideal value changes along the reference."""
    step = np.diff(reference, axis=0, prepend=reference[:1])[_times_of(geometry)]
    return RichGeometry(*geometry, np.einsum("kd,kd->k", geometry.jacobian, step), distance, depth)


def _beam_geometry(table: Any, reference: Float) -> ReadingGeometry:
    value = beam_lengths(table, reference)
    z = table.reading[: reference.shape[0]]
    usable = ~np.isnan(z) & np.isfinite(value) & (z > 0.0) & (z < table.max_range)
    jacobian = np.zeros((*value.shape, reference.shape[1]))
    for d, step in enumerate(_PROBE_STEP):
        slopes = []
        for size in (_TINY, step):
            shift = np.zeros(reference.shape[1])
            shift[d] = size
            ahead, behind = beam_lengths(table, reference + shift), beam_lengths(table, reference - shift)
            with np.errstate(invalid="ignore"):
                slopes.append((ahead - behind) / (2.0 * size))
                bend = np.abs(ahead + behind - 2.0 * value)
            usable &= np.isfinite(bend)
        jacobian[..., d] = slopes[0]
        with np.errstate(invalid="ignore"):
            usable &= (np.abs(slopes[0] - slopes[1]) * step < 0.5 * table.std) & (bend < 0.5 * table.std)
    residual = np.where(usable, z - np.minimum(table.scale * value + table.bias, 2.0 * table.max_range), 0.0)
    log_inlier = -0.5 * (residual / table.std) ** 2 - np.log(table.std * np.sqrt(2.0 * np.pi))
    weight = _inlier_share(log_inlier, np.broadcast_to(table.outlier_weight, z.shape), -np.log(table.max_range))
    time, beam = np.nonzero(usable)
    at = (time, beam)
    kind = np.full(time.size, RANGE)
    return pack_geometry(reference.shape[0], time, beam, kind, z[at], value[at], jacobian[at], weight[at])


@reading_geometry.register
def _(table: LandmarkSightings, reference: Float) -> ReadingGeometry:
    return _sighting_geometry(table, reference)


@reading_geometry.register
def _(table: RichLandmarks, reference: Float) -> RichGeometry:
    gross = 1.0 - (1.0 - table.outlier_weight) * (1.0 - table.misread_weight)
    made = _sighting_geometry(table._replace(outlier_weight=gross), reference)
    delta = table.position[made.channel] - reference[_times_of(made), :2]
    heading = reference[_times_of(made), 2]
    c, s = np.cos(heading), np.sin(heading)
    ahead = c * delta[:, 0] + s * delta[:, 1] - table.sensor_pose[0]
    aside = c * delta[:, 1] - s * delta[:, 0] - table.sensor_pose[1]
    depth = np.cos(np.arctan2(aside, ahead) - table.sensor_pose[2])
    return _enriched(made, reference, np.hypot(ahead, aside), depth)


def _sighting_geometry(table: Any, reference: Float) -> ReadingGeometry:
    n_steps, size = reference.shape
    time = table.time[: table.first[n_steps]]
    which = table.landmark[: time.size]
    ahead, aside = _relative(table, reference, time)
    distance = np.maximum(np.hypot(ahead, aside), 1e-9)
    # d(ahead, aside) / d(x, y, heading), with the mount: moving the robot moves the landmark the other way.
    c, s = np.cos(reference[time, 2]), np.sin(reference[time, 2])
    d_ahead = np.stack([-c, -s, aside + table.sensor_pose[1]], axis=-1)
    d_aside = np.stack([s, -c, -(ahead + table.sensor_pose[0])], axis=-1)
    d_range = (ahead[:, None] * d_ahead + aside[:, None] * d_aside) / distance[:, None]
    d_bearing = (ahead[:, None] * d_aside - aside[:, None] * d_ahead) / distance[:, None] ** 2
    bearing = np.arctan2(aside, ahead) - table.sensor_pose[2]
    size_value, d_size = distance**-2.0, (-2.0 * distance**-3.0)[:, None] * d_range
    ranges, bearings, sizes = (values[: time.size] for values in (table.range, table.bearing, table.size))
    residual = [
        (ranges - table.range_scale[which] * distance - table.range_bias[which]) / table.range_std[which],
        _wrapped(bearings - bearing - table.bearing_bias[which]) / table.bearing_std[which],
        (sizes / (table.size_constant[which] * size_value) - 1.0) / table.size_std[which],
    ]
    scales = [table.range_std[which], table.bearing_std[which], table.size_std[which]]
    outlier = [np.log(table.max_range), np.log(2.0 * np.pi), 0.0]
    log_inlier, log_outlier = np.zeros(time.size), np.zeros(time.size)
    for r, std, density in zip(residual, scales, outlier, strict=True):
        seen = ~np.isnan(r)
        log_inlier += np.where(seen, -0.5 * r**2 - np.log(std * np.sqrt(2.0 * np.pi)), 0.0)
        log_outlier -= density * seen
    weight = _inlier_share(log_inlier, table.outlier_weight[which], log_outlier)
    rows = []
    for kind, z, value, slope in (
        (RANGE, ranges, distance, d_range),
        (BEARING, bearings, bearing, d_bearing),
        (SIZE, sizes, size_value, d_size),
    ):
        seen = np.flatnonzero(~np.isnan(z))
        jacobian = np.zeros((seen.size, size))
        jacobian[:, :3] = slope[seen]
        rows.append((time[seen], which[seen], np.full(seen.size, kind), z[seen], value[seen], jacobian, weight[seen]))
    return pack_geometry(n_steps, *(np.concatenate(column) for column in zip(*rows, strict=True)))


_BEAM_PLACE = ("beam_pose", "vertices", "width")
_LANDMARK_PLACE = ("position", "sensor_pose")


def _same_place(table: Any, made_from: Any, fields: tuple[str, ...]) -> bool:
    for name in fields:
        value = getattr(table, name, None)
        if value is None or value is (other := getattr(made_from, name)):
            continue
        if not np.array_equal(value, other):
            return False
    return True


@singledispatch
def moved_geometry(table: Any, made_from: Any, geometry: Any, reference: Float) -> Any:
    """Return a linearisation for a table whose mount or map is not that of the table it was made from.

    Parameters
    ----------
    table : NamedTuple
        A sensor table under some theta.
    made_from : NamedTuple
        The table that `geometry` was made from.
    geometry : NamedTuple
        From :func:`reading_geometry`.
    reference : ndarray, shape (T, D)
        The reference trajectory.

    Returns
    -------
    NamedTuple
        `geometry` itself where nothing has moved; else one with the ideal values that `table` has at the reference.
        Slopes stay. Cost: O(readings) where something has moved.
    """
    return geometry


@moved_geometry.register(RangeBeams)
@moved_geometry.register(RichRangeBeams)
def _(table: Any, made_from: Any, geometry: Any, reference: Float) -> Any:
    if _same_place(table, made_from, _BEAM_PLACE):
        return geometry
    lengths = beam_lengths(table, reference)[_times_of(geometry), geometry.channel]
    # A beam that meets nothing from its new place says as little as it can: what it said before.
    return geometry._replace(value=np.where(np.isfinite(lengths), lengths, geometry.value))


@moved_geometry.register(LandmarkSightings)
@moved_geometry.register(RichLandmarks)
def _(table: Any, made_from: Any, geometry: Any, reference: Float) -> Any:
    if _same_place(table, made_from, _LANDMARK_PLACE):
        return geometry
    place = reference[_times_of(geometry)]
    delta = table.position[geometry.channel] - place[:, :2]
    c, s = np.cos(place[:, 2]), np.sin(place[:, 2])
    ahead = c * delta[:, 0] + s * delta[:, 1] - table.sensor_pose[0]
    aside = c * delta[:, 1] - s * delta[:, 0] - table.sensor_pose[1]
    distance, bearing = np.maximum(np.hypot(ahead, aside), 1e-9), np.arctan2(aside, ahead) - table.sensor_pose[2]
    return geometry._replace(value=np.choose(geometry.kind, [distance, bearing, distance**-2.0]))


def _wrapped(angle: Float) -> Float:
    return np.asarray(angle - 2.0 * np.pi * np.floor(angle / (2.0 * np.pi) + 0.5))


def _inlier_share(log_inlier: Float, outlier_weight: Float, log_outlier: Float | float) -> Float:
    """Return the probability that each reading is no gross error."""
    with np.errstate(divide="ignore", over="ignore"):
        odds = np.log(outlier_weight) - np.log1p(-outlier_weight) + log_outlier - log_inlier
        return np.asarray(1.0 / (1.0 + np.exp(odds)))
