"""Particle Gibbs in stages (Table 1 of the paper), with emcee: every walker is a chain of its own."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from emcee.state import State
from numpy.typing import NDArray

from pmcl.models.robot_model import BoundModel
from pmcl.sampling.advance import StageRunner
from pmcl.sampling.chains import Chains
from pmcl.sampling.move import ParticleGibbsMove
from pmcl.sampling.options import RunOptions, SettingValue
from pmcl.sampling.schedule import Schedule
from pmcl.sampling.session import check_run_memory, collected, run_session
from pmcl.sampling.stages import Stage
from pmcl.sampling.state import SweepInfo, into_blob
from pmcl.sampling.sweep import ChainStart, start_chain
from pmcl.sampling.transport import Transport
from pmcl.sampling.tuning import lost_chains, near_their_modes, restarted, tuned_schedule, tuned_transports

__all__ = ["run_particle_gibbs"]

_logger = logging.getLogger("pmcl.sampling")
Float = NDArray[np.float64]
# A stage of burn-in that the clock ended after fewer steps than these tells too little to tune anything from it.
_LEAST_STEPS = 4


def run_particle_gibbs(
    bound: BoundModel, stages: Sequence[Stage], options: RunOptions, settings: Mapping[str, SettingValue]
) -> Chains:
    """Run the chains of particle Gibbs through some stages.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    stages : sequence of Stage
        Inclusion of the data, tuning, and last the draws.
    options : RunOptions
        How the run is carried out.
    settings : mapping of str to scalar
        Every setting of the run; a checkpoint knows its run by them, and they become the result's.

    Returns
    -------
    Chains

    Raises
    ------
    SamplingError, DensityError
        When a chain cannot start, the filter meets a density that is not a number, or the checkpoint does not fit.
    """
    longest = max(bound.lengths)
    check_run_memory(bound, options.chains, max(stage.settings.particles for stage in stages), options)
    transports: list[Transport | None] | None = None
    schedule = Schedule()
    restarts = 0
    # Of each chain: the chain whose beginning it has, and how many sweeps were dead before the stage that follows.
    origins, dead_before = np.arange(options.chains), np.zeros(options.chains, dtype=np.int64)
    with run_session(bound, settings, options.chains, options) as session:
        backends = [session.backend(stage.name, stage.steps, stage.window, stage.keep_every) for stage in stages]
        # Also when resuming: the first states are cheap, and how they were found is part of the result.
        session.stopwatch.deadline = session.stopwatch.limit
        state, impossible = _first_state(bound, stages[0], options, session.pool)
        for stage, backend, following in zip(stages, backends, [*backends[1:], None], strict=True):
            move = ParticleGibbsMove(bound, transports=transports, **asdict(stage.settings))
            if not backend.complete:
                runner = StageRunner(session, bound, options.chains, _never_evaluated, move, backend)
                state = runner.advance(state, stage.name, stage.time_share, longest if stage.settings.data_rate else 0)
            elif following is not None and not following.iteration:
                state = backend.get_last_sample()
            if following is None or backend.iteration < min(_LEAST_STEPS, stage.steps):
                continue
            lost = lost_chains(backend, stage, longest)
            restarts += len(lost)
            source = np.array([lost.get(k, k) for k in range(options.chains)])
            origins = origins[source]
            dead_before = backend.get_blobs()["failed_updates"][-1][source]
            transported = stages[-1].settings.transport_moves != 0
            if transported:
                schedule = tuned_schedule(backend, schedule)
            if following.complete:  # no later stage needs what this one would be used for
                continue
            state = restarted(state, lost)
            if transported and stage.settings.data_rate:
                run = session.pool.map if session.pool is not None else map
                state, transports = near_their_modes(bound, backend, state, source, schedule, options.seed, run)
            elif transported:
                transports = tuned_transports(bound, backend, stage, lost, schedule)
            if transports is not None and any(transport is None for transport in transports):
                _logger.warning("the model offers no usable linearisation at the mean trajectory: no transport moves")
    sweeps, moves = stages[-1].settings.sweeps, stages[-1].settings.transport_moves
    outcome: dict[str, SettingValue] = {
        "sweeps_per_draw": sweeps if sweeps is not None else schedule.sweeps,
        "transport_moves": moves if moves is not None else schedule.moves,
        "restarted_chains": restarts,
        "impossible_starts": impossible,
        "chain_origins": " ".join(map(str, origins)),
        "dead_sweeps_while_drawing": int((backends[-1].get_blobs()["failed_updates"][-1] - dead_before).sum()),
    }
    return collected(bound, backends, SweepInfo._fields, {**settings, **outcome, **options.attributes})


def _never_evaluated(theta: Float) -> float:
    raise AssertionError("the particle Gibbs move evaluates its own density")


def _first_state(bound: BoundModel, stage: Stage, options: RunOptions, pool: Any) -> tuple[State, int]:
    """Start every chain from its own seed; return emcee's state and how many impossible draws there were."""
    seeds = np.random.SeedSequence(options.seed).generate_state(options.chains, dtype=np.uint64)
    run = pool.map if pool is not None else map
    starts: list[ChainStart] = list(run(_Starter(bound, stage), [int(s) for s in seeds]))
    dtype = ParticleGibbsMove(bound).dtype
    impossible = sum(start.impossible_draws for start in starts)
    if impossible:
        _logger.warning(
            "%d draws of theta from the prior could not explain the first rows at all and were drawn again", impossible
        )
    blobs = np.array([into_blob(start.state, start.info, dtype) for start in starts], dtype=dtype)
    random_state = np.random.RandomState(options.seed % 2**32).get_state()
    coords = np.array([start.state.theta for start in starts])
    log_prob = np.array([start.state.log_joint for start in starts])
    return State(coords, log_prob=log_prob, blobs=blobs, random_state=random_state), impossible


class _Starter:
    """A picklable function seed -> first state."""

    def __init__(self, bound: BoundModel, stage: Stage) -> None:
        self.bound, self.stage = bound, stage

    def __call__(self, seed: int) -> ChainStart:
        return start_chain(self.bound, self.stage.settings, seed)
