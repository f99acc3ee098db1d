"""Estimates of the evidence whose random numbers are part of the state of a chain.

The bootstrap filter's estimate of p(readings | theta) is unbiased, so a chain on theta and on the random numbers of the
estimate has the exact posterior (Andrieu and Roberts 2009). The random numbers of the rows of a log are made in blocks,
each from a seed of its own. A proposal that redraws one block of B and keeps the others gives an estimate that is
correlated with the old one by about 1 - 1/B, so that far fewer particles will do: this is the correlated
pseudo-marginal method of Deligiannidis, Doucet, Pitt (2018) with block updates (Tran, Kohn, Quiroz, Villani 2016) in
place of an autoregression of normal deviates, because a motion model may draw whatever random numbers it likes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import ModelError, SamplingError
from pmcl.filtering.kernels import stepwise
from pmcl.filtering.kernels.weighing import ALL_ZERO, FINE
from pmcl.filtering.particle_filter import FilterPass, check_particles, draw_paths, log_joint, make_rng, raise_outcome
from pmcl.interrupts import check_interrupt
from pmcl.models.robot_model import BoundModel
from pmcl.models.tables import Tables
from pmcl.sampling.state import state_dimension

__all__ = ["EvidenceEstimate", "chosen_particles", "draw_numbers", "estimate_evidence", "paths_of", "redrawn_ratio"]

Float = NDArray[np.float64]
Numbers = NDArray[np.uint64]

# The standard deviation of the log of the ratio of two estimates in a proposal: 1.7 is that of independent estimates
# with a standard deviation of 1.2 each, which is best for them (Doucet, Pitt, Deligiannidis, Kohn 2015), and near what
# is best for correlated ones (Deligiannidis, Doucet, Pitt 2018, section 4.3).
BEST_RATIO_SPREAD = 1.7
# How it is measured: pairs of estimates with so many particles, in so many attempts with four times as many when the
# filter loses the robot or the spread is beyond measure; and the fewest and most particles that are chosen.
_PAIRS, _PILOT, _ATTEMPTS, _MEASURABLE = 16, 128, 4, 12.0
_FEWEST, _MOST = 16, 20_000


class EvidenceEstimate(NamedTuple):
    """An estimate of the evidence, and the filters that it comes from.

    Attributes
    ----------
    log_evidence : float
        Its logarithm [nat]; minus infinity where theta is impossible or every particle died.
    tables : tuple of Tables
        Tables of each log; empty where theta is impossible.
    passes : tuple of FilterPass
        The filter of each log; empty where there is none.
    """

    log_evidence: float
    tables: tuple[Tables, ...] = ()
    passes: tuple[FilterPass, ...] = ()


def draw_numbers(rng: np.random.Generator, blocks: int) -> Numbers:
    """Return seeds of all blocks and, last, of the trajectory, (blocks + 1,)."""
    return rng.integers(0, 2**63, size=blocks + 1, dtype=np.uint64)


def estimate_evidence(
    bound: BoundModel, theta: Float, particles: int, numbers: Numbers, *, ordered: bool | None = None
) -> EvidenceEstimate:
    """Estimate the evidence of all logs; a function of its arguments.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    theta : ndarray, shape (d,)
        Parameters.
    particles : int
        Number of particles.
    numbers : ndarray of uint64, shape (B + 1,)
        Seeds, see :func:`draw_numbers`. Rows of each log are shared out evenly among the B blocks.
    ordered : bool, optional
        Whether particles are resampled in the order of a Hilbert curve, which correlated estimates need; by default
        where there is more than one block.

    Returns
    -------
    EvidenceEstimate

    Raises
    ------
    FilterError
        When a density is not a number.
    """
    check_interrupt()
    check_particles(particles)
    blocks = numbers.size - 1
    ordered = blocks > 1 if ordered is None else ordered
    try:
        bound.check(theta)
        all_tables = bound.tables(theta)
    except ModelError:
        return EvidenceEstimate(-math.inf)
    size, passes = state_dimension(bound), []
    for number, (tables, length) in enumerate(zip(all_tables, bound.lengths, strict=True)):
        states, log_weights = np.empty((length, size, particles)), np.empty((length, particles))
        ancestors, increments = np.zeros((length, particles), np.uint32), np.empty(length)
        bounds = np.linspace(0, length, blocks + 1).astype(int)
        weighted = False
        for seed, begin, stop in zip(numbers[:-1], bounds[:-1], bounds[1:], strict=True):
            if begin == stop:
                continue
            rng = make_rng(np.random.SeedSequence((int(seed), number)))
            status, row, weighted = stepwise.filter_rows(
                tables, rng, int(begin), int(stop), ordered, weighted, states, log_weights, ancestors, increments
            )
            if status == ALL_ZERO:
                return EvidenceEstimate(-math.inf)
            if status != FINE:
                raise_outcome(status, row, "particle filter")
        nothing = np.empty(0)
        passes.append(FilterPass(float(increments.sum()), states, log_weights, increments, nothing, ancestors))
    return EvidenceEstimate(math.fsum(each.log_evidence for each in passes), all_tables, tuple(passes))


def paths_of(estimate: EvidenceEstimate, seed: int) -> tuple[list[Float], float]:
    """Draw one trajectory of each log backward from the filters of an estimate.

    Parameters
    ----------
    estimate : EvidenceEstimate
        An estimate with its filters.
    seed : int
        The draw is a function of it.

    Returns
    -------
    paths : list of ndarray, shape (T_l, D)
    log_joint : float
        Log density of trajectories and readings given theta.
    """
    rng = make_rng(np.random.SeedSequence(seed))
    paths = [
        draw_paths(tables, filtered, 1, rng)[0]
        for tables, filtered in zip(estimate.tables, estimate.passes, strict=True)
    ]
    return paths, math.fsum(log_joint(tables, path) for tables, path in zip(estimate.tables, paths, strict=True))


def redrawn_ratio(bound: BoundModel, theta: Float, blocks: int) -> Callable[[int, np.random.Generator], float]:
    """Return a function (particles, generator) -> log of the ratio of two estimates of which one block differs."""

    def log_ratio(particles: int, rng: np.random.Generator) -> float:
        numbers = draw_numbers(rng, blocks)
        first = estimate_evidence(bound, theta, particles, numbers).log_evidence
        numbers[rng.integers(blocks)] = draw_numbers(rng, 0)[0]
        return estimate_evidence(bound, theta, particles, numbers).log_evidence - first

    return log_ratio


def chosen_particles(log_ratio: Callable[[int, np.random.Generator], float], seed: int) -> int:
    """Return the number of particles with which the log of the ratio of two estimates has the best standard deviation.

    Parameters
    ----------
    log_ratio : callable
        (particles, generator) to one draw of that logarithm, at a theta near the posterior's centre.
    seed : int
        All randomness follows from it.

    Returns
    -------
    int
        The variance of the log of an estimate falls as one over the number of particles, so it is measured once.

    Raises
    ------
    SamplingError
        When the filter loses the robot with thousands of particles.
    """
    rng = make_rng(np.random.SeedSequence((seed, 37)))
    particles = _PILOT
    for _ in range(_ATTEMPTS):
        ratios: list[float] = []
        while len(ratios) < _PAIRS and all(math.isfinite(ratio) for ratio in ratios):
            ratios.append(log_ratio(particles, rng))
        spread = math.sqrt(float(np.mean(np.square(ratios))))
        if spread < _MEASURABLE:
            needed = math.ceil(particles * (spread / BEST_RATIO_SPREAD) ** 2)
            return min(max(needed, _FEWEST), _MOST)
        particles *= 4
    raise SamplingError(
        f"the particle filter's estimates of the evidence scatter too much even with {particles // 4} particles; use "
        "method particle-gibbs, a shorter log, or a model with outliers"
    )
