"""Distances as numbers of levels: the same as those of the map's distance field, in little memory."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from pmcl.maps.occupancy_grid import OccupancyGrid
from pmcl.models.sensors.lidar.grid_arrays import _levels, grid_arrays
from pmcl.models.sensors.lidar.table import LONGEST_DISTANCE


def sparse_map(rows, columns, resolution):
    cells = (np.random.default_rng(4).random((rows, columns)) < 0.002).astype(np.uint8)
    cells[5, 7] = 1
    return OccupancyGrid(cells, resolution)


@pytest.mark.parametrize("resolution", [0.01, 0.05, 1.0 / 3.0, 10.0])
def test_every_cell_has_its_distance(resolution):
    grid = sparse_map(150, 210, resolution)
    arrays = grid_arrays(grid)
    field = np.minimum(grid.with_margin(LONGEST_DISTANCE).distance_field, LONGEST_DISTANCE)
    expected = np.pad(field, 1, constant_values=LONGEST_DISTANCE)
    np.testing.assert_allclose(arrays.level_distance[arrays.levels], expected, rtol=0.0, atol=1e-15)
    assert (np.diff(arrays.level_distance) > 0.0).all()
    assert arrays.level_distance[-1] == LONGEST_DISTANCE
    assert np.isin(np.arange(arrays.level_distance.size), arrays.levels).all()


def test_fine_maps_have_rounded_distances():
    grid = sparse_map(300, 400, 0.003)
    wide = grid.with_margin(LONGEST_DISTANCE)
    distance, levels = _levels(wide.distance_field, wide.resolution)
    assert distance.size == 1 << 16
    np.testing.assert_allclose(distance[levels[1:-1, 1:-1]], np.minimum(wide.distance_field, 2.0), atol=1.6e-5)


def test_levels_take_little_memory():
    field = sparse_map(1200, 1500, 0.05).distance_field
    tracemalloc.start()
    try:
        _levels(field, 0.05)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # Two bytes for each cell, and some rows as numbers; sorted, all cells would take 40 bytes each: 72 MB.
    assert most < 8e6
