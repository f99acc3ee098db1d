"""What the kernels need of a grid map, computed once for each map."""

from __future__ import annotations

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
        Cost: O(H W log(H W)) for a map that is asked for the first time.
    """
    found = _known.get(grid)
    if found is None:
        wide = grid.with_margin(LONGEST_DISTANCE)
        distance, levels = _levels(np.minimum(wide.distance_field, LONGEST_DISTANCE))
        squares = free_squares(np.ascontiguousarray(wide.cells == OCCUPIED))
        found = GridArrays(distance, levels, squares, float(wide.resolution), owned(wide.origin))
        _known[grid] = found
    return found


def _levels(field: Float) -> tuple[Float, NDArray[np.uint16]]:
    """Return the distances that occur, and the number of each cell's, with a border at the longest distance."""
    padded = np.pad(field, 1, constant_values=LONGEST_DISTANCE)
    distance, levels = np.unique(padded, return_inverse=True)
    if distance.size > _MOST_LEVELS:
        distance = np.linspace(0.0, LONGEST_DISTANCE, _MOST_LEVELS)
        levels = np.rint(padded / LONGEST_DISTANCE * (_MOST_LEVELS - 1))
    return owned(distance), np.ascontiguousarray(levels.reshape(padded.shape).astype(np.uint16))
