"""Independent ray casting, likelihood field and beam model on grid maps: slow, plain, from the definitions."""

from __future__ import annotations

import numpy as np
import shapely
from scipy import integrate, stats


def random_grid(rng, rows=30, columns=40, share=0.05):
    """Return cells (rows, columns), 1 where occupied, with a few solid blocks and single cells."""
    cells = (rng.random((rows, columns)) < share).astype(np.uint8)
    for _ in range(3):
        j, i = rng.integers(0, rows - 5), rng.integers(0, columns - 5)
        cells[j : j + rng.integers(1, 5), i : i + rng.integers(1, 5)] = 1
    return cells


def box(rows, columns):
    """Return cells (rows, columns) of which the outermost are occupied."""
    cells = np.ones((rows, columns), dtype=np.uint8)
    cells[1:-1, 1:-1] = 0
    return cells


def to_map(grid, x, y):
    """Return the point of the map frame at column x and row y of a grid."""
    x0, y0, yaw = grid.origin
    c, s = np.cos(yaw), np.sin(yaw)
    return x0 + grid.resolution * (c * x - s * y), y0 + grid.resolution * (s * x + c * y)


def cells_of(grid):
    """Return all occupied cells as one geometry in the map frame."""
    squares = []
    for j, i in np.argwhere(grid.cells == 1):
        corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
        squares.append(shapely.Polygon([to_map(grid, *corner) for corner in corners]))
    return shapely.MultiPolygon(squares)


def cast(geometry, origin, angle, reach):
    """Return the distance to the first point of a geometry along a ray; inf where there is none within `reach`."""
    ray = shapely.LineString([origin, (origin[0] + reach * np.cos(angle), origin[1] + reach * np.sin(angle))])
    met = [ray.intersection(part) for part in geometry.geoms]
    distances = [shapely.Point(origin).distance(part) for part in met if not part.is_empty]
    return min(distances, default=np.inf)


def beam_poses(pose, mount):
    """Return where a ray with a mount (3,) on the robot begins in the map frame, and its direction."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return pose[0] + c * mount[0] - s * mount[1], pose[1] + s * mount[0] + c * mount[1], pose[2] + mount[2]


def field_density(grid, point, sigma, z_rand, max_range, longest=2.0):
    """Return the likelihood field's density of a reading that ends at a point, by looking at every occupied cell."""
    x0, y0, yaw = grid.origin
    dx, dy = point[0] - x0, point[1] - y0
    column = int(np.floor((np.cos(yaw) * dx + np.sin(yaw) * dy) / grid.resolution))
    row = int(np.floor((np.cos(yaw) * dy - np.sin(yaw) * dx) / grid.resolution))
    # The cells go on outside the map.
    occupied = np.argwhere(grid.cells == 1)
    nearest = grid.resolution * np.sqrt(((occupied - (row, column)) ** 2).sum(axis=1)).min()
    distance = min(nearest, longest)
    # Two points, each anywhere in its cell, are apart by the difference of two uniform numbers.
    hidden = 2.0 * grid.resolution**2 / 12.0
    return (1.0 - z_rand) * stats.norm.pdf(distance, scale=np.sqrt(sigma**2 + hidden)) + z_rand / max_range


def beam_density(z, length, max_range, sigma, z_short, z_max, z_rand, rate):
    """Return the beam model's density of one reading, or its probability where it is no echo."""
    hit = stats.truncnorm(-length / sigma, np.inf, loc=length, scale=sigma)
    z_hit = 1.0 - z_short - z_max - z_rand
    if z >= max_range:
        return z_max + z_hit * hit.sf(max_range)
    short = stats.truncexpon(b=min(length, max_range) * rate, scale=1.0 / rate)
    return z_hit * hit.pdf(z) + z_short * short.pdf(z) + z_rand / max_range


def beam_probability(low, high, length, max_range, *theta):
    """Return the probability of a reading between two values, by quadrature."""
    points = [p for p in (length - 3 * theta[0], length, length + 3 * theta[0]) if low < p < high]
    value, _ = integrate.quad(
        beam_density, low, high, args=(length, max_range, *theta), points=points or None, epsabs=1e-11, limit=200
    )
    return value
