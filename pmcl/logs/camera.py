"""From what a camera says about a fiducial tag to the range and bearing of a landmark."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmcl.logs.validation import fail
from pmcl.maps.arrays import as_numbers

__all__ = ["sightings_from_camera"]

Float = NDArray[np.float64]


def sightings_from_camera(positions: ArrayLike, *, tilt: float = 0.0, roll: float = 0.0) -> tuple[Float, Float]:
    """Turn positions of tags in a camera's frame into distances and bearings in the plane on which the robot drives.

    Detectors of AprilTag, ArUco and other fiducial tags give the position of a tag (``tvec``, ``pose_t``) in the
    camera's optical frame: x to the right of the image, y down, z ahead.

    Parameters
    ----------
    positions : array_like, shape (R, 3)
        Centres of the tags in the optical frame [m].
    tilt : float, optional
        Angle by which the camera looks down below the horizon [rad]; negative when it looks up.
    roll : float, optional
        Angle by which the camera is turned clockwise about its optical axis, as seen from behind it [rad].

    Returns
    -------
    ranges : ndarray, shape (R,)
        Distance from the camera, measured along the floor [m].
    bearings : ndarray, shape (R,)
        Angle counter-clockwise from the direction of the camera, in [-pi, pi] [rad].

    Raises
    ------
    LogError
        When the shape is another, or something is not finite.

    Notes
    -----
    Where the camera sits on the robot and where it looks is the argument ``landmark_sensor_pose`` (x, y, yaw) of
    :meth:`pmcl.RobotLog.build`; its height does not matter, because only horizontal distances count.
    """
    where = "sightings_from_camera"
    try:
        given = as_numbers(positions)
    except TypeError as problem:
        fail(where, f"expected positions [m], got {problem}: convert them")
    if given.ndim != 2 or given.shape[1] != 3:
        fail(where, f"expected positions of shape (R, 3): tag, (right, down, ahead), got {given.shape}: reshape them")
    if not np.isfinite(given).all():
        k = int(np.argwhere(~np.isfinite(given))[0, 0])
        fail(where, f"expected finite positions, got {given[k].tolist()} at index {k}: leave failed detections out")
    right, down, ahead = given.T
    # A camera that is turned clockwise sees the world turned counter-clockwise.
    level_right = right * np.cos(roll) - down * np.sin(roll)
    level_down = right * np.sin(roll) + down * np.cos(roll)
    forward = ahead * np.cos(tilt) - level_down * np.sin(tilt)
    return np.hypot(forward, level_right), np.arctan2(-level_right, forward)
