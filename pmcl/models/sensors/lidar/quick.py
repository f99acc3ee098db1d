"""Scans of lidars as a quick filter reads them: mistakes with units, mounts and stamps, and densities under each."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.logs.arrays import LidarScans, LogArrays
from pmcl.maps.occupancy_grid import FREE, OCCUPIED, OccupancyGrid
from pmcl.models.quick import ChannelReading, Misreading, QuickReadings, ReadAs, gauss, some
from pmcl.models.sensors.lidar.table import LONGEST_DISTANCE

__all__ = ["QuickScans", "ScanChange", "ScanDensity", "quick_scans"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# At most so many rays of one scan: they share the errors of the map, so that those beyond tell little more.
_RAYS = 8
# Share of echoes that may end anywhere: people and furniture are on no map.
_GROSS = 0.2
# Share of rays without an echo; the same under every way to read a log, so that its value matters little.
_NO_ECHO = 0.1
# A symmetric map is one of which so many walls fall on walls.
_SAME = 0.98
_QUARTER = 0.5 * math.pi


class ScanChange(NamedTuple):
    """What undoes a mistake with the scans of a laser; the defaults change nothing.

    Attributes
    ----------
    range_factor, max_range_factor : float
        What turns readings, and the laser's range, into metres.
    laser : str or None
        The laser whose mount is wrong, by its name; None for all.
    upside_down : bool
        Whether angles run the other way.
    turn : float
        What the yaw of the mount lacks [rad].
    """

    range_factor: float = 1.0
    max_range_factor: float = 1.0
    laser: str | None = None
    upside_down: bool = False
    turn: float = 0.0


_AS_IT_IS = ScanChange()


class _Rays(NamedTuple):
    """Rays of one row: laser, ray and reading, (b,) each."""

    laser: Int
    ray: Int
    reading: Float


class QuickScans(QuickReadings):
    """The scans of a log's lasers, eight rays of each scan at most.

    Parameters
    ----------
    lasers : mapping of str to LidarScans
        The lasers by their names.
    grid : OccupancyGrid
        The map.
    noise : float
        Usual distance between the end of a ray and the wall that it met [m].
    """

    particles_anywhere: ClassVar[int] = 1000
    # Clocks of computers that nobody has synchronised. Less than a second is a latency, which is for the critic [s].
    delays: ClassVar[tuple[float, ...]] = (1.0, 1.5, 2.2, 3.3, 5.0)
    start_may_be_elsewhere: ClassVar[bool] = True

    def __init__(self, lasers: Mapping[str, LidarScans], grid: OccupancyGrid, noise: float) -> None:
        self.names, self.lasers, self.grid, self.noise = tuple(lasers), tuple(lasers.values()), grid, noise
        self.width_beyond = [_width_beyond(laser) for laser in self.lasers]
        # As in the model, distances go on outside the map.
        self.wide = grid.with_margin(LONGEST_DISTANCE)
        self.distance = np.pad(self.wide.distance_field.astype(np.float32), 1, constant_values=np.inf)

    @property
    def rows(self) -> NDArray[np.bool_]:
        """Which rows have readings, (T,)."""
        return np.asarray(np.any([(laser.ranges > laser.min_range).any(axis=1) for laser in self.lasers], axis=0))

    def rays(self, row: int) -> _Rays:
        """Return the rays of a row that count."""
        found = []
        for number, laser in enumerate(self.lasers):
            ray = some(np.flatnonzero(laser.ranges[row] > laser.min_range), _RAYS)
            found.append(_Rays(np.full(ray.size, number), ray, laser.ranges[row, ray]))
        return _Rays(*(np.concatenate(columns) for columns in zip(*found, strict=True)))

    def under(self, ways: Sequence[ReadAs]) -> ScanDensity:
        """Return the log densities of the readings under some ways to read the log."""
        return ScanDensity(self, ways)

    def channels(self, row: int) -> Iterator[ChannelReading]:
        """Return the readings of a row that count, by laser and ray."""
        for number, ray, value in zip(*(column.tolist() for column in self.rays(row)), strict=True):
            laser, beyond = self.lasers[number], self.width_beyond[number]
            yield ChannelReading((f"laser {number}", ray), value, 0.0, laser.max_range, beyond)

    def map_points(self) -> Float:
        """Return two opposite corners of the grid's bounding box."""
        x_low, x_high, y_low, y_high = self.grid.bounds
        return np.array([(x_low, y_low), (x_high, y_high), (x_low, y_high), (x_high, y_low)])

    def free_places(self) -> Float:
        """Return the centres of free cells, (N, 2) [m], where a robot may be."""
        row, column = np.nonzero(self.grid.cells == FREE)
        return self.grid.from_cells(np.column_stack((column + 0.5, row + 0.5)))

    def is_same_map(self, matrix: Float, shift: Float) -> bool:
        """Tell whether nearly all walls fall on walls, to within a cell and a half."""
        row, column = np.nonzero(self.grid.cells == OCCUPIED)
        step = max(1, row.size // 2000)
        walls = self.grid.from_cells(np.column_stack((column[::step] + 0.5, row[::step] + 0.5)))
        distance = self.distance_at(walls @ matrix.T + shift)
        return bool(np.mean(distance < 1.5 * self.grid.resolution) > _SAME)

    def distance_at(self, points: Float) -> Float:
        """Return the distance from the cells of points (..., 2) to the nearest wall [m]; inf far outside the grid."""
        cells = self.wide.to_cells(points)
        rows, columns = self.wide.cells.shape
        column = np.clip(cells[..., 0] + 1.0, 0.0, columns + 1.0).astype(np.int64)
        row = np.clip(cells[..., 1] + 1.0, 0.0, rows + 1.0).astype(np.int64)
        return np.asarray(self.distance[row, column], dtype=np.float64)

    def mistakes(self) -> Iterator[Misreading]:
        """Return mistakes with units, and mounts that are upside down or off by right angles."""
        for unit, factor in (("millimetres", 1e-3), ("centimetres", 1e-2)):
            name, advice = f"ranges-in-{unit}", f"multiply them by {factor:g}"
            yield Misreading(name, f"the ranges of the scans seem to be in {unit}", advice, ScanChange(factor))
            both = ScanChange(factor, factor)
            yield Misreading(name, f"the ranges of the scans and max_range seem to be in {unit}", advice, both)
        of_one = self.names if len(self.names) > 1 else ()
        for laser in (None, *of_one):
            what = "the laser" if not of_one else "all lasers" if laser is None else f"laser '{laser}'"
            seems = "seem" if what == "all lasers" else "seems"
            for turn in (_QUARTER, -_QUARTER, math.pi):
                yield Misreading(
                    "laser-yaw-off",
                    f"{what} {seems} to be turned by {math.degrees(turn):+.0f} degrees against the stated mount",
                    f"add {turn:+.4f} rad to the yaw of the laser's pose",
                    ScanChange(laser=laser, turn=turn),
                )
            for turn in (0.0, math.pi):
                turned = " and turned by 180 degrees" if turn else ""
                yield Misreading(
                    "laser-upside-down",
                    f"{what} {seems} to be mounted upside down{turned}",
                    "count the angles of the rays counter-clockwise as seen from above",
                    ScanChange(laser=laser, upside_down=True, turn=turn),
                )


class ScanDensity:
    """Log densities of scans under H ways to read a log, by the distance field of the map.

    Parameters
    ----------
    scans : QuickScans
        The readings.
    ways : sequence of ReadAs
        The ways to read them.

    Notes
    -----
    An echo has the density of a normal error of that size which the distance from its end to the nearest wall shows,
    mixed with a uniform one. Where the ray passes through a wall before, nothing is said.
    """

    def __init__(self, scans: QuickScans, ways: Sequence[ReadAs]) -> None:
        self.scans = scans
        changes: list[ScanChange] = [way.change or _AS_IT_IS for way in ways]
        self.range_factor = np.array([change.range_factor for change in changes])
        reach = np.array([laser.max_range for laser in scans.lasers])
        self.max_range = reach * np.array([[change.max_range_factor] for change in changes])
        mount = np.array([laser.pose for laser in scans.lasers])
        self.mount = np.stack([mount] * len(changes))
        self.hand = np.ones((len(changes), len(mount)))
        for h, change in enumerate(changes):
            mine = np.array([change.laser in (None, name) for name in scans.names])
            self.mount[h, mine, 2] += change.turn
            self.hand[h, mine] = -1.0 if change.upside_down else 1.0
        self.inverse = np.stack([np.linalg.inv(way.map_matrix) for way in ways])
        self.shift = np.stack([way.map_shift for way in ways])
        self.scale = np.sqrt([abs(np.linalg.det(way.map_matrix)) for way in ways])

    def __call__(self, row: int, way: Int, level: Float, x: Float, y: Float, heading: Float) -> Float:
        """Return the log density of the readings of a row; see :class:`pmcl.models.quick.QuickDensity`."""
        scans, rays = self.scans, self.scans.rays(row)
        if not rays.ray.size:
            return np.zeros_like(x)
        angle = np.array([scans.lasers[n].angles[ray] for n, ray in zip(rays.laser, rays.ray, strict=True)])
        beyond = np.array([scans.width_beyond[n] for n in rays.laser])
        mount, reach = self.mount[way][:, rays.laser], self.max_range[way][:, rays.laser]
        reading = self.range_factor[way, None] * np.where(np.isfinite(rays.reading), rays.reading, np.inf)
        echo = reading < reach
        length = np.where(echo, reading, 0.0)
        direction = mount[..., 2] + self.hand[way][:, rays.laser] * angle
        # Where the ray ends in the robot's frame, then on the map as each way reads it.
        ahead, aside = mount[..., 0] + length * np.cos(direction), mount[..., 1] + length * np.sin(direction)
        c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
        dx = x[:, None] + c * ahead[..., None] - s * aside[..., None] - self.shift[way, 0, None, None]
        dy = y[:, None] + s * ahead[..., None] + c * aside[..., None] - self.shift[way, 1, None, None]
        inverse = self.inverse[way][:, None, None]
        ends = np.stack(
            (inverse[..., 0, 0] * dx + inverse[..., 0, 1] * dy, inverse[..., 1, 0] * dx + inverse[..., 1, 1] * dy),
            axis=-1,
        )
        distance = scans.distance_at(ends) * self.scale[way, None, None]
        # A wall is known to within half a cell.
        std = np.hypot(level * scans.noise, 0.5 * scans.grid.resolution * self.scale[way])[:, None, None]
        density = (1.0 - _GROSS) * gauss(distance, std) + _GROSS / reach[..., None]
        log_echo = math.log1p(-_NO_ECHO) + np.log(self.range_factor[way, None, None] * density)
        width = np.where(np.isfinite(rays.reading), beyond, 1.0)
        log_missed = np.broadcast_to(math.log(_NO_ECHO) - np.log(width), echo.shape)
        return np.asarray(np.where(echo[..., None], log_echo, log_missed[..., None]).sum(axis=1))


def quick_scans(log: LogArrays, usual: Mapping[str, float]) -> QuickScans | None:
    """Return a log's scans for a quick filter; None when it has none, or no grid map.

    Parameters
    ----------
    log : LogArrays
        The log.
    usual : mapping of str to float
        Usual values of parameters, of which ``sigma_hit`` [m] is taken.
    """
    if not log.lidars or log.grid_map is None:
        return None
    return QuickScans(log.lidars, log.grid_map, usual.get("sigma_hit", math.nan))


def _width_beyond(laser: LidarScans) -> float:
    """Return over how many metres readings beyond max_range spread: 1 where one number marks all rays without echo."""
    beyond = laser.ranges[np.isfinite(laser.ranges) & (laser.ranges > laser.max_range)]
    return float(beyond.max()) if beyond.size and beyond.min() < beyond.max() else 1.0
