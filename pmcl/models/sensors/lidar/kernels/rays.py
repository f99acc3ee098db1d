"""One ray of a scan: where it begins on the grid, what a hit should read, where a reading ends."""

from __future__ import annotations

import math

from pmcl.engine.compile import kernel
from pmcl.engine.vector_math import sincos_into
from pmcl.models.sensors.lidar.kernels.beam import beam_logpdf, expected_range
from pmcl.models.sensors.lidar.kernels.casting import WALL_DEPTH, cast_ray
from pmcl.models.sensors.lidar.kernels.field import level_at

__all__ = [
    "BEFORE", "BORDER", "COLUMN", "COSINE", "LATE", "ROW", "ROWS", "SINE", "TOTAL", "beam_reading_logpdf", "end_point",
    "expected_of", "level_of", "mount_of", "place",
]  # fmt: skip

# Rows of scratch space: sine and cosine of each heading in the grid's frame, where the robot is in cells, the sum of
# the log densities, and three rows each for the poses of late readings and for those of the row before.
SINE, COSINE, COLUMN, ROW, TOTAL, LATE, BEFORE = 0, 1, 2, 3, 4, 5, 8
ROWS = 11
# The grid of levels has a border of one cell, the grid of squares none.
BORDER = 1.0


@kernel
def place(sensor, pose, scratch):
    """Write where the grid has each `pose` (3, n) into the rows SINE, COSINE, COLUMN and ROW."""
    sine, cosine, column, row = scratch[SINE], scratch[COSINE], scratch[COLUMN], scratch[ROW]
    c0, s0 = math.cos(sensor.origin[2]), math.sin(sensor.origin[2])
    x0, y0, yaw = sensor.origin[0], sensor.origin[1], sensor.origin[2]
    per_cell = 1.0 / sensor.resolution
    for i in range(pose.shape[1]):
        row[i] = pose[2, i] - yaw
    sincos_into(row, sine, cosine)
    for i in range(pose.shape[1]):
        x, y = pose[0, i] - x0, pose[1, i] - y0
        column[i] = (c0 * x + s0 * y) * per_cell
        row[i] = (c0 * y - s0 * x) * per_cell


@kernel
def mount_of(sensor, r):
    """Return where a ray begins on the robot, in cells, and cosine and sine of its direction there."""
    per_cell, yaw = 1.0 / sensor.resolution, sensor.beam_pose[r, 2]
    return sensor.beam_pose[r, 0] * per_cell, sensor.beam_pose[r, 1] * per_cell, math.cos(yaw), math.sin(yaw)


@kernel
def expected_of(sensor, r, mount, i, scratch):
    """Return what a hit of ray r, mounted as :func:`mount_of` says, should read from the i-th place [m]."""
    c, s = scratch[COSINE, i], scratch[SINE, i]
    x, y, cosine, sine = mount
    length = cast_ray(
        sensor.squares, scratch[COLUMN, i] + c * x - s * y, scratch[ROW, i] + s * x + c * y,
        c * cosine - s * sine, s * cosine + c * sine, sensor.max_range[r] / sensor.resolution,
    )  # fmt: skip
    return expected_range(
        (length + WALL_DEPTH) * sensor.resolution, sensor.scale[r], sensor.bias[r], sensor.max_range[r]
    )


@kernel
def end_point(sensor, r, z):
    """Return where a reading ends in the robot's frame, in cells."""
    per_cell = 1.0 / sensor.resolution
    length, yaw = (z - sensor.bias[r]) / sensor.scale[r], sensor.beam_pose[r, 2]
    u = (sensor.beam_pose[r, 0] + length * math.cos(yaw)) * per_cell
    return u, (sensor.beam_pose[r, 1] + length * math.sin(yaw)) * per_cell


@kernel
def beam_reading_logpdf(sensor, r, z, expected):
    """Return the log density of a reading of ray r under the beam model, where a hit should read `expected` [m]."""
    return beam_logpdf(
        z, expected, sensor.max_range[r], sensor.std[r], sensor.z_hit, sensor.z_short, sensor.z_max, sensor.z_rand,
        sensor.lambda_short,
    )  # fmt: skip


@kernel
def level_of(sensor, r, z, i, scratch):
    """Return the level at which a reading of ray r ends from the i-th place."""
    u, v = end_point(sensor, r, z)
    c, s = scratch[COSINE, i], scratch[SINE, i]
    x = scratch[COLUMN, i] + c * u - s * v + BORDER
    return level_at(sensor.levels, x, scratch[ROW, i] + s * u + c * v + BORDER)
