"""Exact ray casting against wall segments, the one place where rays are cast.

A ray from p along d meets the line of the wall a-b at distance cross(a - p, b - a) / cross(d, b - a); it meets the
wall itself when a and b lie on different sides of the ray, that is when cross(a, d) - cross(p, d) and
cross(b, d) - cross(p, d) differ in sign or vanish. The sides are computed once for each vertex, so two walls that share a
corner see the same number and no ray slips between them; the difference of two sides is the divisor. The inner loops run over rays.

A wall that is seen exactly edge-on has no width and is not hit, unless another wall meets its end.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmcl.filtering.kernels.compile import entry, kernel

__all__ = ["cast_rays", "inverse_lengths", "wall_numerators"]

Float = NDArray[np.float64]


@kernel
def wall_numerators(vertices, wall_start, wall_stop, x, y, inverse):  # type: ignore[no-untyped-def]
    """Write 1 / cross(a - p, b - a) for each wall (row) and ray origin (column) into `inverse` (W, n)."""
    for w in range(wall_start.size):
        ax, ay = vertices[wall_start[w], 0], vertices[wall_start[w], 1]
        ex, ey = vertices[wall_stop[w], 0] - ax, vertices[wall_stop[w], 1] - ay
        constant = ax * ey - ay * ex
        row = inverse[w]
        for i in range(x.size):
            row[i] = 1.0 / (constant - (x[i] * ey - y[i] * ex))


@kernel
def inverse_lengths(vertices, wall_start, wall_stop, x, y, dx, dy, inverse, side, best):  # type: ignore[no-untyped-def]
    """Write 1 / length of each ray into `best` (n,); 0 where the ray meets no wall.

    Parameters
    ----------
    vertices, wall_start, wall_stop : ndarray
        The map, see :class:`~pmcl.models.tables.RangeBeams`.
    x, y, dx, dy : ndarray, shape (n,)
        Origins [m] and unit directions in the map frame.
    inverse : ndarray, shape (W, n)
        From :func:`wall_numerators`.
    side : ndarray, shape (V, n)
        Work space.
    best : ndarray, shape (n,)
        The result [1/m].
    """
    n = x.size
    n_vertices, n_walls = vertices.shape[0], wall_start.size
    # Two vertices, then two walls, share one pass over the rays: one is bound by memory traffic, and with three
    # the compiler gives up proving that the arrays are distinct.
    for i in range(n):
        best[i] = x[i] * dy[i] - y[i] * dx[i]
    for v in range(0, n_vertices - 1, 2):
        side_0, side_1 = side[v], side[v + 1]
        x0, y0, x1, y1 = vertices[v, 0], vertices[v, 1], vertices[v + 1, 0], vertices[v + 1, 1]
        for i in range(n):
            side_0[i] = (x0 * dy[i] - y0 * dx[i]) - best[i]
            side_1[i] = (x1 * dy[i] - y1 * dx[i]) - best[i]
    for v in range(n_vertices - n_vertices % 2, n_vertices):
        side_0, x0, y0 = side[v], vertices[v, 0], vertices[v, 1]
        for i in range(n):
            side_0[i] = (x0 * dy[i] - y0 * dx[i]) - best[i]
    for i in range(n):
        best[i] = 0.0
    for w in range(0, n_walls - 1, 2):
        a0, b0, inverse_0 = side[wall_start[w]], side[wall_stop[w]], inverse[w]
        a1, b1, inverse_1 = side[wall_start[w + 1]], side[wall_stop[w + 1]], inverse[w + 1]
        for i in range(n):
            trial = (a0[i] - b0[i]) * inverse_0[i]
            value = best[i]
            value = trial if (a0[i] * b0[i] <= 0.0) & (trial > value) else value
            trial = (a1[i] - b1[i]) * inverse_1[i]
            best[i] = trial if (a1[i] * b1[i] <= 0.0) & (trial > value) else value
    for w in range(n_walls - n_walls % 2, n_walls):
        a0, b0, inverse_0 = side[wall_start[w]], side[wall_stop[w]], inverse[w]
        for i in range(n):
            trial = (a0[i] - b0[i]) * inverse_0[i]
            best[i] = trial if (a0[i] * b0[i] <= 0.0) & (trial > best[i]) else best[i]


@entry
def _cast(vertices, wall_start, wall_stop, x, y, dx, dy):  # type: ignore[no-untyped-def]
    n = x.size
    inverse, side, best = np.empty((wall_start.size, n)), np.empty((vertices.shape[0], n)), np.empty(n)
    wall_numerators(vertices, wall_start, wall_stop, x, y, inverse)
    inverse_lengths(vertices, wall_start, wall_stop, x, y, dx, dy, inverse, side, best)
    return 1.0 / best


def cast_rays(
    vertices: Float, wall_start: NDArray[np.int64], wall_stop: NDArray[np.int64], poses: Float
) -> Float:
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
