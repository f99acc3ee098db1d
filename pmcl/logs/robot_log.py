"""One robot log: what was measured, where the landmarks or walls are, and what is known about the start."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from pmcl.checks import MOST_COUNT, check_path, check_seed, check_type, check_whole
from pmcl.errors import LogError, MapError, did_you_mean
from pmcl.logs.arrays import LogArrays
from pmcl.logs.assemble import assemble
from pmcl.logs.finding import warn_of
from pmcl.logs.netcdf import read_dataset, write_dataset
from pmcl.logs.plausibility import implausible, without_map
from pmcl.logs.schema import REFERENCE
from pmcl.logs.schema import variables as format_variables
from pmcl.logs.validation import fail, validated
from pmcl.maps.landmarks import LandmarkMap
from pmcl.maps.walls import WallMap

__all__ = ["RobotLog"]


@dataclass(frozen=True, eq=False, repr=False)
class RobotLog(LogArrays):
    """A validated robot log.

    Its arrays (times, odometry, readings, maps, start, reference) are the properties of
    :class:`~pmcl.logs.arrays.LogArrays`.

    Attributes
    ----------
    dataset : xarray.Dataset
        The log in the file format, a validated copy of what was given.
    where : str
        File or call that it came from, for messages.

    Raises
    ------
    LogError, MapError
        When the dataset does not follow the format.
    """

    def __post_init__(self) -> None:
        object.__setattr__(self, "dataset", validated(self.dataset, self.where))

    def __repr__(self) -> str:
        name = self.robot or "unnamed robot"
        return f"<RobotLog of {name}: {self.n_steps} samples, {self.n_readings} readings, from {self.where}>"

    @classmethod
    def from_dataset(cls, dataset: xr.Dataset, where: str = "dataset") -> RobotLog:
        """Validate a dataset in the file format.

        Parameters
        ----------
        dataset : xarray.Dataset
            A log in the file format.
        where : str
            What it is called in messages.

        Returns
        -------
        RobotLog

        Raises
        ------
        LogError, MapError
            When it does not follow the format.
        """
        return cls(dataset, where)

    @classmethod
    def trusted(cls, dataset: xr.Dataset, where: str) -> RobotLog:
        """Take a dataset as it is: one that was made from a validated one, with values that are valid by their making.

        Simulations of a log are made by the hundred, and checking them all would take longer than making them.

        Parameters
        ----------
        dataset : xarray.Dataset
            A log in the file format, with the types and the order of dimensions of a validated one.
        where : str
            What it is called in messages.

        Returns
        -------
        RobotLog
        """
        log = object.__new__(cls)
        object.__setattr__(log, "dataset", dataset)
        object.__setattr__(log, "where", where)
        return log

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> RobotLog:
        """Read a NetCDF file; raises LogError or MapError when it is missing, damaged or not a valid log."""
        path = check_path("path", path, error=LogError)
        return cls(read_dataset(path), path)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write a NetCDF file, all or nothing; raises LogError and leaves an existing file as it was when it cannot."""
        write_dataset(self.dataset, check_path("path", path, error=LogError))

    @classmethod
    def build(
        cls,
        *,
        time: ArrayLike,
        odometry: ArrayLike,
        ranges: ArrayLike | None = None,
        beam_poses: ArrayLike | None = None,
        max_range: float | None = None,
        landmark_range: ArrayLike | None = None,
        landmark_bearing: ArrayLike | None = None,
        landmark_size: ArrayLike | None = None,
        size_at_one_metre: float | None = None,
        landmark_time_offset: ArrayLike | None = None,
        landmark_sensor_pose: ArrayLike | None = None,
        landmarks: LandmarkMap | ArrayLike | None = None,
        walls: WallMap | ArrayLike | None = None,
        variables: Mapping[str, ArrayLike | None] | None = None,
        start_mean: ArrayLike | None = None,
        start_std: ArrayLike | None = None,
        true_poses: ArrayLike | None = None,
        true_theta: Mapping[str, float] | None = None,
        robot: str = "",
        source: str = "",
        seed: int | None = None,
        attributes: Mapping[str, object] | None = None,
        where: str = "RobotLog.build",
        warn: bool = True,
    ) -> RobotLog:
        """Build a log from arrays.

        Parameters
        ----------
        time : array_like, shape (T,)
            Strictly increasing sample times [s].
        odometry : array_like, shape (T, 3)
            Displacement (forward, left, turn) from the previous sample in its frame [m, m, rad]; row 0 is ignored.
        ranges : array_like, shape (T, B), optional
            Range readings [m]; NaN not measured, inf or >= `max_range` no echo, 0 "at or below".
        beam_poses : array_like, shape (B, 3), optional
            Where each beam sits on the robot [m, m, rad]; needed with `ranges`.
        max_range : float, optional
            Longest range of the beams [m]; needed with `ranges`.
        landmark_range, landmark_bearing, landmark_size : array_like, shape (T, J), optional
            Distance [m], bearing in the sensor frame [rad], apparent size [pixel]; NaN not seen.
        size_at_one_metre : float, optional
            Apparent size of a landmark one metre away [pixel].
        landmark_time_offset : array_like, shape (T, J), optional
            Time of each reading minus the time of its sample [s].
        landmark_sensor_pose : array_like, shape (3,), optional
            Where the landmark sensor sits on the robot [m, m, rad]; at its centre by default.
        landmarks : LandmarkMap or array_like, shape (J, 2), optional
            Landmark map [m]; needed with landmark readings.
        walls : WallMap or array_like, shape (W, 2, 2), optional
            Segment map [m].
        variables : mapping of str to array_like, optional
            Variables of further registered sensors, by their names in the file and with the shapes and units that the
            sensor declares; None leaves one out.
        start_mean, start_std : array_like, shape (3,), optional
            Gaussian belief about the pose at row 0 [m, m, rad]; anywhere on the map by default.
        true_poses : array_like, shape (T, 3), optional
            Reference trajectory, NaN where unknown; for scoring only.
        true_theta : mapping, optional
            Parameters of the simulation, in their SI units.
        robot, source : str, optional
            What moved, and where the data come from.
        seed : int, optional
            Seed of the simulation.
        attributes : mapping, optional
            Further attributes of the file; text or numbers. One that a variable declares goes to that variable.
        where : str, optional
            The caller, for messages.
        warn : bool, optional
            Whether to warn (logger ``pmcl.preflight``) of what is implausible in the numbers themselves:
            :func:`~pmcl.logs.plausibility.implausible`; and of range readings without walls, which are in order when
            a grid map is given beside the log.

        Returns
        -------
        RobotLog

        Raises
        ------
        LogError, MapError
            When shapes disagree, or the log is not valid.

        See Also
        --------
        pmcl.logs.odometry_from_poses, pmcl.logs.odometry_from_velocities : The column `odometry`.
        pmcl.logs.row_times, pmcl.logs.landmark_rows, pmcl.logs.beam_rows : Rows from streams with clocks of their own.
        """
        mappings = (("true_theta", true_theta), ("attributes", attributes), ("variables", variables))
        for name, given in mappings:
            if given is not None:
                check_type(name, given, Mapping, error=LogError, advice="write a dict with texts as keys")
        for name, text in (("robot", robot), ("source", source), ("where", where)):
            check_type(name, text, str, error=LogError, advice="write a text")
        if seed is not None:
            seed = check_seed(seed, error=LogError)
        names: tuple[str, ...] = ()
        if isinstance(landmarks, LandmarkMap):
            names, landmarks = tuple(landmarks.names), landmarks.positions
        if start_mean is None and start_std is None:
            start_mean, start_std = np.zeros(3), np.full(3, np.inf)
        arrays: dict[str, ArrayLike | None] = {
            "time": time,
            "odometry": odometry,
            "range": ranges,
            "beam_pose": beam_poses,
            "landmark_range": landmark_range,
            "landmark_bearing": landmark_bearing,
            "landmark_size": landmark_size,
            "landmark_time_offset": landmark_time_offset,
            "landmark_sensor_pose": landmark_sensor_pose,
            "landmark_position": landmarks,
            "wall": walls.segments if isinstance(walls, WallMap) else walls,
            "start_mean": start_mean,
            "start_std": start_std,
            "true_pose": true_poses,
        }
        arrays |= _of_further_sensors(variables or {}, arrays, where)
        theta = None if true_theta is None else json.dumps(dict(true_theta), default=_number)
        stated = {
            "robot": robot,
            "source": source,
            "true_theta": theta,
            "seed": seed,
            "max_range": max_range,
            "size_at_one_metre": size_at_one_metre,
        }
        log = cls(assemble(arrays, {**(attributes or {}), **stated}, where, names), where)
        if warn:
            # Arrays of its own, so that the log's are not made before they are asked for.
            arrays_of_log = LogArrays(log.dataset, where)
            warn_of((*implausible(arrays_of_log), *without_map(arrays_of_log)), where)
        return log

    def require_map(self) -> None:
        """Check that ranges can be explained by a map in the log; not needed when a grid map is given beside it.

        Raises
        ------
        MapError
            When there are range readings but no walls.
        """
        if "range" in self.dataset and "wall" not in self.dataset:
            raise MapError(
                f"{self.where}: expected walls (variable 'wall') or a grid map for the range readings, got neither: "
                "add the walls, or give a map beside the log"
            )

    def select(
        self,
        start: int,
        stop: int,
        *,
        start_mean: ArrayLike | None = None,
        start_std: ArrayLike | None = None,
    ) -> RobotLog:
        """Cut out samples ``start <= t < stop``; the row `start` becomes row 0.

        Parameters
        ----------
        start, stop : int
            Rows, ``0 <= start < stop <= T``.
        start_mean, start_std : array_like, shape (3,), optional
            Belief about the pose at the new row 0 [m, m, rad]. Without it, the log's own belief stays when
            `start` is 0; otherwise nothing is known: anywhere on the map.

        Returns
        -------
        RobotLog

        Raises
        ------
        LogError
            When the rows are not in the log, or only one of `start_mean` and `start_std` is given.
        """
        start = check_whole("start", start, -MOST_COUNT, error=LogError, advice="choose a row", where=self.where)
        stop = check_whole("stop", stop, -MOST_COUNT, error=LogError, advice="choose a row", where=self.where)
        if not 0 <= start < stop <= self.n_steps:
            fail(self.where, f"expected rows 0 <= start < stop <= {self.n_steps}, got {start}, {stop}: choose others")
        if (start_mean is None) != (start_std is None):
            fail(self.where, "expected start_mean and start_std together, got one of them: give both or none")
        part = self.dataset.isel(time=slice(start, stop))
        if start_mean is not None:
            belief = assemble({"start_mean": start_mean, "start_std": start_std}, {}, self.where)
            part = part.assign(start_mean=belief["start_mean"], start_std=belief["start_std"])
        elif start != 0:
            part = part.assign(start_mean=("pose", np.zeros(3)), start_std=("pose", np.full(3, np.inf)))
        return RobotLog(part, f"{self.where}[{start}:{stop}]")

    def without_truth(self) -> RobotLog:
        """Return the same log without reference trajectory, true parameters, simulated effects and seed."""
        bare = self.dataset.drop_vars(list(REFERENCE), errors="ignore")
        bare.attrs = {key: value for key, value in bare.attrs.items() if key not in ("true_theta", "effects", "seed")}
        return RobotLog.trusted(bare, self.where)


def _of_further_sensors(
    given: Mapping[str, ArrayLike | None], arguments: Mapping[str, object], where: str
) -> dict[str, ArrayLike | None]:
    """Check the names in the argument `variables`: those of registered sensors that no other argument sets."""
    known = [name for name in format_variables() if name not in arguments]
    for name in given:
        if name in arguments:
            fail(where, f"expected '{name}' as an argument of its own, got it in 'variables': move it")
        if name not in known:
            advice = did_you_mean(name, known, "install the package of its sensor, or register it with register_sensor")
            fail(where, f"expected variables of registered sensors, got '{name}': {advice}")
    return dict(given)


def _number(value: object) -> float | str:
    # numpy scalars are numbers too; whatever is not one is left to the validation, which says so.
    return float(value) if isinstance(value, np.number) else str(value)
