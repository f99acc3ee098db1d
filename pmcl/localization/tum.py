"""Trajectories as TUM text, the format that evo and most other evaluation tools read."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import ArrayLike

from pmcl.errors import PmclError
from pmcl.whole_file import replacing

__all__ = ["write_tum"]


def write_tum(path: str | os.PathLike[str], times: ArrayLike, poses: ArrayLike) -> None:
    """Write a trajectory, one line for each pose: time tx ty tz qx qy qz qw.

    Parameters
    ----------
    path : path
        Replaced when it exists, all or nothing.
    times : array_like, shape (T,)
        Sample times [s].
    poses : array_like, shape (T, 3)
        (x [m], y [m], heading [rad]) in the map frame. Rows with NaN, such as gaps of a reference, are left out. The
        heading becomes a quaternion about z.

    Raises
    ------
    PmclError
        When shapes disagree, or no pose is known.
    PosteriorError
        When the file cannot be written.
    """
    times, poses = np.asarray(times, dtype=float), np.asarray(poses, dtype=float)
    if poses.ndim != 2 or poses.shape[1] != 3 or times.shape != poses.shape[:1]:
        raise PmclError(
            f"expected times of shape (T,) and poses of shape (T, 3), got {times.shape} and {poses.shape}: "
            "give one pose for each time"
        )
    known = ~np.isnan(poses).any(axis=1)
    if not known.any():
        raise PmclError("expected at least one pose to write, got none: this trajectory is nowhere known")
    t, (x, y, heading) = times[known], poses[known].T
    zero = np.zeros_like(t)
    rows = np.column_stack([t, x, y, zero, zero, zero, np.sin(0.5 * heading), np.cos(0.5 * heading)])
    with replacing(path) as temporary, open(temporary, "w", encoding="ascii") as stream:
        # Seconds of a unix clock need ten digits before the point and six after it.
        np.savetxt(stream, rows, fmt=["%.6f"] + ["%.9g"] * 7)
