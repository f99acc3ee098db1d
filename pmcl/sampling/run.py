"""Run the chains with emcee: particle Gibbs in stages, or an ensemble on the pseudo-marginal target."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any

import emcee
import numpy as np
from emcee.state import State
from numpy.typing import NDArray

from pmcl.errors import SamplingError
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.backends import CheckpointBackend, MemoryBackend, StageBackend
from pmcl.sampling.chains import Chains
from pmcl.sampling.checkpoint import check_fingerprint, fingerprint, stored_steps
from pmcl.sampling.ensemble import PseudoMarginalTarget, first_walkers
from pmcl.sampling.move import ParticleGibbsMove
from pmcl.sampling.pool import walker_pool
from pmcl.sampling.stages import Plan, Stage, lost_chains, plan_stages, restarted, tuned_transports
from pmcl.sampling.state import into_blob
from pmcl.sampling.stopwatch import Stopwatch
from pmcl.sampling.sweep import included, start_chain
from pmcl.sampling.transport import Transport

__all__ = ["run_ensemble", "run_particle_gibbs"]

_logger = logging.getLogger("pmcl.sampling")
Float = NDArray[np.float64]
# A run that is stopped by the clock has at least so many draws: what R-hat takes.
_LEAST_DRAWS = 4
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
        HDF5 file that every step is written to.
    resume : bool
        Continue an existing checkpoint; the result is that of an uninterrupted run.
    progress : bool
        Show emcee's progress bars.
    settings : dict, optional
        Further attributes of the result.
    stopwatch : Stopwatch, optional
        Notes the time of every step, and ends the last stage when its time is over; how many draws there are then
        depends on the machine.

    Returns
    -------
    Chains

    Raises
    ------
    SamplingError, FilterError
        When a chain cannot start, the filter meets a density that is not a number, or the checkpoint does not fit.
    """
    longest = max(bound.lengths)
    told = {"method": "particle-gibbs", "chains": n_chains, "seed": seed, **_plan_settings(plan)}
    if checkpoint is not None:
        check_fingerprint(checkpoint, fingerprint(bound, told), resume=resume)
    stages = plan_stages(plan, longest)
    transports: list[Transport | None] | None = None
    restarts, redrawn = 0, 0
    state: State | None = None
    backends: list[StageBackend] = []
    with walker_pool(pool, n_chains) as workers:
        for stage in stages:
            backend, done = _backend(checkpoint, stage.name, stage.keep_every)
            if state is None:
                # Also when resuming: the first states are cheap, and what they tell is part of the result.
                state, redrawn = _first_state(bound, stage, n_chains, seed, workers)
            move = ParticleGibbsMove(bound, transports=transports, **_settings_of(stage))
            sampler = emcee.EnsembleSampler(
                n_chains, bound.dimension, _forbidden, pool=workers, moves=[move], backend=backend
            )
            last = stage is stages[-1]
            state = _advance(sampler, state, stage.steps, done, progress, stage.name, stopwatch, last)
            backends.append(backend)
            if last:
                break
            lost = lost_chains(backend, stage, longest)
            restarts += len(lost)
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
    if checkpoint is not None:
        check_fingerprint(checkpoint, fingerprint(bound, told), resume=resume)
    target = PseudoMarginalTarget(bound, particles, seed)
    keep_every = max(1, draws // max(trajectories, 1))
    state: State | None = None
    backends: list[StageBackend] = []
    with walker_pool(pool, n_walkers) as workers:
        for name, steps, every in (("burn-in", burn_in, max(1, burn_in)), ("draws", draws, keep_every)):
            backend, done = _backend(checkpoint, name, every)
            if state is None and not done:
                state = first_walkers(target, n_walkers, seed, workers)
            sampler = emcee.EnsembleSampler(
                n_walkers, bound.dimension, target, pool=workers, moves=moves, backend=backend, blobs_dtype=target.dtype
            )
            state = _advance(sampler, state, steps, done, progress, name, stopwatch, name == "draws")
            backends.append(backend)
    return _collect(bound, backends, keep_every, told | (settings or {}))


def _backend(checkpoint: str | None, name: str, keep_every: int) -> tuple[StageBackend, int]:
    if checkpoint is None:
        return MemoryBackend(keep_every), 0
    return CheckpointBackend(checkpoint, name, keep_every), stored_steps(checkpoint, name)


def _advance(
    sampler: Any,
    state: State | None,
    steps: int,
    done: int,
    progress: bool,
    name: str,
    stopwatch: Stopwatch | None,
    last: bool,
) -> State:
    """Bring a stage to its full length, from the backend's last step when there is one."""
    if done:
        state = sampler.backend.get_last_sample()
    if done >= steps:
        return state
    made = sampler.sample(
        state,
        iterations=steps - done,
        progress=progress,
        progress_kwargs={"desc": f"{name:<9}"},
        skip_initial_state_check=True,
    )
    for after in made:
        state = after
        if stopwatch is not None and not stopwatch.step() and last and sampler.backend.iteration >= _LEAST_DRAWS:
            break
    return state


def _settings_of(stage: Stage) -> dict[str, Any]:
    return dict(vars(stage.settings))


def _plan_settings(plan: Plan) -> dict[str, Any]:
    return {name: value if not isinstance(value, tuple) else str(value) for name, value in vars(plan).items()}


def _collect(bound: BoundModel, backends: Sequence[StageBackend], keep_every: int, told: dict[str, Any]) -> Chains:
    """Put the backends' arrays, which have the step first, into chains."""
    final = backends[-1]
    blobs = final.get_blobs()
    statistics = {
        told_as: np.moveaxis(np.asarray(blobs[name], dtype=float), 0, 1) for name, told_as in _STATISTICS.items()
    }
    paths = np.moveaxis(final.kept_paths(), 0, 1)
    split = included(bound, np.moveaxis(paths, 2, 0), max(bound.lengths))
    told["draws"] = int(final.iteration)
    told["dead_sweeps"] = int(blobs["dead"][-1].sum())
    warm_theta = np.concatenate([backend.get_chain() for backend in backends[:-1]])
    warm_joint = np.concatenate([backend.get_blobs()["log_joint"] for backend in backends[:-1]])
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
