r"""A likelihood field's weights for filters that multiply beams: nav2, ROS 1 AMCL and beluga.

pmcl weighs a scan by the product over its beams of ``(z_hit N(d; 0, sigma_hit) + z_rand / max_range) ** exponent``,
where d is the distance of a beam's end point from the nearest obstacle. ``likelihood_field_prob`` of nav2 and of ROS 1
AMCL multiplies ``z_hit' exp(-d^2 / (2 sigma^2)) + z_rand' / max_range``: the normal density's factor is missing. That
of beluga has the factor.

Without tempering the translation is exact. For nav2 it is
``(z_hit', z_rand') = c (z_hit / (sigma sqrt(2 pi)), z_rand)``; c makes them sum to one, and a factor that all weights
share changes nothing.

None of these programs has an exponent. A tempered beam, ``(a exp(-d^2 / (2 sigma^2)) + b) ** exponent``, has nearly the
shape of an untempered beam with a wider hit and more random readings. Its height and its floor are kept exactly. The
new sigma_hit is the one for which the greatest difference between the log weights, over all distances, is least. So all
beams are kept. The other way, to use only as many beams as a scan is worth independent ones, throws readings away.

The model ``likelihood_field``, the default of all three, adds up the cubes of the beams' weights. No choice of its
parameters makes a sum of cubes proportional to a product, so there is no exact export for it.

References
----------
Sources of nav2_amcl, likelihood_field_model_prob.cpp, and of beluga, likelihood_field_model_base.hpp.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

__all__ = ["FieldWeights", "beluga_weights", "log_weight", "nav2_weights", "without_exponent"]

Float = NDArray[np.float64]

_ROOT_2PI = math.sqrt(2.0 * math.pi)
# The distances at which log weights are compared reach to where the wider of the two hits has faded to exp(-18).
_FADED = 6.0
_DISTANCES = 400


class FieldWeights(NamedTuple):
    """Parameters of a likelihood field in one program's meaning.

    Attributes
    ----------
    z_hit, z_rand : float
        Weights, which sum to one.
    sigma_hit : float
        Standard deviation of a hit [m].
    deviation : float
        By how much the log weight of one beam differs from pmcl's at most, apart from a constant [nat].
    """

    z_hit: float
    z_rand: float
    sigma_hit: float
    deviation: float


def log_weight(height: float, floor: float, sigma: float, exponent: float, distance: Float) -> Float:
    """Return the log weight of a beam, ``exponent log(height exp(-d^2 / (2 sigma^2)) + floor)``.

    Parameters
    ----------
    height, floor : float
        Greatest density of a hit and density of a random reading [1/m].
    sigma : float
        Standard deviation of a hit [m].
    exponent : float
        Tempering.
    distance : ndarray
        Distances of end points from obstacles [m].

    Returns
    -------
    ndarray
        In the shape of `distance` [nat].
    """
    return np.asarray(exponent * np.log(height * np.exp(-0.5 * (distance / sigma) ** 2) + floor))


def without_exponent(
    z_hit: float, z_rand: float, sigma_hit: float, max_range: float, exponent: float
) -> tuple[float, float, float, float]:
    """Return the untempered beam that is nearest to a tempered one.

    Parameters
    ----------
    z_hit, z_rand : float
        Weights of hits and of random readings.
    sigma_hit : float
        Standard deviation of a hit [m].
    max_range : float
        Range of random readings [m].
    exponent : float
        Tempering, above 0 and at most 1.

    Returns
    -------
    height, floor, sigma, deviation : float
        The beam ``height exp(-d^2 / (2 sigma^2)) + floor``, with height + floor = 1; `deviation` is the greatest
        difference of log weights [nat]. With exponent 1, or with no random readings, there is none.
    """
    height, floor = z_hit / (sigma_hit * _ROOT_2PI), z_rand / max_range
    total = height + floor
    if exponent == 1.0:
        return height / total, floor / total, sigma_hit, 0.0
    if floor == 0.0:
        return 1.0, 0.0, sigma_hit / math.sqrt(exponent), 0.0
    # Relative to the greatest weight, that of d = 0, which both have in common.
    depth = exponent * math.log(floor / total)
    new_floor = math.exp(depth)
    new_height = -math.expm1(depth)
    widest = sigma_hit / math.sqrt(exponent)
    distance = np.linspace(0.0, _FADED * widest, _DISTANCES)
    tempered = log_weight(height / total, floor / total, sigma_hit, exponent, distance)

    def deviation(sigma: float) -> float:
        return float(np.abs(log_weight(new_height, new_floor, sigma, 1.0, distance) - tempered).max())

    found = minimize_scalar(deviation, bounds=(0.5 * sigma_hit, 2.0 * widest), method="bounded")
    return new_height, new_floor, float(found.x), float(found.fun)


def nav2_weights(
    z_hit: float, z_rand: float, sigma_hit: float, max_range: float, exponent: float = 1.0
) -> FieldWeights:
    """Return the parameters of ``likelihood_field_prob`` of nav2 and of ROS 1 AMCL.

    Parameters
    ----------
    z_hit, z_rand, sigma_hit, max_range, exponent : float
        As for :func:`without_exponent`.

    Returns
    -------
    FieldWeights
    """
    height, floor, sigma, deviation = without_exponent(z_hit, z_rand, sigma_hit, max_range, exponent)
    return _summing_to_one(height, floor * max_range, sigma, deviation)


def beluga_weights(
    z_hit: float, z_rand: float, sigma_hit: float, max_range: float, exponent: float = 1.0
) -> FieldWeights:
    """Return the parameters of beluga's ``likelihood_field_prob``.

    Parameters
    ----------
    z_hit, z_rand, sigma_hit, max_range, exponent : float
        As for :func:`without_exponent`.

    Returns
    -------
    FieldWeights
    """
    height, floor, sigma, deviation = without_exponent(z_hit, z_rand, sigma_hit, max_range, exponent)
    return _summing_to_one(height * sigma * _ROOT_2PI, floor * max_range, sigma, deviation)


def _summing_to_one(hit: float, random: float, sigma: float, deviation: float) -> FieldWeights:
    return FieldWeights(hit / (hit + random), random / (hit + random), sigma, deviation)
