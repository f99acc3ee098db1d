"""Odometry of your own robot as the increments that a log holds: from integrated poses, or from velocities."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmcl.geometry import between
from pmcl.logs.resample import hold_and_integrate, interpolate_poses
from pmcl.logs.stream_checks import clock_of, fail_for_pause, require_same_length, table_of, vector
from pmcl.logs.validation import fail

__all__ = ["LONGEST_PAUSE", "odometry_from_poses", "odometry_from_velocities", "poses_at"]

Float = NDArray[np.float64]

LONGEST_PAUSE = 1.0
"""Longest pause of a stream that is bridged unless the caller says otherwise [s]. Robots report odometry 5 to 100 times
a second, so that a pause of a second means that messages are missing."""


def odometry_from_poses(
    poses: ArrayLike,
    pose_times: ArrayLike | None = None,
    times: ArrayLike | None = None,
    *,
    max_pause: float = LONGEST_PAUSE,
) -> Float:
    """Turn the poses that odometry integrated, in any fixed frame, into increments from row to row.

    Parameters
    ----------
    poses : array_like, shape (N, 3)
        x, y, heading [m, m, rad], e.g. of ``nav_msgs/Odometry``; headings may be wrapped or not.
    pose_times : array_like, shape (N,), optional
        When each pose was reached [s], strictly increasing. Without it there is one row for each pose.
    times : array_like, shape (T,), optional
        Times of the rows [s]; `pose_times` when left out. Between poses the robot's pose is interpolated, the heading
        along the shorter way round.
    max_pause : float, optional
        Longest pause between poses in which a row may lie [s].

    Returns
    -------
    ndarray, shape (T, 3)
        Forward, left and turn [m, m, rad] from the row before, in the robot's frame there; row 0 is zero. Turns are in
        [-pi, pi).

    Raises
    ------
    LogError
        When shapes disagree, something is not finite, or a row lies outside the poses or in a longer pause.
    """
    where = "odometry_from_poses"
    given = table_of(where, "poses", poses, 3)
    at_rows = given
    if pose_times is not None:
        at_rows = poses_at(pose_times, given, pose_times if times is None else times, max_pause=max_pause)
        lost = np.flatnonzero(np.isnan(at_rows[:, 0]))
        if lost.size:
            fail_for_pause(where, "poses", float(np.ravel(np.asarray(times, dtype=float))[lost[0]]), max_pause)
    elif times is not None:
        fail(where, "expected pose_times together with times, got times alone: say when each pose was reached")
    odometry = np.zeros_like(at_rows)
    odometry[1:] = between(at_rows[:-1], at_rows[1:])
    return odometry


def poses_at(pose_times: ArrayLike, poses: ArrayLike, times: ArrayLike, *, max_pause: float = LONGEST_PAUSE) -> Float:
    """Interpolate poses at the times of the rows, e.g. a reference trajectory for ``true_poses``.

    Parameters
    ----------
    pose_times : array_like, shape (N,)
        Strictly increasing [s].
    poses : array_like, shape (N, 3)
        x, y, heading [m, m, rad].
    times : array_like, shape (T,)
        Times of the rows [s].
    max_pause : float, optional
        Longest pause of the poses that is bridged [s].

    Returns
    -------
    ndarray, shape (T, 3)
        Poses [m, m, rad], heading in [-pi, pi); NaN outside the recording and in longer pauses.

    Raises
    ------
    LogError
        When shapes disagree, times do not increase, or something is not finite.
    """
    where = "poses_at"
    clock, given = clock_of(where, "pose_times", pose_times), table_of(where, "poses", poses, 3)
    require_same_length(where, "pose_times", clock, "poses", given)
    if not max_pause >= 0.0:
        fail(where, f"expected max_pause >= 0 [s], got {max_pause}: choose another")
    return interpolate_poses(clock, given, clock_of(where, "times", times), max_pause)


def odometry_from_velocities(
    velocity_times: ArrayLike,
    forward: ArrayLike,
    turn_rate: ArrayLike,
    times: ArrayLike,
    *,
    left: ArrayLike | None = None,
    max_pause: float = LONGEST_PAUSE,
) -> Float:
    """Integrate velocities from row to row, exactly on SE(2): at constant velocities the robot drives an arc.

    Parameters
    ----------
    velocity_times : array_like, shape (N,)
        From when on each velocity holds [s], strictly increasing; it holds until the next one.
    forward : array_like, shape (N,)
        Velocity ahead [m/s]. For a differential drive the mean of the speeds of both wheels.
    turn_rate : array_like, shape (N,)
        Velocity of turning [rad/s], counter-clockwise. For a differential drive the speed of the right wheel minus that
        of the left wheel, divided by the track width.
    times : array_like, shape (T,)
        Times of the rows [s], none before the first velocity.
    left : array_like, shape (N,), optional
        Velocity to the left [m/s] of a robot that drives in all directions.
    max_pause : float, optional
        How long a velocity may hold before and between rows [s].

    Returns
    -------
    ndarray, shape (T, 3)
        Forward, left and turn [m, m, rad] from the row before, in the robot's frame there; row 0 is zero. Turns are
        not wrapped.

    Raises
    ------
    LogError
        When shapes disagree, something is not finite, a row comes before the first velocity, or a velocity would hold
        for longer than `max_pause`.

    Notes
    -----
    With velocities v ahead and u to the left and the angle a = w dt that is turned in the time dt, the increment is
    forward = dt (v sin(a) - u (1 - cos(a))) / a, left = dt (u sin(a) + v (1 - cos(a))) / a, turn = a: the exponential
    map of SE(2) (Lynch and Park, Modern Robotics, section 13.4, for the differential drive).
    """
    where = "odometry_from_velocities"
    clock, rows = clock_of(where, "velocity_times", velocity_times), clock_of(where, "times", times)
    columns = {"forward": forward, "turn_rate": turn_rate, **({} if left is None else {"left": left})}
    speeds = {name: vector(where, name, value) for name, value in columns.items()}
    for name, value in speeds.items():
        require_same_length(where, "velocity_times", clock, name, value)
    if rows[0] < clock[0]:
        fail(
            where,
            f"expected rows from the first velocity on, got a row at {rows[0]:.9g} s before {clock[0]:.9g} s: "
            "begin later, see row_times",
        )
    ends = np.append(clock[1:], max(float(rows[-1]), float(clock[-1])))
    # Only what holds between the first and the last row matters.
    used_until = np.minimum(ends, rows[-1])
    late = np.flatnonzero((used_until > rows[0]) & (used_until - clock > max_pause))
    if late.size:
        fail_for_pause(where, "velocities", float(clock[late[0]]), max_pause)
    return hold_and_integrate(clock, speeds["forward"], speeds["turn_rate"], rows, speeds.get("left"))
