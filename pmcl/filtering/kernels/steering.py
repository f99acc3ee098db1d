"""Simulating a robot that is steered along a given path, by the compiled motion of the model itself."""

from __future__ import annotations

import math

import numpy as np

from pmcl.engine.compile import entry
from pmcl.engine.contract import propagate, scratch_rows

__all__ = ["steered_path"]


@entry
def steered_path(motion, mean, rng, first, reference, pull, swerve):
    """Draw a path whose commands follow the log's and, softly, a reference.

    The command of each step is ``mean[t]`` plus `pull` times the way back to the reference, seen from where
    the robot was before the step; so the noise of a step is independent of its command, as with a real driver.

    Parameters
    ----------
    motion : NamedTuple
        A motion table.
    mean : ndarray, shape (T, 3 or more)
        The mean of its increments, as the table holds it; the correction is **added to it in place**.
    rng : numpy.random.Generator
        Source of randomness.
    first : ndarray, shape (D,)
        First state.
    reference : ndarray, shape (T, D)
        Path to follow, heading not wrapped [m, m, rad].
    pull : float
        Share of the distance that each step makes good; 0 follows the commands alone.
    swerve : float
        0 where commands may lead aside. Otherwise the way back from one side leads through turns: by this much for each
        metre aside [rad/m].

    Returns
    -------
    path : ndarray, shape (T, D)
        The states drawn.
    correction : ndarray, shape (T, 3)
        What was added to the commands [m, m, rad].
    """
    n_steps, size = reference.shape
    path, correction = np.empty((n_steps, size)), np.zeros((n_steps, 3))
    previous, current = np.empty((size, 1)), np.empty((size, 1))
    scratch = np.empty((scratch_rows(motion), 1))
    for d in range(size):
        path[0, d] = first[d]
    for t in range(1, n_steps):
        heading = path[t - 1, 2]
        c, s = math.cos(heading), math.sin(heading)
        dx, dy = reference[t - 1, 0] - path[t - 1, 0], reference[t - 1, 1] - path[t - 1, 1]
        correction[t, 0] = pull * (dx * c + dy * s)
        aside = dy * c - dx * s
        correction[t, 1] = 0.0 if swerve != 0.0 else pull * aside
        # A robot that reverses comes back to the left by turning to the right.
        ahead = 1.0 if mean[t, 0] >= 0.0 else -1.0
        correction[t, 2] = pull * (reference[t - 1, 2] - heading) + swerve * ahead * aside
        for d in range(3):
            mean[t, d] += correction[t, d]
        for d in range(size):
            previous[d, 0] = path[t - 1, d]
        propagate(motion, t, rng, previous, current, scratch)
        for d in range(size):
            path[t, d] = current[d, 0]
    return path, correction
