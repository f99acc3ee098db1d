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
from pmcl.errors import LogError, MapError
from pmcl.logs.arguments import of_further_sensors, of_lidars, plain_number
from pmcl.logs.arrays import LidarScans, LogArrays
from pmcl.logs.assemble import assemble
from pmcl.logs.finding import warn_of
from pmcl.logs.grid_map import check_start_on_map, map_named_by, map_to_name
from pmcl.logs.netcdf import read_dataset, write_dataset
from pmcl.logs.plausibility import implausible, without_map
from pmcl.logs.schema import REFERENCE
from pmcl.logs.validation import fail, validated
from pmcl.maps.landmarks import LandmarkMap
from pmcl.maps.occupancy_grid import OccupancyGrid
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
    grid_map : OccupancyGrid or None
        The grid map, which lidars need. All logs that are made from this one share it.

    Raises
    ------
    LogError, MapError
        When the dataset does not follow the format, or the start is not on the grid map.
    """

    def __post_init__(self) -> None:
        object.__setattr__(self, "dataset", validated(self.dataset, self.where))
        if self.grid_map is not None:
            check_start_on_map(self.dataset, self.grid_map, self.where)

    def __repr__(self) -> str:
        name = self.robot or "unnamed robot"
        return f"<RobotLog of {name}: {self.n_steps} samples, {self.n_readings} readings, from {self.where}>"

    @classmethod
    def from_dataset(
        cls, dataset: xr.Dataset, where: str = "dataset", grid_map: OccupancyGrid | None = None
    ) -> RobotLog:
        """Validate a dataset in the file format.

        Parameters
        ----------
        dataset : xarray.Dataset
            A log in the file format.
        where : str
            What it is called in messages.
        grid_map : OccupancyGrid, optional
            The grid map.

        Returns
        -------
        RobotLog

        Raises
        ------
        LogError, MapError
            When it does not follow the format.
        """
        return cls(dataset, where, grid_map)

    @classmethod
    def trusted(cls, dataset: xr.Dataset, where: str, grid_map: OccupancyGrid | None) -> RobotLog:
        """Take a dataset as it is: one that was made from a validated one, with values that are valid by their making.

        Simulations of a log are made by the hundred, and checking them all would take longer than making them.

        Parameters
        ----------
        dataset : xarray.Dataset
            A log in the file format, with the types and the order of dimensions of a validated one.
        where : str
            What it is called in messages.
        grid_map : OccupancyGrid or None
            The grid map of the log that the dataset was made from.

        Returns
        -------
        RobotLog
        """
        log = object.__new__(cls)
        object.__setattr__(log, "dataset", dataset)
        object.__setattr__(log, "where", where)
        object.__setattr__(log, "grid_map", grid_map)
        return log

    @classmethod
    def read(
        cls, path: str | os.PathLike[str], map: str | os.PathLike[str] | OccupancyGrid | None = None
    ) -> RobotLog:
        """Read a log from its NetCDF file, and its grid map.

        Parameters
        ----------
        path : path
            The log.
        map : path or OccupancyGrid, optional
            The YAML file of a map_server map, or a grid. Without it, the map is the one that the log names in its
            attribute ``map``, a path relative to the log that stays in its folder; a log that names none has none.

        Returns
        -------
        RobotLog

        Raises
        ------
        LogError, MapError
            When a file is missing or damaged, or the log is not valid.
        """
        path = check_path("path", path, error=LogError)
        dataset = read_dataset(path)
        if isinstance(map, OccupancyGrid):
            grid: OccupancyGrid | None = map
        else:
            grid = map_named_by(dataset, path) if map is None else OccupancyGrid.read(map)
        return cls(dataset, path, grid)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write a NetCDF file, all or nothing.

        A grid map stays in its own files. The log names it in its attribute ``map`` when it was read from a file in the
        folder of the log or below; else the log names none, and the map is given again when the log is read.

        Parameters
        ----------
        path : path
            Target; replaced when it exists.

        Raises
        ------
        LogError
            When it cannot be written. An existing file is left as it was.
        """
        path = check_path("path", path, error=LogError)
        dataset = self.dataset
        if self.grid_map is not None:
            dataset = dataset.copy()
            name = map_to_name(self.grid_map, path)
            dataset.attrs = {key: value for key, value in dataset.attrs.items() if key != "map"}
            dataset.attrs |= {} if name is None else {"map": name}
        write_dataset(dataset, path)

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
        lidars: Mapping[str, LidarScans] | None = None,
        grid_map: OccupancyGrid | None = None,
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
        lidars : mapping of str to LidarScans, optional
            The scans of each lidar by its name, empty for the only one.
        grid_map : OccupancyGrid, optional
            Grid map, which lidars need.
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
            :func:`~pmcl.logs.plausibility.implausible`; and of readings without a map, which are in order when one is
            given later.

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
        mappings = (
            ("true_theta", true_theta), ("attributes", attributes), ("variables", variables), ("lidars", lidars)
        )  # fmt: skip
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
        arrays |= of_further_sensors(variables or {}, arrays, where)
        laser_variables = of_lidars(lidars or {}, where)
        arrays |= {name: values for name, (values, _) in laser_variables.items()}
        theta = None if true_theta is None else json.dumps(dict(true_theta), default=plain_number)
        stated = {
            "robot": robot,
            "source": source,
            "true_theta": theta,
            "seed": seed,
            "max_range": max_range,
            "size_at_one_metre": size_at_one_metre,
        }
        attributes_of = {name: attrs for name, (_, attrs) in laser_variables.items()}
        dataset = assemble(arrays, {**(attributes or {}), **stated}, where, names, attributes_of)
        log = cls(dataset, where, grid_map)
        if warn and log.n_readings:
            # Arrays of its own, so that the log's are not made before they are asked for.
            arrays_of_log = LogArrays(log.dataset, where, grid_map)
            warn_of((*implausible(arrays_of_log), *without_map(arrays_of_log)), where)
        return log

    def require_map(self) -> None:
        """Check that the log's walls can explain the readings of its range beams; beams do not use a grid map.

        Raises
        ------
        MapError
            When there are range readings but no walls.
        """
        if "range" in self.dataset and "wall" not in self.dataset:
            advice = "add the walls"
            if self.grid_map is not None:
                advice += ", or write the readings as those of a lidar (variables 'scan' and 'scan_angle')"
            raise MapError(
                f"{self.where}: expected walls (variable 'wall') for the range readings, got none: {advice}"
            )

    def require_grid_map(self) -> OccupancyGrid:
        """Return the grid map.

        Returns
        -------
        OccupancyGrid

        Raises
        ------
        MapError
            When the log has none.
        """
        if self.grid_map is None:
            raise MapError(
                f"{self.where}: expected a grid map for the lidar, got none: give one with --map MAP.yaml (in Python: "
                "RobotLog.read(path, map=...) or log.with_map(grid)), or name it in the log's attribute 'map'"
            )
        return self.grid_map

    def with_map(self, grid_map: OccupancyGrid | None) -> RobotLog:
        """Return the same log with another grid map, or with none.

        Parameters
        ----------
        grid_map : OccupancyGrid or None
            The map.

        Returns
        -------
        RobotLog

        Raises
        ------
        LogError, MapError
            When it is no grid map, or the start is not on it.
        """
        if grid_map is not None:
            check_start_on_map(self.dataset, grid_map, self.where)
        return RobotLog.trusted(self.dataset, self.where, grid_map)

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
        return RobotLog(part, f"{self.where}[{start}:{stop}]", self.grid_map)

    def without_truth(self) -> RobotLog:
        """Return the same log without reference trajectory, true parameters, simulated effects and seed."""
        bare = self.dataset.drop_vars(list(REFERENCE), errors="ignore")
        bare.attrs = {key: value for key, value in bare.attrs.items() if key not in ("true_theta", "effects", "seed")}
        return RobotLog.trusted(bare, self.where, self.grid_map)
