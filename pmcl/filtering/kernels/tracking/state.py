"""What a localizing filter remembers between two time steps, and how it is diagnostics to work.

All arrays are flat or one-dimensional and as long as the greatest number of particles N needs, so that the number of
particles n may change from step to step without any allocation: ``views.columns(flat, D, n)`` is
a contiguous (D, n) array.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["FilterState", "Options", "new_state"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# Places in FilterState.numbers.
COUNT, STARTED, SEEN, WEIGHT_SUM, EFFECTIVE, FAST, SLOW, FRESH, SUSPICION = range(9)


class Options(NamedTuple):
    """How the filter works; numbers only, so that one compilation serves all.

    Attributes
    ----------
    particles, least, most : int
        Particles of the first step; fewest and most when the number adapts (equal: it does not).
    draws, picks : int
        Parameter draws K, and how many of them each reading is averaged over.
    scheme : int
        Resampling scheme.
    threshold : float
        Resample where the effective sample size is at most this share of n.
    annealed : int
        First reading: 0 as any other, 1 annealed when it comes at the first row, 2 annealed whenever it comes.
    recover : bool
        Whether to look for the robot elsewhere when readings become unlikely.
    fast, slow : float
        Rates of the short- and the long-term average likelihood of a reading, for each step.
    usual_readings : float
        Independent readings of a step for which these rates hold; a step of fewer has accordingly smaller ones.
    tolerance : float
        Look elsewhere when the short-term average falls below the long-term one divided by this.
    bin_size, bin_turn : float
        Bins that particles are counted in [m], [rad].
    kld_error, kld_quantile : float
        Bound of the Kullback-Leibler distance, and the normal quantile of its probability.
    """

    particles: int
    least: int
    most: int
    draws: int
    picks: int
    scheme: int
    threshold: float
    annealed: int
    recover: bool
    fast: float
    slow: float
    usual_readings: float
    tolerance: float
    bin_size: float
    bin_turn: float
    kld_error: float
    kld_quantile: float


class FilterState(NamedTuple):
    """Memory of a filter with up to N particles of D components.

    Attributes
    ----------
    particles, before : ndarray, shape (D N,)
        States now, and their parents.
    spare, proposed : ndarray, shape (2 D N,) and (D N,)
        Work space.
    log_weights, weights : ndarray, shape (N,)
        Normalised log weights, and weights of sum ``numbers[WEIGHT_SUM]``.
    log_like, new_like, log_start, new_start : ndarray, shape (N,)
        Work space.
    rate : ndarray, shape (2 N,)
        Work space.
    spread : ndarray, shape (D,)
        Work space.
    ancestors, order, which : ndarray of int, shape (N,)
        Parents, and work space.
    counts : ndarray of int, shape (K + 1,)
        Work space.
    shuffled : ndarray of int, shape (K,)
        The draws in random order; the first `picks` of them serve this step.
    log_densities : ndarray, shape (picks N,)
        Log densities under each pick.
    scratch : ndarray, shape (rows N,)
        Work space of the model.
    bins : ndarray of int, shape (power of two,)
        Set of occupied bins.
    numbers : ndarray, shape (9,)
        n, whether begun, whether anything was measured yet, sum of weights, effective sample size, short- and long-term
        average likelihood of a reading, whether all weights are equal, and the
        probability that the robot is somewhere else.
    """

    particles: Float
    before: Float
    spare: Float
    proposed: Float
    log_weights: Float
    weights: Float
    log_like: Float
    new_like: Float
    log_start: Float
    new_start: Float
    rate: Float
    spread: Float
    ancestors: Int
    order: Int
    which: Int
    counts: Int
    shuffled: Int
    log_densities: Float
    scratch: Float
    bins: Int
    numbers: Float


def new_state(options: Options, size: int, rows: int) -> FilterState:
    """Make the memory of a filter.

    Parameters
    ----------
    options : Options
        Number of particles and draws.
    size : int
        Components D of a state.
    rows : int
        Rows of scratch space that the tables ask for.
    """
    most = max(options.particles, options.most)
    bins = 1
    while bins < 4 * most:
        bins *= 2

    def floats(count: int) -> Float:
        return np.zeros(count)

    def ints(count: int) -> Int:
        return np.zeros(count, dtype=np.int64)

    return FilterState(
        floats(size * most), floats(size * most), floats(2 * size * most), floats(size * most),
        floats(most), floats(most), floats(most), floats(most), floats(most), floats(most), floats(2 * most),
        floats(size),
        ints(most), ints(most), ints(most), ints(options.draws + 1), np.arange(options.draws, dtype=np.int64),
        floats(options.picks * most), floats(rows * most), ints(bins), floats(9),
    )  # fmt: skip
