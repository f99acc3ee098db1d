"""The settings of one run of the critic, and the threads that work for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

from pmcl.criticism.progress import Progress
from pmcl.logs.robot_log import RobotLog

__all__ = ["Settings"]

# Held-out rows are predicted with so many times the particles of a scored pass: log scores of 500 particles have a
# standard deviation of some 8 nats, which four times as many halve (chosen by hand).
_FINER = 4


@dataclass(frozen=True)
class Settings:
    """The settings of a run.

    Attributes
    ----------
    particles, seed, level, simulations, paths, workers, progress
        As in :func:`pmcl.criticism.workflow.criticize`.
    finer : int
        Held-out rows are predicted with so many times the particles of a scored pass.
    statistics : tuple of :class:`~pmcl.criticism.scoring.statistics.Statistic`
        Statistics of the user's own, which become alarms.
    reporter : Progress
        Reports how far the run has come.
    """

    particles: int
    seed: int
    level: float
    simulations: int
    paths: int
    workers: int
    progress: bool
    finer: int = _FINER
    statistics: tuple[Any, ...] = ()
    reporter: Progress = field(default_factory=Progress, compare=False, repr=False)

    @property
    def comparing(self) -> int:
        """Particles of the passes that predict held-out rows."""
        return self.finer * self.particles

    def with_particles(self, particles: int) -> Settings:
        """Return settings with another number of particles of a scored pass; held-out rows keep theirs if it is more.

        Parameters
        ----------
        particles : int
            The number.
        """
        return replace(self, particles=particles, finer=max(1, self.comparing // particles))

    def tell(self, message: str, doing: str = "") -> None:
        """Report a step of the run if the user asked for progress.

        Parameters
        ----------
        message : str
            The step that begins, or the result of the step that ends.
        doing : str
            The step that goes on from here, if it differs from the message.
        """
        self.reporter.tell(message, doing)

    def recorded(self, split: int, fingerprint: str, other: RobotLog | None) -> dict[str, Any]:
        """Return the settings that reproduce a run; the result does not depend on the others.

        Parameters
        ----------
        split : int
            First row of the held-out part.
        fingerprint : str
            The log's fingerprint.
        other : RobotLog or None
            Another log that is held out.
        """
        told = vars(self) | {"split": split, "log": fingerprint}
        told["statistics"] = [statistic.name for statistic in self.statistics]
        if other is not None:
            told["held_out"] = other.fingerprint()
        del told["workers"], told["reporter"]
        return told

    def mapped(self, function: Callable[[int], Any], activity: str, names: Sequence[str]) -> list[Any]:
        """Evaluate a function at 0, 1, ..., in threads; kernels release the interpreter's lock.

        Parameters
        ----------
        function : callable
            Takes the position in `names`. When a call fails or the user interrupts, calls that have not begun are
            dropped.
        activity : str
            The work, for progress messages, e.g. "quick fits of candidates".
        names : sequence of str
            A name for each piece of work, for progress messages; empty where the pieces are alike.

        Returns
        -------
        list
            The values, in the order of `names`.
        """
        with self.reporter.watched(activity, names) as watch:

            def evaluate(k: int) -> Any:
                watch.begin(k)
                value = function(k)
                watch.end()
                return value

            if self.workers == 1 or len(names) < 2:
                return [evaluate(k) for k in range(len(names))]
            pool = ThreadPoolExecutor(self.workers)
            try:
                return list(pool.map(evaluate, range(len(names))))
            finally:
                pool.shutdown(wait=True, cancel_futures=True)
