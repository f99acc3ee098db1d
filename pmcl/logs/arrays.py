"""A robot log as plain arrays: what models, localization and scoring read."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from pmcl.logs.schema import FORMAT, REFERENCE, variables
from pmcl.maps.landmarks import LandmarkMap
from pmcl.maps.occupancy_grid import OccupancyGrid
from pmcl.maps.walls import WallMap
from pmcl.registry import sensor_variables

__all__ = ["LidarScans", "LogArrays", "landmark_names"]

Float = NDArray[np.float64]


class LidarScans(NamedTuple):
    """The scans of one lidar. T is the number of samples, R of rays.

    Attributes
    ----------
    ranges : ndarray, shape (T, R)
        Distances along the rays [m]; NaN not measured, inf or >= `max_range` no echo.
    angles : ndarray, shape (R,)
        Direction of each ray in the laser's frame [rad], strictly increasing or decreasing.
    min_range, max_range : float
        Shortest and longest range of the laser [m].
    pose : ndarray, shape (3,)
        Where the laser sits on the robot (x, y, yaw) [m, m, rad]. One that is mounted upside down has decreasing
        angles, which are its directions seen from above.
    """

    ranges: Float
    angles: Float
    min_range: float
    max_range: float
    pose: Float


@dataclass(frozen=True, eq=False, repr=False)
class LogArrays:
    """Arrays of a validated log. T is the number of samples, B of beams, J of landmarks.

    All arrays are float64 and read-only; poses are (x, y, heading) in the world frame [m, m, rad].

    Attributes
    ----------
    dataset : xarray.Dataset
        The log in the file format; :class:`~pmcl.logs.robot_log.RobotLog` validates it.
    where : str
        File or call that it came from, for messages.
    grid_map : OccupancyGrid or None
        The grid map of the surroundings; shared by all logs that are made from this one.
    """

    dataset: xr.Dataset
    where: str = "robot log"
    grid_map: OccupancyGrid | None = None
    is_whole: ClassVar[bool] = True
    """Whether these are all rows of a log; the latest rows of a robot that is still running are not."""

    @property
    def n_steps(self) -> int:
        """Number of samples T."""
        return int(self.dataset.sizes["time"])

    @cached_property
    def n_readings(self) -> int:
        """Number of readings of all sensors.

        A beam without echo (inf) was measured and counts; a sighting counts once, however much of distance, bearing
        and size it tells.
        """
        return int(self.readings_of_rows().sum())

    def readings_of_rows(self) -> NDArray[np.int64]:
        """Return the number of readings of all sensors in each row, (T,)."""
        total = np.zeros(self.n_steps, dtype=np.int64)
        for sensor in sensor_variables().values():
            held = {name: self.variable(name) for name in sensor.readings(self.dataset)}
            held = {name: values for name, values in held.items() if values is not None}
            if held:
                total += sensor.count(held)
        return total

    def variable(self, name: str) -> Float | None:
        """Return a variable of the log by its name in the file, or None when the log does not have it.

        Parameters
        ----------
        name : str
            For example ``"range"``, or the variable of a sensor that an installed package adds.

        Returns
        -------
        ndarray or None
            Read-only.
        """
        return self._optional(name)

    @property
    def robot(self) -> str:
        """What moved; empty when the log does not say."""
        return str(self.dataset.attrs.get("robot", ""))

    @property
    def source(self) -> str:
        """Where the data come from; empty when the log does not say."""
        return str(self.dataset.attrs.get("source", ""))

    @cached_property
    def times(self) -> Float:
        """Sample times [s], shape (T,)."""
        return _frozen(self.dataset["time"].values)

    @cached_property
    def odometry(self) -> Float:
        """Measured displacement from the previous sample in its frame [m, m, rad], shape (T, 3).

        Row 0, which the format ignores, reads as zero.
        """
        increments = np.array(self.dataset["odometry"].values)
        increments[0] = 0.0
        return _frozen(increments)

    @property
    def ranges(self) -> Float | None:
        """Range readings [m], shape (T, B); NaN not measured, inf or >= :attr:`max_range` no echo."""
        return self._optional("range")

    @property
    def beam_poses(self) -> Float | None:
        """Where each beam sits on the robot [m, m, rad], shape (B, 3)."""
        return self._optional("beam_pose")

    @property
    def max_range(self) -> float:
        """Longest range of the beams [m]; inf when the log has no range readings."""
        return float(self.dataset["range"].attrs["max_range"]) if "range" in self.dataset else float("inf")

    @property
    def landmark_range(self) -> Float | None:
        """Distance readings to landmarks [m], shape (T, J); NaN not seen."""
        return self._optional("landmark_range")

    @property
    def landmark_bearing(self) -> Float | None:
        """Bearing readings to landmarks in the sensor frame [rad], shape (T, J); NaN not seen."""
        return self._optional("landmark_bearing")

    @property
    def landmark_size(self) -> Float | None:
        """Apparent sizes of landmarks [pixel], shape (T, J); NaN not seen."""
        return self._optional("landmark_size")

    @property
    def size_at_one_metre(self) -> float | None:
        """Apparent size of a landmark one metre away [pixel]; None when the log does not say."""
        stated = (
            self.dataset["landmark_size"].attrs.get("size_at_one_metre") if "landmark_size" in self.dataset else None
        )
        return None if stated is None else float(stated)

    @property
    def landmark_time_offset(self) -> Float | None:
        """Time of each landmark reading minus the time of its sample [s], shape (T, J)."""
        return self._optional("landmark_time_offset")

    @property
    def landmark_sensor_pose(self) -> Float:
        """Where the landmark sensor sits on the robot [m, m, rad], shape (3,); its centre unless given."""
        pose = self._optional("landmark_sensor_pose")
        return _frozen(np.zeros(3)) if pose is None else pose

    @property
    def lidars(self) -> dict[str, LidarScans]:
        """The scans of each lidar, by its name; the name is empty for a lidar whose variable is plainly ``scan``."""
        found: dict[str, LidarScans] = {}
        for name in sensor_variables()["lidar"].readings(self.dataset):
            ranges = self._optional(name)
            if ranges is None:
                continue
            label = name.removeprefix("scan").removeprefix("_")
            angles = self._optional(f"scan_angle_{label}" if label else "scan_angle")
            attrs = self.dataset[name].attrs
            assert angles is not None
            found[label] = LidarScans(
                ranges, angles, float(attrs["min_range"]), float(attrs["max_range"]), _frozen(np.array(attrs["pose"]))
            )
        return found

    @cached_property
    def landmarks(self) -> LandmarkMap | None:
        """The landmark map; None when the log has none."""
        positions = self._optional("landmark_position")
        return None if positions is None else LandmarkMap(positions, landmark_names(self.dataset))

    @cached_property
    def walls(self) -> WallMap | None:
        """The segment map; None when the log has none."""
        segments = self._optional("wall")
        return None if segments is None else WallMap(segments)

    @property
    def start_mean(self) -> Float:
        """Mean of the belief about the pose at row 0 [m, m, rad], shape (3,)."""
        return _frozen(self.dataset["start_mean"].values)

    @property
    def start_std(self) -> Float:
        """Standard deviation of that belief [m, m, rad], shape (3,); inf means anywhere on the map."""
        return _frozen(self.dataset["start_std"].values)

    @property
    def true_poses(self) -> Float | None:
        """Reference trajectory [m, m, rad], shape (T, 3), NaN where unknown. For scoring only."""
        return self._optional("true_pose")

    @property
    def true_theta(self) -> dict[str, float] | None:
        """Parameters that the simulation used; None for a recorded log. For scoring only."""
        text = self.dataset.attrs.get("true_theta")
        return None if text is None else {name: float(value) for name, value in json.loads(text).items()}

    def estimated(self, name: str) -> Float | None:
        """Return what somebody estimated from the log, or None: no reading, but what readings tell together.

        Parameters
        ----------
        name : str
            ``path``: (T, 3) poses [m, m, rad], headings not wrapped. For range beams ``world_direction`` [rad],
            ``distance`` [m] and ``incidence`` [rad], (T, B) each.
        """
        return self._optional(f"estimated_{name}")

    def fingerprint(self) -> str:
        """SHA-256 of all numbers that calibration sees, those of the grid map included, in hexadecimal.

        Equal for two logs exactly when calibration cannot tell them apart: names, notes, the reference trajectory,
        the true parameters, the seed and the ignored odometry of row 0 do not count.
        """
        names = [name for name in variables(self.dataset) if name in self.dataset and name not in REFERENCE]
        seen = {name: self.dataset[name].values for name in names}
        seen["odometry"] = self.odometry
        for sensor in sensor_variables().values():
            seen |= sensor.settings(self)
        digest = hashlib.sha256(FORMAT.encode())
        for name, values in sorted(seen.items()):
            # One spelling for every NaN and for both zeros.
            plain = np.where(np.isnan(values), np.nan, values + 0.0).astype("<f8")
            digest.update(f"{name}{plain.shape}".encode() + plain.tobytes())
        if self.grid_map is not None:
            digest.update(self.grid_map.fingerprint().encode())
        return digest.hexdigest()

    def _optional(self, name: str) -> Float | None:
        return _frozen(self.dataset[name].values) if name in self.dataset else None


def landmark_names(dataset: xr.Dataset) -> tuple[str, ...]:
    """Names of the landmarks: the labels of their dimension, or nothing when it has none."""
    return tuple(str(label) for label in dataset["landmark"].values) if "landmark" in dataset.coords else ()


def _frozen(values: Float) -> Float:
    # Read-only even after pickling, which forgets the flag; kernels get contiguous memory.
    view: Float = np.ascontiguousarray(values, dtype=np.float64).view()
    view.flags.writeable = False
    return view
