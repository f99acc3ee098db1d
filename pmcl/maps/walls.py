"""Segment maps: the straight walls that range beams hit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmcl.errors import MapError
from pmcl.maps.arrays import coordinates

__all__ = ["WallMap"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# Wall ends that differ by less are one corner: far below any sensor, far above rounding in the coordinates [m].
_CORNER_DECIMALS = 9


@dataclass(frozen=True, eq=False)
class WallMap:
    """Straight walls, in no particular order.

    Attributes
    ----------
    segments : ndarray, shape (W, 2, 2)
        Both ends (x, y) of each wall [m], world frame; read-only.

    Raises
    ------
    MapError
        When there is no wall, a coordinate is not a finite number, a wall has no length, or the shape is wrong.
    """

    segments: Float

    def __post_init__(self) -> None:
        segments = coordinates(self.segments, "walls", "(W, 2, 2): wall, end, xy", (2, 2))
        length = np.hypot(*(segments[:, 1] - segments[:, 0]).T)
        if not length.all():
            k = int(np.argmin(length))
            raise MapError(
                f"expected walls of positive length, got both ends at {_point(segments[k, 0])} in wall {k}: remove it"
            )
        object.__setattr__(self, "segments", segments)

    @classmethod
    def from_polygon(cls, vertices: ArrayLike) -> WallMap:
        """Build the closed outline through corners: the last corner is joined to the first.

        Parameters
        ----------
        vertices : array_like, shape (V, 2)
            Corners [m], world frame, V >= 3, in either direction of travel.

        Returns
        -------
        WallMap
            V walls; wall k runs from corner k to corner k + 1.

        Raises
        ------
        MapError
            When there are fewer than three corners, or the walls are not valid.
        """
        corners = coordinates(vertices, "polygon", "(V, 2): corner, xy", (2,))
        if len(corners) < 3:
            raise MapError(f"expected a polygon of at least 3 corners, got {len(corners)}: list every corner once")
        return cls(np.stack((corners, np.roll(corners, -1, axis=0)), axis=1))

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Bounding box (xmin, xmax, ymin, ymax) [m]."""
        low, high = self.segments.min(axis=(0, 1)), self.segments.max(axis=(0, 1))
        return float(low[0]), float(high[0]), float(low[1]), float(high[1])

    @cached_property
    def is_closed(self) -> bool:
        """Whether the walls separate inside from outside: an even number of them meets at every corner."""
        _, start, stop = self.vertices_and_edges()
        return not (np.bincount(np.concatenate((start, stop))) % 2).any()

    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Tell which points lie inside the walls, by the even-odd rule.

        Meaningful when :attr:`is_closed`; obstacles drawn inside a room count as outside. A point exactly on a wall
        may fall on either side. Costs O(W) passes over the points.

        Parameters
        ----------
        points : array_like, shape (..., 2)
            Points (x, y) [m], world frame; further columns (a heading) are ignored.

        Returns
        -------
        ndarray of bool, shape (...)
            True inside. A point with a NaN coordinate is outside.

        Raises
        ------
        MapError
            When the last axis holds fewer than two coordinates.
        """
        points = np.asarray(points, dtype=np.float64)
        if points.ndim == 0 or points.shape[-1] < 2:
            raise MapError(f"expected points of shape (..., 2), got {points.shape}: give x and y on the last axis")
        x, y = points[..., 0], points[..., 1]
        inside = np.zeros(x.shape, dtype=bool)
        for (x1, y1), (x2, y2) in self.segments:
            # The half-open comparison counts a ray through a corner once, not twice; it also leaves out level walls.
            if y1 != y2:
                inside ^= ((y1 > y) != (y2 > y)) & (x < x1 + (y - y1) * ((x2 - x1) / (y2 - y1)))
        return inside

    def vertices_and_edges(self) -> tuple[Float, Int, Int]:
        """Share corners: what a ray caster works on.

        Returns
        -------
        vertices : ndarray, shape (V, 2)
            Distinct wall ends [m]; ends closer than a nanometre are one.
        start, stop : ndarray of int, shape (W,)
            Wall w runs from ``vertices[start[w]]`` to ``vertices[stop[w]]``.
        """
        vertices, start, stop = self._edges
        return vertices.copy(), start.copy(), stop.copy()

    @cached_property
    def _edges(self) -> tuple[Float, Int, Int]:
        ends = self.segments.reshape(-1, 2)
        # Adding zero turns -0.0 into 0.0; keeping the first spelling returns coordinates as they were given.
        rounded = np.round(ends, _CORNER_DECIMALS) + 0.0
        _, first, index = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
        edges = index.reshape(-1, 2).astype(np.int64)
        return ends[first], edges[:, 0], edges[:, 1]


def _point(xy: Float) -> str:
    return f"({xy[0]:g}, {xy[1]:g}) m"
