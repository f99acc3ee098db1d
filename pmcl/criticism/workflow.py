"""The critic's entry point: check the arguments, then run the loop."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from pmcl import defaults
from pmcl.criticism.arguments import check_arguments, check_other
from pmcl.criticism.findings.result import Criticism
from pmcl.criticism.loop import Loop
from pmcl.criticism.naming.search import Search
from pmcl.criticism.progress import Progress
from pmcl.criticism.scoring.statistics import Statistic, checked_statistics, statistics_in_use
from pmcl.criticism.settings import Settings
from pmcl.errors import CriticismError
from pmcl.filtering.estimated_path import with_estimated_path
from pmcl.interrupts import stopping_on_interrupt
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.models.effects.registry import candidates
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.preflight.check import checked_logs

__all__ = ["criticize"]

# A log must have so many rows, for a fit on one part and a comparison on the other (chosen by hand).
_LEAST_ROWS = 60


@stopping_on_interrupt()
def criticize(
    log: RobotLog,
    model: RobotModel | None = None,
    *,
    held_out: RobotLog | None = None,
    effects: Sequence[Effect] | None = None,
    statistics: Sequence[Statistic] | None = None,
    particles: int = defaults.CRITICISM_PARTICLES,
    seed: int = 0,
    level: float = defaults.FALSE_ALARM_LEVEL,
    simulations: int = 30,
    paths: int = 15,
    rounds: int = 3,
    joint: bool = True,
    draws: int = 500,
    posterior: bool = False,
    workers: int | None = None,
    progress: bool = False,
) -> Criticism:
    """Find where a model and a log disagree, name the missing effect, add it, and measure what it explains.

    Parameters
    ----------
    log : RobotLog
        The log; its reference trajectory and true parameters are never read.
    model : RobotModel, optional
        The base model; the default model of the log when left out.
    held_out : RobotLog, optional
        Another log of the robot with the same sensors. Models are then fitted to the whole of `log`, gains are
        confirmed on this one, and it gives the gaps. When left out, the last part of `log` serves for that.
    effects : sequence of Effect, optional
        Candidates; when left out, all effects of the catalogue at all places that the log has.
    statistics : sequence of Statistic, optional
        Statistics of your own, which become alarms; when left out, those in use
        (:func:`pmcl.criticism.scoring.statistics.use_statistics`).
    particles : int
        Particles of scored passes; comparisons of log scores use four times as many.
    seed : int
        Determines all random numbers.
    level : float
        Rate of false alarms.
    simulations : int
        Number of logs that the fitted model simulates for comparison.
    paths : int
        Number of trajectories over which scores are averaged.
    rounds : int
        Greatest number of effects that are added.
    joint : bool
        Whether the final model is calibrated by full chains; otherwise one longer chain gives its parameters.
    draws : int
        Draws of each of the four final chains.
    posterior : bool
        Whether full chains are run even if no effect is added to the model, so that the result always has a posterior.
    workers : int, optional
        Number of threads; one for each core when left out. The result does not depend on it.
    progress : bool
        Whether to report what is being tried, how many candidates are left, and the elapsed time. On a terminal one
        line is kept up to date; elsewhere the logger ``pmcl.criticism`` gets messages.

    Returns
    -------
    Criticism

    Raises
    ------
    CriticismError
        When the log is too short to split, when nothing in it moves, or when a posterior is asked for without full
        chains.
    FilterError
        When the filter loses the robot and no single effect lets it follow; scores mean nothing then.
    PmclError
        When model and log do not fit each other.

    Notes
    -----
    Unless another log is held out, an effect is chosen on the first 60 % of the rows. The other rows, which alone give
    the gap, must confirm it. If the disagreement begins too late for that, the shares are 80 and 20 %. An alarm that is
    not beyond doubt is judged again with three times as many simulated logs. This is not necessary when an effect gains
    more than two standard errors on the held-out part, or when it gains one standard error there and, on the whole log,
    two and more than chance can. A number that deviates by z standard errors costs a model at least z^2 / 2 nats. An
    effect that gains less must therefore also be the best one among all effects of the whole robot and formulas. If the
    filter of the base model loses the robot, effects of the motion are refitted first, then effects of the sensors; the
    first one that lets the filter follow is added.
    """
    check_arguments(
        log, held_out, model, effects,
        {"particles": particles, "simulations": simulations, "paths": paths, "rounds": rounds, "draws": draws,
         "workers": workers},
        {"joint": joint, "progress": progress, "posterior": posterior}, seed, level,
    )  # fmt: skip
    own_statistics = statistics_in_use() if statistics is None else checked_statistics(statistics)
    if posterior and not joint:
        raise CriticismError(
            "expected full chains for a posterior, but joint=False switches them off; leave joint at True, or ask "
            "for no posterior"
        )
    log = log.without_truth()
    _check(log)
    checked_logs((log,), model)
    base = model or default_model(log)
    other = None
    if held_out is not None:
        other = held_out.without_truth()
        check_other(log, other)
        checked_logs((other,), model)
    with Progress(progress) as reporter:
        threads = workers or os.cpu_count() or 1
        settings = Settings(
            particles, seed, level, simulations, paths, threads, progress, reporter=reporter,
            statistics=own_statistics,
        )  # fmt: skip
        log = with_estimated_path(log, base, seed=seed)
        if other is not None:
            # Formulas that are found on the log may need the path of the other one.
            other = with_estimated_path(other, base, always=True, seed=seed)
        offered = candidates(log) if effects is None else effects
        return Loop(base, Search(log, offered, settings, other)).run(rounds, joint, draws, always=posterior)


def _check(log: RobotLog) -> None:
    if log.n_steps < _LEAST_ROWS:
        # The rows of a lidar's log are those scans that a filter uses; recordings hold more.
        more = "; record longer"
        if log.lidars:
            more += ", or convert with more scans (--update-min-d 0.1 --update-min-a 0.1; 0 takes every scan)"
        raise CriticismError(
            f"{log.where}: expected at least {_LEAST_ROWS} rows, to fit on one part and judge on another, but got "
            f"{log.n_steps}{more}"
        )
    if not np.any(log.odometry[1:] != 0.0):
        raise CriticismError(
            f"{log.where}: expected a robot that moves, but all odometry is zero; drive, and turn both ways"
        )
