"""Scans and poses that a text recording states line by line, gathered into streams."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pmcl.logs.amcl_rows import thinned
from pmcl.logs.lidar_recording import LidarStream, usual_readings
from pmcl.logs.validation import fail

__all__ = ["PoseLines", "ScanLines"]

Float = NDArray[np.float64]


@dataclass
class PoseLines:
    """Poses of one kind: times [s] and poses (x, y, heading) [m, m, rad], in the order of recording."""

    times: list[float] = field(default_factory=list)
    poses: list[Float] = field(default_factory=list)

    def add(self, time: float, pose: Float) -> None:
        """Add a pose."""
        self.times.append(time)
        self.poses.append(pose)

    def arrays(self) -> tuple[Float, Float]:
        """Return times, shape (N,), and poses, shape (N, 3)."""
        return np.array(self.times, dtype=np.float64), np.array(self.poses, dtype=np.float64).reshape(-1, 3)


@dataclass
class ScanLines:
    """Scans of one laser, each with the odometry pose of the robot at its time.

    Attributes
    ----------
    max_beams : int or None
        About how many rays of each scan are kept; None for all.
    n_readings : int
        Rays that are kept of all scans so far.
    """

    max_beams: int | None
    n_readings: int = 0
    _poses: PoseLines = field(default_factory=PoseLines)
    _ranges: list[Float] = field(default_factory=list)
    _counts: list[int] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self._counts)

    def add(self, time: float, pose: Float, ranges: Float) -> None:
        """Add a scan: its time [s], the robot's pose [m, m, rad] and all ranges [m]."""
        self._poses.add(time, pose)
        self._counts.append(len(ranges))
        kept = ranges[thinned(len(ranges), self.max_beams)].copy()
        self._ranges.append(kept)
        self.n_readings += len(kept)

    def stream(
        self, first: float, step: float | None, min_range: float, max_range: float, mount: Float, where: str
    ) -> tuple[LidarStream, int]:
        """Return the scans that have the usual number of rays, and how many have another number.

        Parameters
        ----------
        first : float
            Angle of the first ray in the laser's frame [rad].
        step : float or None
            Angle between rays [rad]; None where the last ray points as far to the other side as the first one.
        min_range, max_range : float
            Limits of the readings [m].
        mount : ndarray, shape (3,)
            Where the laser sits on the robot [m, m, rad].
        where : str
            File, for messages.

        Raises
        ------
        LogError
            When the usual scan has less than two rays.
        """
        usual, _ = Counter(self._counts).most_common(1)[0]
        if usual < 2:
            fail(where, f"expected scans of at least two rays, got {usual} in most: check the recording")
        kept = np.flatnonzero(np.array(self._counts) == usual)
        times, poses = self._poses.arrays()
        width = -2.0 * first / (usual - 1) if step is None else step
        angles: Float = first + width * np.arange(usual, dtype=np.float64)
        ranges = usual_readings(np.array([self._ranges[k] for k in kept]), min_range, max_range)
        stream = LidarStream(
            "", times[kept], ranges, angles[thinned(usual, self.max_beams)], min_range, max_range, mount, poses[kept]
        )
        return stream, len(self._counts) - len(kept)
