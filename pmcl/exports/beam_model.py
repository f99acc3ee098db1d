"""The beam model's mixture in the scaling of nav2, ROS 1 AMCL and beluga.

pmcl's density of one reading z, expected at z*, is normalised: a hit is a normal density, truncated to the sensor's
range, a short reading an exponential density truncated at z*, a random one is uniform, and no echo is a point mass.
beluga's mixture of one reading is the same. nav2 and ROS 1 AMCL leave out the normal density's factor and both
truncations. With the weights ``c (z_hit / (sigma sqrt(2 pi)), z_short, z_max, z_rand)`` their mixture is proportional
to pmcl's wherever the truncations do not matter: where z* is some sigma_hit away from 0 and from the greatest range,
and 1 / lambda_short is short against z*.

All three add up the cubes of the mixtures over the beams, where a likelihood multiplies the mixtures. So there is no
exact export of a beam model. A filter with these numbers knows each beam as it is, but not what a whole scan is worth.

References
----------
Sources of nav2_amcl, beam_model.cpp, and of beluga, beam_model.hpp; Thrun, Burgard, Fox, Probabilistic Robotics, 2005,
section 6.3.
"""

from __future__ import annotations

import math
from typing import NamedTuple

__all__ = ["BeamWeights", "beluga_beam_weights", "nav2_beam_weights"]


class BeamWeights(NamedTuple):
    """Weights of the four kinds of readings in one program's meaning; they sum to one."""

    z_hit: float
    z_short: float
    z_max: float
    z_rand: float


def nav2_beam_weights(z_short: float, z_max: float, z_rand: float, sigma_hit: float) -> BeamWeights:
    """Return the weights of the model ``beam`` of nav2 and of ROS 1 AMCL.

    Parameters
    ----------
    z_short, z_max, z_rand : float
        Probabilities of short readings, of no echo and of random readings; that of a hit is the rest.
    sigma_hit : float
        Standard deviation of a hit [m].

    Returns
    -------
    BeamWeights
    """
    hit = (1.0 - z_short - z_max - z_rand) / (sigma_hit * math.sqrt(2.0 * math.pi))
    total = hit + z_short + z_max + z_rand
    return BeamWeights(hit / total, z_short / total, z_max / total, z_rand / total)


def beluga_beam_weights(z_short: float, z_max: float, z_rand: float) -> BeamWeights:
    """Return the weights of beluga's model ``beam``: they are pmcl's.

    Parameters
    ----------
    z_short, z_max, z_rand : float
        Probabilities of short readings, of no echo and of random readings; that of a hit is the rest.

    Returns
    -------
    BeamWeights
    """
    return BeamWeights(1.0 - z_short - z_max - z_rand, z_short, z_max, z_rand)
