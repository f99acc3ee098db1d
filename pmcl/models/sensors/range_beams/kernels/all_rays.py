"""Casting all rays that the full kernels need: cones of several rays, late poses, and the rays of the row before.

A filter evaluates one reading at many states, a path many readings at one state each. Both are columns here: column i
belongs to row ``first + stride * i`` of the readings, with stride 0 in a filter and 1 along a path, so that one
implementation serves both.
"""

from __future__ import annotations

import math

import numpy as np

from pmcl.engine.compile import kernel
from pmcl.engine.vector_math import any_nonzero, sincos_into
from pmcl.models.sensors.range_beams.kernels.casting import (
    COSINE,
    DIRECTION_X,
    DIRECTION_Y,
    INVERSE_LENGTH,
    MOMENT,
    ORIGIN_X,
    ORIGIN_Y,
    SINE,
    cast_along,
    cast_beam,
    has_origin,
    one_origin,
)
from pmcl.models.sensors.range_beams.kernels.rays import hit_cosines
from pmcl.models.sensors.range_beams.kernels.rows import BEAM_ROWS, OTHER_RAY, POSE, first_row

__all__ = ["cast_all", "cast_beams"]

# How many rays stand for a cone, and which of them is the middle one; the outermost are its edges.
_RAYS, _MIDDLE = 5, 2


@kernel
def _cast_cone(sensor, beam, pose, moved, scratch, inverse, cosine):
    """Write 1 / length into `inverse` (n,), nearest ray of the cone, and the cosine of incidence of its middle one."""
    nearest = scratch[INVERSE_LENGTH]
    cast_beam(sensor, beam, pose, scratch[SINE], scratch[COSINE], moved, scratch)
    for i in range(inverse.size):
        inverse[i] = nearest[i]
    if sensor.extras.specular_weight[beam] != 0.0:
        hit_cosines(
            sensor.vertices, sensor.wall_start, sensor.wall_stop, scratch[ORIGIN_X], scratch[ORIGIN_Y],
            scratch[DIRECTION_X], scratch[DIRECTION_Y], scratch[MOMENT], nearest, cosine,
        )  # fmt: skip
    if sensor.extras.width[beam] == 0.0:
        return
    other, shared = scratch[first_row(sensor) + OTHER_RAY], one_origin(sensor.beam_pose)
    for ray in range(_RAYS):
        if ray == _MIDDLE:
            continue
        angle = sensor.beam_pose[beam, 2] + (ray - _MIDDLE) / (_RAYS - 1.0) * sensor.extras.width[beam]
        cast_along(sensor, angle, shared, scratch[SINE], scratch[COSINE], scratch, other)
        for i in range(inverse.size):
            inverse[i] = max(inverse[i], other[i])


@kernel
def cast_beams(sensor, pose, only, correlated, scratch, inverses, cosines):
    """Cast all beams from each `pose` (3, n), or some of them.

    Parameters
    ----------
    sensor : RangeBeams
        The table, with extras.
    pose : ndarray, shape (3, n)
        The poses.
    only : int
        Where it is not negative, only beams that were read at this row are cast.
    correlated : bool
        Whether only beams whose echoes are correlated in time are cast.
    scratch : ndarray, shape (rows, n)
        Work space.
    inverses, cosines : ndarray, shape (B, n)
        1 / length of each beam, and the cosine of incidence of its middle ray; filled.
    """
    sincos_into(pose[2], scratch[SINE], scratch[COSINE])
    origin_x, origin_y = np.nan, np.nan
    for beam in range(sensor.reading.shape[1]):
        if only >= 0 and math.isnan(sensor.reading[only, beam]):
            continue
        if correlated and sensor.extras.correlation[beam] == 0.0:
            continue
        moved = not has_origin(sensor.beam_pose, beam, origin_x, origin_y)
        origin_x, origin_y = sensor.beam_pose[beam, 0], sensor.beam_pose[beam, 1]
        _cast_cone(sensor, beam, pose, moved, scratch, inverses[beam], cosines[beam])


@kernel
def _late_poses(sensor, first, stride, previous, current, pose):
    """Write the pose at which each column was read."""
    for d in range(3):
        for i in range(current.shape[1]):
            pose[d, i] = current[d, i] - sensor.extras.lag[first + stride * i] * (current[d, i] - previous[d, i])


@kernel
def cast_all(sensor, first, stride, previous, current, scratch):
    """Cast all beams of one row, or of each column's own row, and keep the lengths in `scratch`."""
    n_beams, rows = sensor.reading.shape[1], scratch[first_row(sensor) :]
    inverses = rows[BEAM_ROWS : BEAM_ROWS + n_beams]
    cosines = rows[BEAM_ROWS + n_beams : BEAM_ROWS + 2 * n_beams]
    inverses_before = rows[BEAM_ROWS + 2 * n_beams : BEAM_ROWS + 3 * n_beams]
    pose = rows[POSE : POSE + 3]
    only = first if stride == 0 else -1
    if any_nonzero(sensor.extras.correlation):
        cast_beams(sensor, previous, only, True, scratch, inverses_before, cosines)
    _late_poses(sensor, first, stride, previous, current, pose)
    # A beam that was not read may still be the neighbour of one that was.
    neighbours_count = any_nonzero(sensor.extras.talk_weight)
    cast_beams(sensor, pose, -1 if neighbours_count else only, False, scratch, inverses, cosines)
