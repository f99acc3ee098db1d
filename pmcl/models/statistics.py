"""What remains of a trajectory for the Metropolis block: statistics whose size does not depend on theta.

Given the trajectory, residuals are computed once. Gaussian noise then needs only sums of squares, so an update costs
O(1); mixtures and growing noise keep the residuals themselves. Each tuple says which entries of theta it uses in
`slots`; -1 means that the value is fixed and stands in `value`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["GaussianSums", "GrowingResiduals", "RangeResiduals", "SightingResiduals", "sum_of_squares"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]


def sum_of_squares(values: Float) -> float:
    """Return the sum of squares of `values` (N,), on one core.

    ``values @ values`` would start BLAS threads on long logs; chains already keep every core busy, and their waiting
    for each other costs a hundred times the product.
    """
    return float(np.square(values).sum())


class GaussianSums(NamedTuple):
    """Residuals with a constant standard deviation per group.

    Attributes
    ----------
    slots : ndarray of int, shape (G,)
        Entry of theta that is the group's standard deviation.
    value : ndarray, shape (G,)
        The standard deviation where it is fixed.
    counts, squares : ndarray, shape (G,)
        Number of residuals and their sum of squares.
    """

    slots: Int
    value: Float
    counts: Float
    squares: Float


class GrowingResiduals(NamedTuple):
    """Increment residuals whose standard deviations grow with distance and turn.

    Attributes
    ----------
    slots, value : ndarray, shape (6,)
        sigma_forward, sigma_left, sigma_turn, sigma_forward_per_metre, sigma_turn_per_radian, sigma_turn_per_metre.
    residual : ndarray, shape (N, 3)
        Forward [m], left [m], turn [rad].
    distance, turn : ndarray, shape (N,)
        Size of each odometry increment [m], [rad].
    """

    slots: Int
    value: Float
    residual: Float
    distance: Float
    turn: Float


class RangeResiduals(NamedTuple):
    """Range residuals that are clipped or may be outliers.

    Attributes
    ----------
    slots, value : ndarray, shape (2,)
        Standard deviation [m], outlier weight.
    residual : ndarray, shape (N,)
        Reading minus expected range [m].
    tail : ndarray, shape (M,)
        For a clipped reading, how far the Gaussian must reach beyond its mean to be clipped [m].
    density : float
        Density of an outlier, 1 / max_range.
    """

    slots: Int
    value: Float
    residual: Float
    tail: Float
    density: float


class SightingResiduals(NamedTuple):
    """Landmark residuals with an outlier mixture over whole sightings.

    Attributes
    ----------
    slots, value : ndarray, shape (4,)
        Standard deviations of distance [m], bearing [rad] and size ratio [1], outlier weight.
    residual : ndarray, shape (N, 3)
        Residuals in that order, NaN where not measured.
    log_scale : ndarray, shape (N,)
        Log of the Jacobian from size ratio to pixels (0 without size).
    log_outlier : ndarray, shape (N,)
        Log density of each sighting as an outlier.
    """

    slots: Int
    value: Float
    residual: Float
    log_scale: Float
    log_outlier: Float
