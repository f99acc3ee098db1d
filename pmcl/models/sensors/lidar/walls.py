"""The straight walls of a grid map: lines through its occupied cells."""

from __future__ import annotations

import weakref
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from pmcl.models.sensors.lidar.geometry import occupied_centres
from pmcl.models.sensors.lidar.table import LidarTable

__all__ = ["Walls", "walls_of"]

Float = NDArray[np.float64]

# Occupied cells that a wall's direction is taken from: about half a metre of it at 5 cm.
_NEIGHBOURS = 9
# They are a wall where their scatter across it is at most this share of that along it (variances).
_MOST_CURVED = 0.15


class Walls:
    """The line through the occupied cells around each occupied cell.

    Parameters
    ----------
    centres : ndarray, shape (N, 2)
        Centres of occupied cells [m].
    """

    def __init__(self, centres: Float) -> None:
        self._tree = KDTree(centres)
        count = min(_NEIGHBOURS, len(centres))
        _, around = self._tree.query(centres, k=count)
        members = centres[np.reshape(around, (len(centres), count))]
        middle = members.mean(axis=1)
        spread = members - middle[:, None]
        variance, axes = np.linalg.eigh(np.einsum("kni,knj->kij", spread, spread) / count)
        self._normal = axes[:, :, 0]
        self._straight = (variance[:, 0] <= _MOST_CURVED * variance[:, 1]) & (count > 2)
        self._offset = np.einsum("ki,ki->k", self._normal, middle)

    def next_to(self, points: Float) -> tuple[Float, Float, NDArray[np.bool_]]:
        """Return the straight wall next to each point.

        Parameters
        ----------
        points : ndarray, shape (M, 2)
            Points [m].

        Returns
        -------
        normal : ndarray, shape (M, 2)
            Unit normal, of either sign.
        offset : ndarray, shape (M,)
            Distance of the wall from the origin along the normal [m].
        straight : ndarray of bool, shape (M,)
            Whether the occupied cells there lie along a line.
        """
        _, nearest = self._tree.query(points)
        return self._normal[nearest], self._offset[nearest], self._straight[nearest]


# An array cannot be a key: its place in memory is, as long as it lives.
_known: dict[int, tuple[weakref.ref[Any], Walls]] = {}


def walls_of(table: LidarTable) -> Walls:
    """Return the walls of a table's map; those of a map that is asked for again are kept."""
    squares = table.squares
    found = _known.get(id(squares))
    if found is not None and found[0]() is squares:
        return found[1]
    walls = Walls(occupied_centres(table))
    _known[id(squares)] = weakref.ref(squares, partial(_forget, id(squares))), walls
    return walls


def _forget(key: int, _: Any) -> None:
    _known.pop(key, None)
