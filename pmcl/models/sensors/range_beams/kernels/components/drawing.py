"""What the draws of all components share: where the beams run along a path, and what their own echoes should read."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.geometry import late_poses
from pmcl.models.sensors.range_beams.linearisation import beam_lengths
from pmcl.models.sensors.range_beams.table import OPEN_RAY, RangeBeams, extras_of

__all__ = [
    "Alternative", "BeamsAlongPath", "beam_std", "beams_along_path", "expected_reading", "origins_and_directions",
]  # fmt: skip

Float = NDArray[np.float64]


class BeamsAlongPath(NamedTuple):
    """The beams of a table along a path, at the poses at which they were read.

    Attributes
    ----------
    poses : ndarray, shape (T, 3)
        The poses [m, m, rad], as late as the readings are.
    lengths : ndarray, shape (T, B)
        Length of each ray [m]; inf where it meets no wall.
    expected, std : ndarray, shape (T, B)
        What each beam's own echo should read, and the scale of its noise [m].
    """

    poses: Float
    lengths: Float
    expected: Float
    std: Float


class Alternative(NamedTuple):
    """Something other than its own echo that a beam may read.

    Attributes
    ----------
    weight : ndarray, shape (T, B)
        Probability that a reading is this, given that it is none of the alternatives that are asked before.
    reading : ndarray, shape (T, B)
        What it then reads [m].
    """

    weight: Float
    reading: Float


def expected_reading(table: RangeBeams, lengths: Float) -> Float:
    """Return what echoes from distances `lengths` (T, B) [m] should read [m]."""
    straight = table.scale * lengths + table.bias + extras_of(table).bias_at
    return np.asarray(np.minimum(straight, OPEN_RAY * table.max_range))


def beam_std(table: RangeBeams, lengths: Float) -> Float:
    """Return the scale of the noise of beams of `lengths` (T, B) [m]."""
    extras = extras_of(table)
    growth = 1.0 + extras.growth * np.minimum(lengths, table.max_range)
    return np.asarray(table.std * extras.std_factor[:, None] * growth)


def beams_along_path(table: RangeBeams, path: Float) -> BeamsAlongPath:
    """Return the beams along a path (T, >= 3)."""
    poses = late_poses(path, extras_of(table).lag)
    lengths = beam_lengths(table, poses)
    return BeamsAlongPath(poses, lengths, expected_reading(table, lengths), beam_std(table, lengths))


def origins_and_directions(table: RangeBeams, poses: Float) -> tuple[Float, Float, Float, Float]:
    """Return x and y of the origins and of the unit directions of all beams at poses (T, 3), each (T, B)."""
    c, s = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
    mount = table.beam_pose
    x = poses[:, 0, None] + c * mount[:, 0] - s * mount[:, 1]
    y = poses[:, 1, None] + s * mount[:, 0] + c * mount[:, 1]
    angle = poses[:, 2, None] + mount[:, 2]
    return x, y, np.cos(angle), np.sin(angle)
