"""Ray casting on a grid, and what is computed once for each map."""

from __future__ import annotations

import numpy as np
import pytest

from pmcl.maps.occupancy_grid import OCCUPIED
from pmcl.models.sensors.lidar.kernels.casting import free_squares, ray_lengths
from pmcl.simulations.lidar_room import lidar_room_map

RAYS, POSES = 60, 2000


@pytest.mark.parametrize("spread", ["tracking", "everywhere"])
def test_casting_rays(benchmark, spread):
    grid = lidar_room_map()
    rng = np.random.default_rng(1)
    if spread == "tracking":
        path = np.array([9.0, 2.5, 0.3]) + np.array([0.1, 0.1, 0.05]) * rng.standard_normal((POSES, 3))
    else:
        path = rng.uniform((0.5, 0.5, -np.pi), (15.5, 11.5, np.pi), (POSES, 3))
    mounts = np.column_stack([np.zeros((RAYS, 2)), np.linspace(-2.3, 2.3, RAYS)])
    squares = free_squares(grid.cells == OCCUPIED)
    origin, reach = np.array(grid.origin), np.full(RAYS, 30.0)
    benchmark(ray_lengths, squares, grid.resolution, origin, mounts, reach, path)
    benchmark.extra_info["rays_per_second"] = RAYS * POSES / benchmark.stats["min"]


def test_free_squares_of_a_large_map(benchmark):
    benchmark(free_squares, lidar_room_map(0.01).cells == OCCUPIED)
