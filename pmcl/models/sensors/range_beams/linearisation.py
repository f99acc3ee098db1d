"""Ideal ranges along a path, and their slopes: what residuals, simulation and the transport move share."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.linear_readings import (
    RANGE,
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
from pmcl.models.sensors.late_readings import reading_poses
from pmcl.models.sensors.range_beams.kernels.rays import cast_rays
from pmcl.models.sensors.range_beams.table import OPEN_RAY, RangeBeams, RangeExtras

__all__ = ["beam_lengths", "empty_like", "fitted_linearisation", "linearise", "moved_linearisation"]

Float = NDArray[np.float64]

# A path may deviate from its reference by about this much. Where a beam's length is not linear over that distance, it
# may cross the edge of a wall. The path stays on the side where the reading fits: there the slope at the reference is
# the right one. Where the reading is farther from it than this many standard deviations, the reference is on the wrong
# side, and the beam is left out. Between walls 5 % of the beams are at an edge; with them a third more of the transport
# moves are accepted, and there are 1.7 times the effective draws for the time.
_PROBE_STEP = (0.03, 0.03, 0.03)
_TINY = 1e-5
_FARTHEST = 3.5


def beam_lengths(table: RangeBeams, path: Float) -> Float:
    """Return the length of each beam's ray [m], shape (T, B), from poses `path` (T, >= 3).

    Of a beam with a width it is that of the shortest of the five rays across its cone.
    """
    lengths = _ray_lengths(table, table.beam_pose, path)
    if isinstance(table.extras, RangeExtras) and table.extras.width.any():
        for share in (-0.5, -0.25, 0.25, 0.5):
            mount = table.beam_pose.copy()
            mount[:, 2] += share * table.extras.width
            lengths = np.minimum(lengths, _ray_lengths(table, mount, path))
    return lengths


def _ray_lengths(table: RangeBeams, mount: Float, path: Float) -> Float:
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


def linearise(table: RangeBeams, reference: Float) -> LinearReadings:
    """Linearise the readings of beams around a reference (T, D); see :meth:`pmcl.models.sensor.Sensor.linearise`."""
    if not isinstance(table.extras, RangeExtras):
        return _linear_readings(table, reference)
    extras = table.extras
    gross = (table.outlier_weight, extras.no_echo_weight, extras.short_weight, extras.talk_weight)
    sound = np.prod([1.0 - weight for weight in gross], axis=0)
    rows = reference.shape[0]
    std = table.std * extras.std_factor[:rows, None]
    readings = _linear_readings(
        table._replace(reading=table.reading[:rows] - extras.bias_at[:rows], std=std, outlier_weight=1.0 - sound),
        reading_poses(table, reference),
    )
    with_bias = readings.reading + extras.bias_at[times_of(readings), readings.channel]
    readings = readings._replace(reading=np.ascontiguousarray(with_bias))
    return add_linear_extras(readings, table, reference, readings.value.copy(), np.ones(readings.value.size))


def _linear_readings(table: Any, reference: Float) -> LinearReadings:
    value = beam_lengths(table, reference)
    z = table.reading[: reference.shape[0]]
    usable = ~np.isnan(z) & np.isfinite(value) & (z > 0.0) & (z < table.max_range)
    jacobian, at_edge = np.zeros((*value.shape, reference.shape[1])), np.zeros(value.shape, dtype=bool)
    for d, step in enumerate(_PROBE_STEP):
        with np.errstate(invalid="ignore"):
            slope, kink = _slope(table, reference, value, d, _TINY)
            far_slope, bend = _slope(table, reference, value, d, step)
            # A beam that already the slope takes across an edge or a corner has another slope on either side.
            usable &= np.isfinite(bend) & (kink / _TINY * step < 0.5 * table.std)
            at_edge |= (np.abs(slope - far_slope) * step > 0.5 * table.std) | (bend > 0.5 * table.std)
        jacobian[..., d] = slope
    residual = np.where(usable, z - np.minimum(table.scale * value + table.bias, OPEN_RAY * table.max_range), 0.0)
    usable &= ~at_edge | (np.abs(residual) < _FARTHEST * table.std)
    log_inlier = -0.5 * (residual / table.std) ** 2 - np.log(table.std * np.sqrt(2.0 * np.pi))
    weight = inlier_share(log_inlier, np.broadcast_to(table.outlier_weight, z.shape), -np.log(table.max_range))
    time, beam = np.nonzero(usable)
    at = (time, beam)
    kind = np.full(time.size, RANGE)
    return pack_readings(reference.shape[0], time, beam, kind, z[at], value[at], jacobian[at], weight[at])


def fitted_linearisation(
    table: RangeBeams, linearisation: LinearReadings, reference: Float, paths: Float
) -> LinearReadings:
    """Fit values and slopes to some paths; see :meth:`pmcl.models.sensor.Sensor.fitted_linearisation`."""
    at = (times_of(linearisation), linearisation.channel)
    here = beam_lengths(table, reading_poses(table, reference))[at]
    along = np.array([beam_lengths(table, reading_poses(table, path))[at] for path in paths])
    with np.errstate(invalid="ignore"):
        offset = along.reshape(len(paths), here.size) - here
    return fitted_readings(linearisation, reference, paths, offset)


def _slope(table: Any, reference: Float, value: Float, d: int, size: float) -> tuple[Float, Float]:
    """Return each beam's slope by a component of the state, from a step both ways, and by how much it bends there."""
    shift = np.zeros(reference.shape[1])
    shift[d] = size
    ahead, behind = beam_lengths(table, reference + shift), beam_lengths(table, reference - shift)
    return (ahead - behind) / (2.0 * size), np.abs(ahead + behind - 2.0 * value)


def moved_linearisation(table: RangeBeams, made_from: RangeBeams, linearisation: Any, reference: Float) -> Any:
    """Return a linearisation for moved beams or walls; see :meth:`pmcl.models.sensor.Sensor.moved_linearisation`."""
    time, beam = times_of(linearisation), linearisation.channel
    poses = reading_poses(made_from, reference)
    if not _same_walls(table, made_from):
        lengths = beam_lengths(table, poses)[time, beam] + earlier_part(made_from, linearisation)
        # A beam that meets nothing from its new place keeps the value that it had.
        return linearisation._replace(value=np.where(np.isfinite(lengths), lengths, linearisation.value))
    if same_fields(table, made_from, ("beam_pose",)):
        return linearisation
    # Along the slopes, as where a path moves: a beam that is turned one way on a robot that is turned the other way
    # reads what it has read, and no beam meets another wall.
    slopes, (ahead, left, _) = linearisation.jacobian, made_from.beam_pose[beam].T
    x, y, yaw = (table.beam_pose[beam] - made_from.beam_pose[beam]).T
    c, s = np.cos(poses[time, 2]), np.sin(poses[time, 2])
    of_place = slopes[:, 0] * (c * x - s * y) + slopes[:, 1] * (s * x + c * y)
    # A robot that turns also moves a beam beside its centre; a beam that turns on its robot stays where it is.
    of_swing = slopes[:, 1] * (c * ahead - s * left) - slopes[:, 0] * (s * ahead + c * left)
    value = linearisation.value + of_place + (slopes[:, 2] - of_swing) * yaw
    return linearisation._replace(value=np.ascontiguousarray(value))


def _same_walls(table: RangeBeams, made_from: RangeBeams) -> bool:
    if not same_fields(table, made_from, ("vertices",)):
        return False
    return not isinstance(table.extras, RangeExtras) or same_fields(table.extras, made_from.extras, ("width",))


def empty_like(table: RangeBeams) -> LinearReadings:
    """Return an empty linearisation of the type that belongs to such a table."""
    return empty_readings(extras=isinstance(table.extras, RangeExtras))
