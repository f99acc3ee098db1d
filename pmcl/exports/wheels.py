"""Corrections of a differential drive's wheels from effects of odometry that were found.

A differential drive reports f = (r + l) / 2 ahead and w = (r - l) / b turned, where l and r are the ways of its left
and right wheel and b is the wheel separation. The effects ``odometry-forward-scale``, ``odometry-turn-scale`` and
``odometry-arc`` say that it really goes f' = S f ahead and turns w' = K f + R w. With wheel radii multiplied by
m_l and m_r and the separation by m_b, the same encoder counts report
``f' = (m_r + m_l) / 2 f + (m_r - m_l) b / 4 w`` and ``w' = (m_r - m_l) / (m_b b) f + (m_r + m_l) / (2 m_b) w``.

Equal coefficients give m_b = S / R and m_r, m_l = S +- K m_b b / 2. What is left over is (m_r - m_l) b / 4 ahead for
each radian turned, which the effects do not have: some millimetres where wheels differ by a percent.

References
----------
Borenstein, Feng, Measurement and Correction of Systematic Odometry Errors in Mobile Robots, 1996; the parameters'
meaning: ros2_controllers, diff_drive_controller.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import PosteriorError

__all__ = ["WHEEL_EFFECTS", "WheelMultipliers", "motion_coefficients", "wheel_multipliers"]

Float = NDArray[np.float64]

WHEEL_EFFECTS = {
    "odometry-forward-scale": "odometry_forward_scale",
    "odometry-turn-scale": "odometry_turn_scale",
    "odometry-arc": "odometry_arc",
}
"""Effects that wrong wheels explain, with their parameters."""


class WheelMultipliers(NamedTuple):
    """By what to multiply the wheel radii and the wheel separation [1], as numbers or as one array of draws each."""

    left: Any
    right: Any
    separation: Any


def motion_coefficients(effects: Sequence[str], theta: Mapping[str, Any]) -> tuple[Any, Any, Any]:
    """Return S, K and R: the robot goes S f ahead and turns K f + R w where its odometry says f and w.

    Parameters
    ----------
    effects : sequence of str
        Effects of the model, in its order; those of :data:`WHEEL_EFFECTS` count. They act one after the other.
    theta : mapping of str to float or ndarray
        Values of their parameters.

    Returns
    -------
    forward, turn_per_metre, turn : float or ndarray
        S [1], K [rad/m] and R [1].
    """
    forward, per_metre, turn = 1.0, 0.0, 1.0
    for effect in effects:
        if effect not in WHEEL_EFFECTS:
            continue
        value = theta[WHEEL_EFFECTS[effect]]
        if effect == "odometry-forward-scale":
            forward = forward * (1.0 + value)
        elif effect == "odometry-turn-scale":
            per_metre, turn = per_metre * (1.0 + value), turn * (1.0 + value)
        else:
            per_metre = per_metre + value * forward
    return forward, per_metre, turn


def wheel_multipliers(
    effects: Sequence[str], theta: Mapping[str, Any], separation: float | None = None
) -> WheelMultipliers:
    """Return the multipliers that correct the odometry of a differential drive.

    Parameters
    ----------
    effects, theta
        As for :func:`motion_coefficients`.
    separation : float, optional
        The wheel separation with which the log's odometry was computed [m]; needed for the effect ``odometry-arc``.

    Returns
    -------
    WheelMultipliers
        Relative to the radii and the separation that the log was recorded with.

    Raises
    ------
    PosteriorError
        When the separation is needed and missing, or is no distance.
    """
    if separation is not None and not (math.isfinite(separation) and separation > 0.0):
        raise PosteriorError(
            f"expected a wheel separation > 0 m, but got {separation:g}; measure it between the wheels"
        )
    forward, per_metre, turn = motion_coefficients(effects, theta)
    ratio = forward / turn
    if "odometry-arc" not in effects:
        return WheelMultipliers(forward, forward, ratio)
    if separation is None:
        raise PosteriorError(
            "expected the wheel separation, since the effect odometry-arc means wheels of unequal size, but got none; "
            "give the separation that the log's odometry was computed with (--wheel-separation)"
        )
    half = 0.5 * per_metre * ratio * separation
    return WheelMultipliers(forward - half, forward + half, ratio)
