"""Logs that the fitted model simulates along the path of a recorded log.

The critic computes the same numbers from the recorded log and from some tens of simulated ones. A number is unusual
only if it is unusual among those. The simulated robot is steered along the fitted path: it gets the commands of the log
and a soft pull back to the path, because commands alone would lead it through walls. No step is rejected or redrawn.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import ModelError
from pmcl.filtering.kernels.steering import steered_path
from pmcl.logs.robot_log import RobotLog
from pmcl.models.motions.joined.table import joined_tables, parts_of_joined
from pmcl.models.sensor import sensor_of
from pmcl.models.starts.table import GaussianStart
from pmcl.models.tables import Tables

__all__ = ["Replica", "replicated_log"]

Float = NDArray[np.float64]

# Share of the distance to the path that each step corrects. With it the robot stays within some 2 standard deviations
# of a step's noise of the path, while its commands differ from those of the log by a third of one.
_CORRECTED_SHARE = 0.15
# A robot whose usual steps are shorter than this [m] turns on the spot, and is not led back from the side by turns.
_SHORTEST_STEP = 1e-3


class Replica(NamedTuple):
    """A simulated log.

    Attributes
    ----------
    log : RobotLog
        The log: the same times, map, beams and missing readings, new odometry (that of the log plus the steering) and
        new readings, without reference trajectory and true parameters.
    path : ndarray, shape (T, D)
        The trajectory of the simulated robot, headings not wrapped [m, m, rad]. Simulated together with the readings,
        it is a draw given these.
    """

    log: RobotLog
    path: Float


def replicated_log(
    log: RobotLog, tables: Tables, reference: Float, rng: np.random.Generator, *, by_turning: bool = False
) -> Replica:
    """Simulate a log again from a fitted model.

    Parameters
    ----------
    log : RobotLog
        The recorded log.
    tables : Tables
        Coefficient tables of the fitted model for this log; they are not changed.
    reference : ndarray, shape (T, D)
        The path along which the robot is steered, headings not wrapped [m, m, rad].
    rng : numpy.random.Generator
        A generator of the kind that kernels use, :func:`pmcl.filtering.particle_filter.make_rng`.
    by_turning : bool
        Whether the robot is led aside by turns only, see :attr:`pmcl.models.motion.Motion.aside_by_turning`.

    Returns
    -------
    Replica

    Raises
    ------
    ModelError
        When a motion or sensor table of the model cannot be simulated.
    """
    steps, seams = parts_of_joined(tables)
    mean = getattr(steps.motion, "mean", None)
    if mean is None or reference.shape[1] < 3:
        raise ModelError(
            f"{log.where}: expected motion by increments of a pose, which can be steered, but got a "
            f"{type(steps.motion).__name__}; criticism needs such a model"
        )
    commands = mean.copy()
    steered: Any = steps._replace(motion=steps.motion._replace(mean=commands))
    if seams is not None:
        steered = joined_tables(steered, seams)
    swerve = _swerve(mean) if by_turning else 0.0
    path, correction = steered_path(
        steered.motion, commands, rng, _start_state(tables, reference, rng), reference, _CORRECTED_SHARE, swerve
    )
    if seams is not None:
        correction[seams.row] = 0.0  # nobody drives from one log to the next
    dataset = log.without_truth().dataset.copy(deep=True)
    dataset["odometry"].values[1:] += correction[1:]
    for table in tables.sensors:
        sensor = sensor_of(table)
        sensor.store(sensor.replicate(table, path, rng), dataset)
    return Replica(RobotLog.trusted(dataset, f"{log.where} (simulated)", log.grid_map), np.asarray(path))


def _swerve(mean: Float) -> float:
    """Return the turn for each metre aside [rad/m] that leads a robot back soonest without swinging.

    With the share p of the error of the heading that each step corrects, and steps of length d, the distance aside
    obeys a linear recursion whose two decay rates are equal at p^2 / (4 d).
    """
    usual = float(np.sqrt(np.mean(mean[1:, 0] ** 2)))
    return _CORRECTED_SHARE**2 / (4.0 * max(usual, _SHORTEST_STEP))


def _start_state(tables: Tables, reference: Float, rng: np.random.Generator) -> Float:
    """Draw the first state of a Gaussian start belief; without one, return the first state of the reference."""
    first: Float = reference[0].copy()
    if isinstance(tables.start, GaussianStart):
        size = tables.start.mean.size
        first[:size] = tables.start.mean + tables.start.std * rng.standard_normal(size)
        # The heading must lie on the same branch as that of the reference.
        first[2] += 2.0 * np.pi * np.round((reference[0, 2] - first[2]) / (2.0 * np.pi))
    return first
