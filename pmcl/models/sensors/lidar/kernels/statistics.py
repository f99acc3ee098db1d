"""What the Metropolis update of a lidar's parameters needs to know of a trajectory."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.residuals import parameter_value, theta_logpdf
from pmcl.engine.scalars import HALF_LOG_2PI
from pmcl.models.sensors.lidar.kernels.beam import beam_logpdf

__all__ = ["BeamReadings", "FieldCounts"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]


class FieldCounts(NamedTuple):
    """How many readings end at which distance from an occupied cell: all that a likelihood field asks.

    Attributes
    ----------
    theta_index, value : ndarray, shape (2,)
        sigma_hit [m], z_rand.
    distance, counts : ndarray, shape (N,)
        Distances [m], and how many readings of a laser end there.
    uniform : ndarray, shape (N,)
        1 / max_range of that laser [1/m].
    cell_noise : float
        Standard deviation of what the cells hide [m], see :func:`pmcl.models.sensors.lidar.table.cell_noise`.
    exponent : float
        Of each reading's density.
    """

    theta_index: Int
    value: Float
    distance: Float
    counts: Float
    uniform: Float
    cell_noise: float
    exponent: float


class BeamReadings(NamedTuple):
    """Readings and what they should be.

    Attributes
    ----------
    theta_index, value : ndarray, shape (5,)
        sigma_hit [m], z_short, z_max, z_rand, lambda_short [1/m].
    reading, expected, max_range : ndarray, shape (N,)
        As the beam model takes them [m].
    exponent : float
        Of each reading's density.
    """

    theta_index: Int
    value: Float
    reading: Float
    expected: Float
    max_range: Float
    exponent: float


@theta_logpdf.register(FieldCounts)
def _field(statistics, theta):
    sigma, z_rand = parameter_value(statistics, theta, 0), parameter_value(statistics, theta, 1)
    if not 0.0 <= z_rand <= 1.0:
        return -np.inf
    std = math.hypot(sigma, statistics.cell_noise)
    constant = math.log((1.0 - z_rand) / std) - HALF_LOG_2PI
    value = 0.0
    for k in range(statistics.counts.size):
        r = statistics.distance[k] / std
        log_hit = constant - 0.5 * r * r
        floor = z_rand * statistics.uniform[k]
        value += statistics.counts[k] * (math.log(math.exp(log_hit) + floor) if floor > 0.0 else log_hit)
    return statistics.exponent * value


@theta_logpdf.register(BeamReadings)
def _beam(statistics, theta):
    std, rate = parameter_value(statistics, theta, 0), parameter_value(statistics, theta, 4)
    z_short, z_max = parameter_value(statistics, theta, 1), parameter_value(statistics, theta, 2)
    z_rand = parameter_value(statistics, theta, 3)
    z_hit = 1.0 - z_short - z_max - z_rand
    if z_hit < 0.0:
        return -np.inf
    value = 0.0
    for k in range(statistics.reading.size):
        value += beam_logpdf(
            statistics.reading[k], statistics.expected[k], statistics.max_range[k], std, z_hit, z_short, z_max, z_rand,
            rate,
        )  # fmt: skip
    return statistics.exponent * value
