"""One fitted model criticised: the log's evidence against that of logs which the model simulates."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.criticism.alarms import Judgement, judge
from pmcl.criticism.evidence import Evidence, gather, rescored
from pmcl.criticism.fit import Fit
from pmcl.criticism.progress import Progress
from pmcl.criticism.replicate import replicated_log
from pmcl.criticism.scores import Direction, directions, fits
from pmcl.errors import FilterError, PmclError
from pmcl.filtering.particle_filter import make_rng
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect

__all__ = [
    "FINER", "Judged", "Settings", "candidate_directions", "criticised", "in_doubt", "judged_again", "key_of",
    "looked_again", "split_again",
]  # fmt: skip

FINER = 4
"""Comparisons of log scores take so many times the particles of a scored pass."""
# An alarm whose p-value (all families considered) is above this is looked at again with so many times the simulated
# logs: thirty know the spread of a number to an eighth only, and a p-value of 1 % may be one of 10 %.
_BEYOND_DOUBT, _LOOK_AGAIN = 1e-5, 3

_logger = logging.getLogger("pmcl.criticism")
Float = NDArray[np.float64]


@dataclass(frozen=True)
class Settings:
    """Settings of a run, as :func:`pmcl.criticism.workflow.criticize` takes them; `reporter` tells how it goes."""

    particles: int
    seed: int
    level: float
    simulations: int
    paths: int
    workers: int
    progress: bool
    finer: int = FINER
    reporter: Progress = field(default_factory=Progress, compare=False, repr=False)

    @property
    def comparing(self) -> int:
        """Particles for comparisons of log scores, whose error must stay below some nats: `finer` times as many."""
        return self.finer * self.particles

    def tell(self, message: str, doing: str = "") -> None:
        """Tell a step of the run, if that was asked for, see :meth:`pmcl.criticism.progress.Progress.tell`."""
        self.reporter.tell(message, doing)

    def mapped(self, function: Callable[[int], Any], what: str, names: Sequence[str]) -> list[Any]:
        """Return the function's values at 0, 1, ..., one for each of `names`, made by threads.

        Kernels do not hold the interpreter's lock. What has not begun when something fails, or when somebody
        interrupts the run, is left out. `what` is done with `names` tells people how far the work has come.
        """
        with self.reporter.watched(what, names) as watch:

            def one(k: int) -> Any:
                watch.begin(k)
                value = function(k)
                watch.end()
                return value

            if self.workers == 1 or len(names) < 2:
                return [one(k) for k in range(len(names))]
            pool = ThreadPoolExecutor(self.workers)
            try:
                return list(pool.map(one, range(len(names))))
            finally:
                pool.shutdown(wait=True, cancel_futures=True)


class Judged(NamedTuple):
    """A log's evidence, what it means, and what it is compared with.

    Attributes
    ----------
    evidence : Evidence
        Of the log.
    judgement : Judgement
        Of all rows.
    z : ndarray, shape (K,)
        Deviations of the candidates' scores over the rows of the fit part only.
    null : tuple of Evidence
        Of the logs that the fitted model simulates.
    """

    evidence: Evidence
    judgement: Judgement
    z: Float
    null: tuple[Evidence, ...]


def criticised(
    log: RobotLog, fit: Fit, wanted: Sequence[Direction], split: int, settings: Settings
) -> Judged:
    """Return what a log tells about a fitted model, what that means, and the scores of the fit part by themselves.

    Parameters
    ----------
    log : RobotLog
        The whole log, to which `fit` belongs.
    fit : Fit
        A fit of the whole log.
    wanted : sequence of Direction
        K candidates.
    split : int
        First row of the held-out part.
    settings : Settings

    Returns
    -------
    Judged
    """
    # One more simulated log for each parameter: those are projected out of every number.
    count = max(settings.simulations, 12 + 3 * fit.theta.size)
    settings.tell(f"scoring {len(wanted)} directions, and simulating {count} logs")
    seed = np.random.SeedSequence((settings.seed, 1))
    found = gather(
        fit.bound, fit.theta, wanted, particles=settings.particles, paths=settings.paths, seed=seed
    )
    return _judged(found, _simulated(log, fit, wanted, range(count), settings), wanted, split, settings)


def in_doubt(judgement: Judgement) -> bool:
    """Return whether there is an alarm that is not beyond doubt."""
    return bool(judgement.raised) and judgement.p_value >= _BEYOND_DOUBT


def looked_again(
    before: Judged, log: RobotLog, fit: Fit, wanted: Sequence[Direction], split: int, settings: Settings
) -> Judged:
    """Return the same with three times as many simulated logs; see :func:`criticised`.

    What would be an alarm, but not beyond doubt, is judged again in this way, and that judgement stands; this can only
    lower the rate of false alarms.
    """
    count = len(before.null)
    further = range(count, _LOOK_AGAIN * count)
    settings.tell(f"p = {before.judgement.p_value:.1e}: simulating {len(further)} logs more, to be sure")
    null = [*before.null, *_simulated(log, fit, wanted, further, settings)]
    return _judged(before.evidence, null, wanted, split, settings)


def _simulated(
    log: RobotLog, fit: Fit, wanted: Sequence[Direction], numbers: range, settings: Settings
) -> list[Evidence]:
    """Return the evidence of logs that the fitted model simulates; each has a number, from which it follows."""

    def one(k: int) -> Evidence:
        rng = make_rng(np.random.SeedSequence((settings.seed, 2, numbers[k])))
        bound = fit.bound.model.bind(replicated_log(log, fit.tables, fit.path, rng))
        seed = np.random.SeedSequence((settings.seed, 3, numbers[k]))
        try:
            return gather(bound, fit.theta, wanted, particles=settings.particles, paths=settings.paths, seed=seed)
        except FilterError as error:
            if error.row is None:
                raise
            raise FilterError(
                f"{log.where}: the filter loses the robot at t={log.times[error.row]:g} s of a log that the fitted "
                "model simulates, so nothing can be judged by such logs; use more particles, or restart with a wider "
                "start belief"
            ) from None

    return settings.mapped(one, "simulating logs", [""] * len(numbers))


def judged_again(before: Judged, wanted: Sequence[Direction], split: int, settings: Settings) -> Judged:
    """Return the same of other candidates, scored along the trajectories that are there already."""
    settings.tell(f"scoring {len(wanted)} further directions")
    logs = [before.evidence, *before.null]
    found, *null = settings.mapped(lambda k: rescored(logs[k], wanted), "scoring logs", [""] * len(logs))
    return _judged(found, null, wanted, split, settings)


def _judged(
    found: Evidence, null: Sequence[Evidence], wanted: Sequence[Direction], split: int, settings: Settings
) -> Judged:
    on_fit = judge(found, null, wanted, level=settings.level, rows=split)
    return Judged(found, judge(found, null, wanted, level=settings.level), on_fit.z, tuple(null))


def split_again(before: Judged, wanted: Sequence[Direction], split: int, settings: Settings) -> Judged:
    """Return the same with another first row of the held-out part."""
    return _judged(before.evidence, before.null, wanted, split, settings)


def candidate_directions(log: RobotLog, fit: Fit, offered: Sequence[Effect]) -> tuple[Direction, ...]:
    """Return the directions of those effects that the fitted model lacks and that go together with it."""
    present = {key_of(effect) for effect in fit.bound.model.effects}
    usable = []
    for effect in offered:
        try:
            if key_of(effect) not in present and fits(effect, fit.tables, log):
                usable.append(effect)
        except PmclError as error:
            _logger.debug("%s is no candidate: %s", effect.name, error)
    return directions(usable)


def key_of(effect: Effect) -> tuple[str, tuple[Any, ...]]:
    """Return what tells one instance of an effect from others."""
    return effect.name, tuple((name, tuple(values)) for name, values in effect.where.items())
