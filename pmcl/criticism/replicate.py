"""Logs that never were: the same drive and the same readings, as the fitted model would have produced them.

Whatever the critic computes from a log it also computes from some tens of these; a number is unusual only when it is
unusual among them. The robot is steered along the path that the log tells of, with the log's own commands and a
soft pull back, because commands alone would lead a simulated robot through the walls. No step is ever
rejected or redrawn.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import ModelError
from pmcl.filtering.kernels.steering import steered_path
from pmcl.logs.robot_log import RobotLog
from pmcl.models.sensor import sensor_of
from pmcl.models.starts.table import GaussianStart
from pmcl.models.tables import Tables

__all__ = ["replicated_log"]

Float = NDArray[np.float64]

# A step makes good this share of the distance to the path: the robot stays within some 2 standard deviations of a
# step's noise of it, while its commands differ from the log's by a third of one.
_PULL = 0.15


def replicated_log(log: RobotLog, tables: Tables, reference: Float, rng: np.random.Generator) -> RobotLog:
    """Simulate the log again from a fitted model.

    Parameters
    ----------
    log : RobotLog
        The log.
    tables : Tables
        Coefficients of the fitted model for this log; left as they are.
    reference : ndarray, shape (T, D)
        The path that the log tells of, headings not wrapped.
    rng : numpy.random.Generator
        The kernels' kind of generator, :func:`pmcl.filtering.particle_filter.make_rng`.

    Returns
    -------
    RobotLog
        The same times, map, beams and pattern of missing readings; new odometry (the log's, plus the steering) and new
        readings; without truth.

    Raises
    ------
    ModelError
        When a motion or sensor table of the model cannot be simulated.
    """
    mean = getattr(tables.motion, "mean", None)
    if mean is None or reference.shape[1] < 3:
        raise ModelError(
            f"{log.where}: expected motion by increments of a pose, which can be steered, but got a "
            f"{type(tables.motion).__name__}; criticism needs such a model"
        )
    motion = tables.motion._replace(mean=mean.copy())
    path, correction = steered_path(motion, rng, _first(tables, reference, rng), reference, _PULL)
    dataset = log.without_truth().dataset.copy(deep=True)
    dataset["odometry"].values[1:] += correction[1:]
    for sensor in tables.sensors:
        kind = sensor_of(sensor)
        kind.store(kind.simulate(sensor, path, rng), dataset)
    return RobotLog.trusted(dataset, f"{log.where} (simulated)")


def _first(tables: Tables, reference: Float, rng: np.random.Generator) -> Float:
    """Draw the first state from a Gaussian start; where the start is unknown, any place is as good as the log's."""
    first: Float = reference[0].copy()
    if isinstance(tables.start, GaussianStart):
        size = tables.start.mean.size
        first[:size] = tables.start.mean + tables.start.std * rng.standard_normal(size)
        # The same branch of the heading as the reference.
        first[2] += 2.0 * np.pi * np.round((reference[0, 2] - first[2]) / (2.0 * np.pi))
    return first
