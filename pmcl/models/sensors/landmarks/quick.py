"""Landmark sightings as a quick filter reads them: mistakes with distances and bearings, and densities under each."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.logs.arrays import LogArrays
from pmcl.models.quick import GROSS, ChannelReading, Misreading, QuickReadings, ReadAs, gauss, mixed, some

__all__ = ["QuickSightings", "SightingChange", "SightingDensity", "quick_sightings"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# At most so many sightings of one row: those beyond tell little more of a mistake.
_SIGHTINGS = 6
# How far beyond the outermost landmark a robot may be [m].
_MARGIN = 2.0
_KINDS = ("range", "bearing", "size")
_DEGREE = math.pi / 180.0


class SightingChange(NamedTuple):
    """What undoes a mistake with sightings; the defaults change nothing.

    Attributes
    ----------
    range_factor : float
        What turns distances into metres.
    bearing_factor : float
        What turns bearings into radians, counter-clockwise.
    bearing_from_map : bool
        Whether bearings are directions on the map.
    """

    range_factor: float = 1.0
    bearing_factor: float = 1.0
    bearing_from_map: bool = False


_AS_IT_IS = SightingChange()


class QuickSightings(QuickReadings):
    """The landmark sightings of a log, six of a row at most.

    Parameters
    ----------
    log : LogArrays
        The log, with landmarks and with readings of at least one kind.
    noise : ndarray, shape (3,)
        Usual standard deviations of distance [m], bearing [rad] and relative size [1].
    """

    def __init__(self, log: LogArrays, noise: Float) -> None:
        assert log.landmarks is not None
        self.log, self.noise, self.positions = log, noise, log.landmarks.positions
        self.tables = [log.landmark_range, log.landmark_bearing, log.landmark_size]
        self.seen = np.any([~np.isnan(table) for table in self.tables if table is not None], axis=0)
        if log.size_at_one_metre is None:
            # A size tells nothing where nobody says how large a landmark appears.
            self.tables[2] = None
        self.longest = [math.nan if table is None else float(np.nanmax(table, initial=0.0)) for table in self.tables]

    @property
    def rows(self) -> NDArray[np.bool_]:
        """Which rows have sightings, (T,)."""
        return np.asarray(self.seen.any(axis=1))

    def sighted(self, row: int) -> tuple[Int, list[Float]]:
        """Return the landmarks (k,) of a row that count, and distances, bearings and sizes (k,), NaN if not read."""
        landmark = some(np.flatnonzero(self.seen[row]), _SIGHTINGS)
        nothing = np.full(landmark.size, np.nan)
        return landmark, [nothing if table is None else table[row, landmark] for table in self.tables]

    def under(self, ways: Sequence[ReadAs]) -> SightingDensity:
        """Return the log densities of the readings under some ways to read the log."""
        return SightingDensity(self, ways)

    def channels(self, row: int) -> Iterator[ChannelReading]:
        """Return distances, bearings and sizes of the sightings of a row that count, by their landmarks."""
        landmark, columns = self.sighted(row)
        for kind, longest, values in zip(_KINDS, self.longest, columns, strict=True):
            for j, value in zip(landmark.tolist(), values.tolist(), strict=True):
                if math.isnan(value):
                    continue
                if kind == "bearing":
                    yield ChannelReading((kind, j), _in_one_turn(value), -math.pi, math.pi)
                else:
                    yield ChannelReading((kind, j), value, 0.0, 1.001 * longest)

    def map_points(self) -> Float:
        """Return the landmarks."""
        return self.positions

    def margin(self) -> float:
        """Return how far outside the landmarks the robot may be [m]."""
        return _MARGIN

    def is_same_map(self, matrix: Float, shift: Float) -> bool:
        """Tell whether a similarity leaves each landmark where it is: they have numbers."""
        moved = self.positions @ matrix.T + shift
        return np.array_equal(np.round(self.positions, 6), np.round(moved, 6))

    def mistakes(self) -> Iterator[Misreading]:
        """Return mistakes with units, signs and frames."""
        if self.log.landmark_bearing is not None:
            yield Misreading(
                "bearings-in-degrees",
                "the bearings seem to be in degrees",
                "multiply them by pi / 180",
                SightingChange(bearing_factor=_DEGREE),
            )
            yield Misreading(
                "bearing-sign-flipped",
                "the bearings seem to have the wrong sign",
                "count bearings counter-clockwise from straight ahead",
                SightingChange(bearing_factor=-1.0),
            )
            yield Misreading(
                "bearings-in-world-frame",
                "the bearings seem to be directions on the map",
                "subtract the robot's heading, or take them as the sensor gave them",
                SightingChange(bearing_from_map=True),
            )
        if self.log.landmark_range is not None:
            for unit, factor in (("millimetres", 1e-3), ("centimetres", 1e-2)):
                finding = f"the distances of landmarks seem to be in {unit}"
                advice = f"multiply them by {factor:g}"
                yield Misreading(f"ranges-in-{unit}", finding, advice, SightingChange(factor))


class SightingDensity:
    """Log densities of sightings under H ways to read a log.

    Parameters
    ----------
    sightings : QuickSightings
        The readings.
    ways : sequence of ReadAs
        The ways to read them.
    """

    def __init__(self, sightings: QuickSightings, ways: Sequence[ReadAs]) -> None:
        log = sightings.log
        self.sightings = sightings
        changes: list[SightingChange] = [way.change or _AS_IT_IS for way in ways]
        self.range_factor = np.array([change.range_factor for change in changes])
        self.bearing_factor = np.array([change.bearing_factor for change in changes])
        self.bearing_from_map = np.array([change.bearing_from_map for change in changes])
        self.positions = np.stack([sightings.positions @ way.map_matrix.T + way.map_shift for way in ways])
        extent = np.hypot(*np.ptp(self.positions, axis=1).T)
        longest = 0.0 if log.landmark_range is None else np.nanmax(log.landmark_range, initial=0.0)
        self.longest_sighting = np.maximum(extent, longest * self.range_factor) + 1e-9
        self.size_constant = log.size_at_one_metre or 1.0
        largest = 0.0 if log.landmark_size is None else np.nanmax(log.landmark_size, initial=0.0)
        self.largest_size = max(self.size_constant, float(largest))

    def __call__(self, row: int, way: Int, level: Float, x: Float, y: Float, heading: Float) -> Float:
        """Return the log density of the readings of a row; see :class:`pmcl.models.quick.QuickDensity`."""
        landmark, columns = self.sightings.sighted(row)
        return self.of(landmark, columns, way, level, x, y, heading)

    def of(
        self, landmark: Int, columns: Sequence[Float], way: Int, level: Float, x: Float, y: Float, heading: Float
    ) -> Float:
        """Return the log density of distances, bearings and sizes `columns`, each (k,), of the landmarks (k,)."""
        std_range, std_bearing, std_size = self.sightings.noise
        c, s = np.cos(heading), np.sin(heading)
        ahead, aside, yaw = self.sightings.log.landmark_sensor_pose
        sensor_x, sensor_y = x + c * ahead - s * aside, y + s * ahead + c * aside
        total = np.zeros_like(x)
        rows = zip(landmark.tolist(), *(values.tolist() for values in columns), strict=True)
        for j, distance_read, bearing_read, size_read in rows:
            dx = self.positions[way, j, 0, None] - sensor_x
            dy = self.positions[way, j, 1, None] - sensor_y
            square = dx * dx + dy * dy
            if not math.isnan(distance_read):
                factor = self.range_factor[way, None]
                residual = distance_read * factor - np.sqrt(square)
                spread = 1.0 / self.longest_sighting[way, None]
                total += np.log(factor * mixed(residual, level[:, None] * std_range, spread))
            if not math.isnan(bearing_read):
                facing = np.where(self.bearing_from_map[way, None], 0.0, heading + yaw)
                factor = self.bearing_factor[way, None]
                residual = bearing_read * factor - np.arctan2(dy, dx) + facing
                residual -= 2.0 * np.pi * np.round(residual / (2.0 * np.pi))
                density = mixed(residual, level[:, None] * std_bearing, 0.5 / np.pi)
                total += np.log(np.abs(factor) * density)
            if not math.isnan(size_read):
                per_size = square / self.size_constant
                density = per_size * gauss(size_read * per_size - 1.0, level[:, None] * std_size)
                total += np.log((1.0 - GROSS) * density + GROSS / self.largest_size)
        return total


def quick_sightings(log: LogArrays, usual: Mapping[str, float]) -> QuickSightings | None:
    """Return a log's sightings for a quick filter; None when it has none.

    Parameters
    ----------
    log : LogArrays
        The log.
    usual : mapping of str to float
        Usual values of parameters, of which those of sightings are taken.
    """
    if all(values is None for values in (log.landmark_range, log.landmark_bearing, log.landmark_size)):
        return None
    names = ("sigma_landmark_range", "sigma_bearing", "sigma_size")
    return QuickSightings(log, np.array([usual.get(name, math.nan) for name in names]))


def _in_one_turn(angle: float) -> float:
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))
