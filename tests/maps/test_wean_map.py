"""The grid map of the Wean Hall recordings, made and recorded."""

import gzip
import os

import numpy as np
import pytest

from pmcl.errors import MapError
from pmcl.maps.occupancy_grid import FREE, OCCUPIED, UNKNOWN
from pmcl.maps.wean import read_wean_map

HEAD = """robot_specifications->global_mapsize_x                 30
robot_specifications->global_mapsize_y                 20
robot_specifications->resolution                       10
robot_specifications->autoshifted_x                    0

global_map[0]: 3 2
"""
# One line for each x: free probabilities along y.
NUMBERS = "-1.000 0.000 \n0.350 0.500 \n0.810 1.000 \n"


@pytest.fixture
def made(tmp_path):
    path = tmp_path / "made.dat"
    path.write_text(HEAD + NUMBERS)
    return path


def test_cells_are_by_row_and_column_and_high_numbers_are_free(made, tmp_path):
    grid = read_wean_map(made)
    assert grid.cells.tolist() == [[UNKNOWN, OCCUPIED, FREE], [OCCUPIED, UNKNOWN, FREE]]
    assert (grid.resolution, grid.origin, grid.source) == (0.1, (0.0, 0.0, 0.0), str(made))
    packed = tmp_path / "made.dat.gz"
    packed.write_bytes(gzip.compress(made.read_bytes()))
    assert read_wean_map(packed).fingerprint() == grid.fingerprint()


BAD = {
    "a number less": (HEAD + NUMBERS[:-7], "6 numbers, one for each cell, got 5"),
    "words": (HEAD + NUMBERS.replace("0.350", "wall"), "6 numbers"),
    "percent": (HEAD + NUMBERS.replace("0.350", "35.0"), "probabilities from 0 to 1, or -1 .* got 35 in cell 2"),
    "nan": (HEAD + NUMBERS.replace("0.350", "nan"), "probabilities from 0 to 1"),
    "no size": (NUMBERS, "global_map"),
    "no resolution": (HEAD.replace("resolution", "solution") + NUMBERS, "robot_specifications->resolution"),
    "no side": (HEAD.replace(" 10\n", " 0\n") + NUMBERS, "resolution as a number of at least"),
    "two points": (HEAD.replace(" 10\n", " 1.0.0\n") + NUMBERS, "resolution as a number of at least"),
    "10^9 cells": (HEAD.replace("3 2", "40000 25000") + NUMBERS, "1 to 16000000 cells, got 40000 x 25000"),
    "no cells": (HEAD.replace("3 2", "0 2") + NUMBERS, "1 to 16000000 cells"),
    "empty": ("", "global_map"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_one_line(made, case):
    text, says = BAD[case]
    made.write_text(text)
    with pytest.raises(MapError, match=f"^{made}: expected .*{says}") as caught:
        read_wean_map(made)
    assert "\n" not in str(caught.value)


def test_a_truncated_or_missing_file_is_one_line(made, tmp_path):
    packed = tmp_path / "short.dat.gz"
    packed.write_bytes(gzip.compress(made.read_bytes())[:-12])
    for path in (packed, tmp_path / "gone.dat.gz"):
        with pytest.raises(MapError, match=f"^{path}: expected a map of the Wean recordings"):
            read_wean_map(path)


def test_the_published_map_is_the_hall(shared_data):
    grid = read_wean_map(shared_data / "wean" / "wean.dat.gz")
    assert grid.cells.shape == (800, 800)
    assert grid.resolution == 0.1
    # What is known is twice as wide as high: 76 m from west to east, 39 m from south to north.
    rows, columns = np.nonzero(grid.cells == FREE)
    assert (columns.min(), columns.max(), rows.min(), rows.max()) == (41, 799, 319, 709)
    # Corridors are wider than their walls are thick.
    assert np.count_nonzero(grid.cells == FREE) > 2 * np.count_nonzero(grid.cells == OCCUPIED)


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(MapError, match="got something that is no file"):
        read_wean_map(tmp_path / "pipe")
