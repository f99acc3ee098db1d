"""Increment residuals for the Metropolis block, where noise grows with distance and turn."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.residuals import parameter_value, theta_logpdf

__all__ = ["GrowingResiduals"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]


class GrowingResiduals(NamedTuple):
    """Increment residuals whose standard deviations grow with distance and turn.

    Attributes
    ----------
    theta_index, value : ndarray, shape (6,)
        sigma_forward, sigma_left, sigma_turn, sigma_forward_per_metre, sigma_turn_per_radian, sigma_turn_per_metre.
    residual : ndarray, shape (N, 3)
        Forward [m], left [m], turn [rad].
    distance, turn : ndarray, shape (N,)
        Size of each odometry increment [m], [rad].
    """

    theta_index: Int
    value: Float
    residual: Float
    distance: Float
    turn: Float


@theta_logpdf.register(GrowingResiduals)
def _growing(statistics, theta):
    forward, left = parameter_value(statistics, theta, 0), parameter_value(statistics, theta, 1)
    turn = parameter_value(statistics, theta, 2)
    forward_per_metre, turn_per_radian = parameter_value(statistics, theta, 3), parameter_value(statistics, theta, 4)
    turn_per_metre = parameter_value(statistics, theta, 5)
    residual, distance, angle = statistics.residual, statistics.distance, statistics.turn
    value = 0.0
    for i in range(distance.size):
        var_forward = forward**2 + (forward_per_metre * distance[i]) ** 2
        var_turn = turn**2 + (turn_per_radian * angle[i]) ** 2 + (turn_per_metre * distance[i]) ** 2
        value -= 0.5 * math.log(var_forward * var_turn)
        value -= 0.5 * (residual[i, 0] ** 2 / var_forward + residual[i, 2] ** 2 / var_turn)
        value -= 0.5 * (residual[i, 1] / left) ** 2
    return value - distance.size * math.log(left)
