"""Draws of lidar scans along a path.

:func:`simulate` draws each beam by itself, whatever exponent its density has. :func:`replicate` draws scans that are
worth as many independent beams as the exponent says (:mod:`~pmcl.models.sensors.lidar.tempering`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import special

from pmcl.models.sensors.discs import disc_lengths
from pmcl.models.sensors.lidar.along_path import incidence
from pmcl.models.sensors.lidar.geometry import lengths_along, ray_origins
from pmcl.models.sensors.lidar.table import BEAM, OPEN_RAY, LidarExtras, LidarTable

__all__ = ["replicate", "simulate"]

Float = NDArray[np.float64]

# Walls met more slantingly than this (cosine of the incidence) scatter readings as if it were this.
_LEAST_COSINE = 0.2


def simulate(table: LidarTable, path: Float, rng: np.random.Generator) -> LidarTable:
    """Draw readings along a path (T, >= 3); see :meth:`pmcl.models.sensor.Sensor.simulate`.

    Under the likelihood field a hit ends at a distance from the wall that is Gaussian, and every reading has an echo.
    """
    shape = table.reading.shape
    return _drawn(table, path, lambda: rng.standard_normal(shape), lambda: rng.random(shape))


def replicate(table: LidarTable, path: Float, rng: np.random.Generator) -> LidarTable:
    """Draw readings whose errors neighbouring beams share; see :meth:`pmcl.models.sensor.Sensor.replicate`.

    Each reading by itself has the distribution of :func:`simulate`. The normal scores of a scan are correlated from
    beam to beam by a constant factor, so that the mean over a long scan of n beams is as uncertain as that of
    n * exponent independent ones.
    """
    shape = table.reading.shape
    correlation = (1.0 - table.exponent) / (1.0 + table.exponent)
    innovation = np.sqrt(1.0 - correlation**2)
    begins = np.diff(table.laser, prepend=-1) != 0

    def scores() -> Float:
        drawn = rng.standard_normal(shape)
        for ray in np.flatnonzero(~begins):
            drawn[:, ray] = correlation * drawn[:, ray - 1] + innovation * drawn[:, ray]
        return drawn

    return _drawn(table, path, scores, lambda: special.ndtr(scores()))


def _drawn(table: LidarTable, path: Float, scores: Callable[[], Float], shares: Callable[[], Float]) -> LidarTable:
    """Return the table with readings drawn by standard normal numbers and uniform ones, which come as (T, R)."""
    shape = table.reading.shape
    poses = path.copy()
    if isinstance(table.extras, LidarExtras):
        step = np.diff(path, axis=0, prepend=path[:1])
        poses = path - table.extras.lag[: len(path), None] * step
    lengths = lengths_along(table, poses)
    std = np.broadcast_to(table.std, shape)
    if table.model != BEAM:
        # The likelihood field rounds where a reading ends to a cell; what is drawn here has that noise already.
        std = np.sqrt(np.maximum(std**2 - table.resolution**2 / 12.0, 0.0))
        std = std / np.maximum(np.cos(incidence(table, poses)), _LEAST_COSINE)
    if isinstance(table.extras, LidarExtras):
        lengths, std = _with_obstacles(table, table.extras.obstacles, poses, lengths, std, shares)
    expected = np.clip(table.scale * lengths + table.bias, 1e-3, OPEN_RAY * table.max_range)
    reading = expected + std * scores()
    # A hit is positive: those few that are not are drawn again.
    while (again := reading <= 0.0).any():
        reading[again] = (expected + std * scores())[again]
    component, place = shares(), shares()
    seen = np.minimum(expected, table.max_range)
    short = -np.log1p(place * np.expm1(-table.lambda_short * seen)) / table.lambda_short
    edges = np.cumsum([table.z_short, table.z_max, table.z_rand])
    drawn = [short, np.broadcast_to(table.max_range, shape), place * table.max_range]
    reading = np.select([component < edge for edge in edges], drawn, reading)
    reading = np.minimum(reading, table.max_range)
    return table._replace(reading=np.where(np.isnan(table.reading), np.nan, reading))


def _with_obstacles(
    table: LidarTable, obstacles: Float, poses: Float, lengths: Float, std: Float, shares: Callable[[], Float]
) -> tuple[Float, Float]:
    """Return lengths and standard deviations, (T, R), where some rays end at obstacles before their wall."""
    origins, direction = ray_origins(table, poses)
    for x, y, radius, weight in obstacles:
        near = disc_lengths(x - origins[..., 0], y - origins[..., 1], np.cos(direction), np.sin(direction), radius)
        answers = (near < lengths) & (shares() < weight)
        lengths, std = np.where(answers, near, lengths), np.where(answers, table.std, std)
    return lengths, std
