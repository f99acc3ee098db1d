"""Places on the floor at which an effect may be: a coarse grid over the map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import stats

from pmcl.logs.robot_log import RobotLog
from pmcl.maps.occupancy_grid import FREE, OccupancyGrid
from pmcl.models.effects.effect import Effect, Where
from pmcl.models.part import Float

__all__ = ["at_place", "cell_size", "floor_places", "has_floor"]

# Cells along the longer side of the map (chosen by hand).
_CELLS = 4
# Rows and columns of a grid map that are looked at, and the least floor of a cell relative to the one that has most: a
# robot that drives in a corner of a cell only shows little of an effect there.
_LOOKED_AT, _LEAST_FLOOR = 200, 0.1


def has_floor(log: RobotLog) -> bool:
    """Return whether the log has a map, and with it a floor of known extent."""
    return log.walls is not None or log.landmarks is not None or _free_bounds(log) is not None


def _free_bounds(log: RobotLog) -> tuple[float, float, float, float] | None:
    return None if log.grid_map is None else log.grid_map.free_bounds


def _bounds(log: RobotLog) -> tuple[float, float, float, float]:
    if log.walls is not None:
        return log.walls.bounds
    free = _free_bounds(log)
    if free is not None:
        return free
    assert log.landmarks is not None
    return log.landmarks.bounds


def cell_size(log: RobotLog) -> float:
    """Return the side of a cell of the grid [m]."""
    x_low, x_high, y_low, y_high = _bounds(log)
    return max(x_high - x_low, y_high - y_low, 1e-3) / _CELLS


def floor_places(log: RobotLog) -> list[Where]:
    """Return the centres of the grid's cells that lie on the floor, as ``{"place": (x, y)}`` [m]."""
    x_low, x_high, y_low, y_high = _bounds(log)
    side = cell_size(log)
    across = [max(1, round((high - low) / side)) for low, high in ((x_low, x_high), (y_low, y_high))]
    x, y = (
        low + (np.arange(n) + 0.5) * (high - low) / n
        for low, high, n in zip((x_low, y_low), (x_high, y_high), across, strict=True)
    )
    centres: Float = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    if log.walls is not None and log.walls.is_closed:
        centres = centres[log.walls.contains(centres)]
    elif log.walls is None and log.grid_map is not None and _free_bounds(log) is not None:
        centres = centres[_share_of_floor(log.grid_map, x, y) >= _LEAST_FLOOR]
    return [{"place": (round(float(x), 4), round(float(y), 4))} for x, y in centres]


def _share_of_floor(grid: OccupancyGrid, x: Float, y: Float) -> Float:
    """Return how much of each cell with these centres is free, relative to the one that is free most, (x * y,)."""
    small = grid.coarser(_LOOKED_AT)
    row, column = np.nonzero(small.cells == FREE)
    points = small.from_cells(np.stack((column, row), axis=-1) + 0.5)
    edges = [np.append((c[:-1] + c[1:]) / 2.0, np.inf) for c in (x, y)]
    edges = [np.append(-np.inf, edge) for edge in edges]
    count = np.histogram2d(points[:, 0], points[:, 1], edges)[0].ravel()
    return np.asarray(count / count.max())


def at_place(effect: Effect, log: RobotLog) -> Effect:
    """Return an effect of parameters (strength, x, y, radius) with its disc at the place of the instance.

    The place gives the null of x and y, and the centre of their priors.

    Parameters
    ----------
    effect : Effect
        The instance, whose `where` holds the place.
    log : RobotLog
        The log, whose map gives the grid.
    """
    x, y = (float(value) for value in effect.where["place"])
    side = cell_size(log)
    radius = effect.null[3] * side
    priors = (
        effect.parameters[0].prior,
        stats.norm(loc=x, scale=side),
        stats.norm(loc=y, scale=side),
        stats.gamma(8.0, scale=radius / 8.0),
    )
    parameters = tuple(replace(p, prior=prior) for p, prior in zip(effect.parameters, priors, strict=True))
    typical = {name: (values[0], x, y, radius) for name, values in effect.typical.items()}
    return replace(effect, parameters=parameters, null=(effect.null[0], x, y, radius), typical=typical)
