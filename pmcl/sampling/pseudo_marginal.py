"""Estimates of the evidence whose random numbers are part of the state of a chain.

The estimates of p(readings | theta) by a bootstrap filter and by a guided one are unbiased, so a chain on theta and on
the random numbers of the estimate has the exact posterior (Andrieu and Roberts 2009). The random numbers of the rows of
a log are made in blocks, each from a seed of its own. A proposal that redraws one block of B and keeps the others gives
an estimate that is correlated with the old one by about 1 - 1/B, so that far fewer particles will do: this is the
correlated pseudo-marginal method of Deligiannidis, Doucet, Pitt (2018) with block updates (Tran, Kohn, Quiroz, Villani
2016) in place of an autoregression of normal deviates, because a motion model may draw whatever random numbers it
likes.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import FilterError, ModelError, SamplingError
from pmcl.filtering.guided_filter import guide_along, looks_back_anywhere, needed_counts, run_guided
from pmcl.filtering.kernels import stepwise
from pmcl.filtering.kernels.weighing import ALL_ZERO, FINE
from pmcl.filtering.linearised_evidence import LinearisedEvidence
from pmcl.filtering.particle_filter import FilterPass, check_particles, draw_paths, log_joint, make_rng, raise_outcome
from pmcl.interrupts import check_interrupt
from pmcl.models.robot_model import BoundModel
from pmcl.models.tables import Tables
from pmcl.sampling.near_mode import NearMode
from pmcl.sampling.state import state_dimension
from pmcl.sampling.transforms import Unconstrained

__all__ = [
    "BootstrapEvidence", "EvidenceEstimate", "EvidenceFilter", "GuidedEvidence", "chosen_particles",
    "draw_numbers", "evidence_filter", "paths_of", "redrawn_ratio",
]  # fmt: skip

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


class KeptPass(Protocol):
    """A filter of one log, with all of its particles."""

    @property
    def log_evidence(self) -> float:
        """Log of the unbiased estimate of p(readings | theta)."""

    @property
    def effective_share(self) -> float:
        """Mean effective sample size of the rows with readings, as a share of the particles."""

    def draw_path(self, tables: Tables, rng: np.random.Generator) -> Float:
        """Return a path (T, D) of this filter."""


class BootstrapPass(FilterPass):
    """A pass of the bootstrap filter, as :class:`KeptPass` has it."""

    @property
    def effective_share(self) -> float:
        """Mean effective sample size of the rows with readings, as a share of the particles."""
        weights = np.exp(self.log_weights - self.log_weights.max(axis=1, keepdims=True))
        share = weights.sum(axis=1) ** 2 / (weights**2).sum(axis=1) / weights.shape[1]
        read = self.log_increments != 0.0
        return float(share[read].mean()) if read.any() else 1.0

    def draw_path(self, tables: Tables, rng: np.random.Generator) -> Float:
        """Return a path (T, D), drawn backward."""
        return np.asarray(draw_paths(tables, self, 1, rng)[0])


class EvidenceEstimate(NamedTuple):
    """An estimate of the evidence, and the filters that it comes from.

    Attributes
    ----------
    log_evidence : float
        Its logarithm [nat]; minus infinity where theta is impossible or every particle died.
    tables : tuple of Tables
        Tables of each log; empty where theta is impossible.
    passes : tuple of KeptPass
        The filter of each log; empty where there is none.
    """

    log_evidence: float
    tables: tuple[Tables, ...] = ()
    passes: tuple[KeptPass, ...] = ()


class EvidenceFilter(Protocol):
    """A filter that estimates the evidence; it can be pickled."""

    bound: BoundModel

    def __call__(
        self, theta: Float, particles: int, numbers: Numbers, *, ordered: bool | None = None
    ) -> EvidenceEstimate:
        """Estimate the evidence of all logs; a function of its arguments.

        Parameters
        ----------
        theta : ndarray, shape (d,)
            Parameters.
        particles : int
            Number of particles.
        numbers : ndarray of uint64, shape (B + 1,)
            Seeds, see :func:`draw_numbers`. Rows of each log are shared out evenly among the B blocks.
        ordered : bool, optional
            Whether particles are resampled in the order of a Hilbert curve, which correlated estimates need; by default
            where there is more than one block.

        Raises
        ------
        DensityError
            When a density is not a number.
        """


def draw_numbers(rng: np.random.Generator, blocks: int) -> Numbers:
    """Return seeds of all blocks and, last, of the trajectory, (blocks + 1,)."""
    return rng.integers(0, 2**63, size=blocks + 1, dtype=np.uint64)


class BootstrapEvidence:
    """An :class:`EvidenceFilter` that draws each state from the motion model, as most particle filters do.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    """

    def __init__(self, bound: BoundModel) -> None:
        self.bound = bound

    def __call__(
        self, theta: Float, particles: int, numbers: Numbers, *, ordered: bool | None = None
    ) -> EvidenceEstimate:
        """Return the estimate with these random numbers, see :class:`EvidenceFilter`."""
        check_interrupt()
        check_particles(particles)
        ordered = numbers.size > 2 if ordered is None else ordered
        all_tables = _possible_tables(self.bound, theta)
        size, passes = state_dimension(self.bound), []
        for number, tables in enumerate(all_tables):
            length = self.bound.lengths[number]
            states, log_weights = np.empty((length, size, particles)), np.empty((length, particles))
            ancestors, increments = np.zeros((length, particles), np.uint32), np.empty(length)
            bounds = np.linspace(0, length, numbers.size).astype(int)
            weighted = False
            for rng, begin, stop in zip(_generators(numbers, number), bounds[:-1], bounds[1:], strict=True):
                if begin == stop:
                    continue
                status, row, weighted = stepwise.filter_rows(
                    tables, rng, int(begin), int(stop), ordered, weighted, states, log_weights, ancestors, increments
                )
                if status == ALL_ZERO:
                    return EvidenceEstimate(-math.inf)
                if status != FINE:
                    raise_outcome(status, row, "particle filter")
            nothing = np.empty(0)
            passes.append(
                BootstrapPass(float(increments.sum()), states, log_weights, increments, nothing, ancestors)
            )
        return _estimate(all_tables, passes)


class GuidedEvidence:
    """An :class:`EvidenceFilter` that is guided along the most probable path (:mod:`pmcl.filtering.guided_filter`).

    Path and numbers of particles of each row are those near the mode, and stay as they are. A theta whose linearised
    model has no Gaussian path there is left to the bootstrap filter.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    near : NearMode
        Where the posterior is, and the paths.
    seed : int
        The pilot that tells the rows' particles follows from it.

    Raises
    ------
    FilterError
        When even near the mode there is no Gaussian path, or every particle of the pilot gets weight zero.
    DensityError
        When a density is not a number.
    """

    def __init__(self, bound: BoundModel, near: NearMode, seed: int) -> None:
        theta = Unconstrained(bound.parameters).from_line(near.centre)[0]
        self.bound, self._bootstrap = bound, BootstrapEvidence(bound)
        self._linearised = LinearisedEvidence(bound, theta, near.references)
        self._rows: list[tuple[Float, bool]] = []
        rng = make_rng(np.random.SeedSequence((seed, 47)))
        for number, tables in enumerate(bound.tables(theta)):
            guide = guide_along(self._linearised, number, tables)
            if guide is None:
                raise FilterError(f"{bound.logs[number].where}: the linearised model has no Gaussian path")
            counts = np.full(bound.lengths[number], _PILOT)
            effective = run_guided(tables, guide, counts, [rng]).steps[:, 1]
            self._rows.append((effective, looks_back_anywhere(tables)))

    def __call__(
        self, theta: Float, particles: int, numbers: Numbers, *, ordered: bool | None = None
    ) -> EvidenceEstimate:
        """Return the estimate with these random numbers, see :class:`EvidenceFilter`."""
        check_particles(particles)
        ordered = numbers.size > 2 if ordered is None else ordered
        all_tables = _possible_tables(self.bound, theta)
        guides = [guide_along(self._linearised, *of_log) for of_log in enumerate(all_tables)]
        passes: list[Any] = []
        for number, (tables, guide) in enumerate(zip(all_tables, guides, strict=True)):
            if guide is None:
                return self._bootstrap(theta, particles, numbers, ordered=ordered)
            counts, rngs = needed_counts(particles, *self._rows[number]), _generators(numbers, number)
            try:
                passes.append(run_guided(tables, guide, counts, rngs, ordered=ordered, with_history=True))
            except FilterError:
                return EvidenceEstimate(-math.inf)
        return _estimate(all_tables, passes)


def evidence_filter(name: str, bound: BoundModel, near: NearMode, seed: int) -> EvidenceFilter:
    """Return the filter of a name; the bootstrap filter where the guided one finds no path.

    Parameters
    ----------
    name : {"guided", "bootstrap"}
        Which.
    bound, near, seed
        As for :class:`GuidedEvidence`.
    """
    if name == "guided":
        with contextlib.suppress(FilterError):
            return GuidedEvidence(bound, near, seed)
    return BootstrapEvidence(bound)


def _possible_tables(bound: BoundModel, theta: Float) -> tuple[Tables, ...]:
    """Return the tables of each log; none where theta is impossible."""
    try:
        bound.check(theta)
        return tuple(bound.tables(theta))
    except ModelError:
        return ()


def _generators(numbers: Numbers, log: int) -> list[np.random.Generator]:
    return [make_rng(np.random.SeedSequence((int(seed), log))) for seed in numbers[:-1]]


def _estimate(all_tables: tuple[Tables, ...], passes: Sequence[KeptPass]) -> EvidenceEstimate:
    if not all_tables:
        return EvidenceEstimate(-math.inf)
    return EvidenceEstimate(math.fsum(one.log_evidence for one in passes), all_tables, tuple(passes))


def paths_of(estimate: EvidenceEstimate, seed: int) -> tuple[list[Float], float]:
    """Draw one trajectory of each log from the filters of an estimate.

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
    paths = [one.draw_path(tables, rng) for tables, one in zip(estimate.tables, estimate.passes, strict=True)]
    return paths, math.fsum(log_joint(tables, path) for tables, path in zip(estimate.tables, paths, strict=True))


def redrawn_ratio(
    estimate: EvidenceFilter, theta: Float, blocks: int = 1
) -> Callable[[int, np.random.Generator], float]:
    """Return a function (particles, generator) -> log of the ratio of two estimates of which one block differs."""

    def log_ratio(particles: int, rng: np.random.Generator) -> float:
        numbers = draw_numbers(rng, blocks)
        first = estimate(theta, particles, numbers).log_evidence
        numbers[rng.integers(blocks)] = draw_numbers(rng, 0)[0]
        return estimate(theta, particles, numbers).log_evidence - first

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
