"""Run the chains with emcee: particle Gibbs in stages, or an ensemble on the pseudo-marginal target."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import emcee
import numpy as np
from emcee.state import State
from numpy.typing import NDArray

from pmcl.checks import check_memory
from pmcl.errors import SamplingError
from pmcl.interrupts import check_interrupt, stopping_on_interrupt
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.backends import StageBackend
from pmcl.sampling.chains import Chains
from pmcl.sampling.checkpoint import Checkpoint, fingerprint
from pmcl.sampling.ensemble import PseudoMarginalTarget, first_walkers
from pmcl.sampling.move import ParticleGibbsMove
from pmcl.sampling.pool import walker_pool
from pmcl.sampling.stages import (
    BURN_IN_SHARE,
    Plan,
    Stage,
    hurried_rate,
    lost_chains,
    plan_stages,
    restarted,
    tuned_transports,
)
from pmcl.sampling.state import into_blob, state_dimension
from pmcl.sampling.stopwatch import Stopwatch, TimeOver
from pmcl.sampling.sweep import included, start_chain
from pmcl.sampling.transport import Transport

__all__ = ["run_ensemble", "run_particle_gibbs"]

_logger = logging.getLogger("pmcl.sampling")
Float = NDArray[np.float64]
# A stage of burn-in that the clock ended after fewer steps than these tells too little to tune anything from it.
_LEAST_STEPS = 4
# emcee sets memory aside for all steps it is asked for; a run that the clock ends is asked for this many at a time.
_BLOCK = 5000
# Blob fields and the names they have in ArviZ's sample_stats.
_STATISTICS = {
    "accepted": "acceptance_rate",
    "walked": "transport_walk_acceptance_rate",
    "jumped": "transport_jump_rate",
    "refreshed": "path_block_redraw_rate",
    "log_evidence": "log_evidence",
    "effective_size": "particle_ess",
    "changed": "path_update_rate",
}


def _forbidden(theta: Float) -> float:
    raise AssertionError("the particle Gibbs move evaluates its own density")


def _first_state(bound: BoundModel, stage: Stage, n_chains: int, seed: int, pool: Any) -> tuple[State, int]:
    """Start every chain from its own seed; return emcee's state and how many impossible draws there were."""
    seeds = np.random.SeedSequence(seed).generate_state(n_chains, dtype=np.uint64)
    run = pool.map if pool is not None else map
    started = list(run(_Starter(bound, stage), [int(s) for s in seeds]))
    move = ParticleGibbsMove(bound)
    redrawn = sum(count for _, count in started)
    if redrawn:
        _logger.warning(
            "%d draws of theta from the prior could not explain the first rows at all and were drawn again", redrawn
        )
    states = [state for state, _ in started]
    blobs = np.array([into_blob(state, move.dtype) for state in states], dtype=move.dtype)
    random_state = np.random.RandomState(seed % 2**32).get_state()
    coords = np.array([state.theta for state in states])
    log_prob = np.array([state.log_joint for state in states])
    return State(coords, log_prob=log_prob, blobs=blobs, random_state=random_state), redrawn


class _Starter:
    """A picklable function seed -> first state."""

    def __init__(self, bound: BoundModel, stage: Stage) -> None:
        self.bound, self.stage = bound, stage

    def __call__(self, seed: int) -> Any:
        return start_chain(self.bound, self.stage.settings, seed)


def run_particle_gibbs(
    bound: BoundModel,
    plan: Plan,
    n_chains: int,
    seed: int,
    *,
    pool: Any = None,
    checkpoint: str | None = None,
    resume: bool = False,
    progress: bool = False,
    settings: dict[str, Any] | None = None,
    stopwatch: Stopwatch | None = None,
) -> Chains:
    """Calibrate by particle Gibbs (Table 1 of the paper).

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    plan : Plan
        Sizes of the stages.
    n_chains : int
        Number of chains K.
    seed : int
        All randomness follows from it, whatever the pool.
    pool : object with a `map` method, optional
        Runs the chains of each step; threads on all cores when left out.
    checkpoint : str, optional
        HDF5 file to which the run is written every few seconds, and when an error or Ctrl-C ends it.
    resume : bool
        Continue an existing checkpoint; the result is that of an uninterrupted run.
    progress : bool
        Show emcee's progress bars.
    settings : dict, optional
        Further attributes of the result.
    stopwatch : Stopwatch, optional
        Notes the time of every step, and ends the run when its time is over; burn-in is shortened when it would take
        more than half of it. How many draws there are then depends on the machine. Not with a checkpoint.

    Returns
    -------
    Chains

    Raises
    ------
    SamplingError, FilterError
        When a chain cannot start, the filter meets a density that is not a number, or the checkpoint does not fit.
    """
    longest = max(bound.lengths)
    if stopwatch is None:
        _check_memory(bound, n_chains, plan.draws, plan.trajectories, max(plan.particles, plan.burn_in_particles))
    told = {"method": "particle-gibbs", "chains": n_chains, "seed": seed, **_plan_settings(plan)}
    stages = plan_stages(plan, longest)
    transports: list[Transport | None] | None = None
    restarts = 0
    clock = stopwatch if stopwatch is not None else Stopwatch()
    with (
        _stoppable(checkpoint, fingerprint(bound, told), resume) as file,
        walker_pool(pool, n_chains, clock.check) as workers,
    ):
        backends = [_backend(file, stage.name, stage.steps, stage.window, stage.keep_every) for stage in stages]
        # Also when resuming: the first states are cheap, and what they tell is part of the result.
        clock.deadline = clock.limit
        state, redrawn = _first_state(bound, stages[0], n_chains, seed, workers)
        for stage, backend, following in zip(stages, backends, [*backends[1:], None], strict=True):
            move = ParticleGibbsMove(bound, transports=transports, **_settings_of(stage))
            if not backend.complete:
                run = _Run(n_chains, bound, _forbidden, workers, move, backend, file, progress, clock)
                state = run.advance(state, stage.name, stage.share, longest if stage.settings.data_rate else 0)
            elif following is not None and not following.iteration:
                state = backend.get_last_sample()
            if following is None or backend.iteration < min(_LEAST_STEPS, stage.steps):
                continue
            lost = lost_chains(backend, stage, longest)
            restarts += len(lost)
            if following.complete:  # nothing is left to be made with what this stage tells
                continue
            state = restarted(state, lost)
            if plan.transport_moves:
                transports = tuned_transports(bound, backend, stage, lost)
                if any(transport is None for transport in transports):
                    _logger.warning(
                        "the model offers no usable linearisation at the mean trajectory: no transport moves"
                    )
    told |= {"restarted_chains": restarts, "impossible_starts": redrawn, **(settings or {})}
    return _collect(bound, backends, stages[-1].keep_every, told)


def run_ensemble(
    bound: BoundModel,
    *,
    particles: int,
    n_walkers: int,
    draws: int,
    burn_in: int,
    seed: int,
    trajectories: int = 100,
    moves: Any = None,
    pool: Any = None,
    checkpoint: str | None = None,
    resume: bool = False,
    progress: bool = False,
    settings: dict[str, Any] | None = None,
    stopwatch: Stopwatch | None = None,
) -> Chains:
    """Calibrate with emcee's ensemble moves on the pseudo-marginal target; every walker is returned as a chain.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    particles : int
        Number of particles of each evidence estimate.
    n_walkers : int
        Size of the ensemble, at least 2 d.
    draws, burn_in : int
        Steps that are kept, and steps before.
    seed : int
        All randomness follows from it, whatever the pool.
    trajectories : int
        Trajectories per walker that are kept.
    moves : emcee moves, optional
        emcee's StretchMove when left out.
    pool, checkpoint, resume, progress, settings, stopwatch
        As for :func:`run_particle_gibbs`.

    Raises
    ------
    SamplingError
        When there are too few walkers, the ensemble cannot start, or the checkpoint does not fit.
    """
    if n_walkers < 2 * bound.dimension:
        raise SamplingError(
            f"an ensemble needs at least twice as many walkers as parameters ({2 * bound.dimension}), but got "
            f"{n_walkers}; ask for more chains"
        )
    told = {
        "method": "ensemble", "chains": n_walkers, "seed": seed, "particles": particles, "draws": draws,
        "burn_in": burn_in, "moves": repr(moves), "trajectories": trajectories,
    }  # fmt: skip
    if stopwatch is None:
        _check_memory(bound, n_walkers, draws, trajectories, particles)
    target = PseudoMarginalTarget(bound, particles, seed)
    keep_every = max(1, draws // max(trajectories, 1))
    state: State | None = None
    clock = stopwatch if stopwatch is not None else Stopwatch()
    with (
        _stoppable(checkpoint, fingerprint(bound, told), resume) as file,
        walker_pool(pool, n_walkers, clock.check) as workers,
    ):
        backends = [_backend(file, "burn-in", burn_in, 0, 0), _backend(file, "draws", draws, 0, keep_every)]
        if not any(backend.iteration for backend in backends):
            clock.deadline = clock.limit
            state = first_walkers(target, n_walkers, seed, workers, clock)
        for name, backend, share in zip(("burn-in", "draws"), backends, (BURN_IN_SHARE, 1.0), strict=True):
            if not backend.complete:
                run = _Run(n_walkers, bound, target, workers, moves, backend, file, progress, clock)
                state = run.advance(state, name, share)
            elif name == "burn-in" and not backends[1].iteration:
                state = backend.get_last_sample()
    return _collect(bound, backends, keep_every, told | (settings or {}))


def _check_memory(bound: BoundModel, n_chains: int, draws: int, trajectories: int, particles: int) -> None:
    """Refuse a run whose draws, trajectories and particles can never fit into memory, before it begins."""
    states = float(sum(bound.lengths)) * state_dimension(bound)
    # A draw: theta and what the blob tells of each parameter and of the sweep. A kept trajectory: once in single and
    # twice in double precision. A particle of each row: its state, its weight and its parent.
    of_draws = draws * (8.0 * 4.0 * bound.dimension + 100.0)
    of_trajectories = 20.0 * min(trajectories, draws) * states
    of_particles = 8.0 * particles * (states + 1.5 * sum(bound.lengths))
    check_memory(
        "draws, chains, trajectories and particles",
        n_chains * (of_draws + of_trajectories) + of_particles,
        error=SamplingError,
        advice="ask for fewer",
    )


@contextmanager
def _stoppable(checkpoint: str | None, expected: str, resume: bool) -> Iterator[Checkpoint | None]:
    """Open the checkpoint; write it whatever ends the run, and let Ctrl-C end the run between sweeps."""
    with stopping_on_interrupt():
        file = Checkpoint(checkpoint, expected, resume=resume) if checkpoint is not None else None
        try:
            yield file
        except TimeOver:
            raise SamplingError("the time was over before the first draw; give more time, or a shorter log") from None
        except KeyboardInterrupt:
            if file is None:
                raise KeyboardInterrupt("the run was stopped; without a checkpoint nothing of it is kept") from None
            file.write()
            raise KeyboardInterrupt(
                f"the run was stopped after {file.steps_written} steps; they are in {file.path}: the same call with "
                "resume goes on"
            ) from None
        finally:
            if file is not None:
                file.write()


def _backend(file: Checkpoint | None, name: str, steps: int, window: int, keep_every: int) -> StageBackend:
    return file.backend(name, steps, window, keep_every) if file else StageBackend(steps, window, keep_every)


class _Run:
    """One stage and all that advances it."""

    def __init__(
        self,
        n_walkers: int,
        bound: BoundModel,
        target: Any,
        pool: Any,
        move: Any,
        backend: StageBackend,
        file: Checkpoint | None,
        progress: bool,
        clock: Stopwatch,
    ) -> None:
        self.move, self.backend, self.file, self.progress, self.clock = move, backend, file, progress, clock
        dtype = getattr(target, "dtype", None)
        self.sampler = emcee.EnsembleSampler(
            n_walkers, bound.dimension, target, pool=pool, moves=move, backend=backend, blobs_dtype=dtype
        )

    def advance(self, state: State | None, name: str, share: float, longest: int = 0) -> State:
        """Bring the stage to its full length, or to the end of its time; go on from the last step if there is one.

        Parameters
        ----------
        state : State, optional
            Where a stage begins that has no steps yet.
        name : str
            What the stage is called.
        share : float
            The share of the stopwatch's time after which it ends.
        longest : int
            Rows of the longest log when the stage includes them by and by: it then ends only when all are included.
        """
        backend, clock = self.backend, self.clock
        if backend.iteration:
            state = backend.get_last_sample()
        begun, deadline = clock.now(), share * clock.limit
        # Only the end of the whole run may come before all rows are included.
        clock.deadline = clock.limit if longest else deadline
        pace = _Pace(self.move, longest, deadline, state) if longest and deadline < np.inf else None
        try:
            while not backend.complete:
                for after in self._steps(state, name):
                    state = after
                    now = clock.step()
                    check_interrupt()
                    if self.file is not None:
                        self.file.step_done()
                    included = pace is None or pace.step(state, begun, now)
                    if included and now >= 0.5 * (begun + deadline):
                        backend.begin_window()
                    if included and now >= deadline:
                        raise TimeOver
        except TimeOver:
            if clock.now() >= clock.limit and not backend.iteration:
                raise
        return state

    def _steps(self, state: State | None, name: str) -> Iterator[State]:
        left = self.backend.steps - self.backend.iteration
        made: Iterator[State] = self.sampler.sample(
            state,
            iterations=min(left, _BLOCK) if self.clock.limit < np.inf else left,
            progress=self.progress,
            progress_kwargs={"desc": f"{name:<9}"},
            skip_initial_state_check=True,
        )
        return made


class _Pace:
    """How fast rows are included in a run of limited time: as planned, or as fast as the time demands."""

    def __init__(self, move: ParticleGibbsMove, longest: int, deadline: float, state: State | None) -> None:
        self.move, self.longest, self.deadline = move, longest, deadline
        self.passed = 0
        self.adapt(state, 0.0, deadline)

    def adapt(self, state: Any, pace: float, left: float) -> None:
        """Set how many rows the next sweep includes."""
        settings = self.move.settings
        rate = hurried_rate(settings.data_rate, int(state.blobs["rows"].min()), self.longest, pace, left)
        self.move.settings = replace(settings, data_rate=rate)

    def step(self, state: Any, begun: float, now: float) -> bool:
        """Take notice of a step; return whether some chain has all rows: lost ones are then restarted from there."""
        rows = int(state.blobs["rows"].max())
        self.passed += rows
        self.adapt(state, (now - begun) / self.passed, self.deadline - now)
        return rows >= self.longest


def _settings_of(stage: Stage) -> dict[str, Any]:
    return dict(vars(stage.settings))


def _plan_settings(plan: Plan) -> dict[str, Any]:
    return {name: value if not isinstance(value, tuple) else str(value) for name, value in vars(plan).items()}


def _collect(bound: BoundModel, backends: Sequence[StageBackend], keep_every: int, told: dict[str, Any]) -> Chains:
    """Put the backends' arrays, which have the step first, into chains."""
    final = backends[-1]
    backends = [backend for backend in backends[:-1] if backend.iteration]
    blobs = final.get_blobs()
    statistics = {
        told_as: np.moveaxis(np.asarray(blobs[name], dtype=float), 0, 1) for name, told_as in _STATISTICS.items()
    }
    paths = np.moveaxis(final.kept_paths(), 0, 1)
    split = included(bound, np.moveaxis(paths, 2, 0), max(bound.lengths))
    told["draws"] = int(final.iteration)
    told["dead_sweeps"] = int(blobs["dead"][-1].sum())
    warm_theta = np.concatenate([backend.get_chain() for backend in backends])
    warm_joint = np.concatenate([backend.get_blobs()["log_joint"] for backend in backends])
    return Chains(
        names=bound.names,
        units=tuple(parameter.unit for parameter in bound.parameters),
        theta=np.moveaxis(final.get_chain(), 0, 1),
        log_joint=np.moveaxis(np.asarray(blobs["log_joint"]), 0, 1),
        statistics=statistics,
        trajectories=tuple(np.moveaxis(part, 0, 2) for part in split),
        trajectory_draw=np.arange(paths.shape[1], dtype=np.int64) * keep_every,
        warmup_theta=np.moveaxis(warm_theta, 0, 1),
        warmup_log_joint=np.moveaxis(warm_joint, 0, 1),
        settings=told,
    )
