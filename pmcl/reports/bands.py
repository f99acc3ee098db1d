"""Medians and bands, for values that are too many to be drawn one by one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Band", "band_over_time", "mass_levels"]

Float = NDArray[np.float64]


class Band(NamedTuple):
    """Quantiles of values in bins of time.

    Attributes
    ----------
    time : ndarray, shape (B,)
        Middle of each bin that holds a value.
    median, low, high : ndarray, shape (B,)
        50 %, 5 % and 95 % quantile of the values in the bin.
    """

    time: Float
    median: Float
    low: Float
    high: Float


def band_over_time(times: Float, values: Float, n_bins: int) -> Band:
    """Quantiles of values over time.

    Parameters
    ----------
    times : ndarray, shape (T,)
        Increasing.
    values : ndarray, shape (T,) or (T, C)
        Of one or several channels, which are taken together; NaN where there is none.
    n_bins : int
        Bins of equal length in time.

    Returns
    -------
    Band
        Bins without a value are left out.
    """
    edges = np.linspace(times[0], times[-1], n_bins + 1)
    which = np.clip(np.searchsorted(edges, times, side="right") - 1, 0, n_bins - 1)
    rows = []
    for number in range(n_bins):
        inside = values[which == number]
        inside = inside[np.isfinite(inside)]
        if inside.size:
            low, median, high = np.quantile(inside, [0.05, 0.5, 0.95])
            rows.append((0.5 * (edges[number] + edges[number + 1]), median, low, high))
    return Band(*np.array(rows).reshape(-1, 4).T)


def mass_levels(density: Float, shares: tuple[float, ...]) -> list[float]:
    """Heights of a density on a grid above which given shares of its mass lie.

    Parameters
    ----------
    density : ndarray
        Not negative, not all zero; cells of equal size.
    shares : tuple of float
        Between 0 and 1.

    Returns
    -------
    list of float
        In increasing order, without repetition.
    """
    heights = np.sort(density.ravel())[::-1]
    mass = np.cumsum(heights) / heights.sum()
    levels = {float(heights[min(int(np.searchsorted(mass, share)), heights.size - 1)]) for share in shares}
    return sorted(levels)
