"""Draws of lidar scans along a path: independent beams, whatever exponent their densities have."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmcl.models.sensors.lidar.along_path import incidence
from pmcl.models.sensors.lidar.geometry import lengths_along
from pmcl.models.sensors.lidar.table import BEAM, OPEN_RAY, LidarExtras, LidarTable

__all__ = ["simulate"]

Float = NDArray[np.float64]

# Walls met more slantingly than this (cosine of the incidence) scatter readings as if it were this.
_LEAST_COSINE = 0.2


def simulate(table: LidarTable, path: Float, rng: np.random.Generator) -> LidarTable:
    """Draw readings along a path (T, >= 3); see :meth:`pmcl.models.sensor.Sensor.simulate`.

    Under the likelihood field a hit ends at a distance from the wall that is Gaussian, and every reading has an echo.
    """
    shape = table.reading.shape
    poses = path.copy()
    if isinstance(table.extras, LidarExtras):
        step = np.diff(path, axis=0, prepend=path[:1])
        poses = path - table.extras.lag[: len(path), None] * step
    expected = np.clip(table.scale * lengths_along(table, poses) + table.bias, 1e-3, OPEN_RAY * table.max_range)
    std = np.broadcast_to(table.std, shape)
    if table.model != BEAM:
        # The likelihood field rounds where a reading ends to a cell; what is drawn here has that noise already.
        std = np.sqrt(np.maximum(std**2 - table.resolution**2 / 12.0, 0.0))
        std = std / np.maximum(np.cos(incidence(table, poses)), _LEAST_COSINE)
    reading = expected + std * rng.standard_normal(shape)
    # A hit is positive: those few that are not are drawn again.
    while (again := reading <= 0.0).any():
        reading[again] = (expected + std * rng.standard_normal(shape))[again]
    component, place = rng.random(shape), rng.random(shape)
    seen = np.minimum(expected, table.max_range)
    short = -np.log1p(place * np.expm1(-table.lambda_short * seen)) / table.lambda_short
    edges = np.cumsum([table.z_short, table.z_max, table.z_rand])
    drawn = [short, np.broadcast_to(table.max_range, shape), place * table.max_range]
    reading = np.select([component < edge for edge in edges], drawn, reading)
    reading = np.minimum(reading, table.max_range)
    return table._replace(reading=np.where(np.isnan(table.reading), np.nan, reading))
