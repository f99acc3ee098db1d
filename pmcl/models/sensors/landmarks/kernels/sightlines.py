"""Where landmarks lie as the sensor sees them, for many states at once or for one."""

from __future__ import annotations

import math

from pmcl.engine.compile import kernel
from pmcl.engine.vector_math import sincos_into
from pmcl.models.sensors.landmarks.kernels.rows import AHEAD, ASIDE, COSINE, DISTANCE, POSE, SINE

__all__ = ["locate", "locate_named", "place_sensor"]


@kernel
def place_sensor(sensor, lag, stride, n, previous, current, scratch):
    """Write the pose of the sensor when each of n columns was read, with sine and cosine of where it looks.

    Column i was read ``lag[stride * i]`` before its state, as a share of the time since the state before.
    """
    yaw = sensor.sensor_pose[2]
    mount_x, mount_y = sensor.sensor_pose[0], sensor.sensor_pose[1]
    for d in range(3):
        for i in range(n):
            scratch[POSE + d, i] = current[d, i] - lag[stride * i] * (current[d, i] - previous[d, i])
    sine, cosine = scratch[SINE, :n], scratch[COSINE, :n]
    sincos_into(scratch[POSE + 2, :n], sine, cosine)
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
def locate_named(sensor, first, onward, n, scratch):
    """Do the same with column i belonging to sighting ``first + i``, of the landmark `onward` after the one it names.

    Landmarks are counted in a circle.
    """
    sine, cosine, ahead, aside = scratch[SINE], scratch[COSINE], scratch[AHEAD], scratch[ASIDE]
    distance, count = scratch[DISTANCE], sensor.position.shape[0]
    for i in range(n):
        j = sensor.landmark[first + i] + onward
        j -= count if j >= count else 0
        ahead[i] = sensor.position[j, 0] - scratch[POSE, i]
        aside[i] = sensor.position[j, 1] - scratch[POSE + 1, i]
    for i in range(n):
        dx, dy = ahead[i], aside[i]
        ahead[i] = dx * cosine[i] + dy * sine[i]
        aside[i] = dy * cosine[i] - dx * sine[i]
    for i in range(n):
        distance[i] = math.sqrt(ahead[i] * ahead[i] + aside[i] * aside[i])
