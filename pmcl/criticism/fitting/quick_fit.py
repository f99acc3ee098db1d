"""A quick calibration by one short chain, which takes seconds instead of minutes.

It runs the same sweeps and transport moves as :mod:`pmcl.sampling`, without emcee, and may start from an earlier fit.
The critic fits many models in this way; its final model is calibrated by several long chains
(:func:`pmcl.calibration.workflow.calibrate`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import ModelError
from pmcl.filtering.estimated_path import START_PARTICLES, plausible_theta
from pmcl.filtering.particle_filter import make_rng, update_path
from pmcl.models.robot_model import BoundModel
from pmcl.models.tables import Tables
from pmcl.sampling.state import ChainState, state_dimension
from pmcl.sampling.sweep import SweepSettings, step
from pmcl.sampling.transforms import Unconstrained
from pmcl.sampling.transport import Proposal, Transport, linearised_at

__all__ = ["BRIEF", "GLANCE", "LONG", "THOROUGH", "Effort", "Fit", "quick_fit"]

Float = NDArray[np.float64]

# Standard deviation of the first proposals of transport moves, in unconstrained parameters (chosen by hand).
_FIRST_PROPOSAL = 0.1
# About so many draws of the path are those that the linearised readings are fitted to, as in a calibration.
_FITTED_PATHS = 40
# Gain of the adaptation of Metropolis steps in each sweep (chosen by hand).
_GAIN = 0.05
# A chain has not converged when the means of its halves differ by more than this many of its standard deviations; it
# is then continued, see Effort.continued. Chosen by hand.
_DRIFT = 1.3


class Effort(NamedTuple):
    """Length of a fit.

    Attributes
    ----------
    settling : int
        Sweeps of burn-in without transport moves.
    rounds : tuple of int
        Sweeps of each round that tunes the proposals of transport moves.
    draws : int
        Sweeps that are kept.
    particles : int
        Particles of a sweep.
    passes : int
        Passes of the filter that scores the rows of the log afterwards.
    continued : int
        How often the chain is continued at most, by `draws` sweeps, where it has not converged at the end.
    """

    settling: int
    rounds: tuple[int, ...]
    draws: int
    particles: int
    passes: int = 4
    continued: int = 3


# The lengths are chosen by hand; a glance differs from a brief fit by some 4 nats on the logs of
# analyses/hidden_effects, and is not continued: the means of so few draws differ by accident.
THOROUGH = Effort(12, (24, 40), 100, 24)
"""Long enough for posterior means and standard deviations."""
LONG = THOROUGH._replace(draws=300)
"""Long enough for intervals: half as many draws may give half of the true standard deviation."""
BRIEF = Effort(6, (12, 24), 60, 16)
"""Long enough to compare models: an estimate half a standard deviation off loses an eighth of a nat."""
GLANCE = Effort(6, (18,), 18, 16, passes=1, continued=0)
"""Long enough to find the models that are far behind others."""


@dataclass(frozen=True)
class Fit:
    """The result of a quick calibration.

    Attributes
    ----------
    bound : BoundModel
        The model bound to the log.
    theta, std : ndarray, shape (d,)
        Posterior mean and standard deviation of the parameters.
    draws : ndarray, shape (N, d)
        The draws.
    path : ndarray, shape (T, D)
        Posterior mean path, headings not wrapped [m, m, rad].
    path_std : ndarray, shape (T, D)
        Its posterior standard deviation.
    drawn_path : ndarray, shape (T, D)
        The last trajectory of the chain: a draw given all readings, where `path` is the mean of many.
    """

    bound: BoundModel
    theta: Float
    std: Float
    draws: Float
    path: Float
    path_std: Float
    drawn_path: Float

    @property
    def tables(self) -> Tables:
        """Coefficient tables at the posterior mean."""
        return self.bound.tables(self.theta)[0]

    @property
    def paths(self) -> tuple[Float, Float]:
        """The mean of the chain's paths, and the last of them."""
        return self.path, self.drawn_path

    def values(self) -> dict[str, float]:
        """Return the posterior mean by name."""
        return dict(zip(self.bound.names, self.theta.tolist(), strict=True))


def quick_fit(
    bound: BoundModel,
    seed: int,
    *,
    theta: Float | None = None,
    path: Float | None = None,
    draws: Float | None = None,
    effort: Effort = THOROUGH,
) -> Fit:
    """Calibrate a model on one log by a single short chain.

    Parameters
    ----------
    bound : BoundModel
        The model bound to one log.
    seed : int
        Determines all random numbers.
    theta : ndarray, shape (d,), optional
        Parameters to start from; when left out, the mean of `draws`, or without these a plausible value.
    path : ndarray, shape (T, D), optional
        A trajectory to start from; drawn by a filter when left out. State components that the model lacks are dropped,
        those that only the model has start at zero.
    draws : ndarray, shape (N, d), optional
        Draws of an earlier fit of the same model, of these rows or others; they need a path as well. The chain goes
        on from there: they tune its first transport moves, there is no burn-in, and only the last round of tuning is
        run.
    effort : Effort
        Length of the chain. Where it is continued, only the last part is kept.

    Returns
    -------
    Fit

    Raises
    ------
    FilterError
        When no start lets the filter follow the robot.
    ModelError
        When `path` is not as long as the log.
    """
    rng = make_rng(np.random.SeedSequence(seed))
    transform = Unconstrained(bound.parameters)
    if theta is None:
        theta = plausible_theta(bound, rng) if draws is None else draws.mean(axis=0)
    particles = effort.particles
    # A Metropolis step of an effect's parameter costs a density of the whole log, and transport moves change these
    # parameters as well.
    metropolis = 2 if bound.effects else 5
    if path is None:
        path = np.zeros((bound.lengths[0], state_dimension(bound)))
        update_path(bound.tables(theta)[0], path, len(path), START_PARTICLES, rng, "smoothing")
        settings, draws = SweepSettings("smoothing", 10 * particles, 2 * metropolis, 0, 1, 0, _GAIN), None
    else:
        if len(path) != bound.lengths[0]:
            raise ModelError(f"expected a path of {bound.lengths[0]} rows to start from, but got {len(path)}")
        path = _of_size(path, state_dimension(bound))
        settings = SweepSettings("conditional", particles, 2 * metropolis, 0, 1, 0, _GAIN)
    state = _state(bound, theta, path, draws)
    transport: Transport | None = None
    if draws is None:
        plans = [(effort.settling, settings)]
        rounds = effort.rounds
    else:
        plans, rounds = [], effort.rounds[-1:]
        transport = _tuned(bound, transform, draws, path)
    tuning = SweepSettings("conditional", particles, metropolis, 6, 1, 0, _GAIN)
    plans += [(n, tuning) for n in rounds] + [(effort.draws, replace(tuning, gain=0.0))] * (1 + effort.continued)
    kept: list[ChainState] = []
    for number, (length, settings) in enumerate(plans):
        if number > len(plans) - 1 - effort.continued and not _drifts(kept):
            break
        if kept:
            later = kept[len(kept) // 3 :]
            thetas = np.array([state.theta for state in later])
            paths = np.array([state.path for state in later])
            transport = _tuned(bound, transform, thetas, paths.mean(axis=0), paths, number == 1 and draws is None)
        kept = []
        for _ in range(length):
            state, _ = step(bound, settings, transport, transform, state, int(rng.integers(2**62)))
            kept.append(state)
    thetas, paths = np.array([state.theta for state in kept]), np.array([state.path for state in kept])
    return Fit(bound, thetas.mean(axis=0), thetas.std(axis=0), thetas, paths.mean(axis=0), paths.std(axis=0), paths[-1])


def _drifts(kept: list[ChainState]) -> bool:
    """Return whether the means of a chain's halves differ too much."""
    thetas = np.array([state.theta for state in kept])
    halves = np.array([half.mean(axis=0) for half in np.array_split(thetas, 2)])
    return bool((np.abs(halves[0] - halves[1]) > _DRIFT * thetas.std(axis=0)).any())


def _of_size(path: Float, size: int) -> Float:
    """Return a path (T, D) with state components added (at zero) or dropped."""
    if path.shape[1] >= size:
        return np.ascontiguousarray(path[:, :size])
    return np.hstack([path, np.zeros((path.shape[0], size - path.shape[1]))])


def _state(bound: BoundModel, theta: Float, path: Float, draws: Float | None) -> ChainState:
    """Return a first state; Metropolis steps are a fifth of each parameter, or the spread of earlier draws."""
    log_step = np.log(np.maximum(0.2 * np.abs(theta) if draws is None else draws.std(axis=0), 1e-6))
    return ChainState(
        theta=theta.copy(), log_joint=0.0, path=path.copy(), log_step=log_step, log_scale=0.0, rows=bound.lengths[0],
        failed_updates=0,
    )  # fmt: skip


def _tuned(
    bound: BoundModel,
    transform: Unconstrained,
    thetas: Float,
    reference: Float,
    paths: Float | None = None,
    blind: bool = False,
) -> Transport | None:
    """Return transport moves linearised at the mean of some draws.

    Parameters
    ----------
    bound : BoundModel
        The model bound to one log.
    transform : Unconstrained
        Maps parameters to the real line.
    thetas : ndarray, shape (N, d)
        The draws; their covariance gives the proposals.
    reference : ndarray, shape (T, D)
        The path at which the model is linearised.
    paths : ndarray, shape (M, T, D), optional
        Draws of the path, to some of which the linearised readings are fitted.
    blind : bool
        Whether to use proposals of a fixed width instead, because the draws are too few.
    """
    d = thetas.shape[1]
    if blind:
        proposal = Proposal(_FIRST_PROPOSAL * np.eye(d))
    else:
        u = transform.to_line(thetas)
        covariance = np.atleast_2d(np.cov(u.T)) + 1e-8 * np.eye(d)
        root = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
        proposal = Proposal(2.38 / math.sqrt(d) * root, u.mean(axis=0), math.sqrt(1.2) * root)
    fitted = () if paths is None else (paths[:: max(1, len(paths) // _FITTED_PATHS)],)
    return linearised_at(bound, thetas.mean(axis=0), [reference], proposal, paths=fitted)
