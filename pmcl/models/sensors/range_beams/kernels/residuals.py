"""Range residuals for the Metropolis block."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.residuals import parameter_value, theta_logpdf
from pmcl.engine.scalars import HALF_LOG_2PI
from pmcl.engine.student import log_normal_tail

__all__ = ["RangeResiduals"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]


class RangeResiduals(NamedTuple):
    """Range residuals that are clipped or may be outliers.

    Attributes
    ----------
    theta_index, value : ndarray, shape (2,)
        Standard deviation [m], outlier weight.
    residual : ndarray, shape (N,)
        Reading minus expected range [m].
    tail : ndarray, shape (M,)
        For a clipped reading, how far the Gaussian must reach beyond its mean to be clipped [m].
    density : float
        Density of an outlier, 1 / max_range.
    """

    theta_index: Int
    value: Float
    residual: Float
    tail: Float
    density: float


@theta_logpdf.register(RangeResiduals)
def _ranges(statistics, theta):
    std, weight = parameter_value(statistics, theta, 0), parameter_value(statistics, theta, 1)
    constant = math.log((1.0 - weight) / std) - HALF_LOG_2PI
    floor = weight * statistics.density
    residual, tail = statistics.residual, statistics.tail
    value = 0.0
    for i in range(residual.size):
        r = residual[i] / std
        value += math.log(math.exp(constant - 0.5 * r * r) + floor) if floor > 0.0 else constant - 0.5 * r * r
    for i in range(tail.size):
        value += math.log(1.0 - weight) + log_normal_tail(tail[i] / std)
    return value
