"""Occupancy grids: maps of square cells that are free, occupied or unknown, as lidar robots use them."""

from __future__ import annotations

import hashlib
import math
import os
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from pmcl.checks import check_number, check_type
from pmcl.errors import MapError
from pmcl.maps.arrays import FARTHEST, as_numbers

__all__ = ["FREE", "MOST_CELLS", "OCCUPIED", "RESOLUTIONS", "UNKNOWN", "OccupancyGrid"]

Float = NDArray[np.float64]

FREE, OCCUPIED, UNKNOWN = 0, 1, 2
"""What a cell may be."""

MOST_CELLS = 50_000_000
"""Greatest number of cells. 350 m x 350 m at 5 cm have as many; the distance field of such a grid takes 0.4 GB, and
0.9 GB while it is computed."""

RESOLUTIONS = (1e-3, 10.0)
"""Least and greatest side of a cell [m]: makers of maps write 0.01 to 0.1; in coarser cells no room can be seen."""

# Yaw of the origin beyond one turn is an angle in degrees; the rest is left for rounding [rad].
_ONE_TURN = 2.0 * math.pi + 0.01
# Rows of which distances are computed at a time: a few MB each, however wide the grid.
_CELLS_AT_ONCE = 1 << 20


@dataclass(frozen=True, eq=False, repr=False)
class OccupancyGrid:
    """A map of square cells, in the layout of ``nav_msgs/OccupancyGrid``.

    Attributes
    ----------
    cells : ndarray of uint8, shape (H, W)
        :data:`FREE`, :data:`OCCUPIED` or :data:`UNKNOWN`; read-only. Row 0 is the lowest row of the map, column 0 the
        leftmost one.
    resolution : float
        Side of a cell [m].
    origin : tuple of float
        Pose (x, y, yaw) [m, m, rad] of the outer corner of ``cells[0, 0]`` in the map frame. Columns grow along the x
        axis of that pose, rows along its y axis.
    source : str
        File that it was read from, or a remark.

    Raises
    ------
    MapError
        When a value is out of bounds, no cell is occupied, or there are more than :data:`MOST_CELLS` cells.
    """

    cells: NDArray[np.uint8]
    resolution: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    source: str = ""

    FREE = FREE
    OCCUPIED = OCCUPIED
    UNKNOWN = UNKNOWN

    def __post_init__(self) -> None:
        check_type("source of the grid map", self.source, str, error=MapError, advice="write a text")
        where = self.source
        low, high = RESOLUTIONS
        advice = "write the side of a cell in metres"
        resolution = check_number("resolution", self.resolution, low, high, unit="m", error=MapError,
                                  advice=advice, where=where)  # fmt: skip
        object.__setattr__(self, "resolution", resolution)
        object.__setattr__(self, "origin", _checked_origin(self.origin, where))
        object.__setattr__(self, "cells", _checked_cells(self.cells, where))

    def __repr__(self) -> str:
        rows, columns = self.cells.shape
        return f"<OccupancyGrid of {columns} x {rows} cells of {self.resolution:g} m, from {self.source or 'arrays'}>"

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what is computed from the cells: it is larger than they are."""
        return {name: self.__dict__[name] for name in ("cells", "resolution", "origin", "source")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take the fields; pickling forgets that the cells are read-only."""
        self.__dict__.update(state)
        self.cells.flags.writeable = False

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> OccupancyGrid:
        """Read a map_server pair: a YAML file and the image that it names.

        Parameters
        ----------
        path : path
            The YAML file. The image must lie in its folder or below.

        Returns
        -------
        OccupancyGrid

        Raises
        ------
        MapError
            When a file is missing, damaged or too large, or does not say what map_server needs.

        See Also
        --------
        pmcl.maps.map_server.read_map : The same function, with the rules by which pixels become cells.
        """
        from pmcl.maps.map_server import read_map

        return read_map(path)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write a map_server pair: a YAML file, and beside it a PGM image of the same name.

        Reading the pair gives the same cells, resolution and origin.

        Parameters
        ----------
        path : path
            The YAML file, with the ending ``.yaml`` or ``.yml``; replaced when it exists, like the image.

        Raises
        ------
        MapError
            When the files cannot be written.
        """
        from pmcl.maps.map_server import write_map

        write_map(self, path)

    @property
    def size(self) -> tuple[float, float]:
        """Width and height [m] along the axes of the grid."""
        rows, columns = self.cells.shape
        return columns * self.resolution, rows * self.resolution

    @cached_property
    def bounds(self) -> tuple[float, float, float, float]:
        """Bounding box (xmin, xmax, ymin, ymax) of all cells in the map frame [m]."""
        rows, columns = self.cells.shape
        corners = self.from_cells(np.array([[0, 0], [columns, 0], [0, rows], [columns, rows]]))
        low, high = corners.min(axis=0), corners.max(axis=0)
        return float(low[0]), float(high[0]), float(low[1]), float(high[1])

    @cached_property
    def free_bounds(self) -> tuple[float, float, float, float] | None:
        """Box (xmin, xmax, ymin, ymax) around the free cells in the map frame [m]; None when no cell is free."""
        free = self.cells == FREE
        rows, columns = (np.flatnonzero(free.any(axis=axis)) for axis in (1, 0))
        if not rows.size:
            return None
        corners = [(u, v) for u in (columns[0], columns[-1] + 1) for v in (rows[0], rows[-1] + 1)]
        points = self.from_cells(np.array(corners))
        low, high = points.min(axis=0), points.max(axis=0)
        return float(low[0]), float(high[0]), float(low[1]), float(high[1])

    @cached_property
    def distance_field(self) -> Float:
        """Euclidean distance [m] from each cell's centre to the centre of the nearest occupied cell, (H, W).

        Zero in occupied cells; exact. Computed when it is first asked for, in O(H W), and kept; read-only.
        """
        nearest = ndimage.distance_transform_edt(
            self.cells != OCCUPIED, return_distances=False, return_indices=True
        )
        rows, columns = self.cells.shape
        field = np.empty((rows, columns))
        step = max(1, _CELLS_AT_ONCE // columns)
        column = np.arange(columns)
        for first in range(0, rows, step):
            part = slice(first, first + step)
            row = np.arange(rows)[part, None]
            field[part] = np.hypot(nearest[0, part] - row, nearest[1, part] - column)
        field *= self.resolution
        field.flags.writeable = False
        return field

    def to_cells(self, points: ArrayLike) -> Float:
        """Return where points of the map frame lie in the grid.

        Parameters
        ----------
        points : array_like, shape (..., 2)
            Points (x, y) [m], map frame; further columns (a heading) are ignored.

        Returns
        -------
        ndarray, shape (..., 2)
            (column, row) in units of cells from the outer corner of ``cells[0, 0]``: rounded down, it is the cell
            that the point lies in, ``cells[row, column]``; the centre of that cell is at (column + 0.5, row + 0.5).
            Points outside the grid get coordinates outside ``[0, W] x [0, H]``.

        Raises
        ------
        MapError
            When the last axis holds fewer than two coordinates.
        """
        xy = _pairs(points)
        x0, y0, yaw = self.origin
        dx, dy = xy[..., 0] - x0, xy[..., 1] - y0
        cosine, sine = math.cos(yaw), math.sin(yaw)
        cells: Float = np.stack((cosine * dx + sine * dy, cosine * dy - sine * dx), axis=-1) / self.resolution
        return cells

    def from_cells(self, cells: ArrayLike) -> Float:
        """Return the points of the map frame at coordinates in the grid: the inverse of :meth:`to_cells`.

        Parameters
        ----------
        cells : array_like, shape (..., 2)
            (column, row) in units of cells from the outer corner of ``cells[0, 0]``.

        Returns
        -------
        ndarray, shape (..., 2)
            Points (x, y) [m], map frame.

        Raises
        ------
        MapError
            When the last axis holds fewer than two coordinates.
        """
        u, v = np.moveaxis(_pairs(cells)[..., :2] * self.resolution, -1, 0)
        x0, y0, yaw = self.origin
        cosine, sine = math.cos(yaw), math.sin(yaw)
        return np.stack((x0 + cosine * u - sine * v, y0 + sine * u + cosine * v), axis=-1)

    def state_at(self, points: ArrayLike) -> NDArray[np.uint8]:
        """Return what the cells are in which points lie.

        Parameters
        ----------
        points : array_like, shape (..., 2)
            Points (x, y) [m], map frame; further columns (a heading) are ignored.

        Returns
        -------
        ndarray of uint8, shape (...)
            :data:`UNKNOWN` outside the grid and for NaN.

        Raises
        ------
        MapError
            When the last axis holds fewer than two coordinates.
        """
        rows, columns = self.cells.shape
        column, row = np.moveaxis(self.to_cells(points), -1, 0)
        inside = (column >= 0.0) & (column < columns) & (row >= 0.0) & (row < rows)
        at = np.where(inside, row, 0.0).astype(np.int64), np.where(inside, column, 0.0).astype(np.int64)
        return np.asarray(np.where(inside, self.cells[at], UNKNOWN), dtype=np.uint8)

    def coarser(self, most: int) -> OccupancyGrid:
        """Return the map with larger cells, for pictures.

        Parameters
        ----------
        most : int
            Greatest number of rows and of columns; more stay only where cells would be too large for a map.

        Returns
        -------
        OccupancyGrid
            The grid itself when it has no more. Else squares of cells become one cell each: occupied where one of them
            is, else free where one is, else unknown. Cells beyond the last row and column count as unknown.
        """
        rows, columns = self.cells.shape
        k = min(-(-max(rows, columns) // most), int(RESOLUTIONS[1] / self.resolution))
        if k == 1:
            return self
        # In the order of their weight: unknown, free, occupied.
        rank = np.array([1, 2, 0], dtype=np.uint8)[self.cells]
        rank = np.pad(rank, ((0, -rows % k), (0, -columns % k)))
        rank = rank.reshape(rank.shape[0] // k, k, rank.shape[1] // k, k).max(axis=(1, 3))
        cells = np.array([UNKNOWN, FREE, OCCUPIED], dtype=np.uint8)[rank]
        return OccupancyGrid(cells, k * self.resolution, self.origin, self.source)

    def with_margin(self, width: float) -> OccupancyGrid:
        """Return the map with unknown cells all round.

        Parameters
        ----------
        width : float
            Least width of the margin [m], not negative.

        Returns
        -------
        OccupancyGrid
            The same cells at the same places, so that the distance field goes on beyond the map's edge.
        """
        k = math.ceil(width / self.resolution)
        # The map's corner has these coordinates in the larger grid; its own axes may be turned.
        x, y = self.from_cells(np.array([-k, -k], dtype=np.float64))
        cells = np.pad(self.cells, k, constant_values=UNKNOWN)
        return OccupancyGrid(cells, self.resolution, (float(x), float(y), self.origin[2]), self.source)

    def fingerprint(self) -> str:
        """Return the SHA-256 of cells, resolution and origin, in hexadecimal; the source does not count."""
        return self._fingerprint

    @cached_property
    def _fingerprint(self) -> str:
        numbers = np.array([self.resolution, *self.origin]) + 0.0
        digest = hashlib.sha256(f"grid{self.cells.shape}".encode() + numbers.astype("<f8").tobytes())
        digest.update(self.cells.data)
        return digest.hexdigest()


def _pairs(points: ArrayLike) -> Float:
    xy = np.asarray(points, dtype=np.float64)
    if xy.ndim == 0 or xy.shape[-1] < 2:
        raise MapError(f"expected points of shape (..., 2), got {xy.shape}: give two coordinates on the last axis")
    return xy


def _checked_origin(origin: Any, where: str) -> tuple[float, float, float]:
    place = f"{where}: " if where else ""
    expected = f"{place}expected the origin as three finite numbers (x [m], y [m], yaw [rad])"
    try:
        values = as_numbers(origin)
    except TypeError as problem:
        raise MapError(f"{expected}, got {problem}: correct it") from None
    if values.shape != (3,):
        raise MapError(f"{expected}, got shape {values.shape}: correct it")
    x, y, yaw = (float(value) for value in values)
    if not np.isfinite(values).all() or max(abs(x), abs(y)) > FARTHEST:
        raise MapError(f"{expected}, got ({x:g}, {y:g}, {yaw:g}): correct it")
    if abs(yaw) > _ONE_TURN:
        raise MapError(f"{place}expected the origin's yaw within one turn, got {yaw:g} rad: convert degrees to radians")
    return x, y, yaw


def _checked_cells(cells: Any, where: str) -> NDArray[np.uint8]:
    place = f"{where}: " if where else ""
    array = np.asarray(cells)
    if array.ndim != 2 or array.size == 0:
        raise MapError(f"{place}expected cells of shape (rows, columns), got shape {array.shape}: rearrange them")
    if array.size > MOST_CELLS:
        raise MapError(
            f"{place}expected at most {MOST_CELLS} cells, got {array.shape[1]} x {array.shape[0]}: "
            "cut the map, or make its cells larger"
        )
    if array.dtype.kind not in "iu" or array.min() < FREE or array.max() > UNKNOWN:
        raise MapError(
            f"{place}expected cells {FREE} (free), {OCCUPIED} (occupied) or {UNKNOWN} (unknown) as whole numbers, got "
            f"others (type {array.dtype}): translate them"
        )
    if not (array == OCCUPIED).any():
        unknown = float(np.mean(array == UNKNOWN))
        raise MapError(
            f"{place}expected at least one occupied cell, got none ({unknown:.0%} of {array.shape[1]} x "
            f"{array.shape[0]} cells are unknown): check thresholds, negate and the image"
        )
    # Cells that nobody else can write are kept as they are: a grid is shared by many logs.
    array = np.array(array, dtype=np.uint8, order="C", copy=True if array.flags.writeable else None)
    array.flags.writeable = False
    return array
