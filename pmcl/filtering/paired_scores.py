"""Comparisons of two models by one-step-ahead log scores, row by row."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Gain", "block_starts", "block_sums", "paired_gain"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# Rows of a block; sums over blocks of this length are nearly independent (chosen by hand).
_BLOCK = 15


class Gain(NamedTuple):
    """Difference of two models' log scores.

    Attributes
    ----------
    total : float
        The difference [nat]; positive when the new model predicts better.
    se : float
        Its standard error [nat].
    largest : float
        The greatest share that a single block of rows has in it [nat].
    """

    total: float
    se: float
    largest: float = 0.0

    @property
    def bounded(self) -> float:
        """The difference, of which the largest block counts at most half as much as all others together [nat].

        One row may gain dozens of nats by an accident of the particles. Where the others gain nothing, it counts not at
        all.
        """
        others = self.without_largest
        return others + min(self.largest, 0.5 * max(others, 0.0))

    @property
    def without_largest(self) -> float:
        """The difference without its largest block [nat]: what remains if that block is an accident."""
        return self.total - self.largest


def paired_gain(new: Float, old: Float, rows: slice) -> Gain:
    """Compare two models on some rows.

    Parameters
    ----------
    new, old : ndarray, shape (T,)
        Row scores of the two models [nat].
    rows : slice
        The rows that count.

    Returns
    -------
    Gain
        Its standard error is that of a bootstrap of blocks of 15 rows.
    """
    difference = (new - old)[rows]
    sums = block_sums(difference)
    # A bootstrap of blocks of equal weight has this standard error, so no resampling is necessary.
    return Gain(float(difference.sum()), float(np.sqrt(sums.size) * sums.std(ddof=1)), float(sums.max()))


def block_starts(n_rows: int) -> Int:
    """Return the first row of each block of 15 rows; there are at least two blocks."""
    count = max(2, n_rows // _BLOCK)
    sizes = n_rows // count + (np.arange(count) < n_rows % count)
    return np.asarray(np.cumsum(sizes) - sizes, dtype=np.int64)


def block_sums(rows: Float) -> Float:
    """Return sums over blocks of 15 rows, at least two blocks; the sums are nearly independent.

    Parameters
    ----------
    rows : ndarray, shape (..., T)
        Numbers of at least two rows.
    """
    return np.asarray(np.add.reduceat(rows, block_starts(rows.shape[-1]), axis=-1))
