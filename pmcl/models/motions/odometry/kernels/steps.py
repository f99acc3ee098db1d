"""One step of AMCL's odometry models: what odometry measured, how much noise that gives, and the density of a step.

The step of a differential drive is a turn, a drive along the new direction, and a second turn. Its density in the space
of poses follows by a change of variables. Let D be the length of the displacement, e the heading's error, and d the
error of the displacement's direction. The heading's error is the sum of the errors of both turns; given it, the error
of the first turn is Gaussian with mean c e and a variance w. A displacement may come from a drive forward or from a
drive backward in the opposite direction, and the direction is known up to full turns:

    p(pose | previous pose) = 1/D N(e; 0, S^2) sum_m N(d + m pi - c e; 0, w) N((-1)^m D; distance, along^2)

over all integers m, with the factor 1/D of polar coordinates. It is infinite at D = 0, but integrable.
"""

from __future__ import annotations

import math

from pmcl.engine.compile import kernel
from pmcl.engine.scalars import HALF_LOG_2PI, LOG_2PI, TURN, wrap_angle

__all__ = [
    "FEW_WRAPS",
    "NEAREST",
    "SHORTEST",
    "differential_spreads",
    "fold_for_reversing",
    "measured_step",
    "omni_spreads",
    "step_logpdf",
]

# Below this distance [m] nav2_amcl and beluga take a step for a turn on the spot and its direction for the robot's.
SHORTEST = 0.01
# Where the robot stands, AMCL's models have no noise at all, and a step without noise has no density. These standard
# deviations of the drive [m] and of the heading [rad] are added to the models' own in squares. They are a tenth of what
# a robot can notice on a map with cells of 5 cm; where alphas are 0.001 and steps 0.25 m or 0.2 rad, they move the
# likeliest alphas by less than 3 per cent (tests/models/test_odometry_motion.py).
FLOOR_LENGTH, FLOOR_TURN = 1e-3, 1e-3
# A robot that turns on the spot goes ahead or back by the noise of the drive, in AMCL's model exactly so. This standard
# deviation [rad] of the direction is for a drive of no length; it falls to a hundredth where the drive is ten times
# SHORTEST. It depends on no alpha: one that did would reward alphas for widening it.
FLOOR_DIRECTION = 0.1
# The density of a displacement shorter than this [m] is that at this length: it must stay a number.
NEAREST = 1e-9
# Below this standard deviation [rad] of the direction, full turns of it change the log density only where it is
# below -50; above the second one its distribution is uniform up to 3e-8.
FEW_WRAPS, NO_DIRECTION = 0.3, 6.0


@kernel
def fold_for_reversing(angle):
    """Return the angle [rad] between a direction and the robot's axis, 0 to pi/2: reversing is as exact as driving."""
    size = abs(wrap_angle(angle))
    return min(size, math.pi - size)


@kernel
def measured_step(forward, left, turn):
    """Return what odometry measured as (first turn, distance, squares of the first and of the second turn, folded).

    Angles in rad, the distance in m. The second turn is the turn less the first one.
    """
    distance = math.sqrt(forward * forward + left * left)
    first = math.atan2(left, forward) if distance >= SHORTEST else 0.0
    a, b = fold_for_reversing(first), fold_for_reversing(turn - first)
    return first, distance, a * a, b * b


@kernel
def differential_spreads(distance, first, second, alpha1, alpha2, alpha3, alpha4):
    """Return the noise of a step of a differential drive.

    Parameters
    ----------
    distance : float
        Length of the step [m].
    first, second : float
        Squares of the folded turns [rad^2].
    alpha1, alpha2, alpha3, alpha4 : float
        Factors of the variances.

    Returns
    -------
    along, heading : float
        Standard deviations of the drive [m] and of the heading [rad].
    share, direction : float
        The direction's error is `share` times that of the heading plus Gaussian noise of standard deviation
        `direction` [rad].
    """
    square = distance * distance
    variance = alpha3 * square + alpha4 * (first + second) + FLOOR_LENGTH * FLOOR_LENGTH
    of_first, of_second = alpha1 * first + alpha2 * square, alpha1 * second + alpha2 * square
    of_second += FLOOR_TURN * FLOOR_TURN
    total = of_first + of_second
    aside = FLOOR_DIRECTION / (1.0 + square / (SHORTEST * SHORTEST))
    share = of_first / total
    return math.sqrt(variance), math.sqrt(total), share, math.sqrt(share * of_second + aside * aside)


@kernel
def step_logpdf(distance, along, heading_std, share, direction_std, length, direction, heading):
    """Return the log density of one step of a differential drive, see the module.

    Parameters
    ----------
    distance : float
        Length of the step as odometry has it [m].
    along, heading_std, share, direction_std : float
        From :func:`differential_spreads`.
    length : float
        Distance between the poses [m].
    direction, heading : float
        Errors of the displacement's direction and of the heading [rad]; only the former is wrapped.
    """
    d = wrap_angle(direction - share * heading)
    length = max(length, NEAREST)
    constant = -math.log(length * heading_std * along) - LOG_2PI - 0.5 * (heading / heading_std) ** 2
    ahead, back = -0.5 * ((length - distance) / along) ** 2, -0.5 * ((length + distance) / along) ** 2
    if direction_std > NO_DIRECTION:
        high = max(ahead, back)
        return constant - math.log(TURN) + high + math.log1p(math.exp(min(ahead, back) - high))
    first = ahead - 0.5 * (d / direction_std) ** 2
    second = back - 0.5 * ((math.pi - abs(d)) / direction_std) ** 2
    high = max(first, second)
    if direction_std < FEW_WRAPS:
        total = 1.0 + math.exp(min(first, second) - high)
    else:
        total = 0.0
        most = 2 + 2 * int(direction_std)
        for m in range(-most, most + 1):
            term = ahead if m % 2 == 0 else back
            total += math.exp(term - 0.5 * ((d + m * math.pi) / direction_std) ** 2 - high)
    return constant - HALF_LOG_2PI - math.log(direction_std) + high + math.log(total)


@kernel
def omni_spreads(forward, left, turn, alpha1, alpha2, alpha3, alpha4, alpha5):
    """Return (along, aside, turn): standard deviations of a step of an omnidirectional drive [m, m, rad]."""
    square, angle = forward * forward + left * left, wrap_angle(turn)
    angle *= angle
    floor = FLOOR_LENGTH * FLOOR_LENGTH
    return (
        math.sqrt(alpha3 * square + alpha4 * angle + floor),
        math.sqrt(alpha5 * square + alpha4 * angle + floor),
        math.sqrt(alpha1 * angle + alpha2 * square + FLOOR_TURN * FLOOR_TURN),
    )
