"""Beliefs about the first pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pmcl.errors import ModelError
from pmcl.logs.robot_log import RobotLog
from pmcl.maps.occupancy_grid import FREE, OccupancyGrid
from pmcl.models.parameters import Parameter
from pmcl.models.part import Float, Int, owned
from pmcl.models.starts.table import GaussianStart, PoseStart

__all__ = ["StartBelief"]

# How far beyond the outermost landmark a robot may start [m]: landmarks do not enclose the floor as walls do.
_LANDMARK_MARGIN = 2.0


@dataclass(frozen=True)
class StartBelief:
    """Where the robot may be at row 0.

    Attributes
    ----------
    mean, std : tuple of float, optional
        Gaussian belief (x [m], y [m], heading [rad]); an infinite standard deviation of x and y means anywhere on the
        map, of the heading any direction. Taken from the log when left out.
    """

    mean: tuple[float, float, float] | None = None
    std: tuple[float, float, float] | None = None
    parameters: tuple[Parameter, ...] = ()

    def bind(self, log: RobotLog) -> BoundStart:
        """Make the table for one log; raises ModelError for a belief that no density can express."""
        mean = owned(log.start_mean if self.mean is None else self.mean)
        std = owned(log.start_std if self.std is None else self.std)
        if mean.shape != (3,) or std.shape != (3,) or np.isnan(std).any() or (std <= 0.0).any():
            raise ModelError(
                f"{log.where}: the start belief needs three positive standard deviations (inf = unknown), "
                f"but got {std.tolist()}; a robot placed exactly still has, say, 0.001"
            )
        if np.isinf(std[0]) != np.isinf(std[1]):
            raise ModelError(
                f"{log.where}: expected a start that is known in x and y, or in neither, but got the standard "
                f"deviations {std.tolist()}; make both finite, or both inf for anywhere on the map"
            )
        if np.isfinite(std).all():
            return BoundStart(GaussianStart(mean, std))
        return BoundStart(_somewhere(log, np.where(np.isfinite(std), mean, 0.0), std))


@dataclass(frozen=True)
class BoundStart:
    """A start belief with its table; it has no parameters."""

    fixed: GaussianStart | PoseStart

    def table(self, theta: Float) -> GaussianStart | PoseStart:
        """Return the table."""
        return self.fixed

    def statistics(self, table: Any, path: Float, ideal: Any, index: Int, theta: Float) -> None:
        """Nothing: the start does not depend on theta."""
        return


def _somewhere(log: RobotLog, mean: Float, std: Float) -> PoseStart:
    segments = np.empty((0, 4))
    floor, floor_frame = np.empty((0, 0), dtype=np.uint8), np.zeros(5)  # of a grid map
    walls, landmarks, grid_map = log.walls, log.landmarks, log.grid_map
    if walls is not None:
        x_low, x_high, y_low, y_high = walls.bounds
        if walls.is_closed:
            segments = owned(walls.segments.reshape(-1, 4))
    elif grid_map is not None:
        x_low, x_high, y_low, y_high = _free_bounds(grid_map, log.where)
        floor = (grid_map.cells == FREE).astype(np.uint8)
        x, y, yaw = grid_map.origin
        floor_frame = np.array([x, y, np.cos(yaw), np.sin(yaw), grid_map.resolution])
    elif landmarks is not None:
        x_low, x_high, y_low, y_high = landmarks.bounds
        x_low, x_high = x_low - _LANDMARK_MARGIN, x_high + _LANDMARK_MARGIN
        y_low, y_high = y_low - _LANDMARK_MARGIN, y_high + _LANDMARK_MARGIN
    else:
        raise ModelError(
            f"{log.where}: a start anywhere on the map needs a map, but the log has none; give start_mean, start_std"
        )
    area = (x_high - x_low) * (y_high - y_low)
    if floor.size:
        area = float(floor_frame[4]) ** 2 * int(np.count_nonzero(floor))
    if segments.shape[0]:
        # Even-odd area by a fine grid: outlines may be given wall by wall, in any order and direction.
        grid = np.stack(
            np.meshgrid(np.linspace(x_low, x_high, 401)[:-1], np.linspace(y_low, y_high, 401)[:-1], indexing="ij"),
            axis=-1,
        )
        assert walls is not None
        grid += np.array([(x_high - x_low), (y_high - y_low)]) / 800.0
        area *= float(np.mean(walls.contains(grid)))
    log_density = -np.log(area) if np.isinf(std[0]) else 0.0
    log_density -= np.log(2.0 * np.pi) if np.isinf(std[2]) else 0.0
    low, high = np.array([x_low, y_low]), np.array([x_high, y_high])
    return PoseStart(mean, std, low, high, segments, float(log_density), floor, floor_frame)


def _free_bounds(grid: OccupancyGrid, where: str) -> tuple[float, float, float, float]:
    if grid.free_bounds is None:
        raise ModelError(
            f"{where}: a start anywhere on the map needs free cells, but the grid map {grid.source} has none; "
            "check its free_thresh, or give start_mean, start_std"
        )
    return grid.free_bounds
