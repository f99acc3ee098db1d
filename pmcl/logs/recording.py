"""A velocity and landmark recording, as published data sets hold it, and its conversion to a robot log."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmcl.errors import MapError
from pmcl.logs.resample import hold_and_integrate, interpolate_poses, regular_times, sort_sightings
from pmcl.logs.robot_log import RobotLog
from pmcl.logs.schema import MOST_NUMBERS
from pmcl.logs.validation import fail
from pmcl.maps.landmarks import LandmarkMap

__all__ = ["REFERENCE_START_STD", "LandmarkRecording", "landmark_map", "resample_recording"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

REFERENCE_START_STD = (0.1, 0.1, 0.1)
"""How exactly a robot is placed at a known pose [m, m, rad]: what ``start="reference"`` believes."""

# Longest pause of a motion-capture reference that is bridged [s]; within it a slow robot moves a few centimetres.
_MAX_REFERENCE_GAP = 0.5


class LandmarkRecording(NamedTuple):
    """Velocities, landmark readings and reference poses, each with its own clock.

    Attributes
    ----------
    hold_times, forward_velocity, angular_velocity : ndarray, shape (N,)
        Velocities [m/s, rad/s] and when each starts to hold [s].
    reading_times : ndarray, shape (R,)
        When each landmark was seen [s].
    reading_landmark : ndarray of int, shape (R,)
        Index of the landmark in `landmarks`.
    reading_values : ndarray, shape (R, 2)
        Distance [m] and bearing [rad] in the sensor frame.
    landmarks : LandmarkMap
        The landmark map.
    sensor_pose : ndarray, shape (3,)
        Where the sensor sits on the robot [m, m, rad].
    pose_times, poses : ndarray, shapes (M,) and (M, 3)
        Reference trajectory of the robot's centre [s; m, m, rad]; M = 0 when there is none.
    """

    hold_times: Float
    forward_velocity: Float
    angular_velocity: Float
    reading_times: Float
    reading_landmark: Int
    reading_values: Float
    landmarks: LandmarkMap
    sensor_pose: Float
    pose_times: Float
    poses: Float


def landmark_map(positions: ArrayLike, where: str, names: tuple[str, ...] = ()) -> LandmarkMap:
    """Return the landmark map of a recording.

    Parameters
    ----------
    positions : array_like, shape (J, 2)
        Where each landmark stands [m].
    where : str
        File, for messages.
    names : tuple of str, optional
        One name for each landmark.

    Returns
    -------
    LandmarkMap

    Raises
    ------
    MapError
        As :class:`~pmcl.maps.landmarks.LandmarkMap` raises it, beginning with the file.
    """
    try:
        return LandmarkMap(np.asarray(positions), names)
    except MapError as problem:
        raise MapError(f"{where}: {problem}") from None


def resample_recording(
    recording: LandmarkRecording,
    *,
    period: float,
    start: str,
    begin: float,
    duration: float | None,
    max_offset: float | None,
    robot: str,
    source: str,
    dropped: Mapping[str, int],
    where: str,
) -> RobotLog:
    """Resample a recording to a regular period.

    Time zero of the log is the first instant for which both velocities and, where there is one, the reference are
    known; the log ends when either ends. Readings outside that interval are dropped and counted.

    Parameters
    ----------
    recording : LandmarkRecording
        What was recorded.
    period : float
        Time between samples [s].
    start : {"reference", "anywhere"}
        ``"reference"``: the robot was placed at a known pose, the first one of the reference, with standard deviation
        :data:`REFERENCE_START_STD`. ``"anywhere"``: nothing is known about the start.
    begin : float
        Start of the log, in seconds after time zero.
    duration : float or None
        Length of the log [s]; None for all that is there.
    max_offset : float or None
        Readings further from the nearest sample are dropped [s]; None for half a period, which keeps all.
    robot, source : str
        What moved, and where the data come from.
    dropped : mapping
        Numbers of readings that the reader left out already, as attributes of the log.
    where : str
        File or folder, for messages.

    Returns
    -------
    RobotLog
        With ``landmark_time_offset``, ``true_pose`` when there is a reference, and attributes ``time_origin``
        (time zero of the log on the recording's clock [s]) and the numbers of dropped readings.

    Raises
    ------
    LogError
        When a setting is out of range, fewer than two or far too many samples remain, or the start has no reference
        pose.
    """
    if start not in ("reference", "anywhere"):
        fail(where, f"expected start = 'reference' or 'anywhere', got {start!r}: choose one")
    for name, value, allowed in (
        ("period", period, 0.0 < period < math.inf),
        ("begin", begin, 0.0 <= begin < math.inf),
        ("duration", duration, duration is None or duration > 0.0),
        ("max_offset", max_offset, max_offset is None or max_offset >= 0.0),
    ):
        if not allowed:
            bound = ">= 0" if name in ("begin", "max_offset") else "> 0"
            fail(where, f"expected {name} {bound} [s], got {value}: choose another")
    has_reference = len(recording.pose_times) > 0
    clocks = [recording.hold_times, *([recording.pose_times] if has_reference else [])]
    origin, end = max(clock[0] for clock in clocks), min(clock[-1] for clock in clocks)
    last = min(end - origin, begin + (math.inf if duration is None else duration))
    times = regular_times(begin, last, period, where)
    if len(times) < 2:
        fail(
            where,
            f"expected at least two samples, got {len(times)} of period {period:g} s from {begin:g} s on in "
            f"{end - origin:.3f} s of recording: choose a shorter period, an earlier begin or a longer duration",
        )
    n_landmarks = len(recording.landmarks.positions)
    if len(times) * n_landmarks > MOST_NUMBERS:
        fail(
            where,
            f"expected at most {MOST_NUMBERS} cells for readings, got {len(times)} samples of {n_landmarks} landmarks: "
            "choose a longer period or a shorter duration",
        )
    true_poses = None
    if has_reference:
        true_poses = interpolate_poses(recording.pose_times - origin, recording.poses, times, _MAX_REFERENCE_GAP)
    mean, std = _start(start, true_poses, begin, where)
    sightings = sort_sightings(
        recording.reading_times - origin,
        recording.reading_landmark,
        recording.reading_values,
        times,
        n_landmarks,
        0.5 * period if max_offset is None else max_offset,
    )
    return RobotLog.build(
        time=times,
        odometry=hold_and_integrate(
            recording.hold_times - origin, recording.forward_velocity, recording.angular_velocity, times
        ),
        landmark_range=sightings.values[..., 0],
        landmark_bearing=sightings.values[..., 1],
        landmark_time_offset=sightings.time_offset,
        landmark_sensor_pose=recording.sensor_pose,
        landmarks=recording.landmarks,
        start_mean=mean,
        start_std=std,
        true_poses=true_poses,
        robot=robot,
        source=source,
        attributes={
            "time_origin": float(origin),
            **dropped,
            "dropped_outside": sightings.n_outside,
            "dropped_duplicate": sightings.n_duplicate,
        },
        where=where,
    )


def _start(start: str, true_poses: Float | None, begin: float, where: str) -> tuple[Float, Float]:
    if start == "anywhere":
        return np.zeros(3), np.full(3, np.inf)
    if true_poses is None or np.isnan(true_poses[0]).any():
        fail(
            where,
            f"expected a reference pose at {begin:g} s for start = 'reference', got none: "
            "choose another begin, or start = 'anywhere'",
        )
    return true_poses[0], np.array(REFERENCE_START_STD)
