"""Steering a simulated robot through waypoints.

Steering uses the true pose, so the commands depend on the noise before them. Inference takes odometry as given and does
not use that; to first order in the noise the posterior is the same as with commands fixed in advance. For tests that
need this to be exact, draw a path with :func:`pmcl.simulations.simulate.simulate_path` from fixed odometry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmcl.geometry import compose, wrap

__all__ = ["WaypointDriver", "drive"]

Float = NDArray[np.float64]


@dataclass
class WaypointDriver:
    """Turn towards the next waypoint, then drive; the first one follows the last one.

    Attributes
    ----------
    waypoints : ndarray, shape (K, 2)
        Points of a closed route [m], map frame.
    step : float
        Longest forward increment [m].
    turn : float
        Greatest turn of one increment [rad].
    reached : float
        A waypoint counts as reached within this distance [m].
    aim : float
        The robot goes forward only when the waypoint lies within this angle ahead [rad].
    """

    waypoints: Float
    step: float
    turn: float
    reached: float
    aim: float = 0.5
    _next: int = field(default=0, init=False)

    def __call__(self, pose: Float) -> Float:
        """Return the increment (forward, left, turn) [m, m, rad] to command at a pose (3,)."""
        offset = self.waypoints[self._next] - pose[:2]
        if np.hypot(*offset) < self.reached:
            self._next = (self._next + 1) % len(self.waypoints)
            offset = self.waypoints[self._next] - pose[:2]
        ahead = float(wrap(np.arctan2(offset[1], offset[0]) - pose[2]))
        forward = min(self.step, float(np.hypot(*offset))) if abs(ahead) <= self.aim else 0.0
        return np.array([forward, 0.0, min(max(ahead, -self.turn), self.turn)])


def drive(
    start: ArrayLike,
    steer: Callable[[Float], Float],
    std: ArrayLike,
    n_steps: int,
    rng: np.random.Generator,
) -> tuple[Float, Float]:
    """Drive a robot whose increments are noisy: each is the command plus Gaussian noise in the robot's frame.

    Parameters
    ----------
    start : array_like, shape (3,)
        First pose [m, m, rad], map frame.
    steer : callable
        True pose (3,) to commanded increment (3,).
    std : array_like, shape (3,)
        Noise of forward, left and turn [m, m, rad].
    n_steps : int
        Rows T.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    path : ndarray, shape (T, 3)
        True poses, headings in [-pi, pi).
    command : ndarray, shape (T, 3)
        Commanded increments, which odometry reports; row 0 is zero.
    """
    noise = np.asarray(std) * rng.standard_normal((n_steps, 3))
    path, command = np.empty((n_steps, 3)), np.zeros((n_steps, 3))
    path[0] = start
    path[0, 2] = wrap(path[0, 2])
    for t in range(1, n_steps):
        command[t] = steer(path[t - 1])
        path[t] = compose(path[t - 1], command[t] + noise[t])
    return path, command
