"""Ideal readings along a path, and their slopes: what simulation, residuals and linearisation share."""

from __future__ import annotations

from functools import singledispatch
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.filtering.kernels.geometry import BEARING, RANGE, SIZE, ReadingGeometry, pack_geometry
from pmcl.filtering.kernels.landmarks import ideal_sightings
from pmcl.filtering.kernels.rays import cast_rays
from pmcl.models.tables import LandmarkSightings, RangeBeams

__all__ = ["beam_lengths", "ideal_readings", "reading_geometry"]

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


@ideal_readings.register
def _(table: RangeBeams, path: Float) -> Float:
    return beam_lengths(table, path)


def beam_lengths(table: RangeBeams, path: Float) -> Float:
    """Return the length of each beam's ray [m], shape (T, B), from poses `path` (T, >= 3)."""
    c, s = np.cos(path[:, 2, None]), np.sin(path[:, 2, None])
    mount = table.beam_pose
    origins = np.stack(
        [
            path[:, 0, None] + c * mount[:, 0] - s * mount[:, 1],
            path[:, 1, None] + s * mount[:, 0] + c * mount[:, 1],
            path[:, 2, None] + mount[:, 2],
        ],
        axis=-1,
    )
    return cast_rays(table.vertices, table.wall_start, table.wall_stop, origins)


@ideal_readings.register
def _(table: LandmarkSightings, path: Float) -> Float:
    return np.asarray(ideal_sightings(table, np.ascontiguousarray(path)))


def _relative(table: LandmarkSightings, path: Float, time: NDArray[np.int64]) -> tuple[Float, Float]:
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
    value = beam_lengths(table, reference)
    z = table.reading
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
    residual = [
        (table.range - table.range_scale[which] * distance - table.range_bias[which]) / table.range_std[which],
        _wrapped(table.bearing - bearing - table.bearing_bias[which]) / table.bearing_std[which],
        (table.size / (table.size_constant[which] * size_value) - 1.0) / table.size_std[which],
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
        (RANGE, table.range, distance, d_range),
        (BEARING, table.bearing, bearing, d_bearing),
        (SIZE, table.size, size_value, d_size),
    ):
        seen = np.flatnonzero(~np.isnan(z))
        jacobian = np.zeros((seen.size, size))
        jacobian[:, :3] = slope[seen]
        rows.append((time[seen], which[seen], np.full(seen.size, kind), z[seen], value[seen], jacobian, weight[seen]))
    return pack_geometry(n_steps, *(np.concatenate(column) for column in zip(*rows, strict=True)))


def _wrapped(angle: Float) -> Float:
    return np.asarray(angle - 2.0 * np.pi * np.floor(angle / (2.0 * np.pi) + 0.5))


def _inlier_share(log_inlier: Float, outlier_weight: Float, log_outlier: Float | float) -> Float:
    """Return the probability that each reading is no gross error."""
    with np.errstate(divide="ignore", over="ignore"):
        odds = np.log(outlier_weight) - np.log1p(-outlier_weight) + log_outlier - log_inlier
        return np.asarray(1.0 / (1.0 + np.exp(odds)))
