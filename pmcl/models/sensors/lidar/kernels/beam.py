"""The beam model of one lidar reading: density and distribution function (Thrun, Burgard, Fox 2005, section 6.3).

Two details differ from the book, so that the probabilities of all readings sum to 1 wherever the wall stands. A hit
beyond the longest range is no echo, instead of being normalised away: the wall may stand beyond that range. What stands
before the wall is exponential on the part of the ray that the laser can see.
"""

from __future__ import annotations

import math

import numpy as np

from pmcl.engine.compile import kernel
from pmcl.engine.scalars import HALF_LOG_2PI
from pmcl.models.sensors.lidar.table import OPEN_RAY

__all__ = ["beam_below", "beam_logpdf", "expected_range"]

_ROOT_HALF = math.sqrt(0.5)
# Beyond so many standard deviations a Gaussian has no tail that double precision would notice.
_FAR = 9.0
# Densities below this have lost digits, or everything, in the exponential.
_LEAST_DENSITY = 1e-290
# A wall is expected no nearer than this [m]: a large negative bias would otherwise put it behind the laser.
_NEAREST = 1e-3


@kernel
def expected_range(length, scale, bias, max_range):
    """Return what a hit should read [m]; finite where the ray meets nothing."""
    return max(min(scale * length + bias, OPEN_RAY * max_range), _NEAREST)


@kernel
def _below(x):
    """Return the probability that a standard normal is less than x."""
    return 0.5 * math.erfc(-x * _ROOT_HALF)


@kernel
def _positive_share(expected, std):
    """Return the probability that a Gaussian around `expected` is positive."""
    return 1.0 if expected > _FAR * std else _below(expected / std)


@kernel
def beam_logpdf(z, expected, max_range, std, z_hit, z_short, z_max, z_rand, rate):
    """Return the log density of one reading `z` [m]; at `max_range`, no echo, its log probability.

    `expected` is from :func:`expected_range`, the others are as in
    :class:`~pmcl.models.sensors.lidar.table.LidarTable`.
    """
    if z_hit < 0.0:
        return -np.inf
    positive = _positive_share(expected, std)
    if z >= max_range:
        share = z_max + z_hit * min(_below((expected - max_range) / std) / positive, 1.0)
        return math.log(share) if share > 0.0 else -np.inf
    r = (z - expected) / std
    log_hit = -0.5 * r * r - HALF_LOG_2PI - math.log(std * positive)
    density = z_hit * math.exp(log_hit) + z_rand / max_range
    if z <= expected and z_short > 0.0:
        density += z_short * rate * math.exp(-rate * z) / -math.expm1(-rate * min(expected, max_range))
    if density > _LEAST_DENSITY:
        return math.log(density)
    # So unlikely that the exponential vanished: on the scale of logarithms it did not.
    return math.log(z_hit) + log_hit if z_hit > 0.0 else -np.inf


@kernel
def beam_below(z, expected, max_range, std, z_hit, z_short, z_max, z_rand, rate):
    """Return the probabilities of a smaller reading than `z`, and of a smaller or equal one."""
    reached = min(z, max_range)
    seen = min(expected, max_range)
    hit = 1.0 - _below((expected - reached) / std) / _positive_share(expected, std)
    short = math.expm1(-rate * min(reached, seen)) / math.expm1(-rate * seen)
    below = z_hit * max(hit, 0.0) + z_short * short + z_rand * reached / max_range
    return below, 1.0 if z >= max_range else below
