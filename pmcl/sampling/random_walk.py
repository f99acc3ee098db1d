"""Adaptive random-walk Metropolis on theta alone: every walker of emcee is a chain of its own.

The path is integrated out by the target: a particle filter's estimate of the evidence, or that of a Kalman filter.
Proposals are Gaussian in unconstrained parameters. During burn-in their covariance is learnt between stages from the
draws of the stage before, pooled over the chains (Haario, Saksman, Tamminen, An adaptive Metropolis algorithm,
Bernoulli 7, 2001, in stages), and each chain's scale by Robbins and Monro; during the draws both are frozen, so that
the chain is an ordinary Markov chain.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from emcee.state import State
from numpy.typing import NDArray

from pmcl.errors import SamplingError
from pmcl.filtering.particle_filter import make_rng
from pmcl.interrupts import check_interrupt
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.advance import StageRunner
from pmcl.sampling.backends import StageBackend
from pmcl.sampling.chains import Chains
from pmcl.sampling.near_mode import NearMode
from pmcl.sampling.options import RunOptions, SettingValue
from pmcl.sampling.pseudo_marginal import draw_numbers
from pmcl.sampling.session import collected, run_session
from pmcl.sampling.stages import BURN_IN_SHARE
from pmcl.sampling.state import state_dimension
from pmcl.sampling.transforms import Unconstrained
from pmcl.sampling.walker_move import WalkerMove

__all__ = ["Evaluated", "EvidenceTarget", "WalkKit", "WalkPlan", "draw_near", "no_start", "run_random_walk", "run_walk"]

Float = NDArray[np.float64]
Numbers = NDArray[np.uint64]

# Chains start this much wider than the posterior is thought to be, so that R-hat can see chains that have not met.
_START_WIDTH = 2.0
_START_ATTEMPTS = 50
# Robbins-Monro gain of the scales during burn-in.
_GAIN = 0.05
# A stage teaches a covariance only when its chains moved so often for each parameter.
_LEAST_MOVES = 10


class Evaluated(NamedTuple):
    """The target at one theta.

    Attributes
    ----------
    log_evidence : float
        Log of p(readings | theta), exact or estimated [nat].
    finish : callable
        Returns trajectories (sum of T_l, D) that belong to it, and log p(trajectories, readings | theta). It is called
        only for a theta that is stored.
    """

    log_evidence: float
    finish: Callable[[], tuple[Float, float]]


class EvidenceTarget(Protocol):
    """What is sampled, times the prior; it can be pickled."""

    bound: BoundModel

    @property
    def blocks(self) -> int:
        """Blocks of random numbers, of which a proposal redraws one; 0 for a target without randomness."""

    def __call__(self, theta: Float, numbers: Numbers) -> Evaluated:
        """Return the target at `theta` with these random numbers (blocks + 1,)."""


class WalkPlan(NamedTuple):
    """How a random walk is run.

    Attributes
    ----------
    tuning : tuple of int
        Draws of each stage of burn-in.
    proposals : int
        Proposals from one stored draw to the next.
    acceptance : float
        Share of accepted proposals that burn-in aims at.
    """

    tuning: tuple[int, ...]
    proposals: int
    acceptance: float


_FIELDS = ("log_joint", "log_evidence", "acceptance_rate")


class _WalkMove(WalkerMove):
    """Some proposals for every walker."""

    def __init__(self, target: EvidenceTarget, plan: WalkPlan, root: Float, gain: float) -> None:
        self.target, self.plan, self.root, self.gain = target, plan, root, gain
        self.transform = Unconstrained(target.bound.parameters)

    def update(self, walker: tuple[int, Any, Any, int]) -> tuple[Any, float, Any]:
        """Return (theta, log_prob, blob) of one walker after the proposals, given (number, theta, blob, seed)."""
        _, theta, old, seed = walker
        check_interrupt()
        rng, bound, blob = make_rng(np.random.SeedSequence(seed)), self.target.bound, old.copy()
        u = self.transform.to_line(theta)
        theta, log_jacobian = np.array(theta), self.transform.from_line(u)[1]
        log_prior, log_evidence = bound.log_prior(theta), float(blob["log_evidence"])
        kept: Evaluated | None = None
        moved = 0
        for _ in range(self.plan.proposals):
            u_new = u + math.exp(blob["log_scale"]) * (self.root @ rng.standard_normal(u.size))
            numbers = blob["numbers"].copy()
            if self.target.blocks:
                numbers[rng.integers(self.target.blocks)] = draw_numbers(rng, 0)[0]
            numbers[-1] = draw_numbers(rng, 0)[0]
            log_uniform = math.log(rng.random())
            theta_new, jacobian_new = self.transform.from_line(u_new)
            prior_new, log_ratio, found = bound.log_prior(theta_new), -math.inf, None
            if prior_new > -math.inf:
                found = self.target(theta_new, numbers)
                log_ratio = found.log_evidence + prior_new + jacobian_new - log_evidence - log_prior - log_jacobian
            if found is not None and log_uniform < log_ratio:
                theta, u, log_jacobian, log_prior = theta_new, u_new, jacobian_new, prior_new
                log_evidence, kept = found.log_evidence, found
                blob["numbers"] = numbers
                moved += 1
            blob["log_scale"] += self.gain * (math.exp(min(log_ratio, 0.0)) - self.plan.acceptance)
        if kept is not None:
            blob["path"], joint = kept.finish()
            blob["log_joint"], blob["log_evidence"] = joint + log_prior, log_evidence
        blob["acceptance_rate"] = moved / self.plan.proposals
        return theta, log_prior + log_evidence, blob


def draw_near(near: NearMode, transform: Unconstrained, rng: np.random.Generator) -> Iterator[Float]:
    """Yield values of theta (d,) at which a chain may start: wide at first, then nearer and nearer to the mode."""
    root = np.linalg.cholesky(near.covariance)
    for attempt in range(_START_ATTEMPTS):
        width = _START_WIDTH * (1.0 - attempt / _START_ATTEMPTS)
        yield transform.from_line(near.centre + width * (root @ rng.standard_normal(root.shape[0])))[0]


def no_start() -> SamplingError:
    """Return the error of a chain that cannot start at any value that :func:`draw_near` yields."""
    return SamplingError(
        f"no theta out of {_START_ATTEMPTS} near the likeliest one gives the readings a positive probability; use more "
        "particles, wider priors, or method particle-gibbs"
    )


class _Starter:
    """A picklable function seed -> (theta, log_prob, blob)."""

    def __init__(self, target: EvidenceTarget, near: NearMode) -> None:
        self.target, self.near = target, near

    def __call__(self, seed: int) -> tuple[Float, float, Any]:
        rng, bound = make_rng(np.random.SeedSequence(seed)), self.target.bound
        transform = Unconstrained(bound.parameters)
        for theta in draw_near(self.near, transform, rng):
            numbers, prior = draw_numbers(rng, self.target.blocks), bound.log_prior(theta)
            found = self.target(theta, numbers) if prior > -math.inf else None
            if found is None or not math.isfinite(found.log_evidence):
                continue
            blob = np.zeros((), dtype=_dtype(self.target))
            blob["path"], joint = found.finish()
            blob["log_joint"], blob["log_evidence"], blob["numbers"] = joint + prior, found.log_evidence, numbers
            return theta, prior + found.log_evidence, blob
        raise no_start()


def _dtype(target: EvidenceTarget) -> np.dtype[Any]:
    shape = (sum(target.bound.lengths), state_dimension(target.bound))
    numbers: list[Any] = [(name, np.float64) for name in (*_FIELDS, "log_scale")]
    return np.dtype([("path", np.float64, shape), *numbers, ("numbers", np.uint64, (target.blocks + 1,))])


def run_random_walk(
    target: EvidenceTarget,
    near: NearMode,
    plan: WalkPlan,
    options: RunOptions,
    settings: Mapping[str, SettingValue],
) -> Chains:
    """Run chains of adaptive random-walk Metropolis.

    Parameters
    ----------
    target : EvidenceTarget
        The evidence, exact or estimated without bias.
    near : NearMode
        Where the chains start, and the covariance of the first proposals.
    plan : WalkPlan
        Burn-in and proposals.
    options : RunOptions
        How the run is carried out.
    settings : mapping of str to scalar
        Every setting of the run; a checkpoint knows its run by them, and they become the result's.

    Returns
    -------
    Chains

    Raises
    ------
    SamplingError
        When no chain can start, or the checkpoint does not fit.
    """
    kit = WalkKit(
        _Starter(target, near), lambda root, gain: _WalkMove(target, plan, root, gain), _dtype(target), _FIELDS[1:]
    )
    return run_walk(target.bound, kit, near, plan.tuning, options, settings)


class WalkKit(NamedTuple):
    """What a chain with random-walk proposals consists of.

    Attributes
    ----------
    start : callable
        Seed to (theta, log_prob, blob) of a chain.
    move : callable
        Root of the proposals' covariance (d, d), and gain of their scale, to an emcee move.
    dtype : numpy.dtype
        That of a blob: the path first, then numbers, ``log_joint`` among them.
    statistics : tuple of str
        Fields of the blob that are kept as statistics.
    """

    start: Callable[[int], tuple[Float, float, Any]]
    move: Callable[[Float, float], Any]
    dtype: np.dtype[Any]
    statistics: tuple[str, ...]


def run_walk(
    bound: BoundModel,
    kit: WalkKit,
    near: NearMode,
    tuning: Sequence[int],
    options: RunOptions,
    settings: Mapping[str, SettingValue],
) -> Chains:
    """Run chains through stages of burn-in, each of which teaches the next one's proposals, and the draws.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    kit : WalkKit
        How a chain starts and moves.
    near : NearMode
        Its covariance is that of the first proposals.
    tuning : sequence of int
        Draws of each stage of burn-in.
    options, settings
        As for :func:`run_random_walk`.

    Returns
    -------
    Chains
    """
    d, rounds = bound.dimension, len(tuning)
    with run_session(bound, settings, options.chains, options) as session:
        backends = [session.backend(f"tuning-{k}", steps, window=steps // 2) for k, steps in enumerate(tuning, 1)]
        backends.append(session.backend("draws", options.draws, keep_every=options.keep_every))
        state: State | None = None
        if not any(backend.iteration for backend in backends):
            session.stopwatch.deadline = session.stopwatch.limit
            state = _first_state(kit, options, session.pool)
        root = np.asarray(2.38 / math.sqrt(d) * np.linalg.cholesky(near.covariance), dtype=np.float64)
        for number, backend in enumerate(backends):
            last = number == rounds
            if not backend.complete:
                move = kit.move(root, 0.0 if last else _GAIN)
                runner = StageRunner(session, bound, options.chains, _never_evaluated, move, backend)
                share = 1.0 if last else BURN_IN_SHARE * (number + 1) / rounds
                state = runner.advance(state, "draws" if last else f"tuning-{number + 1}", share)
            elif not last and not backends[number + 1].iteration:
                state = backend.get_last_sample()
            if not last:
                root = _learnt_root(backend, root, Unconstrained(bound.parameters))
    return collected(bound, backends, kit.statistics, {**settings, **options.attributes})


def _never_evaluated(theta: Float) -> float:
    raise AssertionError("the random walk evaluates its own density")


def _first_state(kit: WalkKit, options: RunOptions, pool: Any) -> State:
    seeds = [int(s) for s in np.random.SeedSequence(options.seed).generate_state(options.chains, dtype=np.uint64)]
    run: Any = pool.map if pool is not None else map
    starts: Sequence[tuple[Float, float, Any]] = list(run(kit.start, seeds))
    return State(
        np.array([start[0] for start in starts]),
        log_prob=np.array([start[1] for start in starts]),
        blobs=np.array([start[2] for start in starts], dtype=kit.dtype),
        random_state=np.random.RandomState(options.seed % 2**32).get_state(),
    )


def _learnt_root(backend: StageBackend, root: Float, transform: Unconstrained) -> Float:
    """Return the root of the proposals' covariance from a finished stage, or the old one where it moved too little."""
    if not backend.iteration:  # the time of the stage was over before its first step
        return root
    thetas = backend.get_chain()[backend.window]
    d = thetas.shape[2]
    if np.any(np.diff(thetas, axis=0) != 0.0, axis=2).sum() < _LEAST_MOVES * d:
        return root
    u = transform.to_line(thetas)
    # Chains that have not met must not widen the proposals.
    within = (u - u.mean(axis=0)).reshape(-1, d)
    return np.asarray(2.38 / math.sqrt(d) * np.linalg.cholesky(within.T @ within / len(within) + 1e-8 * np.eye(d)))
