"""The rows of a log that a preflight looks at, and what was read in them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.logs.arrays import LogArrays

__all__ = ["RowReadings", "Stretch", "stretch_of"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# At most so many readings of one row: beams and landmarks beyond these tell little more of a mistake.
_BEAMS, _SIGHTINGS = 8, 6
# Longer logs than this many times the rows that are looked at are thinned, so that a stretch holds some motion.
_THIN_BEYOND = 10


class RowReadings(NamedTuple):
    """Readings of one row.

    Attributes
    ----------
    landmark : ndarray of int, shape (k,)
        Landmarks that were seen.
    range, bearing, size : ndarray, shape (k,)
        What was read of each [m, rad, pixel]; NaN where that was not.
    beam : ndarray of int, shape (b,)
        Beams that measured.
    length : ndarray, shape (b,)
        Their readings [m], as the log has them.
    """

    landmark: Int
    range: Float
    bearing: Float
    size: Float
    beam: Int
    length: Float


class Stretch(NamedTuple):
    """Rows with readings, from the start of a log on.

    Attributes
    ----------
    rows : ndarray of int, shape (K,)
        Rows of the log.
    readings : list of RowReadings, length K
        What was read in each.
    """

    rows: Int
    readings: list[RowReadings]


def stretch_of(log: LogArrays, most: int) -> Stretch:
    """Choose rows: those with readings before which odometry has changed since the row chosen before.

    Parameters
    ----------
    log : LogArrays
        The log, T rows.
    most : int
        Greatest number of rows.

    Returns
    -------
    Stretch
        K <= `most` rows. A robot that stands still gives only its first one; where odometry is zero throughout, every
        row with readings counts.
    """
    n = log.n_steps
    tables = [log.landmark_range, log.landmark_bearing, log.landmark_size]
    seen = [~np.isnan(table) for table in tables if table is not None]
    sighted = np.any(seen, axis=0) if seen else np.zeros((n, 0), dtype=bool)
    measured = ~np.isnan(log.ranges) if log.ranges is not None else np.zeros((n, 0), dtype=bool)
    read = sighted.any(axis=1) | measured.any(axis=1)
    moved = (log.odometry != 0.0).any(axis=1)
    if not moved.any():
        moved[:] = True
    # How often the robot had moved by each row: rows of one count show the same view.
    count = np.cumsum(moved)
    rows = np.flatnonzero(read)
    _, first = np.unique(count[rows], return_index=True)
    rows = rows[first]
    thinning = max(1, rows.size // (_THIN_BEYOND * most))
    rows = rows[::thinning][:most]
    return Stretch(rows, [_readings(log, int(row), sighted[row], measured[row]) for row in rows])


def _readings(log: LogArrays, row: int, sighted: NDArray[np.bool_], measured: NDArray[np.bool_]) -> RowReadings:
    landmarks = _some(np.flatnonzero(sighted), _SIGHTINGS)
    beams = _some(np.flatnonzero(measured), _BEAMS)
    nothing = np.full(landmarks.size, np.nan)
    # A size tells nothing where nobody says how large a landmark appears.
    size = None if log.size_at_one_metre is None else log.landmark_size
    columns = [
        nothing if table is None else table[row, landmarks]
        for table in (log.landmark_range, log.landmark_bearing, size)
    ]
    lengths = np.empty(0) if log.ranges is None else log.ranges[row, beams]
    return RowReadings(landmarks, columns[0], columns[1], columns[2], beams, lengths)


def _some(which: Int, most: int) -> Int:
    if which.size <= most:
        return which
    chosen: Int = which[np.linspace(0, which.size - 1, most).round().astype(int)]
    return chosen
