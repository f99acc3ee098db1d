"""What remains of a trajectory for the Metropolis block, for motion by odometry."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.compile import entry
from pmcl.engine.residuals import parameter_value, theta_logpdf
from pmcl.models.motions.odometry.kernels.steps import differential_spreads, measured_step, omni_spreads, step_logpdf

__all__ = ["DifferentialResiduals", "OmniResiduals", "differential_steps", "omni_steps"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]


class DifferentialResiduals(NamedTuple):
    """Steps of a differential drive along a trajectory.

    Attributes
    ----------
    theta_index, value : ndarray, shape (4,)
        alpha1 to alpha4.
    steps : ndarray, shape (N, 6)
        Of each step the distance [m] and the squares of the folded turns [rad^2] that odometry measured; the distance
        that the trajectory goes [m], and the errors of its direction and of its heading [rad].
    """

    theta_index: Int
    value: Float
    steps: Float


class OmniResiduals(NamedTuple):
    """Steps of an omnidirectional drive along a trajectory.

    Attributes
    ----------
    theta_index, value : ndarray, shape (5,)
        alpha1 to alpha5.
    steps : ndarray, shape (N, 6)
        Of each step what odometry measured, forward, left [m] and turn [rad]; errors along and across its direction
        [m], and of the turn [rad].
    """

    theta_index: Int
    value: Float
    steps: Float


@entry
def differential_steps(mean, path):
    """Return the `steps` of :class:`DifferentialResiduals` for odometry `mean` (>= T, 3) and a `path` (T, 3)."""
    n = path.shape[0] - 1
    out = np.empty((n, 6))
    for k in range(n):
        before, after = path[k], path[k + 1]
        first, distance, a, b = measured_step(mean[k + 1, 0], mean[k + 1, 1], mean[k + 1, 2])
        dx, dy = after[0] - before[0], after[1] - before[1]
        out[k, 0], out[k, 1], out[k, 2] = distance, a, b
        out[k, 3] = math.sqrt(dx * dx + dy * dy)
        out[k, 4] = math.atan2(dy, dx) - before[2] - first
        out[k, 5] = after[2] - before[2] - mean[k + 1, 2]
    return out


@entry
def omni_steps(mean, path):
    """Return the `steps` of :class:`OmniResiduals` for odometry `mean` (>= T, 3) and a `path` (T, 3)."""
    n = path.shape[0] - 1
    out = np.empty((n, 6))
    for k in range(n):
        before, after = path[k], path[k + 1]
        forward, left, turn = mean[k + 1, 0], mean[k + 1, 1], mean[k + 1, 2]
        dx, dy = after[0] - before[0], after[1] - before[1]
        bearing = before[2] + math.atan2(left, forward)
        c, s = math.cos(bearing), math.sin(bearing)
        out[k, 0], out[k, 1], out[k, 2] = forward, left, turn
        out[k, 3] = dx * c + dy * s - math.sqrt(forward * forward + left * left)
        out[k, 4] = dy * c - dx * s
        out[k, 5] = after[2] - before[2] - turn
    return out


@theta_logpdf.register(DifferentialResiduals)
def _differential(statistics, theta):
    alpha1, alpha2 = parameter_value(statistics, theta, 0), parameter_value(statistics, theta, 1)
    alpha3, alpha4 = parameter_value(statistics, theta, 2), parameter_value(statistics, theta, 3)
    steps = statistics.steps
    value = 0.0
    for k in range(steps.shape[0]):
        along, heading, share, direction = differential_spreads(
            steps[k, 0], steps[k, 1], steps[k, 2], alpha1, alpha2, alpha3, alpha4
        )
        value += step_logpdf(steps[k, 0], along, heading, share, direction, steps[k, 3], steps[k, 4], steps[k, 5])
    return value


@theta_logpdf.register(OmniResiduals)
def _omni(statistics, theta):
    alpha1, alpha2 = parameter_value(statistics, theta, 0), parameter_value(statistics, theta, 1)
    alpha3, alpha4 = parameter_value(statistics, theta, 2), parameter_value(statistics, theta, 3)
    alpha5 = parameter_value(statistics, theta, 4)
    steps = statistics.steps
    value = 0.0
    for k in range(steps.shape[0]):
        along, aside, turn = omni_spreads(steps[k, 0], steps[k, 1], steps[k, 2], alpha1, alpha2, alpha3, alpha4, alpha5)
        value -= math.log(along * aside * turn)
        value -= 0.5 * ((steps[k, 3] / along) ** 2 + (steps[k, 4] / aside) ** 2 + (steps[k, 5] / turn) ** 2)
    return value
