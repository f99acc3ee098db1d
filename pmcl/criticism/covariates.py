"""What a residual may depend on: time, motion, place, and for each reading its distance and direction."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.terms import motion_of_rows, pose_of_rows
from pmcl.models.sensor import ReadingIndex, sensor_of
from pmcl.models.tables import Tables

__all__ = ["RowCovariates", "reading_covariates", "row_covariates"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]


class RowCovariates(NamedTuple):
    """Covariates of each row, (T,): time [s], speed [m/s], turn rate [rad/s], heading [rad], x and y [m]."""

    time: Float
    speed: Float
    turn: Float
    heading: Float
    x: Float
    y: Float


def row_covariates(log: RobotLog, path: Float) -> RowCovariates:
    """Return the covariates of each row, motion from odometry and place from the mean path (T, D)."""
    motion, pose = motion_of_rows(log), pose_of_rows(path)
    return RowCovariates(motion["time"], motion["speed"], motion["turn_rate"], pose["heading"], pose["x"], pose["y"])


def reading_covariates(
    tables: Tables, path: Float, sensor: Int, channel: Int, time: Int, kind: Int
) -> dict[str, Float]:
    """Return covariates of single readings from what each should be along the mean path.

    Parameters
    ----------
    tables : Tables
        Of the model.
    path : ndarray, shape (T, D)
        Mean path.
    sensor, channel, time, kind : ndarray of int, shape (N,)
        What each reading is, see :class:`pmcl.filtering.one_step_ahead.Predictions`.

    Returns
    -------
    dict of str to ndarray, shape (N,)
        ``distance`` [m], ``direction`` [rad] in the world, ``incidence`` [rad] for beams (0: square on); NaN where a
        table type does not tell.
    """
    n = time.size
    found = {name: np.full(n, np.nan) for name in ("distance", "direction", "incidence")}
    for number, table in enumerate(tables.sensors):
        mine = np.flatnonzero(sensor == number)
        if mine.size == 0:
            continue
        index = ReadingIndex((), kind[mine], channel[mine], time[mine], np.full(mine.size, np.nan))
        for name, values in sensor_of(table).covariates(table, path, index).items():
            found[name][mine] = values
    return found
