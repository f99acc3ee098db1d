"""Where landmarks lie as the sensor sees them, for many states at once or for one."""

from __future__ import annotations

import math

from pmcl.engine.compile import kernel
from pmcl.engine.vector_math import sincos_into
from pmcl.models.sensors.landmarks.kernels.rows import AHEAD, ASIDE, COSINE, DISTANCE, POSE, SINE

__all__ = ["locate", "locate_from", "place_sensor"]


@kernel
def place_sensor(sensor, first, stride, late, previous, current, scratch):
    """Write the pose of the sensor when each column was read, with sine and cosine of the direction it looks in.

    Column i is row ``first + stride * i``; without `late`, readings are as old as the pose.
    """
    yaw = sensor.sensor_pose[2]
    mount_x, mount_y = sensor.sensor_pose[0], sensor.sensor_pose[1]
    n = current.shape[1]
    for d in range(3):
        for i in range(n):
            lag = sensor.extras.lag[first + stride * i] if late else 0.0
            scratch[POSE + d, i] = current[d, i] - lag * (current[d, i] - previous[d, i])
    sine, cosine = scratch[SINE], scratch[COSINE]
    sincos_into(scratch[POSE + 2], sine, cosine)
    c, s = math.cos(yaw), math.sin(yaw)
    for i in range(n):
        along, across = cosine[i], sine[i]
        scratch[POSE, i] += mount_x * along - mount_y * across
        scratch[POSE + 1, i] += mount_x * across + mount_y * along
        cosine[i], sine[i] = along * c - across * s, across * c + along * s


@kernel
def locate(sensor, j, n, scratch):
    """Write how far landmark j lies ahead of the sensor and aside, and its distance, in each of n columns."""
    sine, cosine, ahead, aside = scratch[SINE], scratch[COSINE], scratch[AHEAD], scratch[ASIDE]
    distance = scratch[DISTANCE]
    x, y = sensor.position[j, 0], sensor.position[j, 1]
    for i in range(n):
        dx, dy = x - scratch[POSE, i], y - scratch[POSE + 1, i]
        ahead[i] = dx * cosine[i] + dy * sine[i]
        aside[i] = dy * cosine[i] - dx * sine[i]
    for i in range(n):
        distance[i] = math.sqrt(ahead[i] * ahead[i] + aside[i] * aside[i])


@kernel
def locate_from(sensor, j, i, scratch):
    """Return how far landmark j lies ahead of the sensor and aside, and its distance, in column `i`."""
    dx, dy = sensor.position[j, 0] - scratch[POSE, i], sensor.position[j, 1] - scratch[POSE + 1, i]
    ahead = dx * scratch[COSINE, i] + dy * scratch[SINE, i]
    aside = dy * scratch[COSINE, i] - dx * scratch[SINE, i]
    return ahead, aside, math.sqrt(ahead * ahead + aside * aside)
