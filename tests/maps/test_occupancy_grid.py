"""Occupancy grids: geometry, distances, and what is refused."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pmcl.errors import MapError
from pmcl.maps import OccupancyGrid
from pmcl.maps.occupancy_grid import FREE, MOST_CELLS, OCCUPIED, UNKNOWN

ROOM = np.array([[1, 1, 1, 1, 1], [1, 0, 0, 2, 1], [1, 0, 0, 0, 1]], dtype=np.uint8)


def random_cells(seed, rows=23, columns=31, share=0.03):
    cells = np.random.default_rng(seed).choice(3, p=[0.9 - share, share, 0.1], size=(rows, columns)).astype(np.uint8)
    cells[seed % rows, seed % columns] = OCCUPIED
    return cells


@pytest.mark.parametrize("seed", range(4))
def test_the_distance_field_is_the_distance_to_the_nearest_of_all_occupied_cells(seed, monkeypatch):
    cells = random_cells(seed)
    # Also where the field is computed in several parts.
    monkeypatch.setattr("pmcl.maps.occupancy_grid._CELLS_AT_ONCE", (1 << 20, 100)[seed % 2])
    grid = OccupancyGrid(cells, 0.05, (3.0, -2.0, 0.4))
    rows, columns = np.indices(cells.shape)
    occupied = np.argwhere(cells == OCCUPIED)
    squares = (rows[..., None] - occupied[:, 0]) ** 2 + (columns[..., None] - occupied[:, 1]) ** 2
    np.testing.assert_allclose(grid.distance_field, 0.05 * np.sqrt(squares.min(axis=-1)), rtol=1e-14, atol=0.0)
    assert grid.distance_field is grid.distance_field
    assert not grid.distance_field.flags.writeable


def test_row_zero_is_the_lowest_and_the_origin_is_its_outer_corner():
    grid = OccupancyGrid(ROOM, 0.5, (10.0, 20.0, 0.0))
    assert grid.bounds == (10.0, 12.5, 20.0, 21.5)
    assert grid.size == (2.5, 1.5)
    np.testing.assert_allclose(grid.to_cells([10.75, 20.25, 99.0]), [1.5, 0.5])
    # The only unknown cell inside is in row 1, column 3.
    assert grid.state_at([11.75, 20.75]) == UNKNOWN
    assert grid.state_at([11.25, 20.75]) == FREE
    assert grid.state_at([11.75, 20.25]) == OCCUPIED


def test_an_origin_with_yaw_turns_the_grid_about_its_corner():
    grid = OccupancyGrid(ROOM, 0.5, (10.0, 20.0, np.pi / 2))
    # Columns run to the north and rows to the west.
    np.testing.assert_allclose(grid.to_cells([[9.75, 20.75]]), [[1.5, 0.5]])
    np.testing.assert_allclose(grid.bounds, (8.5, 10.0, 20.0, 22.5))
    assert grid.state_at([9.25, 21.75]) == UNKNOWN
    turned = OccupancyGrid(ROOM, 0.5, (10.0, 20.0, 0.3))
    x, y = turned.from_cells([2.0, 1.0])
    np.testing.assert_allclose([x, y], [10 + np.cos(0.3) - 0.5 * np.sin(0.3), 20 + np.sin(0.3) + 0.5 * np.cos(0.3)])


@settings(max_examples=50, deadline=None)
@given(st.tuples(*[st.floats(-50.0, 50.0)] * 2, st.floats(-6.0, 6.0)), st.floats(-9.0, 9.0), st.floats(-9.0, 9.0))
def test_cells_and_points_are_each_others_inverse(origin, column, row):
    grid = OccupancyGrid(ROOM, 0.1, origin)
    np.testing.assert_allclose(grid.to_cells(grid.from_cells([column, row])), [column, row], atol=1e-10)


def test_outside_the_grid_nothing_is_known():
    grid = OccupancyGrid(ROOM, 0.5)
    outside = [[-0.01, 0.5], [2.51, 0.5], [0.5, -0.01], [0.5, 1.51], [np.nan, 0.5], [1e300, 0.0]]
    assert (grid.state_at(outside) == UNKNOWN).all()
    assert (grid.state_at([[0.01, 0.5], [2.49, 0.5]]) == OCCUPIED).all()


def test_a_margin_moves_no_cell_and_lets_distances_go_on():
    grid = OccupancyGrid(ROOM, 0.5, (3.0, -2.0, 0.7))
    wide = grid.with_margin(1.2)
    assert wide.cells.shape == (ROOM.shape[0] + 6, ROOM.shape[1] + 6)
    row, column = np.mgrid[: ROOM.shape[0], : ROOM.shape[1]]
    centres = grid.from_cells(np.column_stack([column.ravel() + 0.5, row.ravel() + 0.5]))
    np.testing.assert_array_equal(wide.state_at(centres), ROOM.ravel())
    np.testing.assert_allclose(wide.distance_field[3:-3, 3:-3], grid.distance_field, atol=1e-12)
    # The walls of this room are the outermost cells; the next ones outside are one and two cells from them.
    assert ROOM[1, 0] == OCCUPIED
    np.testing.assert_allclose(wide.distance_field[4, :3], [1.5, 1.0, 0.5], atol=1e-12)


def test_cells_are_copied_unless_nobody_can_write_them():
    cells = ROOM.copy()
    grid = OccupancyGrid(cells, 0.5)
    cells[:] = UNKNOWN
    np.testing.assert_array_equal(grid.cells, ROOM)
    with pytest.raises(ValueError, match="read-only"):
        grid.cells[0, 0] = FREE
    assert OccupancyGrid(grid.cells, 0.5).cells is grid.cells
    assert OccupancyGrid(ROOM.astype(np.int64), 0.5).cells.dtype == np.uint8


def test_a_pickled_grid_is_the_same_read_only_and_small():
    grid = OccupancyGrid(random_cells(0, 200, 300), 0.05, (1.0, 2.0, 0.1), "somewhere")
    assert grid.distance_field.nbytes == 8 * grid.cells.size
    packed = pickle.dumps(grid)
    assert len(packed) < grid.cells.size + 2000
    again = pickle.loads(packed)
    assert again.fingerprint() == grid.fingerprint()
    assert (again.source, again.origin) == (grid.source, grid.origin)
    assert not again.cells.flags.writeable


def test_the_fingerprint_knows_cells_resolution_and_origin_and_nothing_else():
    grid = OccupancyGrid(ROOM, 0.5, (0.0, 1.0, 0.0), "here")
    assert OccupancyGrid(ROOM, 0.5, (-0.0, 1.0, 0.0), "there").fingerprint() == grid.fingerprint()
    other = ROOM.copy()
    other[1, 1] = UNKNOWN
    others = [
        OccupancyGrid(other, 0.5, (0.0, 1.0, 0.0)),
        OccupancyGrid(ROOM, 0.25, (0.0, 1.0, 0.0)),
        OccupancyGrid(ROOM, 0.5, (0.0, 1.0, 0.1)),
        OccupancyGrid(ROOM.reshape(5, 3), 0.5, (0.0, 1.0, 0.0)),
    ]
    assert len({grid.fingerprint(), *(each.fingerprint() for each in others)}) == 5


BAD = {
    "no resolution": ({"resolution": 0.0}, "resolution as a number of at least 0.001 m"),
    "negative resolution": ({"resolution": -0.05}, "resolution as a number"),
    "resolution not a number": ({"resolution": float("nan")}, "resolution as a number .* got nan"),
    "absurd resolution": ({"resolution": 1e9}, "at most 10 m"),
    "resolution as text": ({"resolution": "0.05"}, "resolution as a number"),
    "two numbers": ({"origin": (0.0, 1.0)}, "three finite numbers"),
    "endless origin": ({"origin": (0.0, float("inf"), 0.0)}, "three finite numbers"),
    "origin beyond the earth": ({"origin": (1e9, 0.0, 0.0)}, "three finite numbers"),
    "degrees": ({"origin": (0.0, 0.0, 90.0)}, "convert degrees to radians"),
    "words": ({"origin": ("a", "b", "c")}, "three finite numbers .* got text"),
    "a line": ({"cells": np.ones(5, dtype=np.uint8)}, r"cells of shape \(rows, columns\)"),
    "no cells": ({"cells": np.ones((0, 5), dtype=np.uint8)}, r"cells of shape \(rows, columns\)"),
    "probabilities": ({"cells": np.full((2, 2), 0.5)}, "whole numbers"),
    "percentages": ({"cells": np.full((2, 2), 100)}, r"0 \(free\), 1 \(occupied\) or 2 \(unknown\)"),
    "unknown all over": ({"cells": np.full((2, 3), UNKNOWN)}, "at least one occupied cell, got none .100% of 3 x 2"),
    "nothing occupied": ({"cells": np.zeros((2, 3), dtype=int)}, "at least one occupied cell"),
    "source": ({"source": 3}, "source"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_grid_that_cannot_be_is_refused_in_one_line(case):
    change, says = BAD[case]
    with pytest.raises(MapError, match=says) as caught:
        OccupancyGrid(**{"cells": ROOM, "resolution": 0.5, "source": "hall.yaml", **change})
    assert "\n" not in str(caught.value)


def test_a_grid_of_too_many_cells_is_refused_before_anything_is_copied():
    # A view of one number: it has many cells and takes no memory.
    many = np.broadcast_to(np.uint8(OCCUPIED), (MOST_CELLS // 1000 + 1, 1000))
    with pytest.raises(MapError, match=f"at most {MOST_CELLS} cells"):
        OccupancyGrid(many, 0.05)


def test_a_coarser_grid_keeps_obstacles_and_places_where_they_are():
    cells = np.full((5, 7), UNKNOWN, dtype=np.uint8)
    cells[0, :] = FREE
    cells[1, 0] = OCCUPIED
    cells[4, 6] = FREE
    grid = OccupancyGrid(cells, 0.1, (1.0, 2.0, 0.5), "here")
    coarse = grid.coarser(4)
    # Two by two; the last row and the last column stand for one row and one column.
    assert coarse.cells.tolist() == [[1, 0, 0, 0], [2, 2, 2, 2], [2, 2, 2, 0]]
    assert (coarse.resolution, coarse.origin, coarse.source) == (0.2, grid.origin, "here")
    assert grid.coarser(7) is grid
    assert grid.coarser(6).cells.shape == (3, 4)
    # Cells never become larger than those of any map.
    wide = OccupancyGrid(np.ones((1, 2000), dtype=np.uint8), 4.0)
    assert wide.coarser(100).resolution == 8.0
