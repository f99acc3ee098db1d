"""Planar rigid motions, SE(2), on arrays of poses.

A pose is ``(x, y, heading)`` [m, m, rad] in the world frame, x forward, y left, angles counter-clockwise (ROS REP 103).
An increment is ``(forward, left, turn)`` [m, m, rad] in the frame of the pose it starts from: ``b = a (+) increment``.
The last axis always has length 3; all other axes broadcast.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmcl.errors import PmclError

__all__ = ["between", "circular_mean", "compose", "integrate_twist", "inverse", "wrap"]

Float = NDArray[np.float64]

_TURN = 2.0 * math.pi


def wrap(angle: ArrayLike) -> Float:
    """Bring angles into [-pi, pi).

    Angles that are already there come back bit for bit, so that wrapping twice changes nothing.

    Parameters
    ----------
    angle : array_like, shape (...)
        Angles [rad]; NaN stays NaN, an infinite angle becomes NaN.

    Returns
    -------
    ndarray, shape (...)
        The same directions in [-pi, pi) [rad].
    """
    angle = np.asarray(angle, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        turned = np.mod(angle + math.pi, _TURN) - math.pi
        # np.mod of a tiny negative number rounds up to the whole turn, which would give +pi.
        turned = np.where(turned >= math.pi, -math.pi, turned)
        inside = (angle >= -math.pi) & (angle < math.pi)
    wrapped: Float = np.where(inside, angle, turned)[()]
    return wrapped


def circular_mean(angles: ArrayLike, weights: ArrayLike | None = None) -> Float:
    """Weighted mean direction along the last axis: the heading of the weighted sum of unit vectors.

    Parameters
    ----------
    angles : array_like, shape (..., N)
        Angles [rad].
    weights : array_like, broadcastable to (..., N), optional
        Weights >= 0, of any positive sum; equal by default.

    Returns
    -------
    ndarray, shape (...)
        Mean direction in [-pi, pi) [rad]. Directions that cancel have no mean; what comes back is then arbitrary.
    """
    angles = np.asarray(angles, dtype=np.float64)
    weight: Float = np.ones(()) if weights is None else np.asarray(weights, dtype=np.float64)
    return wrap(np.arctan2((weight * np.sin(angles)).sum(-1), (weight * np.cos(angles)).sum(-1)))


def compose(pose: ArrayLike, increment: ArrayLike) -> Float:
    """Move a pose by an increment given in its own frame, ``pose (+) increment``.

    Parameters
    ----------
    pose : array_like, shape (..., 3)
        Where the motion starts [m, m, rad], world frame.
    increment : array_like, shape (..., 3)
        Forward, left and turn [m, m, rad], frame of `pose`.

    Returns
    -------
    ndarray, shape (..., 3)
        Where it ends [m, m, rad], world frame, heading in [-pi, pi).

    Raises
    ------
    PmclError
        When a last axis does not have length 3.
    """
    pose, increment = _triples(pose, "pose"), _triples(increment, "increment")
    sine, cosine = np.sin(pose[..., 2]), np.cos(pose[..., 2])
    forward, left = increment[..., 0], increment[..., 1]
    return np.stack(
        (
            pose[..., 0] + cosine * forward - sine * left,
            pose[..., 1] + sine * forward + cosine * left,
            wrap(pose[..., 2] + increment[..., 2]),
        ),
        axis=-1,
    )


def between(a: ArrayLike, b: ArrayLike) -> Float:
    """Return the increment that leads from pose a to pose b, so that ``compose(a, between(a, b)) = b``.

    Parameters
    ----------
    a, b : array_like, shape (..., 3)
        Poses [m, m, rad], world frame.

    Returns
    -------
    ndarray, shape (..., 3)
        Forward, left and turn [m, m, rad] in the frame of `a`, turn in [-pi, pi).

    Raises
    ------
    PmclError
        When a last axis does not have length 3.
    """
    a, b = _triples(a, "a"), _triples(b, "b")
    sine, cosine = np.sin(a[..., 2]), np.cos(a[..., 2])
    dx, dy = b[..., 0] - a[..., 0], b[..., 1] - a[..., 1]
    return np.stack((cosine * dx + sine * dy, cosine * dy - sine * dx, wrap(b[..., 2] - a[..., 2])), axis=-1)


def inverse(pose: ArrayLike) -> Float:
    """Return the increment that undoes a pose: ``compose(pose, inverse(pose))`` is the origin.

    Parameters
    ----------
    pose : array_like, shape (..., 3)
        Poses or increments [m, m, rad].

    Returns
    -------
    ndarray, shape (..., 3)
        Inverse rigid motions [m, m, rad], heading in [-pi, pi).

    Raises
    ------
    PmclError
        When the last axis does not have length 3.
    """
    return between(pose, np.zeros(3))


def integrate_twist(
    forward_velocity: ArrayLike, angular_velocity: ArrayLike, dt: ArrayLike, left_velocity: ArrayLike = 0.0
) -> Float:
    """Displacement of a robot that holds its velocities for a while: the exponential map of SE(2), exactly.

    The robot runs along an arc with a = w dt: forward = dt (v sin(a) - u (1 - cos(a)))/a and
    left = dt (u sin(a) + v (1 - cos(a)))/a. Both quotients are evaluated as cardinal sines, which loses no digits
    however slowly the robot turns.

    Parameters
    ----------
    forward_velocity : array_like, shape (...)
        v [m/s], along the robot's x axis.
    angular_velocity : array_like, shape (...)
        w [rad/s], counter-clockwise.
    dt : array_like, shape (...)
        How long the velocities hold [s].
    left_velocity : array_like, shape (...), optional
        u [m/s], along the robot's y axis; zero for a robot with wheels that do not slide.

    Returns
    -------
    ndarray, shape (..., 3)
        Forward, left and turn [m, m, rad] in the frame at the start. The turn is w dt and is not wrapped.
    """
    dt = np.asarray(dt, dtype=np.float64)
    arc, turn, aside = np.broadcast_arrays(
        np.asarray(forward_velocity, dtype=np.float64) * dt,
        np.asarray(angular_velocity, dtype=np.float64) * dt,
        np.asarray(left_velocity, dtype=np.float64) * dt,
    )
    half = 0.5 * turn
    # numpy's sinc(x) is sin(pi x) / (pi x); and (1 - cos a) / a = sin(a/2) * sin(a/2) / (a/2).
    along, across = np.sinc(turn / math.pi), np.sin(half) * np.sinc(half / math.pi)
    return np.stack((arc * along - aside * across, arc * across + aside * along, turn), axis=-1)


def _triples(value: ArrayLike, name: str) -> Float:
    array = np.asarray(value, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise PmclError(
            f"expected {name} with a last axis of length 3 (x, y, heading), got shape {array.shape}: "
            "give one pose per row"
        )
    return array


def late_poses(path: Float, lag: Float) -> Float:
    """Return the poses at which late readings were taken.

    Parameters
    ----------
    path : ndarray, shape (T, >= 3)
        Poses (x, y, heading) [m, m, rad].
    lag : ndarray, shape (>= T,)
        How late the readings of each row are, as a share of the last step.

    Returns
    -------
    ndarray, shape (T, 3)
        Poses between the rows; headings follow the shorter way round and are not wrapped.
    """
    poses = path[:, :3].copy()
    poses[:, 2] = np.unwrap(poses[:, 2])
    step = np.diff(poses, axis=0, prepend=poses[:1])
    return np.asarray(poses - lag[: len(poses), None] * step)
