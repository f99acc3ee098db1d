"""Covariates on which a residual may depend: time, motion, place, and the geometry of each reading."""

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
    """Return the covariates of each row.

    Parameters
    ----------
    log : RobotLog
        The log; speed and turn rate come from its odometry.
    path : ndarray, shape (T, D)
        The mean path; heading and place come from it [m, m, rad].
    """
    motion, pose = motion_of_rows(log), pose_of_rows(path)
    return RowCovariates(motion["time"], motion["speed"], motion["turn_rate"], pose["heading"], pose["x"], pose["y"])


def reading_covariates(
    tables: Tables, path: Float, sensor: Int, channel: Int, time: Int, kind: Int
) -> dict[str, Float]:
    """Return covariates of single readings, computed from the ideal reading along the mean path.

    Parameters
    ----------
    tables : Tables
        Coefficient tables of the model.
    path : ndarray, shape (T, D)
        The mean path.
    sensor, channel, time, kind : ndarray of int, shape (N,)
        The sensor, channel, row and kind of each reading, see :class:`pmcl.filtering.one_step_ahead.Predictions`.

    Returns
    -------
    dict of str to ndarray, shape (N,)
        ``distance`` [m], ``direction`` [rad] in the world frame, ``incidence`` [rad] for beams (0: perpendicular to
        the wall); NaN where a sensor does not have the covariate.
    """
    n = time.size
    covariates = {name: np.full(n, np.nan) for name in ("distance", "direction", "incidence")}
    for number, table in enumerate(tables.sensors):
        selected = np.flatnonzero(sensor == number)
        if selected.size == 0:
            continue
        index = ReadingIndex((), kind[selected], channel[selected], time[selected], np.full(selected.size, np.nan))
        for name, values in sensor_of(table).covariates(table, path, index).items():
            covariates[name][selected] = values
    return covariates
