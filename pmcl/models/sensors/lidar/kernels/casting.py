"""Exact ray casting on a grid of cells.

A ray goes from cell to cell (Amanatides and Woo 1987), but not one by one: for each cell and each of the four quadrants
of directions a table holds how large a square of free cells begins there, so that one step leads out of that square.
Which cell comes next is decided by the same comparison as for single cells; no occupied cell is passed over.

Coordinates here are columns and rows of the grid; a cell is [i, i + 1) x [j, j + 1).
"""

# mypy: disable-error-code="call-arg, assignment"
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.compile import entry, kernel

__all__ = ["WALL_DEPTH", "cast_ray", "free_squares", "ray_lengths"]

Float = NDArray[np.float64]

# How far behind the near side of an occupied cell an echo comes from, in cells. A cell is occupied because echoes came
# from somewhere in it: from its middle on average, which is also where the beam models of nav2 and beluga measure to.
WALL_DEPTH = 0.5
# Largest side of a square that 8 bits can tell.
_LARGEST = 255
# In place of 1 / 0: a ray along a row never leaves its squares at their upper or lower side.
_NEVER = 1e300


@entry
def _squares(occupied):
    height, width = occupied.shape
    sides = np.zeros((4, height, width), np.uint8)
    for quadrant in range(4):
        right, up = quadrant & 1, quadrant >> 1
        for row in range(height):
            j = height - 1 - row if up else row
            for column in range(width):
                i = width - 1 - column if right else column
                if occupied[j, i]:
                    continue
                beside, beyond = i + 1 if right else i - 1, j + 1 if up else j - 1
                inside_x, inside_y = 0 <= beside < width, 0 <= beyond < height
                # Outside the map nothing is in the way.
                side = _LARGEST - 1
                if inside_x:
                    side = min(side, np.int64(sides[quadrant, j, beside]))
                if inside_y:
                    side = min(side, np.int64(sides[quadrant, beyond, i]))
                if inside_x and inside_y:
                    side = min(side, np.int64(sides[quadrant, beyond, beside]))
                sides[quadrant, j, i] = side + 1
    return sides


def free_squares(occupied: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return how large a square without occupied cells begins at each cell, in each of the four diagonal directions.

    Parameters
    ----------
    occupied : ndarray of bool, shape (H, W)
        The map.

    Returns
    -------
    ndarray of uint8, shape (4, H, W)
        Sides in cells, 0 for an occupied cell, no more than 255. The first index counts the directions: down left, down
        right, up left, up right. Cost: O(H W).
    """
    return np.asarray(_squares(occupied))


@kernel
def cast_ray(squares, x, y, dx, dy, reach):
    """Return the length of a ray until it enters an occupied cell; infinite beyond `reach`, or where there is none.

    Parameters
    ----------
    squares : ndarray of uint8, shape (4, H, W)
        From :func:`free_squares`.
    x, y, dx, dy : float
        Origin and unit direction in cells. A ray that begins outside the map meets nothing.
    reach : float
        Longest length that matters, in cells.
    """
    height, width = squares.shape[1], squares.shape[2]
    # A pose that is no number is outside too.
    if not ((x >= 0.0) & (x < width) & (y >= 0.0) & (y < height)):
        return np.inf
    right, up = dx > 0.0, dy > 0.0
    sides = squares[(1 if right else 0) + (2 if up else 0)]
    inverse_x = 1.0 / dx if dx != 0.0 else -_NEVER
    inverse_y = 1.0 / dy if dy != 0.0 else -_NEVER
    i, j, length = int(x), int(y), 0.0
    while (np.uint64(i) < np.uint64(width)) & (np.uint64(j) < np.uint64(height)) & (length < reach):
        side = np.int64(sides[np.uint64(j), np.uint64(i)])
        if side == 0:
            return length
        edge_x = i + side if right else i - side + 1
        edge_y = j + side if up else j - side + 1
        length_x, length_y = (edge_x - x) * inverse_x, (edge_y - y) * inverse_y
        # Rounding must not lead out of the square at two sides at once: that could pass over a cell.
        if length_x < length_y:
            length = length_x
            i = edge_x if right else edge_x - 1
            j = math.floor(y + length * dy)
            j = min(j, edge_y - 1) if up else max(j, edge_y)
        else:
            length = length_y
            j = edge_y if up else edge_y - 1
            i = math.floor(x + length * dx)
            i = min(i, edge_x - 1) if right else max(i, edge_x)
    return np.inf


@entry
def ray_lengths(squares, resolution, origin, beam_pose, max_range, path):
    """Return the length of each ray from each pose to what it meets.

    Parameters
    ----------
    squares, resolution, origin, beam_pose, max_range
        As in :class:`~pmcl.models.sensors.lidar.table.LidarTable`.
    path : ndarray, shape (T, >= 3)
        Poses in the map frame.

    Returns
    -------
    ndarray, shape (T, R)
        Lengths [m], :data:`WALL_DEPTH` cells behind the near side of the cell that is met; inf where a ray meets
        nothing within `max_range`.
    """
    n_rays = beam_pose.shape[0]
    lengths, cosine, sine = np.empty((path.shape[0], n_rays)), np.empty(n_rays), np.empty(n_rays)
    for r in range(n_rays):
        cosine[r], sine[r] = math.cos(beam_pose[r, 2]), math.sin(beam_pose[r, 2])
    c0, s0 = math.cos(origin[2]), math.sin(origin[2])
    per_cell = 1.0 / resolution
    for t in range(path.shape[0]):
        x, y, heading = path[t, 0] - origin[0], path[t, 1] - origin[1], path[t, 2] - origin[2]
        column, row = (c0 * x + s0 * y) * per_cell, (c0 * y - s0 * x) * per_cell
        c, s = math.cos(heading), math.sin(heading)
        for r in range(n_rays):
            mount_x, mount_y = beam_pose[r, 0] * per_cell, beam_pose[r, 1] * per_cell
            length = cast_ray(
                squares, column + c * mount_x - s * mount_y, row + s * mount_x + c * mount_y,
                c * cosine[r] - s * sine[r], s * cosine[r] + c * sine[r], max_range[r] * per_cell,
            )  # fmt: skip
            lengths[t, r] = (length + WALL_DEPTH) * resolution
    return lengths
