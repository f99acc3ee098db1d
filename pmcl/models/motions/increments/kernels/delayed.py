"""Odometry that comes too late."""

from __future__ import annotations

import numpy as np

from pmcl.engine.compile import entry
from pmcl.engine.vector_math import sincos_into

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
    x, y, heading, sine, cosine = np.zeros(n), np.zeros(n), np.zeros(n), np.empty(n), np.empty(n)
    for t in range(1, n):
        heading[t] = heading[t - 1] + mean[t, 2]
    sincos_into(heading, sine, cosine)
    for t in range(1, n):
        c, s = cosine[t - 1], sine[t - 1]
        x[t] = x[t - 1] + c * mean[t, 0] - s * mean[t, 1]
        y[t] = y[t - 1] + s * mean[t, 0] + c * mean[t, 1]
    late_x, late_y, late_heading, into = np.empty(n), np.empty(n), np.empty(n), 1
    for t in range(n):
        when = times[t] - delay
        into = min(max(into, 1), n - 1)
        while into < n - 1 and times[into] <= when:
            into += 1
        while into > 1 and times[into - 1] > when:
            into -= 1
        share = min(max((when - times[into - 1]) / (times[into] - times[into - 1]), 0.0), 1.0)
        c, s = cosine[into - 1], sine[into - 1]
        forward, left = share * mean[into, 0], share * mean[into, 1]
        late_x[t], late_y[t] = x[into - 1] + c * forward - s * left, y[into - 1] + s * forward + c * left
        late_heading[t] = heading[into - 1] + share * mean[into, 2]
    sincos_into(late_heading, sine, cosine)
    out = np.empty((n - 1, 3))
    for t in range(1, n):
        dx, dy, c, s = late_x[t] - late_x[t - 1], late_y[t] - late_y[t - 1], cosine[t - 1], sine[t - 1]
        out[t - 1, 0] = c * dx + s * dy
        out[t - 1, 1] = c * dy - s * dx
        out[t - 1, 2] = late_heading[t] - late_heading[t - 1]
    return out
