"""Landmark residuals for the Metropolis block."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.residuals import parameter_value, theta_logpdf
from pmcl.engine.scalars import HALF_LOG_2PI

__all__ = ["SightingResiduals"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]


class SightingResiduals(NamedTuple):
    """Landmark residuals with an outlier mixture over whole sightings.

    Attributes
    ----------
    theta_index, value : ndarray, shape (4,)
        Standard deviations of distance [m], bearing [rad] and size ratio [1], outlier weight.
    residual : ndarray, shape (N, 3)
        Residuals in that order, NaN where not measured.
    log_scale : ndarray, shape (N,)
        Log of the Jacobian from size ratio to pixels (0 without size).
    log_outlier : ndarray, shape (N,)
        Log density of each sighting as an outlier.
    """

    theta_index: Int
    value: Float
    residual: Float
    log_scale: Float
    log_outlier: Float


@theta_logpdf.register(SightingResiduals)
def _sightings(statistics, theta):
    weight = parameter_value(statistics, theta, 3)
    residual, log_scale, log_outlier = statistics.residual, statistics.log_scale, statistics.log_outlier
    value = 0.0
    for i in range(log_scale.size):
        inlier = math.log(1.0 - weight) + log_scale[i]
        for channel in range(3):
            if not math.isnan(residual[i, channel]):
                std = parameter_value(statistics, theta, channel)
                r = residual[i, channel] / std
                inlier -= 0.5 * r * r + math.log(std) + HALF_LOG_2PI
        outlier = math.log(weight) + log_outlier[i]
        high, low = max(inlier, outlier), min(inlier, outlier)
        value += high + math.log1p(math.exp(low - high))
    return value
