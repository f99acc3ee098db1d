"""Densities of readings under each way to read a log, for many particles at once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from pmcl.logs.arrays import LogArrays
from pmcl.models.sensors.range_beams.kernels.rays import cast_rays
from pmcl.models.sensors.range_beams.table import OPEN_RAY
from pmcl.preflight.hypotheses import Hypothesis
from pmcl.preflight.stretch import RowReadings

__all__ = ["Noise", "Sensors", "width_beyond"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# Share of readings that may be anything: it bounds what a single reading can say against an explanation.
_GROSS = 0.05
# What gross readings of a beam are: no echo, zero, or else anything in between.
_NO_ECHO, _ZERO = 0.5, 0.02
_ROOT_2PI = math.sqrt(2.0 * math.pi)


class Noise(NamedTuple):
    """Typical standard deviations, which the levels multiply.

    Attributes
    ----------
    motion : ndarray, shape (3,)
        Of one increment: forward, left, turn [m, m, rad].
    beam, range, bearing, size : float
        Of readings of beams [m] and of landmarks [m, rad, 1].
    """

    motion: Float
    beam: float
    range: float
    bearing: float
    size: float


class Sensors:
    """What a log's readings mean under each way to read it.

    Parameters
    ----------
    log : LogArrays
        The log.
    ways : sequence of Hypothesis
        H ways to read it.
    noise : Noise
        Typical noise.
    """

    def __init__(self, log: LogArrays, ways: Sequence[Hypothesis], noise: Noise) -> None:
        self.noise = noise
        self.range_factor = np.array([way.range_factor for way in ways])
        self.bearing_factor = np.array([way.bearing_factor for way in ways])
        self.bearing_from_map = np.array([way.bearing_from_map for way in ways])
        self.sensor_pose = log.landmark_sensor_pose
        if log.landmarks is not None:
            positions = log.landmarks.positions
            self.positions = np.stack([positions @ way.map_matrix.T + way.map_shift for way in ways])
            extent = np.hypot(*np.ptp(self.positions, axis=1).T)
            longest = 0.0 if log.landmark_range is None else np.nanmax(log.landmark_range, initial=0.0)
            self.longest_sighting = np.maximum(extent, longest * self.range_factor) + 1e-9
            self.size_constant = log.size_at_one_metre or 1.0
            largest = 0.0 if log.landmark_size is None else np.nanmax(log.landmark_size, initial=0.0)
            self.largest_size = max(self.size_constant, float(largest))
        self.has_beams = log.ranges is not None and log.walls is not None
        if self.has_beams:
            self._take_beams(log, ways)

    def _take_beams(self, log: LogArrays, ways: Sequence[Hypothesis]) -> None:
        assert log.ranges is not None
        assert log.walls is not None
        self.vertices, self.wall_start, self.wall_stop = log.walls.vertices_and_edges()
        self.beam_poses = np.stack([way.beam_poses for way in ways if way.beam_poses is not None])
        self.max_range = log.max_range * np.array([way.max_range_factor for way in ways])
        self.zero_is_nothing = np.array([way.zero_is_nothing for way in ways])
        self.inverse = np.stack([np.linalg.inv(way.map_matrix) for way in ways])
        self.shift = np.stack([way.map_shift for way in ways])
        self.scale = np.sqrt([abs(np.linalg.det(way.map_matrix)) for way in ways])
        # A similarity turns direction a into base + a, a reflection into base - a.
        self.hand = np.array([math.copysign(1.0, np.linalg.det(way.map_matrix)) for way in ways])
        self.base = np.array([math.atan2(way.map_matrix[1, 0], way.map_matrix[0, 0]) for way in ways])
        self.width_beyond = width_beyond(log)
        measured = log.ranges[~np.isnan(log.ranges)]
        self.zero_share = float(np.clip(np.mean(measured == 0.0), 1e-3, 1.0 - 1e-3)) if measured.size else 0.5

    def log_density(self, read: RowReadings, way: Int, level: Float, x: Float, y: Float, heading: Float) -> Float:
        """Return the log density of one row's readings.

        Parameters
        ----------
        read : RowReadings
            The readings.
        way : ndarray of int, shape (G,)
            Which way to read the log each group of particles is of.
        level : ndarray, shape (G,)
            Level of noise of each group.
        x, y, heading : ndarray, shape (G, n)
            The particles.

        Returns
        -------
        ndarray, shape (G, n)
        """
        total = np.zeros_like(x)
        if read.landmark.size:
            total += self._sightings(read, way, level, x, y, heading)
        if read.beam.size and self.has_beams:
            total += self._echoes(read, way, level, x, y, heading)
        return total

    def _sightings(self, read: RowReadings, way: Int, level: Float, x: Float, y: Float, heading: Float) -> Float:
        c, s = np.cos(heading), np.sin(heading)
        ahead, aside, yaw = self.sensor_pose
        sensor_x, sensor_y = x + c * ahead - s * aside, y + s * ahead + c * aside
        total = np.zeros_like(x)
        for j, distance_read, bearing_read, size_read in zip(
            read.landmark.tolist(), read.range.tolist(), read.bearing.tolist(), read.size.tolist(), strict=True
        ):
            dx = self.positions[way, j, 0, None] - sensor_x
            dy = self.positions[way, j, 1, None] - sensor_y
            square = dx * dx + dy * dy
            if not math.isnan(distance_read):
                factor = self.range_factor[way, None]
                residual = distance_read * factor - np.sqrt(square)
                spread = 1.0 / self.longest_sighting[way, None]
                total += np.log(factor * _mixed(residual, level[:, None] * self.noise.range, spread))
            if not math.isnan(bearing_read):
                facing = np.where(self.bearing_from_map[way, None], 0.0, heading + yaw)
                factor = self.bearing_factor[way, None]
                residual = bearing_read * factor - np.arctan2(dy, dx) + facing
                residual -= 2.0 * np.pi * np.round(residual / (2.0 * np.pi))
                density = _mixed(residual, level[:, None] * self.noise.bearing, 0.5 / np.pi)
                total += np.log(np.abs(factor) * density)
            if not math.isnan(size_read):
                per_size = square / self.size_constant
                density = per_size * _gauss(size_read * per_size - 1.0, level[:, None] * self.noise.size)
                total += np.log((1.0 - _GROSS) * density + _GROSS / self.largest_size)
        return total

    def _echoes(self, read: RowReadings, way: Int, level: Float, x: Float, y: Float, heading: Float) -> Float:
        length = self._lengths(read, way, x, y, heading)
        std = level[:, None, None] * self.noise.beam
        factor, longest = self.range_factor[way, None, None], self.max_range[way, None, None]
        length = np.minimum(length, OPEN_RAY * longest)
        measured = np.where(np.isfinite(read.length), read.length, np.inf)[None, :, None] * factor
        nothing = measured >= longest
        zero = (read.length == 0.0)[None, :, None]
        anything = (1.0 - _NO_ECHO - _ZERO) / longest
        density = factor * _mixed(np.where(nothing, longest, measured) - length, std, anything)
        if nothing.any():
            missed = (1.0 - _GROSS) * ndtr((length - longest) / std) + _NO_ECHO * _GROSS
            width = np.where(np.isfinite(read.length), self.width_beyond, 1.0)[None, :, None]
            density = np.where(nothing, missed / width, density)
        if zero.any():
            too_near = (1.0 - _GROSS) * ndtr(-length / std) + _ZERO * _GROSS
            density = np.where(zero, too_near, density)
        result = np.log(density)
        if self.zero_is_nothing[way].any():
            skips = self.zero_is_nothing[way, None, None]
            share = self.zero_share
            result = np.where(skips, np.where(zero, math.log(share), result + math.log1p(-share)), result)
        return np.asarray(result.sum(axis=1))

    def _lengths(self, read: RowReadings, way: Int, x: Float, y: Float, heading: Float) -> Float:
        """Return the distance [m] to the nearest wall along each beam, (G, b, n), on the map as each way reads it."""
        mount = self.beam_poses[way][:, read.beam]
        c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
        rays = np.empty((way.size, read.beam.size, x.shape[1], 3))
        at_x = x[:, None] + c * mount[..., 0, None] - s * mount[..., 1, None] - self.shift[way, 0, None, None]
        at_y = y[:, None] + s * mount[..., 0, None] + c * mount[..., 1, None] - self.shift[way, 1, None, None]
        inverse = self.inverse[way][:, None, None]
        rays[..., 0] = inverse[..., 0, 0] * at_x + inverse[..., 0, 1] * at_y
        rays[..., 1] = inverse[..., 1, 0] * at_x + inverse[..., 1, 1] * at_y
        direction = heading[:, None] + mount[..., 2, None]
        rays[..., 2] = self.hand[way, None, None] * (direction - self.base[way, None, None])
        return cast_rays(self.vertices, self.wall_start, self.wall_stop, rays) * self.scale[way, None, None]


def width_beyond(log: LogArrays) -> float:
    """Return over how many metres readings beyond max_range spread.

    Sensors mark "no echo" by one number, which has no width (1). Numbers that differ are readings in truth, and cost
    the density of a number.
    """
    if log.ranges is None:
        return 1.0
    finite = log.ranges[np.isfinite(log.ranges)]
    beyond = finite[finite > log.max_range]
    return float(beyond.max()) if np.unique(beyond).size > 1 else 1.0


def _gauss(residual: Float, std: Float) -> Float:
    return np.asarray(np.exp(-0.5 * (residual / std) ** 2) / (_ROOT_2PI * std))


def _mixed(residual: Float, std: Float, anything: Float | float) -> Float:
    return (1.0 - _GROSS) * _gauss(residual, std) + _GROSS * anything
