"""Exact ray casting against wall segments, the one place where rays are cast.

A ray from p along d meets the line of the wall a-b at distance cross(a - p, b - a) / cross(d, b - a); it meets the
wall itself when a and b lie on different sides of the ray, that is when cross(a, d) - cross(p, d) and
cross(b, d) - cross(p, d) differ in sign or vanish. The side of a corner is computed by the same operations, rounded as
written, for every wall that ends there, so no ray slips between two walls; the difference of two sides is the
divisor. The inner loops run over rays.

A wall that is seen exactly edge-on has no width and is not hit, unless another wall meets its end.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmcl.filtering.kernels.compile import entry, kernel

__all__ = ["cast_rays", "inverse_lengths", "wall_numerators"]

Float = NDArray[np.float64]


@kernel
def wall_numerators(vertices, wall_start, wall_stop, x, y, inverse):
    """Write 1 / cross(a - p, b - a) for each wall (row) and ray origin (column) into `inverse` (W, n)."""
    for w in range(wall_start.size):
        ax, ay = vertices[wall_start[w], 0], vertices[wall_start[w], 1]
        ex, ey = vertices[wall_stop[w], 0] - ax, vertices[wall_stop[w], 1] - ay
        constant = ax * ey - ay * ex
        row = inverse[w]
        for i in range(x.size):
            row[i] = 1.0 / (constant - (x[i] * ey - y[i] * ex))


@kernel(strict=True)
def inverse_lengths(vertices, wall_start, wall_stop, x, y, dx, dy, inverse, moment, best):
    """Write 1 / length of each ray into `best` (n,); 0 where the ray meets no wall.

    Parameters
    ----------
    vertices, wall_start, wall_stop : ndarray
        The map, see :class:`~pmcl.models.tables.RangeBeams`.
    x, y, dx, dy : ndarray, shape (n,)
        Origins [m] and unit directions in the map frame.
    inverse : ndarray, shape (W, n)
        From :func:`wall_numerators`.
    moment : ndarray, shape (n,)
        Work space.
    best : ndarray, shape (n,)
        The result [1/m].
    """
    n = x.size
    n_walls = wall_start.size
    for i in range(n):
        moment[i] = x[i] * dy[i] - y[i] * dx[i]
        best[i] = 0.0 if moment[i] < np.inf else np.nan  # a ray that is no number has no length
    w = 0
    while w < n_walls:
        ax, ay = vertices[wall_start[w], 0], vertices[wall_start[w], 1]
        bx, by = vertices[wall_stop[w], 0], vertices[wall_stop[w], 1]
        first = inverse[w]
        chained = w + 2 < n_walls and wall_stop[w] == wall_start[w + 1] and wall_stop[w + 1] == wall_start[w + 2]
        if chained:
            # Three walls in a row: four corners and one pass over the rays, which is bound by memory traffic.
            cx, cy = vertices[wall_stop[w + 1], 0], vertices[wall_stop[w + 1], 1]
            ex, ey = vertices[wall_stop[w + 2], 0], vertices[wall_stop[w + 2], 1]
            second, third = inverse[w + 1], inverse[w + 2]
            for i in range(n):
                a = (ax * dy[i] - ay * dx[i]) - moment[i]
                b = (bx * dy[i] - by * dx[i]) - moment[i]
                c = (cx * dy[i] - cy * dx[i]) - moment[i]
                e = (ex * dy[i] - ey * dx[i]) - moment[i]
                value = best[i]
                trial = (a - b) * first[i]
                value = trial if (a * b <= 0.0) & (trial > value) else value
                trial = (b - c) * second[i]
                value = trial if (b * c <= 0.0) & (trial > value) else value
                trial = (c - e) * third[i]
                best[i] = trial if (c * e <= 0.0) & (trial > value) else value
            w += 3
        else:
            for i in range(n):
                a = (ax * dy[i] - ay * dx[i]) - moment[i]
                b = (bx * dy[i] - by * dx[i]) - moment[i]
                trial = (a - b) * first[i]
                best[i] = trial if (a * b <= 0.0) & (trial > best[i]) else best[i]
            w += 1


@entry
def _cast(vertices, wall_start, wall_stop, x, y, dx, dy):
    n = x.size
    inverse, moment, best = np.empty((wall_start.size, n)), np.empty(n), np.empty(n)
    wall_numerators(vertices, wall_start, wall_stop, x, y, inverse)
    inverse_lengths(vertices, wall_start, wall_stop, x, y, dx, dy, inverse, moment, best)
    return 1.0 / best


def cast_rays(vertices: Float, wall_start: NDArray[np.int64], wall_stop: NDArray[np.int64], poses: Float) -> Float:
    """Return the distance from each pose along its heading to the nearest wall.

    Parameters
    ----------
    vertices : ndarray, shape (V, 2)
        Wall end points [m].
    wall_start, wall_stop : ndarray of int, shape (W,)
        Indices of each wall's end points.
    poses : ndarray, shape (..., 3)
        Origin [m, m] and direction [rad] of each ray in the map frame.

    Returns
    -------
    ndarray, shape (...,)
        Lengths [m]; inf where no wall is met. Cost: O(rays * (V + W)).
    """
    flat = np.ascontiguousarray(np.asarray(poses, dtype=float).reshape(-1, 3).T)
    with np.errstate(divide="ignore"):
        lengths = _cast(
            np.ascontiguousarray(vertices, dtype=float),
            np.ascontiguousarray(wall_start, dtype=np.int64),
            np.ascontiguousarray(wall_stop, dtype=np.int64),
            flat[0].copy(),
            flat[1].copy(),
            np.cos(flat[2]),
            np.sin(flat[2]),
        )
    return np.asarray(lengths).reshape(np.shape(poses)[:-1])
