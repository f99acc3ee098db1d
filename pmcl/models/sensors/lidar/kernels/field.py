"""Where readings end on the map, and what the likelihood field says there.

Positions here are columns and rows of the padded grid of levels: one more than those of the grid itself.
"""

from __future__ import annotations

import math

import numpy as np

from pmcl.engine.compile import entry, kernel

__all__ = ["add_end_points", "end_levels", "level_at"]


@kernel
def level_at(levels, x, y):
    """Return the level of the cell at (x, y); one of the border outside the map."""
    last_x, last_y = float(levels.shape[1] - 1), float(levels.shape[0] - 1)
    # Written so that what is no number ends in the border too.
    x = x if x > 0.0 else 0.0
    y = y if y > 0.0 else 0.0
    x = x if x < last_x else last_x
    y = y if y < last_y else last_y
    return levels[np.uint32(y), np.uint32(x)]


@kernel
def add_end_points(levels, log_density, u, v, column, row, sine, cosine, total):
    """Add the log density of a reading that ends at (u, v), in cells in the robot's frame, to `total` (n,).

    `column`, `row`, `sine` and `cosine` (n,) say where the robot is.
    """
    for i in range(total.size):
        x = column[i] + cosine[i] * u - sine[i] * v
        y = row[i] + sine[i] * u + cosine[i] * v
        total[i] += log_density[level_at(levels, x, y)]


@entry
def end_levels(levels, resolution, origin, beam_pose, bias, scale, max_range, reading, path):
    """Return the level at which each reading along a path ends.

    Parameters
    ----------
    levels, resolution, origin, beam_pose, bias, scale, max_range, reading
        As in :class:`~pmcl.models.sensors.lidar.table.LidarTable`.
    path : ndarray, shape (T, >= 3)
        Poses in the map frame.

    Returns
    -------
    ndarray of int, shape (T, R)
        -1 where there is no reading, or no echo.
    """
    found = np.empty((path.shape[0], beam_pose.shape[0]), np.int64)
    c0, s0 = math.cos(origin[2]), math.sin(origin[2])
    per_cell = 1.0 / resolution
    for t in range(path.shape[0]):
        x, y, heading = path[t, 0] - origin[0], path[t, 1] - origin[1], path[t, 2] - origin[2]
        column, row = (c0 * x + s0 * y) * per_cell + 1.0, (c0 * y - s0 * x) * per_cell + 1.0
        c, s = math.cos(heading), math.sin(heading)
        for r in range(beam_pose.shape[0]):
            z = reading[t, r]
            if not z < max_range[r]:
                found[t, r] = -1
                continue
            length = (z - bias[r]) / scale[r]
            u = (beam_pose[r, 0] + length * math.cos(beam_pose[r, 2])) * per_cell
            v = (beam_pose[r, 1] + length * math.sin(beam_pose[r, 2])) * per_cell
            found[t, r] = level_at(levels, column + c * u - s * v, row + s * u + c * v)
    return found
