"""emcee advances one stage of a run, to its full length or to the end of its time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import emcee
import numpy as np
from emcee.state import State

from pmcl.interrupts import check_interrupt
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.backends import StageBackend
from pmcl.sampling.move import ParticleGibbsMove
from pmcl.sampling.session import Session
from pmcl.sampling.stages import hurried_rate
from pmcl.sampling.stopwatch import TimeOver

__all__ = ["StageRunner"]

# emcee sets memory aside for all steps it is asked for; a run that the clock ends is asked for this many at a time.
_BLOCK = 5000


class StageRunner:
    """Advances one stage of a run with emcee.

    Parameters
    ----------
    session : Session
        Checkpoint, threads and stopwatch of the run.
    bound : BoundModel
        The model bound to its logs.
    walkers : int
        Number of walkers.
    target : callable
        The log density that emcee's own moves need.
    move : emcee.moves.Move, optional
        The move that each step makes; emcee's StretchMove when left out.
    backend : StageBackend
        Where the steps are stored; those that it holds already are not made again.
    """

    def __init__(
        self,
        session: Session,
        bound: BoundModel,
        walkers: int,
        target: Any,
        move: Any,
        backend: StageBackend,
    ) -> None:
        self.session, self.move, self.backend = session, move, backend
        self.sampler = emcee.EnsembleSampler(
            walkers,
            bound.dimension,
            target,
            pool=session.pool,
            moves=move,
            backend=backend,
            blobs_dtype=getattr(target, "dtype", None),
        )

    def advance(self, state: State | None, name: str, time_share: float, longest: int = 0) -> State:
        """Bring the stage to its full length, or to the end of its time; go on from the last step if there is one.

        Parameters
        ----------
        state : State, optional
            Where a stage begins that has no steps yet.
        name : str
            Name of the stage, for the progress bar.
        time_share : float
            The share of the stopwatch's time after which it ends.
        longest : int
            Rows of the longest log when the stage includes them by and by: it then ends only when all are included.

        Returns
        -------
        State
            After the last step.

        Raises
        ------
        TimeOver
            When the time of the whole run is over before the stage made a step.
        """
        backend, stopwatch = self.backend, self.session.stopwatch
        if backend.iteration:
            state = backend.get_last_sample()
        begin, deadline = stopwatch.now(), time_share * stopwatch.limit
        # Only the end of the whole run may come before all rows are included.
        stopwatch.deadline = stopwatch.limit if longest else deadline
        pace = _InclusionPace(self.move, longest, deadline, state) if longest and deadline < np.inf else None
        try:
            while not backend.complete:
                for after in self._steps(state, name):
                    state = after
                    now = stopwatch.step()
                    check_interrupt()
                    if callable(self.session.progress):
                        self.session.progress(name, int(backend.iteration), backend.steps)
                    if self.session.checkpoint is not None:
                        self.session.checkpoint.step_done()
                    all_included = pace is None or pace.step(state, begin, now)
                    if all_included and now >= 0.5 * (begin + deadline):
                        backend.begin_window()
                    if all_included and now >= deadline:
                        raise TimeOver
        except TimeOver:
            if stopwatch.now() >= stopwatch.limit and not backend.iteration:
                raise
        return state

    def _steps(self, state: State | None, name: str) -> Iterator[State]:
        left = self.backend.steps - self.backend.iteration
        steps: Iterator[State] = self.sampler.sample(
            state,
            iterations=min(left, _BLOCK) if self.session.stopwatch.limit < np.inf else left,
            progress=self.session.progress is True,
            progress_kwargs={"desc": f"{name:<9}"},
            skip_initial_state_check=True,
        )
        return steps


class _InclusionPace:
    """How fast rows are included in a run of limited time: as planned, or as fast as the time demands."""

    def __init__(self, move: ParticleGibbsMove, longest: int, deadline: float, state: State | None) -> None:
        self.move, self.longest, self.deadline = move, longest, deadline
        self.rows_passed = 0
        self.adapt(state, 0.0, deadline)

    def adapt(self, state: Any, seconds_per_row: float, seconds_left: float) -> None:
        """Set how many rows the next sweep includes."""
        settings = self.move.settings
        rate = hurried_rate(
            settings.data_rate, int(state.blobs["rows"].min()), self.longest, seconds_per_row, seconds_left
        )
        self.move.settings = replace(settings, data_rate=rate)

    def step(self, state: Any, begin: float, now: float) -> bool:
        """Adapt to a step; return whether some chain has all rows: lost ones are then restarted from there."""
        rows = int(state.blobs["rows"].max())
        self.rows_passed += rows
        self.adapt(state, (now - begin) / self.rows_passed, self.deadline - now)
        return rows >= self.longest
