"""Coefficient tables of the belief about the first state."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["GaussianStart", "PoseStart", "WiderStart", "wider_start"]

Float = NDArray[np.float64]


class GaussianStart(NamedTuple):
    """Independent Gaussian belief about each component of the first state.

    Attributes
    ----------
    mean, std : ndarray, shape (D,)
        Mean and standard deviation of each component.
    """

    mean: Float
    std: Float


class PoseStart(NamedTuple):
    """Belief about the first pose in which position, heading or both may be unknown.

    Attributes
    ----------
    mean, std : ndarray, shape (3,)
        Gaussian part [m, m, rad]. ``std[0] = inf``: the position is uniform over the map;
        ``std[2] = inf``: the heading is uniform over the circle.
    low, high : ndarray, shape (2,)
        Bounding box of the map [m].
    segments : ndarray, shape (W, 4)
        Closed outline (x1, y1, x2, y2) [m] inside which the position lies; W = 0 means the whole box.
    log_density : float
        Log density of the uniform parts: minus the log of area and circle, where they apply.
    floor : ndarray of uint8, shape (H, W)
        Cells of a grid map, 1 where the position may lie; empty without a grid map.
    floor_frame : ndarray, shape (5,)
        Outer corner (x, y) [m] of ``floor[0, 0]``, cosine and sine of the grid's yaw, and the side of a cell [m].
    """

    mean: Float
    std: Float
    low: Float
    high: Float
    segments: Float
    log_density: float
    floor: NDArray[np.uint8] = np.empty((0, 0), dtype=np.uint8)
    floor_frame: Float = np.zeros(5)


class WiderStart(NamedTuple):
    """A belief about the first pose, and independent Gaussians about further components of the state.

    Attributes
    ----------
    pose : PoseStart
        Belief about the first three components.
    mean, std : ndarray, shape (D - 3,)
        Belief about the others.
    """

    pose: PoseStart
    mean: Float
    std: Float


def wider_start(
    start: GaussianStart | PoseStart | WiderStart, mean: float, std: float
) -> GaussianStart | PoseStart | WiderStart:
    """Return a start belief for a state of one more component.

    Parameters
    ----------
    start : GaussianStart, PoseStart or WiderStart
        The belief about the components before it.
    mean, std : float
        Gaussian belief about the new component, independent of the others.

    Returns
    -------
    GaussianStart or WiderStart
    """
    if isinstance(start, GaussianStart):
        return GaussianStart(np.append(start.mean, mean), np.append(start.std, std))
    if isinstance(start, PoseStart):
        return WiderStart(start, np.array([mean]), np.array([std]))
    return start._replace(mean=np.append(start.mean, mean), std=np.append(start.std, std))
