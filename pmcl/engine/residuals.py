"""What remains of a trajectory for the Metropolis block: statistics whose size does not depend on theta.

Given the trajectory, residuals are computed once. Gaussian noise then needs only sums of squares, so an update costs
O(1); mixtures and growing noise keep the residuals themselves. Each tuple says which entries of theta it uses in
`theta_index`; -1 means that the value is fixed and stands in `value`. A type of statistics registers
:func:`theta_logpdf`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.compile import generic, kernel

__all__ = ["GaussianSums", "parameter_value", "sum_of_squares", "theta_logpdf"]

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
    theta_index : ndarray of int, shape (G,)
        Entry of theta that is the group's standard deviation.
    value : ndarray, shape (G,)
        The standard deviation where it is fixed.
    counts, squares : ndarray, shape (G,)
        Number of residuals and their sum of squares.
    """

    theta_index: Int
    value: Float
    counts: Float
    squares: Float


@generic
def theta_logpdf(statistics, theta):
    """Return the log density of the residuals, up to a constant that does not depend on theta."""


@kernel
def parameter_value(statistics, theta, position):
    """Return the value of the parameter at `position` of `theta_index`: of theta, or the fixed one."""
    entry = statistics.theta_index[position]
    return theta[entry] if entry >= 0 else statistics.value[position]


@theta_logpdf.register(GaussianSums)
def _gaussian(statistics, theta):
    value = 0.0
    for group in range(statistics.theta_index.size):
        std = parameter_value(statistics, theta, group)
        value -= statistics.counts[group] * math.log(std) + 0.5 * statistics.squares[group] / (std * std)
    return value
