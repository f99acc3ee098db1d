"""Readings of landmarks for simulated robots."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pmcl.logs.robot_log import RobotLog
from pmcl.models.sensors import LandmarkNoise
from pmcl.robots.simulate import simulate_readings

__all__ = ["draw_sightings"]

Float = NDArray[np.float64]


def draw_sightings(
    sensor: LandmarkNoise, log: RobotLog, theta: Mapping[str, float], path: Float, rng: np.random.Generator
) -> dict[str, Float]:
    """Let the model itself make the readings.

    Parameters
    ----------
    sensor : LandmarkNoise
        Says what is read of a landmark.
    log : RobotLog
        A log in which each landmark that is seen has some reading; its values do not matter.
    theta : mapping of str to float
        True parameters, those of `sensor` among them.
    path : ndarray, shape (T, 3)
        True poses [m, m, rad].
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    dict of str to ndarray, shape (T, J)
        For each of ``range`` [m], ``bearing`` [rad] and ``size`` [pixel] that the sensor reads; NaN where the landmark
        was not seen.
    """
    truth = np.array([theta[parameter.name] for parameter in sensor.parameters])
    table = simulate_readings(sensor.bind(log).table(truth), path, rng)
    assert log.landmarks is not None
    shape = (log.n_steps, len(log.landmarks.positions))
    readings = {}
    for name in ("range", "bearing", "size"):
        if getattr(sensor, name):
            readings[name] = np.full(shape, np.nan)
            readings[name][table.time, table.landmark] = getattr(table, name)
    return readings
