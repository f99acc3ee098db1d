"""A log judged under one fitted model: its scored pass, those of simulated logs, and the alarms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.criticism.fitting.quick_fit import Fit
from pmcl.criticism.judging.alarms import Judgement, judge
from pmcl.criticism.scoring.scored_log import ScoredLog, rescored, score_log
from pmcl.criticism.scoring.scores import Direction
from pmcl.criticism.scoring.simulated_logs import replicated_log
from pmcl.criticism.settings import Settings
from pmcl.errors import FilterError
from pmcl.filtering.particle_filter import make_rng
from pmcl.logs.robot_log import RobotLog
from pmcl.streams import stream

__all__ = ["JudgedLog", "in_doubt", "judge_log", "with_directions", "with_more_simulations"]

Float = NDArray[np.float64]

# An alarm whose p-value (all families considered) is above _BEYOND_DOUBT is judged again with all simulated logs, and
# with up to _MORE_SIMULATIONS times as many: thirty give the spread of a number to an eighth only, so that a p-value of
# 1 % may be one of 10 %. Both are chosen by hand on logs without a hidden effect (block 0 of analyses/hidden_effects).
_BEYOND_DOUBT, _MORE_SIMULATIONS = 1e-5, 3
# The number of simulated logs is at least _LEAST_SIMULATIONS and _PER_PARAMETER for each parameter, because the
# parameters' scores are projected out of every number (chosen by hand).
_LEAST_SIMULATIONS, _PER_PARAMETER = 12, 3
# A log is looked at first with so many simulated logs more than the model has parameters. The t distribution of a
# deviation has nine degrees of freedom then. An alarm at the first look is enough to look for an effect, whose evidence
# then decides. Only an alarm that nothing explains needs further simulated logs, and so does the absence of an alarm.
_AT_FIRST = 10
# A simulated log whose filter loses the robot is drawn anew at most so many times (chosen by hand).
_DRAWN_ANEW = 3


class JudgedLog(NamedTuple):
    """A log, the logs that it is compared with, and the alarms.

    Attributes
    ----------
    scored : ScoredLog
        The log.
    judgement : Judgement
        Tests of all rows.
    simulated : tuple of ScoredLog
        Logs that the fitted model simulates.
    directions : tuple of Direction
        The candidates of these tests.
    """

    scored: ScoredLog
    judgement: Judgement
    simulated: tuple[ScoredLog, ...]
    directions: tuple[Direction, ...]


def judge_log(log: RobotLog, fit: Fit, directions: Sequence[Direction], settings: Settings) -> JudgedLog:
    """Score a log under a fitted model, and compare it with logs that this model simulates.

    Where few of them raise an alarm already, no more are simulated (:func:`with_more_simulations` goes on).

    Parameters
    ----------
    log : RobotLog
        The whole log, to which `fit` belongs.
    fit : Fit
        A fit of the whole log.
    directions : sequence of Direction
        K candidates.
    settings : Settings
        Settings of the run.

    Returns
    -------
    JudgedLog

    Raises
    ------
    FilterError
        When the filter loses the robot of the log, or of one simulated log after another.
    """
    count = _full_count(fit, settings)
    at_first = min(count, _AT_FIRST + fit.theta.size)
    settings.tell(f"scoring {len(directions)} directions, and simulating {at_first} to {count} logs")
    seed = stream(settings.seed, "scores of the log")
    scored = score_log(
        fit.bound, fit.theta, directions, path=fit.drawn_path, particles=settings.particles, paths=settings.paths,
        seed=seed, statistics=settings.statistics,
    )  # fmt: skip
    simulated = _simulated(log, fit, directions, range(at_first), settings)
    judged = _judged(scored, simulated, directions, settings)
    if at_first == count or judged.judgement.raised:
        return judged
    return _with_further(judged, log, fit, directions, count, settings)


def in_doubt(judgement: Judgement) -> bool:
    """Return whether there is an alarm, but none beyond doubt."""
    return bool(judgement.raised) and judgement.p_value >= _BEYOND_DOUBT


def with_more_simulations(
    before: JudgedLog, log: RobotLog, fit: Fit, directions: Sequence[Direction], settings: Settings
) -> JudgedLog:
    """Judge a log again with all simulated logs, and with up to three times as many.

    A log whose alarm is in doubt is judged again in this way, and the last judgement counts. Further logs are simulated
    as long as the alarm is in doubt. This can only lower the rate of false alarms. Where the filter loses the robot of
    one further log after another, the judgement by those before stands.

    Parameters
    ----------
    before : JudgedLog
        The first judgement.
    log, fit, directions, settings
        As for :func:`judge_log`.
    """
    count, there_are = _full_count(fit, settings), len(before.simulated)
    counts = [times * count for times in range(1, _MORE_SIMULATIONS + 1) if times * count > there_are]
    judged = before
    if counts:
        settings.tell(
            f"p = {before.judgement.p_value:.1e}: simulating {counts[0] - there_are} more logs, or more, to be sure"
        )
    for number in counts:
        try:
            judged = _with_further(judged, log, fit, directions, number, settings)
        except FilterError:
            # The logs that there are have been enough for a first judgement, and it stands.
            break
        if not in_doubt(judged.judgement):
            break
    return judged


def _full_count(fit: Fit, settings: Settings) -> int:
    """Return how many logs are simulated unless an alarm needs fewer or more."""
    return max(settings.simulations, _LEAST_SIMULATIONS + _PER_PARAMETER * fit.theta.size)


def _with_further(
    before: JudgedLog, log: RobotLog, fit: Fit, directions: Sequence[Direction], count: int, settings: Settings
) -> JudgedLog:
    """Judge a log again with further simulated logs, `count` with those that there are."""
    further = _simulated(log, fit, directions, range(len(before.simulated), count), settings)
    return _judged(before.scored, [*before.simulated, *further], directions, settings)


def _simulated(
    log: RobotLog, fit: Fit, directions: Sequence[Direction], numbers: range, settings: Settings
) -> list[ScoredLog]:
    """Simulate and score logs of the fitted model; the number of a log determines its random numbers.

    A log whose filter loses the robot at once is drawn anew: the recorded log is judged only if its own filter follows.
    """

    def simulate_and_score(k: int) -> ScoredLog:
        rng = make_rng(stream(settings.seed, "simulated log", numbers[k]))
        model = fit.bound.model
        by_turning = bool(getattr(model.motion, "aside_by_turning", False))
        seed = stream(settings.seed, "scores of a simulated log", numbers[k])
        for _ in range(1 + _DRAWN_ANEW):
            replica = replicated_log(log, fit.tables, fit.path, rng, by_turning=by_turning)
            bound = model.bind(replica.log)
            try:
                return score_log(
                    bound, fit.theta, directions, path=replica.path, particles=settings.particles,
                    paths=settings.paths, seed=seed, statistics=settings.statistics,
                )  # fmt: skip
            except FilterError as error:
                if error.row is None:
                    raise
                row = error.row
        raise FilterError(
            f"{log.where}: the filter loses the robot at t={log.times[row]:g} s of a log that the fitted model "
            f"simulates, and of {_DRAWN_ANEW} further ones, so that nothing can be judged by such logs"
        )

    return settings.mapped(simulate_and_score, "simulating logs", [""] * len(numbers))


def with_directions(before: JudgedLog, directions: Sequence[Direction], settings: Settings) -> JudgedLog:
    """Judge other candidates, scored along the trajectories of an earlier judgement.

    Parameters
    ----------
    before : JudgedLog
        The earlier judgement.
    directions : sequence of Direction
        The other candidates.
    settings : Settings
        Settings of the run.
    """
    settings.tell(f"scoring {len(directions)} further directions")
    logs = [before.scored, *before.simulated]
    scored, *simulated = settings.mapped(lambda k: rescored(logs[k], directions), "scoring logs", [""] * len(logs))
    return _judged(scored, simulated, directions, settings)


def _judged(
    scored: ScoredLog, simulated: Sequence[ScoredLog], directions: Sequence[Direction], settings: Settings
) -> JudgedLog:
    judgement = judge(scored, simulated, directions, level=settings.level)
    return JudgedLog(scored, judgement, tuple(simulated), tuple(directions))
