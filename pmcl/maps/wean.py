"""Grid maps as CMU's Wean Hall recordings hold them: one text file with a probability for each cell."""

from __future__ import annotations

import gzip
import io
import math
import os
import re
import warnings
import zlib

import numpy as np
from numpy.typing import NDArray

from pmcl.checks import check_path
from pmcl.errors import MapError
from pmcl.maps.map_server import FREE_THRESH, OCCUPIED_THRESH
from pmcl.maps.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid

__all__ = ["read_wean_map"]

# Lines before the numbers; those of the published map have 400 bytes.
_LONGEST_HEADER = 4096
# As text each number takes some eight bytes, so this many cells are 130 MB to read; the published map has 640 000.
_MOST_TEXT_CELLS = 16_000_000
# No number is written with more characters than this, the space included.
_LONGEST_NUMBER = 24


def read_wean_map(path: str | os.PathLike[str]) -> OccupancyGrid:
    """Read a grid map such as ``wean.dat`` or ``wean.dat.gz``.

    The file says the side of a cell [cm] and the number of cells, and then for each x (the outer loop) and y the
    probability that the cell is free, -1 where nothing is known. The instructions beside the published map call it the
    probability of being occupied; its corridors, in which the robot drives, are near 1.

    Parameters
    ----------
    path : path
        The file, compressed by gzip or not.

    Returns
    -------
    OccupancyGrid
        Occupied where the probability of being occupied is at least 0.65, free where it is at most 0.196, which are
        map_server's usual thresholds: between them the published map holds guesses about places behind walls. The
        origin of the map frame is the outer corner of the first cell.

    Raises
    ------
    MapError
        When the file is missing, damaged, too large or of another format, or no cell is occupied.
    """
    where = check_path("path of the map", path, error=MapError)
    if os.path.exists(where) and not os.path.isfile(where):
        raise MapError(f"{where}: expected a map of the Wean recordings, got something that is no file: check the path")
    try:
        with open(where, "rb") as raw:
            packed = raw.read(2) == b"\x1f\x8b"
        with gzip.open(where, "rb") if packed else open(where, "rb") as stream:
            resolution, columns, rows, begin = _header(stream, where)
            free = _numbers(stream, begin, columns * rows, where).reshape(columns, rows).T
    except (OSError, EOFError, zlib.error) as problem:
        text = getattr(problem, "strerror", None) or " ".join(str(problem).split())
        raise MapError(f"{where}: expected a map of the Wean recordings, got '{text}': check the file") from None
    known = free >= 0.0
    occupied = known & (1.0 - free >= OCCUPIED_THRESH)
    cells = np.select([occupied, known & (1.0 - free <= FREE_THRESH)], [OCCUPIED, FREE], UNKNOWN).astype(np.uint8)
    return OccupancyGrid(cells, resolution, (0.0, 0.0, 0.0), where)


def _header(stream: io.BufferedIOBase, where: str) -> tuple[float, int, int, bytes]:
    """Return the side of a cell [m], the numbers of cells along x and y, and what was read of the numbers already."""
    text = stream.read(_LONGEST_HEADER)
    size = re.search(rb"^global_map\[0\]:\s*(\d{1,9})\s+(\d{1,9})\s*\n", text, re.MULTILINE)
    side = re.search(rb"^robot_specifications->resolution\s+([0-9.]{1,20})\s*$", text, re.MULTILINE)
    if size is None or side is None:
        missing = "'robot_specifications->resolution'" if size is not None else "'global_map[0]: columns rows'"
        raise MapError(f"{where}: expected the line {missing} of a Wean map, got none: give wean.dat or wean.dat.gz")
    columns, rows = int(size[1]), int(size[2])
    if not 0 < columns * rows <= _MOST_TEXT_CELLS:
        raise MapError(
            f"{where}: expected 1 to {_MOST_TEXT_CELLS} cells, got {columns} x {rows}: check the line 'global_map[0]'"
        )
    try:
        resolution = float(side[1]) / 100.0
    except ValueError:
        resolution = math.nan
    return resolution, columns, rows, text[size.end() :]


def _numbers(stream: io.BufferedIOBase, begin: bytes, n_cells: int, where: str) -> NDArray[np.float64]:
    text = begin + stream.read(n_cells * _LONGEST_NUMBER)
    with warnings.catch_warnings():
        # A text that is no number is an error in recent versions of numpy, and ends the numbers in older ones.
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            values = np.fromstring(text.decode("latin-1"), dtype=np.float64, sep=" ")
        except ValueError:
            raise MapError(
                f"{where}: expected {n_cells} numbers, one for each cell, got other text among them: "
                "copy the file again"
            ) from None
    if values.size != n_cells:
        raise MapError(
            f"{where}: expected {n_cells} numbers, one for each cell, got {values.size}: copy the file again"
        )
    bad = np.flatnonzero(~((values == -1.0) | ((values >= 0.0) & (values <= 1.0))))
    if bad.size:
        raise MapError(
            f"{where}: expected probabilities from 0 to 1, or -1 for unknown, got {values[bad[0]]:g} in cell {bad[0]}: "
            "correct it"
        )
    return values
