"""Odometry that comes too late."""

from __future__ import annotations

import math

import numpy as np

from pmcl.engine.compile import entry

__all__ = ["delayed_increments"]


@entry
def delayed_increments(mean, times, delay):
    """Return increments (T - 1, 3) of the odometry path `delay` [s] ago; the robot rests before and after the log.

    Parameters
    ----------
    mean : ndarray, shape (T, 3)
        Increments [m, m, rad]; row 0 is not used.
    times : ndarray, shape (T,)
        Times [s].
    delay : float
        [s].
    """
    n = mean.shape[0]
    path = np.zeros((n, 3))
    for t in range(1, n):
        c, s = math.cos(path[t - 1, 2]), math.sin(path[t - 1, 2])
        path[t, 0] = path[t - 1, 0] + c * mean[t, 0] - s * mean[t, 1]
        path[t, 1] = path[t - 1, 1] + s * mean[t, 0] + c * mean[t, 1]
        path[t, 2] = path[t - 1, 2] + mean[t, 2]
    out = np.empty((n - 1, 3))
    last_x, last_y, last_heading, into = 0.0, 0.0, 0.0, 1
    for t in range(n):
        when = times[t] - delay
        into = min(max(into, 1), n - 1)
        while into < n - 1 and times[into] <= when:
            into += 1
        while into > 1 and times[into - 1] > when:
            into -= 1
        share = min(max((when - times[into - 1]) / (times[into] - times[into - 1]), 0.0), 1.0)
        c, s = math.cos(path[into - 1, 2]), math.sin(path[into - 1, 2])
        forward, left = share * mean[into, 0], share * mean[into, 1]
        x, y = path[into - 1, 0] + c * forward - s * left, path[into - 1, 1] + s * forward + c * left
        if t > 0:
            c, s = math.cos(last_heading), math.sin(last_heading)
            out[t - 1, 0] = c * (x - last_x) + s * (y - last_y)
            out[t - 1, 1] = c * (y - last_y) - s * (x - last_x)
            out[t - 1, 2] = path[into - 1, 2] + share * mean[into, 2] - last_heading
        last_x, last_y, last_heading = x, y, path[into - 1, 2] + share * mean[into, 2]
    return out
