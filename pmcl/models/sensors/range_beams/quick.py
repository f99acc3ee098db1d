"""Range beams as a quick filter reads them: mistakes with readings and mounts, and densities under each."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from pmcl.logs.arrays import LogArrays
from pmcl.models.quick import GROSS, ChannelReading, Misreading, QuickReadings, ReadAs, mixed, some
from pmcl.models.sensors.range_beams.kernels.rays import cast_rays
from pmcl.models.sensors.range_beams.table import OPEN_RAY

__all__ = ["BeamChange", "BeamDensity", "QuickBeams", "quick_beams"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# At most so many beams of one row: those beyond tell little more of a mistake.
_BEAMS = 8
# What gross readings are: no echo, zero, or else anything in between.
_NO_ECHO, _ZERO = 0.5, 0.02
_DEGREE = math.pi / 180.0


class BeamChange(NamedTuple):
    """What undoes a mistake with beams; the defaults change nothing.

    Attributes
    ----------
    range_factor, max_range_factor : float
        What turns readings, and max_range, into metres.
    yaws : ndarray, shape (B,), or None
        Directions in which the beams really look [rad].
    zero_is_nothing : bool
        Whether a beam that reads zero did not measure.
    """

    range_factor: float = 1.0
    max_range_factor: float = 1.0
    yaws: Float | None = None
    zero_is_nothing: bool = False


_AS_IT_IS = BeamChange()


class QuickBeams(QuickReadings):
    """The range readings of a log, eight beams of a row at most.

    Parameters
    ----------
    ranges : ndarray, shape (T, B)
        Readings as the log has them.
    poses : ndarray, shape (B, 3)
        Where the beams sit on the robot [m, m, rad].
    log : LogArrays
        The log, with walls.
    noise : float
        Usual standard deviation of a reading [m].
    """

    # Rays cost more than landmarks, and rooms are smaller.
    particles_anywhere: ClassVar[int] = 500

    def __init__(self, ranges: Float, poses: Float, log: LogArrays, noise: float) -> None:
        assert log.walls is not None
        self.ranges, self.poses, self.noise = ranges, poses, noise
        self.max_range, self.walls = log.max_range, log.walls
        self.width_beyond = _width_beyond(ranges, self.max_range)

    @property
    def rows(self) -> NDArray[np.bool_]:
        """Which rows have readings, (T,)."""
        return np.asarray((~np.isnan(self.ranges)).any(axis=1))

    def measured(self, row: int) -> Int:
        """Return the beams of a row that count."""
        return some(np.flatnonzero(~np.isnan(self.ranges[row])), _BEAMS)

    def under(self, ways: Sequence[ReadAs]) -> BeamDensity:
        """Return the log densities of the readings under some ways to read the log."""
        return BeamDensity(self, ways)

    def channels(self, row: int) -> Iterator[ChannelReading]:
        """Return the readings of a row that count, by their beams."""
        for beam in self.measured(row):
            value = float(self.ranges[row, beam])
            yield ChannelReading(("beam", int(beam)), value, 0.0, self.max_range, self.width_beyond)

    def map_points(self) -> Float:
        """Return both ends of all walls."""
        return self.walls.segments.reshape(-1, 2)

    def is_same_map(self, matrix: Float, shift: Float) -> bool:
        """Tell whether the walls are symmetric; they are in no order, and neither are their ends."""

        def canonical(points: Float) -> Float:
            ends = np.round(points, 6) + 0.0
            walls = np.array([sorted(map(tuple, wall)) for wall in ends]).reshape(-1, 4)
            return np.asarray(walls[np.lexsort(walls.T)])

        segments = self.walls.segments
        return np.array_equal(canonical(segments), canonical(segments @ matrix.T + shift))

    def mistakes(self) -> Iterator[Misreading]:
        """Return mistakes with units, with zeros and with the directions of the beams."""
        for unit, factor in (("millimetres", 1e-3), ("centimetres", 1e-2)):
            name, advice = f"ranges-in-{unit}", f"multiply them by {factor:g}"
            yield Misreading(name, f"the range readings seem to be in {unit}", advice, BeamChange(factor))
            both = BeamChange(factor, factor)
            yield Misreading(name, f"the range readings and max_range seem to be in {unit}", advice, both)
        if (self.ranges == 0.0).any():
            yield Misreading(
                "zero-for-not-measured",
                "range readings of 0 seem to mean that nothing was measured",
                "write NaN there (or inf where there was no echo)",
                BeamChange(zero_is_nothing=True),
            )
        yaws = self.poses[:, 2]
        if not yaws.any():
            return
        yield Misreading(
            "beam-yaws-in-degrees",
            "the yaws of the beams seem to be in degrees",
            "multiply them by pi / 180",
            BeamChange(yaws=yaws * _DEGREE),
        )
        yield Misreading(
            "beam-yaws-are-indices",
            "the yaws of the beams seem to be their numbers",
            "give the direction of each beam in radians",
            BeamChange(yaws=yaws * (2.0 * math.pi / len(yaws))),
        )
        yield Misreading(
            "beam-yaw-sign-flipped",
            "the yaws of the beams seem to have the wrong sign",
            "count yaws counter-clockwise from straight ahead",
            BeamChange(yaws=-yaws),
        )


class BeamDensity:
    """Log densities of range readings under H ways to read a log.

    Parameters
    ----------
    beams : QuickBeams
        The readings.
    ways : sequence of ReadAs
        The ways to read them.
    """

    def __init__(self, beams: QuickBeams, ways: Sequence[ReadAs]) -> None:
        self.beams = beams
        self.vertices, self.wall_start, self.wall_stop = beams.walls.vertices_and_edges()
        changes: list[BeamChange] = [way.change or _AS_IT_IS for way in ways]
        self.range_factor = np.array([change.range_factor for change in changes])
        self.max_range = beams.max_range * np.array([change.max_range_factor for change in changes])
        self.zero_is_nothing = np.array([change.zero_is_nothing for change in changes])
        self.poses = np.stack([beams.poses] * len(changes))
        for poses, change in zip(self.poses, changes, strict=True):
            poses[:, 2] = poses[:, 2] if change.yaws is None else change.yaws
        self.inverse = np.stack([np.linalg.inv(way.map_matrix) for way in ways])
        self.shift = np.stack([way.map_shift for way in ways])
        self.scale = np.sqrt([abs(np.linalg.det(way.map_matrix)) for way in ways])
        # A similarity turns direction a into base + a, a reflection into base - a.
        self.hand = np.array([math.copysign(1.0, np.linalg.det(way.map_matrix)) for way in ways])
        self.base = np.array([math.atan2(way.map_matrix[1, 0], way.map_matrix[0, 0]) for way in ways])
        measured = beams.ranges[~np.isnan(beams.ranges)]
        self.zero_share = float(np.clip(np.mean(measured == 0.0), 1e-3, 1.0 - 1e-3)) if measured.size else 0.5

    def __call__(self, row: int, way: Int, level: Float, x: Float, y: Float, heading: Float) -> Float:
        """Return the log density of the readings of a row; see :class:`pmcl.models.quick.QuickDensity`."""
        beam = self.beams.measured(row)
        if not beam.size:
            return np.zeros_like(x)
        return self.of(beam, self.beams.ranges[row, beam], way, level, x, y, heading)

    def of(self, beam: Int, read: Float, way: Int, level: Float, x: Float, y: Float, heading: Float) -> Float:
        """Return the log density of the readings `read` (b,) of the beams `beam` (b,)."""
        length = self._lengths(beam, way, x, y, heading)
        std = level[:, None, None] * self.beams.noise
        factor, longest = self.range_factor[way, None, None], self.max_range[way, None, None]
        length = np.minimum(length, OPEN_RAY * longest)
        measured = np.where(np.isfinite(read), read, np.inf)[None, :, None] * factor
        nothing = measured >= longest
        zero = (read == 0.0)[None, :, None]
        anything = (1.0 - _NO_ECHO - _ZERO) / longest
        density = factor * mixed(np.where(nothing, longest, measured) - length, std, anything)
        if nothing.any():
            missed = (1.0 - GROSS) * ndtr((length - longest) / std) + _NO_ECHO * GROSS
            width = np.where(np.isfinite(read), self.beams.width_beyond, 1.0)[None, :, None]
            density = np.where(nothing, missed / width, density)
        if zero.any():
            too_near = (1.0 - GROSS) * ndtr(-length / std) + _ZERO * GROSS
            density = np.where(zero, too_near, density)
        result = np.log(density)
        if self.zero_is_nothing[way].any():
            skips = self.zero_is_nothing[way, None, None]
            share = self.zero_share
            result = np.where(skips, np.where(zero, math.log(share), result + math.log1p(-share)), result)
        return np.asarray(result.sum(axis=1))

    def _lengths(self, beam: Int, way: Int, x: Float, y: Float, heading: Float) -> Float:
        """Return the distance [m] to the nearest wall along each beam, (G, b, n), on the map as each way reads it."""
        mount = self.poses[way][:, beam]
        c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
        rays = np.empty((way.size, beam.size, x.shape[1], 3))
        at_x = x[:, None] + c * mount[..., 0, None] - s * mount[..., 1, None] - self.shift[way, 0, None, None]
        at_y = y[:, None] + s * mount[..., 0, None] + c * mount[..., 1, None] - self.shift[way, 1, None, None]
        inverse = self.inverse[way][:, None, None]
        rays[..., 0] = inverse[..., 0, 0] * at_x + inverse[..., 0, 1] * at_y
        rays[..., 1] = inverse[..., 1, 0] * at_x + inverse[..., 1, 1] * at_y
        direction = heading[:, None] + mount[..., 2, None]
        rays[..., 2] = self.hand[way, None, None] * (direction - self.base[way, None, None])
        return cast_rays(self.vertices, self.wall_start, self.wall_stop, rays) * self.scale[way, None, None]


def quick_beams(log: LogArrays, usual: Mapping[str, float]) -> QuickBeams | None:
    """Return a log's range readings for a quick filter; None when it has none, or no walls.

    Parameters
    ----------
    log : LogArrays
        The log.
    usual : mapping of str to float
        Usual values of parameters, of which ``sigma_range`` [m] is taken.
    """
    if log.ranges is None or log.beam_poses is None or log.walls is None:
        return None
    return QuickBeams(log.ranges, log.beam_poses, log, usual.get("sigma_range", math.nan))


def _width_beyond(ranges: Float, max_range: float) -> float:
    """Return over how many metres readings beyond max_range spread.

    Sensors mark "no echo" by one number, which has no width (1). Numbers that differ are readings in truth, and cost
    the density of a number.
    """
    finite = ranges[np.isfinite(ranges)]
    beyond = finite[finite > max_range]
    return float(beyond.max()) if np.unique(beyond).size > 1 else 1.0
