"""Ideal sightings along a path, and their slopes: what residuals, simulation and the transport move share."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.linear_readings import (
    BEARING,
    RANGE,
    SIZE,
    LinearReadings,
    add_linear_extras,
    earlier_part,
    empty_readings,
    fitted_readings,
    inlier_share,
    pack_readings,
    same_fields,
    times_of,
)
from pmcl.geometry import wrap
from pmcl.models.sensor import ReadingIndex
from pmcl.models.sensors.landmarks.kernels.plain import ideal_sightings
from pmcl.models.sensors.landmarks.table import LandmarkExtras, LandmarkSightings
from pmcl.models.sensors.late_readings import reading_poses

__all__ = [
    "covariates", "empty_like", "fitted_linearisation", "ideal", "linearise", "moved_linearisation",
    "relative_positions",
]  # fmt: skip

Float = NDArray[np.float64]


def ideal(table: LandmarkSightings, path: Float) -> Float:
    """Return distance [m] and bearing in the sensor frame [rad] of each sighting along a path (T, D), (N, 2)."""
    return np.asarray(ideal_sightings(table, np.ascontiguousarray(path)))


def relative_positions(table: LandmarkSightings, which: NDArray[np.int64], poses: Float) -> tuple[Float, Float]:
    """Return how far landmarks `which` (N,) lie ahead of the sensor at `poses` (N, >= 3), and aside [m], each (N,).

    The frame is that of the mounted sensor, but turned as the robot is: the yaw of the mount does not count.
    """
    delta = table.position[which] - poses[:, :2]
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    ahead = c * delta[:, 0] + s * delta[:, 1] - table.sensor_pose[0]
    aside = c * delta[:, 1] - s * delta[:, 0] - table.sensor_pose[1]
    return ahead, aside


def linearise(table: LandmarkSightings, reference: Float) -> LinearReadings:
    """Linearise sightings around a reference (T, D); see :meth:`pmcl.models.sensor.Sensor.linearise`."""
    if not isinstance(table.extras, LandmarkExtras):
        return _linear_readings(table, reference)
    gross = 1.0 - (1.0 - table.outlier_weight) * (1.0 - table.extras.misread_weight)
    poses = reading_poses(table, reference)
    readings = _linear_readings(table._replace(outlier_weight=gross), poses)
    ahead, aside = relative_positions(table, readings.channel, poses[times_of(readings)])
    depth = np.cos(np.arctan2(aside, ahead) - table.sensor_pose[2])
    return add_linear_extras(readings, table, reference, np.hypot(ahead, aside), depth)


def _linear_readings(table: Any, reference: Float) -> LinearReadings:
    n_steps, size = reference.shape
    time = table.time[: table.first[n_steps]]
    which = table.landmark[: time.size]
    ahead, aside = relative_positions(table, which, reference[time])
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
        wrap(bearings - bearing - table.bearing_bias[which]) / table.bearing_std[which],
        (sizes / (table.size_constant[which] * size_value) - 1.0) / table.size_std[which],
    ]
    scales = [table.range_std[which], table.bearing_std[which], table.size_std[which]]
    outlier = [np.log(table.max_range), np.log(2.0 * np.pi), 0.0]
    log_inlier, log_outlier = np.zeros(time.size), np.zeros(time.size)
    for r, std, density in zip(residual, scales, outlier, strict=True):
        seen = ~np.isnan(r)
        log_inlier += np.where(seen, -0.5 * r**2 - np.log(std * np.sqrt(2.0 * np.pi)), 0.0)
        log_outlier -= density * seen
    weight = inlier_share(log_inlier, table.outlier_weight[which], log_outlier)
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
    return pack_readings(n_steps, *(np.concatenate(column) for column in zip(*rows, strict=True)))


def moved_linearisation(
    table: LandmarkSightings, made_from: LandmarkSightings, linearisation: Any, reference: Float
) -> Any:
    """Return a linearisation for a moved map or sensor; see :meth:`pmcl.models.sensor.Sensor.moved_linearisation`."""
    if same_fields(table, made_from, ("position", "sensor_pose")):
        return linearisation
    value = _ideal_values(table, linearisation, reading_poses(made_from, reference))
    return linearisation._replace(value=np.ascontiguousarray(value + earlier_part(made_from, linearisation)))


def _ideal_values(table: LandmarkSightings, readings: LinearReadings, poses: Float) -> Float:
    """Return what each linearised reading would ideally be from the poses (T, >= 3) where it was taken, (M,)."""
    ahead, aside = relative_positions(table, readings.channel, poses[times_of(readings)])
    distance, bearing = np.maximum(np.hypot(ahead, aside), 1e-9), np.arctan2(aside, ahead) - table.sensor_pose[2]
    return np.choose(readings.kind, [distance, bearing, distance**-2.0])


def fitted_linearisation(
    table: LandmarkSightings, linearisation: LinearReadings, reference: Float, paths: Float
) -> LinearReadings:
    """Fit values and slopes to some paths; see :meth:`pmcl.models.sensor.Sensor.fitted_linearisation`."""
    here, *along = (
        _ideal_values(table, linearisation, reading_poses(table, path)) for path in (reference, *paths)
    )
    offset = np.array(along).reshape(len(paths), here.size) - here
    offset = np.where(linearisation.kind == BEARING, wrap(offset), offset)
    return fitted_readings(linearisation, reference, paths, offset)


def empty_like(table: LandmarkSightings) -> LinearReadings:
    """Return an empty linearisation of the type that belongs to such a table."""
    return empty_readings(extras=isinstance(table.extras, LandmarkExtras))


def covariates(table: LandmarkSightings, path: Float, index: ReadingIndex) -> dict[str, Float]:
    """Return distance and direction of sightings; see :meth:`pmcl.models.sensor.Sensor.covariates`."""
    along = ideal(table, path)
    # Slots run through the sightings in order: find each reading's own by its row and landmark.
    place = {(int(t), int(j)): k for k, (t, j) in enumerate(zip(table.time, table.landmark, strict=True))}
    k = np.array([place[int(t), int(j)] for t, j in zip(index.time, index.channel, strict=True)])
    return {"distance": along[k, 0], "direction": path[index.time, 2] + along[k, 1]}
