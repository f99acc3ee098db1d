"""Ray lengths and end points of scans along a path."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmcl.models.sensors.lidar.kernels.casting import ray_lengths
from pmcl.models.sensors.lidar.kernels.field import end_levels
from pmcl.models.sensors.lidar.table import LidarTable

__all__ = ["end_points_along", "lengths_along", "occupied_centres", "ray_origins"]

Float = NDArray[np.float64]


def lengths_along(table: LidarTable, path: Float) -> Float:
    """Return the length of each ray [m], (T, R), from poses `path` (T, >= 3); inf beyond the laser's range."""
    return np.asarray(
        ray_lengths(
            table.squares, table.resolution, table.origin, table.beam_pose, table.max_range, np.ascontiguousarray(path)
        )
    )


def end_points_along(table: LidarTable, path: Float) -> NDArray[np.int64]:
    """Return the level at which each reading ends, (T, R), from poses `path` (T, >= 3); -1 without an echo."""
    return np.asarray(
        end_levels(
            table.levels, table.resolution, table.origin, table.beam_pose, table.bias, table.scale, table.max_range,
            table.reading, np.ascontiguousarray(path),
        )
    )  # fmt: skip


def ray_origins(table: LidarTable, path: Float) -> tuple[Float, Float]:
    """Return where each ray begins (T, R, 2) [m] and its direction (T, R) [rad] in the map frame."""
    c, s = np.cos(path[:, 2, None]), np.sin(path[:, 2, None])
    x, y, yaw = table.beam_pose.T
    origins = np.stack([path[:, 0, None] + c * x - s * y, path[:, 1, None] + s * x + c * y], axis=-1)
    return origins, path[:, 2, None] + yaw


def occupied_centres(table: LidarTable) -> Float:
    """Return the centres of those occupied cells that have a neighbour that is not, (N, 2) [m] in the map frame."""
    occupied = table.squares[0] == 0
    padded = np.pad(occupied, 1, constant_values=True)
    inner = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    row, column = np.nonzero(occupied & ~inner)
    x, y = (column + 0.5) * table.resolution, (row + 0.5) * table.resolution
    x0, y0, yaw = table.origin
    c, s = np.cos(yaw), np.sin(yaw)
    return np.column_stack([x0 + c * x - s * y, y0 + s * x + c * y])
