"""Localize the same log many times: how good a filter is, beyond the luck of one run."""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl import defaults
from pmcl.checks import check_memory, check_seed, check_whole
from pmcl.errors import FilterError
from pmcl.filtering.particle_filter import make_rng
from pmcl.interrupts import check_interrupt, stopping_on_interrupt
from pmcl.localization.metrics import nees, pose_errors, rmse
from pmcl.localization.options import FilterOptions
from pmcl.localization.setup import Prepared, prepare
from pmcl.logs.robot_log import RobotLog
from pmcl.models.robot_model import RobotModel
from pmcl.posterior.compat import Posterior
from pmcl.sampling.pool import as_pool

__all__ = ["Runs", "localize_many", "run_seeds"]

Float = NDArray[np.float64]

# Parts into which runs are divided for a pool whose size is not known.
_PARTS = 32
_ARRAYS = ("pose_mean", "log_score", "effective_size", "lost_at", "position_error", "heading_error", "nees")


@dataclass(frozen=True, eq=False)
class Runs:
    """R runs of a filter over one log of T rows.

    Attributes
    ----------
    seeds : tuple of int
        Seed of each run: ``localize(..., seed=seeds[r])`` is run r.
    pose_mean : ndarray, shape (R, T, 3)
        Mean poses [m, m, rad]; NaN from the row on at which a run lost the robot.
    log_score : ndarray, shape (R, T)
        Log predictive densities [nat].
    effective_size : ndarray, shape (R, T)
        Effective sample sizes.
    lost_at : ndarray of int, shape (R,)
        Row at which every particle had weight zero; -1 for a run that went through.
    position_error, heading_error : ndarray, shape (R, T)
        Distance to the reference [m] and heading error [rad]; NaN where there is none.
    nees : ndarray, shape (R, T)
        Normalised squared position error, see :func:`pmcl.localization.metrics.nees`.
    """

    seeds: tuple[int, ...]
    pose_mean: Float
    log_score: Float
    effective_size: Float
    lost_at: NDArray[np.int64]
    position_error: Float
    heading_error: Float
    nees: Float

    @property
    def position_rmse(self) -> Float:
        """Root mean square position error of each run [m], shape (R,)."""
        return rmse(self.position_error)

    @property
    def heading_rmse(self) -> Float:
        """Root mean square heading error of each run [rad], shape (R,)."""
        return rmse(self.heading_error)

    @property
    def log_evidence(self) -> Float:
        """Log predictive density of all readings, for each run [nat], shape (R,)."""
        return np.asarray(self.log_score.sum(axis=1))


def run_seeds(seed: int, repetitions: int) -> tuple[int, ...]:
    """Return the seeds of the runs that :func:`localize_many` makes.

    Parameters
    ----------
    seed : int
        The seed of all runs.
    repetitions : int
        Number of runs.

    Returns
    -------
    tuple of int
        One for each run.
    """
    return tuple(int(value) for value in np.random.SeedSequence(seed).generate_state(repetitions, dtype=np.uint64))


@stopping_on_interrupt()
def localize_many(
    log: RobotLog,
    model: RobotModel | None = None,
    posterior: Posterior | None = None,
    method: str = "mean",
    *,
    theta: Mapping[str, float] | None = None,
    repetitions: int = 1000,
    particles: int = defaults.LOCALIZATION_PARTICLES,
    seed: int = 0,
    options: FilterOptions | None = None,
    threads: int | None = None,
    pool: Any = None,
) -> Runs:
    """Run the filter over a log again and again, with other random numbers each time.

    Parameters
    ----------
    log, model, posterior, method, theta, particles, options
        As for :func:`pmcl.localization.offline.localize`.
    repetitions : int
        Number of runs R.
    seed : int
        All randomness follows from it, whatever the number of threads.
    threads : int, optional
        Number of threads; all cores when left out. The compiled filter does not hold the interpreter's lock. Of another
        pool, the number of parts into which the runs are divided; 32 when left out.
    pool : object with a `map` method, optional
        Makes the runs in place of threads: an executor of :mod:`concurrent.futures`, a ``dask.distributed`` client, or
        any other pool. The filter is sent once with each part.

    Returns
    -------
    Runs
        Cost: O(R T n); memory O(R T).

    Raises
    ------
    PmclError
        When log, model, posterior and settings do not fit each other. A run that loses the robot is no error here.
    """
    repetitions = check_whole("repetitions", repetitions, 1, error=FilterError, advice="1000 are usual")
    if threads is not None:
        threads = check_whole("threads", threads, 1, error=FilterError, advice="leave it out to use all cores")
    if pool is not None and not callable(getattr(pool, "map", None)):
        raise FilterError(f"expected pool with a method map, but got {type(pool).__name__}; leave it out for threads")
    seed = check_seed(seed, error=FilterError)
    prepared = prepare(log, model, posterior, method, theta, particles, options)
    check_memory("the runs", 72.0 * repetitions * log.n_steps, error=FilterError, advice="ask for fewer repetitions")
    seeds = run_seeds(seed, repetitions)
    size = min(prepared.tracker.size, 3)
    runs = _empty_runs(seeds, log.n_steps, size)
    parts = threads or (os.cpu_count() or 1 if pool is None else _PARTS)
    chunks = np.array_split(np.arange(repetitions), min(parts, repetitions))
    if pool is None:
        with ThreadPoolExecutor(len(chunks)) as executor:
            for _ in executor.map(lambda chunk: _run_chunk(prepared, runs, chunk), chunks):
                pass
        return runs
    elsewhere = _Elsewhere(prepared, size)
    parts_of_runs = as_pool(pool).map(elsewhere, [tuple(seeds[r] for r in chunk) for chunk in chunks])
    for chunk, part in zip(chunks, parts_of_runs, strict=True):
        for name in _ARRAYS:
            getattr(runs, name)[chunk] = getattr(part, name)
    return runs


def _empty_runs(seeds: tuple[int, ...], n_steps: int, size: int) -> Runs:
    """Return runs with room for their numbers."""
    shape = len(seeds), n_steps
    return Runs(
        seeds,
        np.full((*shape, size), np.nan),
        np.full(shape, np.nan),
        np.full(shape, np.nan),
        np.full(len(seeds), -1, dtype=np.int64),
        *(np.full(shape, np.nan) for _ in range(3)),
    )


class _Elsewhere:
    """Makes some runs in another process, given their seeds."""

    def __init__(self, prepared: Prepared, size: int) -> None:
        self.prepared, self.size = prepared, size

    def __call__(self, seeds: tuple[int, ...]) -> Runs:
        runs = _empty_runs(seeds, self.prepared.log.n_steps, self.size)
        _run_chunk(self.prepared, runs, np.arange(len(seeds)))
        return runs


def _run_chunk(prepared: Prepared, runs: Runs, chunk: NDArray[np.int64]) -> None:
    """Fill the rows of some runs, with one filter after the other in the same memory."""
    tracker, log = prepared.tracker.share(), prepared.log
    reference = log.true_poses if runs.pose_mean.shape[2] == 3 else None
    for r in chunk:
        check_interrupt()
        tracker.forget()
        beliefs, lost_at = tracker.run_until_lost(0, log.n_steps, prepared.counts, make_rng(runs.seeds[r]), log.where)
        mean = beliefs.mean[:, : runs.pose_mean.shape[2]]
        runs.pose_mean[r], runs.lost_at[r] = mean, lost_at
        runs.log_score[r], runs.effective_size[r] = beliefs.log_score, beliefs.effective_size
        if reference is not None:
            errors = pose_errors(mean, reference)
            runs.position_error[r], runs.heading_error[r] = errors
            runs.nees[r] = nees(mean, beliefs.covariance[:, :3, :3], reference)
