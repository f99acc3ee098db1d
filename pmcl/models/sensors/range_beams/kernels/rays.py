"""Exact ray casting against wall segments, the one place where rays are cast.

A ray from p along d meets the line of the wall a-b at distance cross(a - p, b - a) / cross(d, b - a); it meets the
wall itself when a and b lie on different sides of the ray, that is when cross(a, d) - cross(p, d) and
cross(b, d) - cross(p, d) differ in sign or vanish. The side of a corner is computed by the same operations, rounded as
written, for every wall that ends there, so no ray slips between two walls; the difference of two sides is the
divisor. The inner loops run over rays.

The rays of one beam lie close together once a filter knows where the robot is. Bounds on their origins and
directions tell which walls none of them can meet; these are left out, which changes no result.

A wall that is seen exactly edge-on has no width and is not hit, unless another wall meets its end.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.compile import entry, kernel
from pmcl.engine.vector_math import extremes

__all__ = ["cast_rays", "hit_cosines", "inverse_lengths", "middle_and_reach", "wall_numerators"]

Float = NDArray[np.float64]

# Of so few rays it takes longer to find out which walls they may meet than to try them all.
_FEW = 32
# Some thousand times the rounding error of the side of a corner, relative to the size of the coordinates.
_SLACK = 1e-12


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


@kernel
def middle_and_reach(values):
    """Return the middle of the interval that holds all `values`, and half its length."""
    low, high = extremes(values)
    return 0.5 * (low + high), 0.5 * (high - low)


@kernel
def _corner_bounds(corner_x, corner_y, bounds):
    """Return side and advance of a corner as the middle ray sees it, and how far other rays' may differ from these."""
    (x, reach_x), (y, reach_y), (c, reach_c), (s, reach_s) = bounds
    u, v = corner_x - x, corner_y - y
    away, spread = abs(u) + abs(v), reach_x + reach_y
    slack = _SLACK * (1.0 + abs(corner_x) + abs(corner_y) + away + spread)
    return u * s - v * c, u * c + v * s, (away + spread) * max(reach_c, reach_s) + spread + slack


@kernel
def _may_be_met(a, b):
    """Return False when both ends of a wall, given as their bounds, lie on one side of all rays or behind them."""
    (side_a, advance_a, reach_a), (side_b, advance_b, reach_b) = a, b
    left = side_a > reach_a and side_b > reach_b
    right = side_a < -reach_a and side_b < -reach_b
    behind = advance_a < -reach_a and advance_b < -reach_b
    return not (left or right or behind)


@kernel(strict=True)
def _meet_one(ax, ay, bx, by, x, y, dx, dy, moment, inverse, ready, best):
    """Lower `best` where the wall from a to b is met; `inverse` is used when `ready`, else computed anew."""
    ex, ey = bx - ax, by - ay
    constant = ax * ey - ay * ex
    if ready:
        for i in range(best.size):
            a = (ax * dy[i] - ay * dx[i]) - moment[i]
            b = (bx * dy[i] - by * dx[i]) - moment[i]
            trial = (a - b) * inverse[i]
            best[i] = trial if (a * b <= 0.0) & (trial > best[i]) else best[i]
        return
    for i in range(best.size):
        a = (ax * dy[i] - ay * dx[i]) - moment[i]
        b = (bx * dy[i] - by * dx[i]) - moment[i]
        trial = (a - b) * (1.0 / (constant - (x[i] * ey - y[i] * ex)))
        best[i] = trial if (a * b <= 0.0) & (trial > best[i]) else best[i]


@kernel(strict=True)
def _meet_three(ax, ay, bx, by, cx, cy, ex, ey, dx, dy, moment, first, second, third, best):
    """Do the same for three walls in a row: four corners, and one pass over the rays instead of three."""
    for i in range(best.size):
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


@kernel
def _meet_all(vertices, wall_start, wall_stop, x, y, dx, dy, moment, inverse, best):
    """Lower `best` where any wall is met; `inverse` is from :func:`wall_numerators`."""
    n_walls, w = wall_start.size, 0
    while w < n_walls:
        a, b = wall_start[w], wall_stop[w]
        if w + 2 < n_walls and b == wall_start[w + 1] and wall_stop[w + 1] == wall_start[w + 2]:
            c, e = wall_stop[w + 1], wall_stop[w + 2]
            _meet_three(
                vertices[a, 0], vertices[a, 1], vertices[b, 0], vertices[b, 1], vertices[c, 0], vertices[c, 1],
                vertices[e, 0], vertices[e, 1], dx, dy, moment, inverse[w], inverse[w + 1], inverse[w + 2], best,
            )  # fmt: skip
            w += 3
            continue
        _meet_one(
            vertices[a, 0], vertices[a, 1], vertices[b, 0], vertices[b, 1], x, y, dx, dy, moment, inverse[w], True,
            best,
        )  # fmt: skip
        w += 1


@kernel
def _bounds_of(vertices, corner, bounds):
    return _corner_bounds(vertices[corner, 0], vertices[corner, 1], bounds)


@kernel(strict=True)
def inverse_lengths(vertices, wall_start, wall_stop, x, y, dx, dy, bounds, inverse, ready, moment, best):
    """Write 1 / length of each ray into `best` (n,); 0 where the ray meets no wall.

    Parameters
    ----------
    vertices, wall_start, wall_stop : ndarray
        The map, see :class:`~pmcl.models.tables.RangeBeams`.
    x, y, dx, dy : ndarray, shape (n,)
        Origins [m] and unit directions in the map frame.
    bounds : tuple
        Of each of these four the middle of an interval that holds it, and half its length.
    inverse : ndarray, shape (W, n)
        From :func:`wall_numerators`, when `ready`: worth its cost where several calls share their origins.
    ready : bool
        Whether `inverse` holds anything.
    moment : ndarray, shape (n,)
        Work space.
    best : ndarray, shape (n,)
        The result [1/m].
    """
    for i in range(x.size):
        moment[i] = x[i] * dy[i] - y[i] * dx[i]
        best[i] = 0.0 if moment[i] < np.inf else np.nan  # a ray that is no number has no length
    n_walls, w = wall_start.size, 0
    if ready and x.size <= _FEW:
        _meet_all(vertices, wall_start, wall_stop, x, y, dx, dy, moment, inverse, best)
        return
    last, last_bounds = -1, (0.0, 0.0, 0.0)
    while w < n_walls:
        a, b = wall_start[w], wall_stop[w]
        a_bounds = last_bounds if a == last else _bounds_of(vertices, a, bounds)
        b_bounds = _bounds_of(vertices, b, bounds)
        last, last_bounds = b, b_bounds
        met = _may_be_met(a_bounds, b_bounds)
        if met and ready and w + 2 < n_walls and b == wall_start[w + 1] and wall_stop[w + 1] == wall_start[w + 2]:
            c, e = wall_stop[w + 1], wall_stop[w + 2]
            c_bounds, e_bounds = _bounds_of(vertices, c, bounds), _bounds_of(vertices, e, bounds)
            if _may_be_met(b_bounds, c_bounds) and _may_be_met(c_bounds, e_bounds):
                _meet_three(
                    vertices[a, 0], vertices[a, 1], vertices[b, 0], vertices[b, 1], vertices[c, 0], vertices[c, 1],
                    vertices[e, 0], vertices[e, 1], dx, dy, moment, inverse[w], inverse[w + 1], inverse[w + 2], best,
                )  # fmt: skip
                last, last_bounds = e, e_bounds
                w += 3
                continue
        if met:
            _meet_one(
                vertices[a, 0], vertices[a, 1], vertices[b, 0], vertices[b, 1], x, y, dx, dy, moment, inverse[w],
                ready, best,
            )  # fmt: skip
        w += 1


@kernel
def hit_cosines(vertices, wall_start, wall_stop, x, y, dx, dy, moment, best, cosine):
    """Write the cosine of the angle of incidence at the wall that each ray meets into `cosine` (n,).

    `moment` and `best` are as :func:`inverse_lengths` left them. A ray that meets nothing counts as square (1).
    """
    for i in range(x.size):
        cosine[i] = 1.0
    for w in range(wall_start.size):
        ax, ay = vertices[wall_start[w], 0], vertices[wall_start[w], 1]
        bx, by = vertices[wall_stop[w], 0], vertices[wall_stop[w], 1]
        ex, ey = bx - ax, by - ay
        per_length, constant = 1.0 / np.sqrt(ex * ex + ey * ey), ax * ey - ay * ex
        for i in range(x.size):
            a = (ax * dy[i] - ay * dx[i]) - moment[i]
            b = (bx * dy[i] - by * dx[i]) - moment[i]
            trial = (a - b) / (constant - (x[i] * ey - y[i] * ex))
            # The nearest wall gives the very value of `best`, up to rounding.
            met = (a * b <= 0.0) & (trial >= best[i] * (1.0 - 1e-9)) & (best[i] > 0.0)
            cosine[i] = abs(dx[i] * ey - dy[i] * ex) * per_length if met else cosine[i]


@entry
def _cast(vertices, wall_start, wall_stop, x, y, dx, dy):
    n = x.size
    inverse, moment, best = np.empty((wall_start.size, n)), np.empty(n), np.empty(n)
    wall_numerators(vertices, wall_start, wall_stop, x, y, inverse)
    bounds = (middle_and_reach(x), middle_and_reach(y), middle_and_reach(dx), middle_and_reach(dy))
    inverse_lengths(vertices, wall_start, wall_stop, x, y, dx, dy, bounds, inverse, True, moment, best)
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
