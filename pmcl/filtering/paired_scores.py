"""Comparisons of two models by one-step-ahead log scores, row by row."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Gain", "block_sums", "paired_gain"]

Float = NDArray[np.float64]

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
    """

    total: float
    se: float

    @property
    def significant(self) -> bool:
        """Whether it exceeds two standard errors."""
        return self.total > 2.0 * self.se


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
    return Gain(float(difference.sum()), float(np.sqrt(sums.size) * sums.std(ddof=1)))


def block_sums(rows: Float) -> Float:
    """Return sums over blocks of 15 rows, at least two blocks; the sums are nearly independent."""
    count = max(2, rows.size // _BLOCK)
    return np.array([block.sum() for block in np.array_split(rows, count)])
