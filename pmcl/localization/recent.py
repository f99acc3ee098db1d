"""The latest rows of a log that is still being made, as models see them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmcl.errors import LogError
from pmcl.logs.robot_log import RobotLog
from pmcl.logs.schema import Variable, readings, variables
from pmcl.logs.sensor_variables import SensorVariables
from pmcl.maps.arrays import as_numbers
from pmcl.registry import sensor_variables

__all__ = ["RecentRows"]

Float = NDArray[np.float64]


class RecentRows(RobotLog):
    """The first row of a log and its latest ones: a window of bounded length over a log without end.

    Map, mounts and start are those of a log in the same format. A model that is bound to these rows sees its usual log,
    only that the rows between the first and the latest are missing; the latest row is the last.

    Parameters
    ----------
    robot : RobotLog
        Any log of the robot: it tells map, mounts, channels and start. Its rows are not used.
    memory : int
        Rows kept, at least 3: one before the latest for sensors that look back, more for effects that reach back
        farther, such as a latency.

    """

    def __init__(self, robot: RobotLog, memory: int) -> None:
        values: dict[str, object] = {"dataset": robot.dataset, "where": robot.where, "_memory": memory, "_seen": 0}
        values["grid_map"] = robot.grid_map
        shapes = {name: robot.dataset[name].shape[1:] for name in readings(robot.dataset) if name in robot.dataset}
        values["_rows"] = {name: np.empty((0, *shape)) for name, shape in {"odometry": (3,), **shapes}.items()}
        values["_times"] = np.empty(0)
        # Asked for once: every row needs them.
        values["_constants"] = {}
        values["_declared"] = variables(robot.dataset)
        values["_readings"] = [
            (sensor, [name for name in sensor.readings(shapes) if name in shapes])
            for sensor in sensor_variables().values()
        ]
        for name, value in values.items():
            object.__setattr__(self, name, value)

    is_whole: ClassVar[bool] = False
    _memory: int
    _seen: int
    _rows: dict[str, Float]
    _times: Float
    _constants: dict[str, Float | None]
    _declared: dict[str, Variable]
    _readings: list[tuple[type[SensorVariables], list[str]]]

    def __post_init__(self) -> None:
        """Nothing: the rows are checked as they come."""

    def add(self, time: float, odometry: ArrayLike | None, measured: Mapping[str, ArrayLike | None]) -> None:
        """Check one more row and keep it; on an error the rows stay as they were.

        Parameters
        ----------
        time : float
            Sample time [s], later than that of the row before.
        odometry : array_like, shape (3,)
            Displacement since the row before, in its frame [m, m, rad]; not read at the first row.
        measured : mapping of str to array_like
            Readings by the names of the log format; None or NaN where nothing was measured.

        Raises
        ------
        LogError
            When something is missing, of the wrong shape or not a possible reading.
        """
        what = f"time {time:g} s"
        if self._times.size and not time > self._times[-1]:
            raise LogError(
                f"expected a time later than the last one, {self._times[-1]:g} s, but got {time:g} s; "
                "give the sample times in order"
            )
        for name, values in measured.items():
            if name not in self._rows and values is not None:
                raise LogError(f"{what}: expected no '{name}', which this robot does not have; leave it out")
        row = {name: self._reading(name, measured.get(name), what) for name in self._rows if name != "odometry"}
        row["odometry"] = self._odometry(odometry, what)
        # Row 0 stays for good: models may count from it. The oldest of the others makes room.
        drop = [1] if self._times.size == self._memory else []
        object.__setattr__(self, "_times", np.append(np.delete(self._times, drop), time))
        for name, kept in self._rows.items():
            self._rows[name] = np.concatenate([np.delete(kept, drop, axis=0), row[name][None]])
        object.__setattr__(self, "_seen", self._seen + self.readings_of_last_row())

    def _odometry(self, odometry: ArrayLike | None, what: str) -> Float:
        if not self._times.size:
            return np.zeros(3)
        try:
            values = np.array([]) if odometry is None else as_numbers(odometry)
        except TypeError:
            values = np.array([])
        if values.shape != (3,) or not np.isfinite(values).all():
            raise LogError(
                f"{what}: expected odometry as (forward [m], left [m], turn [rad]) since the last row, but got "
                f"{values.tolist() if values.size else type(odometry).__name__}; give three finite numbers"
            )
        return values

    def _reading(self, name: str, values: ArrayLike | None, what: str) -> Float:
        shape = self._rows[name].shape[1:]
        if values is None:
            return np.full(shape, np.nan)
        try:
            found = as_numbers(values)
        except TypeError as problem:
            raise LogError(f"{what}: expected numbers in '{name}', but got {problem}; convert them") from None
        if found.shape != shape:
            size = int(np.prod(shape))
            raise LogError(f"{what}: expected {size} numbers in '{name}', but got shape {found.shape}; NaN is missing")
        declared = self._declared[name]
        wrong = np.zeros(shape, dtype=bool) if declared.may_be_infinite else np.isinf(found)
        if declared.minimum is not None:
            wrong |= found < declared.minimum
        if wrong.any():
            k = int(np.argmax(wrong))
            raise LogError(
                f"{what}: expected possible readings in '{name}', but got {found.ravel()[k]:g} at place {k}"
            )
        return found

    def readings_of_last_row(self) -> int:
        """Return the number of readings of the latest row."""
        total = 0
        for sensor, names in self._readings:
            if names:
                total += int(sensor.count({name: self._rows[name][-1:] for name in names})[0])
        return total

    @property
    def n_steps(self) -> int:
        """Number of rows kept."""
        return int(self._times.size)

    @property
    def n_readings(self) -> int:
        """Number of readings so far; at least one, as a robot may wait for its first."""
        return max(self._seen, 1)

    @property
    def times(self) -> Float:
        """Sample times of the rows kept [s]."""
        return self._times

    @property
    def odometry(self) -> Float:
        """Odometry increments of the rows kept; row 0 is zero."""
        return self._rows["odometry"]

    @property
    def true_poses(self) -> None:
        """Nothing: a robot does not know them."""
        return

    def _optional(self, name: str) -> Float | None:
        if name in self._rows:
            return self._rows[name]
        # What belongs to the rows of the log that was given belongs to no row here.
        declared = self._declared.get(name)
        if declared is not None and "time" in declared.dims:
            return None
        if name not in self._constants:
            self._constants[name] = super()._optional(name)
        return self._constants[name]
