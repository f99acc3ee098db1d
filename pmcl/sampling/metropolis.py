"""The Metropolis block of Table 1: theta given the trajectories, one dimension at a time (eq. 17)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from pmcl.filtering.kernels.metropolis import metropolis_block
from pmcl.filtering.not_a_number import check_density
from pmcl.filtering.particle_filter import log_joint
from pmcl.filtering.statistics import block_statistics
from pmcl.models.parameters import prior_rows
from pmcl.models.robot_model import BoundModel
from pmcl.models.tables import Tables

__all__ = ["TARGET_ACCEPTANCE", "update_theta"]

Float = NDArray[np.float64]

# Best acceptance of a one-dimensional Gaussian random walk (Roberts, Gelman, Gilks 1997).
TARGET_ACCEPTANCE = 0.44


def update_theta(
    bound: BoundModel,
    theta: Float,
    tables: Sequence[Tables],
    paths: Sequence[Float],
    log_step: Float,
    n_sweeps: int,
    gain: float,
    rng: np.random.Generator,
) -> tuple[Float, Float, Float]:
    """Draw theta given the trajectories by `n_sweeps` rounds of one-dimensional random walks.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    theta : ndarray, shape (d,)
        Current parameters.
    tables : sequence of Tables
        Coefficients of each log at `theta`.
    paths : sequence of ndarray, shape (l, D)
        Trajectories over the rows included.
    log_step : ndarray, shape (d,)
        Logs of the proposals' standard deviations.
    n_sweeps : int
        The paper's m.
    gain : float
        Adaptation during burn-in; 0 freezes the steps.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    theta, log_step, accepted : ndarray, shape (d,)
        New arrays. Cost: O(readings) once, then O(d) for each round where sums of squares suffice. Parameters without
        such statistics (those of effects, and noise that an effect reshapes) are updated after the others, with the
        joint density evaluated at every proposal.

    Raises
    ------
    DensityError
        When a density is not a number, with the parameters at which it is not.
    """
    theta, log_step, accepted = theta.copy(), log_step.copy(), np.zeros(theta.size)
    if n_sweeps == 0:
        return theta, log_step, accepted
    covered = np.empty(0, dtype=np.int64)
    if bound.priors is not None:
        statistics, covered = block_statistics(bound, theta, tables, paths)
        if covered.size:
            values, steps, shares = theta[covered], log_step[covered], accepted[covered]
            priors = bound.priors if covered.size == theta.size else prior_rows(bound.priors, covered)
            sound = metropolis_block(
                rng, values, steps, n_sweeps, gain, TARGET_ACCEPTANCE, priors, statistics, shares
            )
            theta[covered], log_step[covered], accepted[covered] = values, steps, shares
            if not sound:
                check_density(math.nan, bound, theta, paths)
    if covered.size == theta.size:
        return theta, log_step, accepted
    rest = np.setdiff1d(np.arange(theta.size), covered)

    def log_density(trial: Float) -> float:
        prior = bound.log_prior(trial)
        if prior == -math.inf:
            return prior
        parts = (log_joint(table, path) for table, path in zip(bound.tables(trial), paths, strict=True))
        return prior + check_density(math.fsum(parts), bound, trial, paths)

    _random_walk(log_density, theta, log_step, rest, n_sweeps, gain, rng, accepted)
    return theta, log_step, accepted


def _random_walk(
    log_density: Callable[[Float], float],
    theta: Float,
    log_step: Float,
    positions: NDArray[np.int64],
    n_sweeps: int,
    gain: float,
    rng: np.random.Generator,
    accepted: Float,
) -> None:
    """Update some parameters as the compiled block does, with any log density; arrays change in place.

    Parameters
    ----------
    log_density : callable
        Log density of theta given the trajectories, up to a constant.
    theta, log_step, accepted : ndarray, shape (d,)
        Parameters, logs of the proposals' standard deviations, and shares of accepted proposals; all are updated.
    positions : ndarray of int
        Which parameters are updated.
    n_sweeps : int
        Rounds.
    gain : float
        Adaptation of the steps; 0 freezes them.
    rng : numpy.random.Generator
        Source of randomness.
    """
    current = log_density(theta)
    for _ in range(n_sweeps):
        for k in positions:
            trial = theta.copy()
            trial[k] += math.exp(log_step[k]) * rng.standard_normal()
            value = log_density(trial)
            accept = math.log(rng.random()) < value - current
            if accept:
                theta[k], current = trial[k], value
                accepted[k] += 1.0 / n_sweeps
            log_step[k] += gain * (float(accept) - TARGET_ACCEPTANCE)
