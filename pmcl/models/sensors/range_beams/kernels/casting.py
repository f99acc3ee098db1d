"""Casting the rays of beams for many poses at once, and the scratch rows that it uses."""

from __future__ import annotations

import math

from pmcl.engine.compile import kernel
from pmcl.models.sensors.range_beams.kernels.rays import inverse_lengths, middle_and_reach, wall_numerators

__all__ = [
    "CASTING_ROWS", "COSINE", "DIRECTION_X", "DIRECTION_Y", "INVERSE_LENGTH", "MOMENT", "ORIGIN_X", "ORIGIN_Y", "SINE",
    "WORK", "cast_along", "cast_beam", "has_origin", "one_origin", "same_origin",
]  # fmt: skip

# Rows of scratch space. The direction of each ray, 1 / length of it, and the point where it begins:
DIRECTION_X, DIRECTION_Y, INVERSE_LENGTH, ORIGIN_X, ORIGIN_Y = 0, 1, 2, 3, 4
# Sine and cosine of each heading, a row that is free while nothing is cast, and the moment of each ray:
SINE, COSINE, WORK, MOMENT = 5, 6, 7, 8
# Pairs of rows of which only the first column is used: the middle and the reach of all values of a kind.
_BOUNDS_X, _BOUNDS_Y, _BOUNDS_COSINE, _BOUNDS_SINE = 9, 11, 13, 15
# One row for each wall comes after these.
CASTING_ROWS = 17


@kernel
def same_origin(beam_pose, beam, other):
    """Return whether two beams leave the robot from one point."""
    return beam_pose[beam, 0] == beam_pose[other, 0] and beam_pose[beam, 1] == beam_pose[other, 1]


@kernel
def one_origin(beam_pose):
    """Return whether several beams leave the robot, all from one point."""
    for beam in range(1, beam_pose.shape[0]):
        if not same_origin(beam_pose, beam, 0):
            return False
    return beam_pose.shape[0] > 1


@kernel
def has_origin(beam_pose, beam, x, y):
    """Return whether a beam leaves the robot from the point (x, y) of its frame; NaN is no point."""
    return beam_pose[beam, 0] == x and beam_pose[beam, 1] == y


@kernel
def _keep_bounds(scratch, row, bounds):
    scratch[row, 0], scratch[row + 1, 0] = bounds


@kernel
def _bounds(scratch, row):
    return scratch[row, 0], scratch[row + 1, 0]


@kernel
def cast_beam(sensor, beam, pose, sine, cosine, moved, scratch):
    """Write 1 / length of one beam from each `pose` (3, n) into the row INVERSE_LENGTH.

    `sine` and `cosine` (n,) are those of the headings, mostly the rows SINE and COSINE: taken from `scratch` here they
    would cost a tenth of the time, as the compiler cannot tell the rows apart. The origins in the rows ORIGIN_X and
    ORIGIN_Y, and what bounds them, are reused when `moved` is False.
    """
    x, y = scratch[ORIGIN_X], scratch[ORIGIN_Y]
    inverse = scratch[CASTING_ROWS : CASTING_ROWS + sensor.wall_start.size]
    shared = one_origin(sensor.beam_pose)
    if moved:
        mount_x, mount_y = sensor.beam_pose[beam, 0], sensor.beam_pose[beam, 1]
        for i in range(x.size):
            x[i] = pose[0, i] + mount_x * cosine[i] - mount_y * sine[i]
        for i in range(x.size):
            y[i] = pose[1, i] + mount_x * sine[i] + mount_y * cosine[i]
        _keep_bounds(scratch, _BOUNDS_X, middle_and_reach(x))
        _keep_bounds(scratch, _BOUNDS_Y, middle_and_reach(y))
        _keep_bounds(scratch, _BOUNDS_COSINE, middle_and_reach(cosine))
        _keep_bounds(scratch, _BOUNDS_SINE, middle_and_reach(sine))
        if shared:
            wall_numerators(sensor.vertices, sensor.wall_start, sensor.wall_stop, x, y, inverse)
    cast_along(sensor, sensor.beam_pose[beam, 2], shared, sine, cosine, scratch, scratch[INVERSE_LENGTH])


@kernel
def cast_along(sensor, yaw, shared, sine, cosine, scratch, nearest):
    """Write 1 / length of rays at `yaw` to the headings into `nearest` (n,), from the origins of the last beam cast."""
    dx, dy, x, y = scratch[DIRECTION_X], scratch[DIRECTION_Y], scratch[ORIGIN_X], scratch[ORIGIN_Y]
    moment = scratch[MOMENT]
    inverse = scratch[CASTING_ROWS : CASTING_ROWS + sensor.wall_start.size]
    c, s = math.cos(yaw), math.sin(yaw)
    for i in range(x.size):
        dx[i] = cosine[i] * c - sine[i] * s
        dy[i] = sine[i] * c + cosine[i] * s
    middle_c, reach_c = _bounds(scratch, _BOUNDS_COSINE)
    middle_s, reach_s = _bounds(scratch, _BOUNDS_SINE)
    bounds = (
        _bounds(scratch, _BOUNDS_X),
        _bounds(scratch, _BOUNDS_Y),
        (middle_c * c - middle_s * s, reach_c * abs(c) + reach_s * abs(s)),
        (middle_s * c + middle_c * s, reach_s * abs(c) + reach_c * abs(s)),
    )
    inverse_lengths(
        sensor.vertices, sensor.wall_start, sensor.wall_stop, x, y, dx, dy, bounds, inverse, shared, moment, nearest
    )
