"""Several logs of one robot, joined to one log in which the robot begins anew at the first row of each.

A joined log has two variables beside those of the file format: ``joined_start_mean`` and ``joined_start_std`` hold the
start belief of each log at its first row, NaN at all other rows and for the first log, whose belief is in its usual
place. Whatever takes rows out of the log takes these along.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from pmcl.errors import LogError
from pmcl.logs.robot_log import RobotLog
from pmcl.logs.schema import variables
from pmcl.maps.occupancy_grid import OccupancyGrid

__all__ = ["Joint", "first_rows", "join_logs", "joints_of", "starts_of_joined"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

MEAN, STD, JOINTS = "joined_start_mean", "joined_start_std", "joined_logs"

_PAUSE = 60.0
"""Time between the last row of a log and the first of the next [s]. Nothing happens in it."""


class Joint(NamedTuple):
    """One of the logs that a joined log consists of.

    Attributes
    ----------
    where : str
        File or call that it came from.
    time : float
        Time of its first row in the joined log [s].
    own_time : float
        Time of that row in the log itself [s].
    """

    where: str
    time: float
    own_time: float


def join_logs(logs: Sequence[RobotLog]) -> RobotLog:
    """Return one log with the rows of several logs of one robot, one log after the other.

    Parameters
    ----------
    logs : sequence of RobotLog
        Logs of one robot with the same sensors and the same map. A single one comes back as it is.

    Returns
    -------
    RobotLog
        Without reference trajectories and true parameters. Times of each further log count on from those before it,
        after a pause.

    Raises
    ------
    LogError
        When sensors or maps differ, or a log is given twice.
    """
    if not logs:
        raise LogError("expected at least one log, but got none; give the logs of one robot")
    if len(logs) == 1:
        return logs[0]
    first = logs[0]
    parts, joints, begin = [], [], float(first.times[0])
    for number, log in enumerate(logs):
        if any(log.fingerprint() == other.fingerprint() for other in logs[:number]):
            raise LogError(f"{log.where}: expected different logs, but this one is given twice; give each once")
        _check_alike(first, log)
        joints.append(Joint(log.where, begin, float(log.times[0])))
        parts.append(_part(log, begin, number > 0))
        begin = float(parts[-1]["time"].values[-1]) + _PAUSE
    moving = [name for name in parts[0].data_vars if "time" in parts[0][name].dims]
    joined = xr.concat([part[moving] for part in parts], dim="time", combine_attrs="override")
    rest = parts[0].drop_vars([*moving, "time"], errors="ignore")
    dataset = rest.assign({name: joined[name] for name in moving}).assign_coords(time=joined["time"])
    for name in parts[0].variables:
        dataset[name].attrs = dict(parts[0][name].attrs)
    dataset.attrs = {**parts[0].attrs, JOINTS: json.dumps(joints)}
    where = " + ".join(log.where for log in logs)
    return RobotLog(dataset, where, first.grid_map)


def joints_of(log: RobotLog) -> tuple[Joint, ...]:
    """Return the logs that a joined log consists of; none for a log that is not joined."""
    return tuple(Joint(*joint) for joint in json.loads(log.dataset.attrs.get(JOINTS, "[]")))


def first_rows(log: RobotLog) -> Int:
    """Return the rows at which the robot begins anew, (K,), the first row of the log not among them."""
    if MEAN not in log.dataset:
        return np.empty(0, dtype=np.int64)
    rows = np.flatnonzero(~np.isnan(log.dataset[MEAN].values).any(axis=1))
    return rows[rows > 0].astype(np.int64)


def starts_of_joined(log: RobotLog) -> list[RobotLog]:
    """Return the log once for each row of :func:`first_rows`, with the start belief of that row as its own."""
    starts = []
    for row in first_rows(log):
        belief = {
            own: log.dataset[own].copy(data=log.dataset[joined].values[row])
            for own, joined in (("start_mean", MEAN), ("start_std", STD))
        }
        starts.append(RobotLog.trusted(log.dataset.assign(belief), log.where, log.grid_map))
    return starts


def _part(log: RobotLog, begin: float, later: bool) -> xr.Dataset:
    """Return the rows of one log, with times that begin at `begin` and its start belief where it is a later one."""
    dataset = log.without_truth().dataset
    dataset = dataset.assign_coords(time=dataset["time"] - dataset["time"].values[0] + begin)
    for name, value in ((MEAN, log.start_mean), (STD, log.start_std)):
        belief = np.full((log.n_steps, 3), np.nan)
        if later:
            belief[0] = value
        dataset[name] = (("time", "pose"), belief)
    if later:
        odometry = dataset["odometry"].values.copy()
        odometry[0] = 0.0  # row 0 of a log means nothing, and may be NaN
        dataset["odometry"] = dataset["odometry"].copy(data=odometry)
    return dataset


def _check_alike(first: RobotLog, log: RobotLog) -> None:
    own, its = first.without_truth().dataset, log.without_truth().dataset
    different = sorted(map(str, set(own.variables) ^ set(its.variables)))
    if different:
        raise LogError(
            f"{log.where}: expected the variables of {first.where}, but only one of the two has "
            f"{', '.join(different)}; join logs of one robot with the same sensors"
        )
    declared = variables(own)
    for name in own.variables:
        # Such as the greatest range of a sensor, or where a laser is mounted.
        for key in declared[str(name)].attributes if name in declared else ():
            one, two = (dataset[name].attrs.get(key) for dataset in (own, its))
            if not _equal(one, two):
                raise LogError(
                    f"{log.where}: expected the {key} of '{name}' as in {first.where}, {one}, but got {two}; join logs "
                    "of one robot with the same sensors"
                )
        if "time" in own[name].dims or name in ("start_mean", "start_std"):
            continue
        if not _equal(own[name].values, its[name].values):
            raise LogError(
                f"{log.where}: expected the same '{name}' as in {first.where}, but it differs; join logs of one robot "
                "in the same surroundings"
            )
    if not _same_map(first.grid_map, log.grid_map):
        raise LogError(
            f"{log.where}: expected the grid map of {first.where}, but it differs; join logs of one robot in the same "
            "surroundings"
        )


def _equal(value: object, other: object) -> bool:
    """Return whether two values are equal, NaN at the same places included."""
    one, two = np.asarray(value), np.asarray(other)
    return np.array_equal(one, two, equal_nan=one.dtype.kind == two.dtype.kind == "f")


def _same_map(grid: OccupancyGrid | None, other: OccupancyGrid | None) -> bool:
    if grid is None or other is None:
        return grid is other
    return grid.resolution == other.resolution and grid.origin == other.origin and _equal(grid.cells, other.cells)
