"""What recorded logs are judged by: readings at the reference poses, and dead reckoning against them."""

from __future__ import annotations

import numpy as np

from pmcl.geometry import between, compose, wrap


def robust_sd(values):
    """Standard deviation of the bulk: 1.4826 times the median absolute deviation."""
    return 1.4826 * np.median(np.abs(values - np.median(values)))


def residuals(log, sensor_pose=None):
    """Distance [m] and bearing [rad] residuals of all sightings at the reference poses."""
    sensor = compose(log.true_poses, log.landmark_sensor_pose if sensor_pose is None else sensor_pose)
    dx, dy = np.moveaxis(log.landmarks.positions - sensor[:, None, :2], -1, 0)
    distance = log.landmark_range - np.hypot(dx, dy)
    bearing = wrap(log.landmark_bearing - np.arctan2(dy, dx) + sensor[:, None, 2])
    known = np.isfinite(distance)
    return distance[known], bearing[known]


def dead_reckoning(log, seconds):
    """Median drift and median displacement over windows: rows (position [m], heading [rad])."""
    k = round(seconds / (log.times[1] - log.times[0]))
    drift, moved = [], []
    for first in range(0, log.n_steps - k, k):
        window = log.true_poses[first : first + k + 1]
        if np.isnan(window[[0, -1]]).any():
            continue
        pose = window[0]
        for increment in log.odometry[first + 1 : first + k + 1]:
            pose = compose(pose, increment)
        for rows, step in ((drift, between(window[-1], pose)), (moved, between(window[0], window[-1]))):
            rows.append((np.hypot(step[0], step[1]), abs(step[2])))
    return np.median(drift, axis=0), np.median(moved, axis=0)
