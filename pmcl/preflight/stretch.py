"""The rows of a log that a preflight looks at."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from pmcl.logs.arrays import LogArrays
from pmcl.models.quick import QuickReadings

__all__ = ["stretch_of"]

Int = NDArray[np.int64]

# Longer logs than this many times the rows that are looked at are thinned, so that a stretch holds some motion.
_THIN_BEYOND = 10


def stretch_of(log: LogArrays, readings: Iterable[QuickReadings], most: int) -> Int:
    """Choose rows: those with readings before which odometry has changed since the row chosen before.

    Parameters
    ----------
    log : LogArrays
        The log, T rows.
    readings : iterable of QuickReadings
        Of its sensors.
    most : int
        Greatest number of rows.

    Returns
    -------
    ndarray of int, shape (K,)
        K <= `most` rows, from the start on. A robot that stands still gives only its first one; where odometry is zero
        throughout, every row with readings counts.
    """
    read = np.any([sensor.rows for sensor in readings], axis=0)
    moved = (log.odometry != 0.0).any(axis=1)
    if not moved.any():
        moved[:] = True
    # How often the robot had moved by each row: rows of one count show the same view.
    count = np.cumsum(moved)
    rows = np.flatnonzero(read)
    _, first = np.unique(count[rows], return_index=True)
    rows = rows[first]
    thinning = max(1, rows.size // (_THIN_BEYOND * most))
    return np.asarray(rows[::thinning][:most])
