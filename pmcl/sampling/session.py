"""The parts of an emcee run that do not depend on the target: memory, threads, checkpoint, Ctrl-C, and the result."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.checks import check_memory
from pmcl.errors import SamplingError
from pmcl.interrupts import stopping_on_interrupt
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.backends import StageBackend
from pmcl.sampling.chains import Chains
from pmcl.sampling.checkpoint import Checkpoint, fingerprint, the_only_run
from pmcl.sampling.options import Progress, RunOptions, SettingValue
from pmcl.sampling.pool import walker_pool
from pmcl.sampling.state import state_dimension
from pmcl.sampling.stopwatch import Stopwatch, TimeOver
from pmcl.sampling.sweep import included

__all__ = ["Session", "check_run_memory", "collected", "run_session"]


@dataclass(frozen=True)
class Session:
    """The checkpoint, threads and stopwatch that the stages of one run share.

    Attributes
    ----------
    checkpoint : Checkpoint, optional
        The file to which the run is written.
    pool : object with a `map` method, optional
        Runs the walkers of each step.
    stopwatch : Stopwatch
        Notes the time of every step, and may end the run.
    progress : bool or callable
        Whether emcee's progress bars are shown, or who is told after each step.
    """

    checkpoint: Checkpoint | None
    pool: Any
    stopwatch: Stopwatch
    progress: Progress

    def backend(self, name: str, steps: int, window: int = 0, keep_every: int = 0) -> StageBackend:
        """Return the backend of a stage, with the steps that the checkpoint holds of it.

        Parameters
        ----------
        name : str
            Name of the stage. Stages must be asked for in their order.
        steps, window, keep_every : int
            See :class:`~pmcl.sampling.backends.StageBackend`.

        Returns
        -------
        StageBackend
        """
        if self.checkpoint is None:
            return StageBackend(steps, window, keep_every)
        return self.checkpoint.backend(name, steps, window, keep_every)


@contextmanager
def run_session(
    bound: BoundModel, settings: Mapping[str, SettingValue], walkers: int, options: RunOptions
) -> Iterator[Session]:
    """Open checkpoint and threads; write the checkpoint whatever ends the run, and let Ctrl-C end it between sweeps.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    settings : mapping of str to scalar
        Settings of the run, by which a checkpoint knows its run.
    walkers : int
        Number of emcee's walkers.
    options : RunOptions
        How the run is carried out.

    Yields
    ------
    Session

    Raises
    ------
    SamplingError
        When the checkpoint does not fit or another run writes it, or the time is over before the first draw.
    KeyboardInterrupt
        After the current sweep, when Ctrl-C was pressed.
    """
    stopwatch = options.stopwatch if options.stopwatch is not None else Stopwatch()
    with stopping_on_interrupt(), the_only_run(options.checkpoint):
        file = None
        if options.checkpoint is not None:
            file = Checkpoint(options.checkpoint, fingerprint(bound, settings), resume=options.resume)
        try:
            with walker_pool(options.pool, walkers, stopwatch.check) as pool:
                yield Session(file, pool, stopwatch, options.progress)
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


def check_run_memory(bound: BoundModel, walkers: int, particles: int, options: RunOptions) -> None:
    """Refuse a run whose draws, trajectories and particles can never fit into memory, before it begins.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    walkers : int
        Number of chains.
    particles : int
        The greatest number of particles of a filter.
    options : RunOptions
        Its draws and trajectories count. A run that a stopwatch ends is not checked.

    Raises
    ------
    SamplingError
        When the run needs more memory than the machine has.
    """
    if options.limited:
        return
    states = float(sum(bound.lengths)) * state_dimension(bound)
    # A draw: theta, and in the blob the fields of each parameter and of the sweep. A kept trajectory: once in single
    # and twice in double precision. A particle of each row: its state, its weight and its parent.
    of_draws = options.draws * (8.0 * 4.0 * bound.dimension + 100.0)
    of_trajectories = 20.0 * min(options.trajectories, options.draws) * states
    of_particles = 8.0 * particles * (states + 1.5 * sum(bound.lengths))
    check_memory(
        "draws, chains, trajectories and particles",
        walkers * (of_draws + of_trajectories) + of_particles,
        error=SamplingError,
        advice="ask for fewer",
    )


def collected(
    bound: BoundModel,
    backends: Sequence[StageBackend],
    statistics: Sequence[str],
    settings: Mapping[str, SettingValue],
) -> Chains:
    """Put the backends' arrays, which have the step first, into chains.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    backends : sequence of StageBackend
        Those of burn-in, and last that of the draws.
    statistics : sequence of str
        Fields of the draws' blobs that are kept as statistics.
    settings : mapping of str to scalar
        Settings of the run.

    Returns
    -------
    Chains
    """
    final = backends[-1]
    burn_in = [backend for backend in backends[:-1] if backend.iteration]
    blobs = final.get_blobs()
    paths = np.moveaxis(final.kept_paths(), 0, 1)
    by_log = included(bound, np.moveaxis(paths, 2, 0), max(bound.lengths))
    return Chains(
        names=bound.names,
        units=tuple(parameter.unit for parameter in bound.parameters),
        theta=np.moveaxis(final.get_chain(), 0, 1),
        log_joint=np.moveaxis(np.asarray(blobs["log_joint"]), 0, 1),
        statistics={name: np.moveaxis(np.asarray(blobs[name], dtype=float), 0, 1) for name in statistics},
        trajectories=tuple(np.moveaxis(part, 0, 2) for part in by_log),
        trajectory_draw=np.arange(paths.shape[1], dtype=np.int64) * final.keep_every,
        warmup_theta=_joined([backend.get_chain() for backend in burn_in]),
        warmup_log_joint=_joined([backend.get_blobs()["log_joint"] for backend in burn_in]),
        settings={**settings, "draws": int(final.iteration)},
    )


def _joined(stages: Sequence[NDArray[np.float64]]) -> NDArray[np.float64] | None:
    """Put stages one after the other and the chain first; None where a hurried run has no stage."""
    return np.moveaxis(np.concatenate(stages), 0, 1) if stages else None
