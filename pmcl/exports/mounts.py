"""Where a laser really sits on the robot, from effects of its mount that were found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

__all__ = ["MOUNT_EFFECTS", "corrected_mount"]

MOUNT_EFFECTS = {"sensor-yaw": ("sensor_yaw",), "sensor-offset": ("sensor_offset_x", "sensor_offset_y")}
"""Effects that correct the mount of all lasers together, with their parameters."""


def corrected_mount(
    pose: tuple[float, float, float], effects: Sequence[str], theta: Mapping[str, Any]
) -> tuple[Any, Any, Any]:
    """Return where a laser sits, given where it is described to sit.

    Parameters
    ----------
    pose : tuple of float
        (x [m], y [m], yaw [rad]) on the robot, as described.
    effects : sequence of str
        Effects of the model, in its order; those of :data:`MOUNT_EFFECTS` count. ``sensor-yaw`` turns all lasers
        together around the robot's centre, ``sensor-offset`` shifts them along the robot's axes.
    theta : mapping of str to float or ndarray
        Values of their parameters.

    Returns
    -------
    x, y, yaw : float or ndarray
        On the robot [m, m, rad].
    """
    x: Any
    y: Any
    yaw: Any
    x, y, yaw = pose
    for effect in effects:
        if effect == "sensor-yaw":
            turned = theta["sensor_yaw"]
            c, s = np.cos(turned), np.sin(turned)
            x, y, yaw = c * x - s * y, s * x + c * y, yaw + turned
        elif effect == "sensor-offset":
            x, y = x + theta["sensor_offset_x"], y + theta["sensor_offset_y"]
    return x, y, yaw
