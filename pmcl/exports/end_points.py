"""Where the readings of lidars and range beams end in the map, given the robot's poses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmcl.geometry import compose
from pmcl.logs.robot_log import RobotLog

__all__ = ["end_points"]

Float = NDArray[np.float64]


def end_points(log: RobotLog, poses: Float) -> list[Float] | None:
    """Return the end points of all readings of distance along rays.

    Parameters
    ----------
    log : RobotLog
        Log of T rows.
    poses : ndarray, shape (T, 3)
        Where the robot was (x, y, heading) [m, m, rad], map frame.

    Returns
    -------
    list of ndarray, shape (N_t, 2), or None
        For each row the points [m] in the map frame at which readings with an echo end; None for a log without lidars
        and beams.
    """
    rays = [
        (scan.ranges, compose(np.asarray(scan.pose)[None, :], _directions(scan.angles)), scan.min_range, scan.max_range)
        for scan in log.lidars.values()
    ]
    if log.ranges is not None and log.beam_poses is not None:
        rays.append((log.ranges, log.beam_poses, 0.0, log.max_range))
    if not rays:
        return None
    parts = [_ends(poses, *each) for each in rays]
    points, kept = (np.concatenate(each, axis=1) for each in zip(*parts, strict=True))
    return [row[keep] for row, keep in zip(points, kept, strict=True)]


def _directions(angles: Float) -> Float:
    return np.column_stack([np.zeros_like(angles), np.zeros_like(angles), angles])


def _ends(poses: Float, ranges: Float, mounts: Float, least: float, most: float) -> tuple[Float, NDArray[np.bool_]]:
    """Return end points (T, R, 2) and whether each reading has one (T, R)."""
    with np.errstate(invalid="ignore"):
        kept = (ranges > least) & (ranges < most)
    reading = np.where(kept, ranges, 0.0)
    rays = compose(poses[:, None, :], mounts[None, :, :])
    ends = rays[..., :2] + reading[..., None] * np.stack([np.cos(rays[..., 2]), np.sin(rays[..., 2])], axis=-1)
    return ends, kept
