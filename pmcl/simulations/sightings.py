"""Readings of landmarks for simulated robots."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.logs.robot_log import RobotLog
from pmcl.models.sensors.landmarks.simulation import simulate

__all__ = ["draw_sightings"]

Float = NDArray[np.float64]


def draw_sightings(table: Any, log: RobotLog, path: Float, rng: np.random.Generator) -> dict[str, Float]:
    """Simulate readings of landmarks by the model.

    Parameters
    ----------
    table : NamedTuple
        Landmark sightings under the true parameters; its readings only show which landmarks are read at which row.
    log : RobotLog
        The log that the table was made from.
    path : ndarray, shape (T, 3)
        True poses [m, m, rad].
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    dict of str to ndarray, shape (T, J)
        For each of ``range`` [m], ``bearing`` [rad] and ``size`` [pixel] that is read; NaN where the landmark was not
        seen.
    """
    drawn = simulate(table, path, rng)
    assert log.landmarks is not None
    shape = (log.n_steps, len(log.landmarks.positions))
    readings = {}
    held = {"range": log.landmark_range, "bearing": log.landmark_bearing, "size": log.landmark_size}
    for name, values in held.items():
        if values is not None:
            readings[name] = np.full(shape, np.nan)
            readings[name][drawn.time, drawn.landmark] = getattr(drawn, name)
    return readings
