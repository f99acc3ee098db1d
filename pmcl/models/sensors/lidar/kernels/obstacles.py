"""Readings of obstacles that the map lacks: discs, which rays meet before their wall.

Under both models a ray that meets a disc before anything on the map ends there with the disc's weight as its
probability. What the disc answers has the noise and the gross errors of any reading, measured along the ray.
"""

from __future__ import annotations

import math

import numpy as np

from pmcl.engine.compile import generic, kernel
from pmcl.engine.scalars import HALF_LOG_2PI
from pmcl.engine.tables import NoExtras
from pmcl.engine.vector_math import any_nonzero
from pmcl.models.sensors.discs import disc_length
from pmcl.models.sensors.lidar.kernels.beam import beam_below, expected_range
from pmcl.models.sensors.lidar.kernels.rays import COLUMN, COSINE, ROW, SINE, beam_reading_logpdf, expected_of
from pmcl.models.sensors.lidar.table import BEAM, LidarExtras, LidarTable

__all__ = ["has_obstacles", "meets_obstacle", "with_obstacles", "with_obstacles_below"]


@generic
def has_obstacles(sensor):
    """Return whether anything stands on the floor that the map lacks."""


@generic
def meets_obstacle(sensor, r, mount, i, scratch):
    """Return whether ray r from the i-th place leads to an obstacle, wherever its wall is."""


@generic
def with_obstacles(sensor, r, z, mount, i, scratch, logp):
    """Return the log density of a reading of ray r from the i-th place, given that without obstacles.

    `mount` and the rows of `scratch` are those of :mod:`~pmcl.models.sensors.lidar.kernels.rays`.
    """


@generic
def with_obstacles_below(sensor, r, z, mount, i, scratch, low, high):
    """Return the probabilities of a smaller, and of a smaller or equal reading, given those without obstacles."""


@has_obstacles.register(LidarTable, NoExtras)
def _has_none(sensor):
    return False


@has_obstacles.register(LidarTable, LidarExtras)
def _has_some(sensor):
    return any_nonzero(sensor.extras.obstacles[:, 3])


@meets_obstacle.register(LidarTable, NoExtras)
def _meets_none(sensor, r, mount, i, scratch):
    return False


@meets_obstacle.register(LidarTable, LidarExtras)
def _meets_some(sensor, r, mount, i, scratch):
    for k in range(sensor.extras.obstacles.shape[0]):
        if sensor.extras.obstacles[k, 3] != 0.0 and _length_to_obstacle(sensor, k, mount, i, scratch) < np.inf:
            return True
    return False


@with_obstacles.register(LidarTable, NoExtras)
def _without(sensor, r, z, mount, i, scratch, logp):
    return logp


@with_obstacles_below.register(LidarTable, NoExtras)
def _without_below(sensor, r, z, mount, i, scratch, low, high):
    return low, high


@kernel
def _length_to_obstacle(sensor, k, mount, i, scratch):
    """Return how far a ray of this mount runs from the i-th place to obstacle k, in cells; inf where it passes by."""
    per_cell, origin = 1.0 / sensor.resolution, sensor.origin
    # The centre on the grid, in cells.
    c0, s0 = math.cos(origin[2]), math.sin(origin[2])
    x, y = sensor.extras.obstacles[k, 0] - origin[0], sensor.extras.obstacles[k, 1] - origin[1]
    column, row = (c0 * x + s0 * y) * per_cell, (c0 * y - s0 * x) * per_cell
    c, s = scratch[COSINE, i], scratch[SINE, i]
    mount_x, mount_y, cosine, sine = mount
    return disc_length(
        column - (scratch[COLUMN, i] + c * mount_x - s * mount_y), row - (scratch[ROW, i] + s * mount_x + c * mount_y),
        c * cosine - s * sine, s * cosine + c * sine, sensor.extras.obstacles[k, 2] * per_cell,
    )  # fmt: skip


@kernel
def _expected_of_obstacle(sensor, k, r, mount, i, scratch):
    """Return what ray r should read of obstacle k from the i-th place [m]; inf where it passes by."""
    length = _length_to_obstacle(sensor, k, mount, i, scratch)
    if not length < np.inf:
        return np.inf
    return expected_range(length * sensor.resolution, sensor.scale[r], sensor.bias[r], sensor.max_range[r])


@kernel
def _echo_logpdf(sensor, r, z, expected):
    """Return the log density of a reading of something at `expected` [m]."""
    if sensor.model == BEAM:
        return beam_reading_logpdf(sensor, r, z, expected)
    e = (z - expected) / (sensor.scale[r] * sensor.std[r])
    hit = sensor.z_hit * math.exp(-0.5 * e * e - HALF_LOG_2PI) / sensor.std[r]
    density = hit + sensor.z_rand / sensor.max_range[r]
    return math.log(density) if density > 0.0 else -np.inf


@kernel
def _log_mixture(first, second, weight):
    """Return the log of (1 - weight) exp(first) + weight exp(second), with 0 < weight <= 1."""
    a = first + math.log1p(-weight) if weight < 1.0 else -np.inf
    b = second + math.log(weight)
    high, low = max(a, b), min(a, b)
    return high + math.log1p(math.exp(low - high)) if high > -np.inf else high


@with_obstacles.register(LidarTable, LidarExtras)
def _with_some(sensor, r, z, mount, i, scratch, logp):
    wall = -1.0
    for k in range(sensor.extras.obstacles.shape[0]):
        weight = sensor.extras.obstacles[k, 3]
        if weight == 0.0:
            continue
        near = _expected_of_obstacle(sensor, k, r, mount, i, scratch)
        if not near < np.inf:
            continue
        if wall < 0.0:
            wall = expected_of(sensor, r, mount, i, scratch)
        if near < wall:
            logp = _log_mixture(logp, _echo_logpdf(sensor, r, z, near), weight)
    return logp


@with_obstacles_below.register(LidarTable, LidarExtras)
def _with_some_below(sensor, r, z, mount, i, scratch, low, high):
    wall = -1.0
    for k in range(sensor.extras.obstacles.shape[0]):
        weight = sensor.extras.obstacles[k, 3]
        if weight == 0.0:
            continue
        near = _expected_of_obstacle(sensor, k, r, mount, i, scratch)
        if not near < np.inf:
            continue
        if wall < 0.0:
            wall = expected_of(sensor, r, mount, i, scratch)
        if near < wall:
            below, as_much = _echo_below(sensor, r, z, near)
            low, high = low + weight * (below - low), high + weight * (as_much - high)
    return low, high


@kernel
def _echo_below(sensor, r, z, expected):
    """Return the distribution function of :func:`_echo_logpdf`, for a smaller and for a smaller or equal reading."""
    if sensor.model == BEAM:
        return beam_below(
            z, expected, sensor.max_range[r], sensor.std[r], sensor.z_hit, sensor.z_short, sensor.z_max, sensor.z_rand,
            sensor.lambda_short,
        )  # fmt: skip
    e = (z - expected) / (sensor.scale[r] * sensor.std[r])
    below = sensor.z_hit * 0.5 * math.erfc(-e * math.sqrt(0.5)) + sensor.z_rand * z / sensor.max_range[r]
    return below, below
