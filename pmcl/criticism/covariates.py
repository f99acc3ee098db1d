"""What a residual may depend on: time, motion, place, and for each reading its distance and direction."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.filtering.estimated_path import incidence
from pmcl.filtering.predict import beam_lengths, ideal_readings
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.terms import motion_of_rows, pose_of_rows
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
        What each reading is, see :class:`pmcl.filtering.predictive.Predictions`.

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
        if hasattr(table, "beam_pose"):
            t, beam = time[mine], channel[mine]
            lengths = beam_lengths(table, path)  # type: ignore[arg-type]
            found["distance"][mine] = np.minimum(lengths, 2.0 * table.max_range)[t, beam]  # type: ignore[attr-defined]
            found["direction"][mine] = path[t, 2] + table.beam_pose[beam, 2]
            found["incidence"][mine] = incidence(table, path)[t, beam]
        elif hasattr(table, "landmark"):
            which: Any = table.landmark
            ideal = ideal_readings(table, path)
            # Slots run through the sightings in order: find each reading's own by its row and landmark.
            place = {(int(t), int(j)): k for k, (t, j) in enumerate(zip(table.time, which, strict=True))}  # type: ignore[attr-defined]
            k = np.array([place[(int(t), int(j))] for t, j in zip(time[mine], channel[mine], strict=True)])
            found["distance"][mine] = ideal[k, 0]
            found["direction"][mine] = path[time[mine], 2] + ideal[k, 1]
    return found
