"""What the kernels need of a grid map, computed once for each map."""

from __future__ import annotations

import math
import weakref
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.maps.occupancy_grid import OCCUPIED, OccupancyGrid
from pmcl.models.part import owned
from pmcl.models.sensors.lidar.kernels.casting import free_squares
from pmcl.models.sensors.lidar.table import LONGEST_DISTANCE

__all__ = ["GridArrays", "grid_arrays"]

Float = NDArray[np.float64]

# Numbers of 16 bits tell so many distances apart. A map has more than these only if its cells are below 4 mm; distances
# are then rounded to 0.03 mm.
_MOST_LEVELS = 1 << 16
_ROWS_AT_ONCE = 64


class GridArrays(NamedTuple):
    """Fields of :class:`~pmcl.models.sensors.lidar.table.LidarTable` that come from the map, with its margin."""

    level_distance: Float
    levels: NDArray[np.uint16]
    squares: NDArray[np.uint8]
    resolution: float
    origin: Float


_known: weakref.WeakKeyDictionary[OccupancyGrid, GridArrays] = weakref.WeakKeyDictionary()


def grid_arrays(grid: OccupancyGrid) -> GridArrays:
    """Return the arrays of a map; a robot asks for those of its map at every time step.

    Parameters
    ----------
    grid : OccupancyGrid
        The map.

    Returns
    -------
    GridArrays
        Cost: O(H W) for a map that is asked for the first time.
    """
    found = _known.get(grid)
    if found is None:
        wide = grid.with_margin(LONGEST_DISTANCE)
        distance, levels = _levels(wide.distance_field, wide.resolution)
        squares = free_squares(np.ascontiguousarray(wide.cells == OCCUPIED))
        found = GridArrays(distance, levels, squares, float(wide.resolution), owned(wide.origin))
        _known[grid] = found
    return found


def _levels(field: Float, resolution: float) -> tuple[Float, NDArray[np.uint16]]:
    """Return the distances that occur, and the number of each cell's, with a border at the longest distance.

    The squares of distances between centres of cells are whole numbers when they are counted in cells, so that a table
    by these numbers tells the level of each cell. The map is gone through row by row: arrays of numbers for all its
    cells would take far more memory than the map.
    """
    rows, columns = field.shape
    # The first square whose distance counts as the longest one.
    beyond = math.ceil((LONGEST_DISTANCE / resolution) ** 2)
    parts = [slice(first, first + _ROWS_AT_ONCE) for first in range(0, rows, _ROWS_AT_ONCE)]
    occurs = np.zeros(beyond + 1, dtype=bool)
    occurs[-1] = True  # in the border
    for part in parts:
        occurs[_squares(field[part], resolution, beyond)] = True
    distance = np.minimum(resolution * np.sqrt(np.flatnonzero(occurs)), LONGEST_DISTANCE)
    level_of_square = np.cumsum(occurs) - 1
    if distance.size > _MOST_LEVELS:
        whole = np.minimum(resolution * np.sqrt(np.arange(beyond + 1)), LONGEST_DISTANCE)
        distance = np.linspace(0.0, LONGEST_DISTANCE, _MOST_LEVELS)
        level_of_square = np.rint(whole / LONGEST_DISTANCE * (_MOST_LEVELS - 1))
    of_square = level_of_square.astype(np.uint16)
    levels = np.full((rows + 2, columns + 2), of_square[-1], dtype=np.uint16)
    for part in parts:
        levels[1:-1, 1:-1][part] = of_square[_squares(field[part], resolution, beyond)]
    return owned(distance), levels


def _squares(distance: Float, resolution: float, beyond: int) -> NDArray[np.int64]:
    """Return squares of distances in cells, no more than `beyond`."""
    return np.minimum(np.rint((distance / resolution) ** 2), beyond).astype(np.int64)
