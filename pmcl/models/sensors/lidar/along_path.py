"""What each ray meets along a path: for formulas, and for residuals of readings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmcl.models.sensor import ReadingIndex
from pmcl.models.sensors.lidar.geometry import lengths_along, ray_origins
from pmcl.models.sensors.lidar.table import LidarTable
from pmcl.models.sensors.lidar.walls import walls_of

__all__ = ["along", "covariates", "incidence"]

Float = NDArray[np.float64]


def along(table: LidarTable, path: Float) -> dict[str, Float]:
    """Return what the terms of formulas may know of each ray at each row, (T, R), along a path (T, >= 3).

    ``distance`` [m], ``incidence`` and ``world_direction`` [rad], see :data:`pmcl.models.effects.terms.OF_BEAMS`.
    """
    lengths = lengths_along(table, path)
    return {
        "distance": np.minimum(lengths, table.max_range),
        "incidence": _incidence(table, path, lengths),
        "world_direction": path[:, 2, None] + table.beam_pose[:, 2],
    }


def incidence(table: LidarTable, path: Float) -> Float:
    """Return the angle between each ray and the normal of the wall it meets [rad], (T, R); 0 where there is none."""
    return _incidence(table, path, lengths_along(table, path))


def _incidence(table: LidarTable, path: Float, lengths: Float) -> Float:
    angle = np.zeros(lengths.shape)
    time, ray = np.nonzero(np.isfinite(lengths))
    if time.size:
        origins, directions = ray_origins(table, path)
        direction = directions[time, ray]
        towards = np.column_stack([np.cos(direction), np.sin(direction)])
        points = origins[time, ray] + lengths[time, ray, None] * towards
        normal, _, straight = walls_of(table).next_to(points)
        cosine = np.abs(np.einsum("ki,ki->k", normal, towards))
        angle[time, ray] = np.where(straight, np.arccos(np.minimum(cosine, 1.0)), 0.0)
    return angle


def covariates(table: LidarTable, path: Float, index: ReadingIndex) -> dict[str, Float]:
    """Return distance, direction and incidence of readings; see :meth:`pmcl.models.sensor.Sensor.covariates`."""
    ray = _positions(table, index)
    lengths = lengths_along(table, path)
    return {
        "distance": np.minimum(lengths, table.max_range)[index.time, ray],
        "direction": path[index.time, 2] + table.beam_pose[ray, 2],
        "incidence": _incidence(table, path, lengths)[index.time, ray],
    }


def _positions(table: LidarTable, index: ReadingIndex) -> NDArray[np.int64]:
    """Return the table's ray of each reading."""
    position = np.full((int(table.laser.max()) + 1, int(table.ray.max()) + 1), -1, dtype=np.int64)
    position[table.laser, table.ray] = np.arange(table.ray.size)
    return position[index.kind, index.channel]
