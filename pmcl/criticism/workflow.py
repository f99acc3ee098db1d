"""The critic's entry point: check the arguments, then run the loop."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pmcl import defaults
from pmcl.criticism.arguments import check_arguments, check_other
from pmcl.criticism.conclusion import concluded
from pmcl.criticism.findings.result import Criticism
from pmcl.criticism.fitting.held_out import HELD_OUT_SHARE
from pmcl.criticism.loop import Loop
from pmcl.criticism.lost_filter import LEAST_ROWS, Runs
from pmcl.criticism.progress import Progress
from pmcl.criticism.scoring.statistics import Statistic, checked_statistics, statistics_in_use
from pmcl.criticism.settings import Settings
from pmcl.criticism.state import Task
from pmcl.errors import CriticismError
from pmcl.filtering.estimated_path import with_estimated_path
from pmcl.interrupts import stopping_on_interrupt
from pmcl.logs.joined import join_logs, joints_of
from pmcl.logs.robot_log import RobotLog
from pmcl.logs.schema import readings
from pmcl.models.effects.effect import Effect
from pmcl.models.effects.registry import candidates
from pmcl.models.robot_model import RobotModel, default_model, log_sequence
from pmcl.preflight.check import checked_logs

__all__ = ["criticize"]

# Both parts of a log must have so many readings (chosen by hand).
_LEAST_READINGS = 20


@stopping_on_interrupt()
def criticize(
    log: RobotLog | Sequence[RobotLog],
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
    log : RobotLog, or sequence of RobotLog
        The log, or several logs of one robot with the same sensors in the same surroundings, which are criticised
        together (:func:`pmcl.logs.joined.join_logs`). Reference trajectories and true parameters are never read.
    model : RobotModel, optional
        The base model; the default model of the log when left out.
    held_out : RobotLog, optional
        Another log of the robot with the same sensors, which gives gains and gaps. When left out, the last part of
        `log` serves for that.
    effects : sequence of Effect, optional
        Candidates; when left out, all effects of the catalogue at all places that the log has.
    statistics : sequence of Statistic, optional
        Statistics of your own, which become alarms; when left out, those in use
        (:func:`pmcl.criticism.scoring.statistics.use_statistics`).
    particles : int
        Particles of scored passes; held-out rows are predicted with four times as many.
    seed : int
        Determines all random numbers.
    level : float
        Rate of false alarms.
    simulations : int
        Number of logs that the fitted model simulates for comparison: fewer where some of them raise an alarm already
        that an effect explains, and up to three times as many where an alarm is in doubt.
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
    PmclError
        When model and log do not fit each other.

    Notes
    -----
    An alarm is the only reason to look for an effect. What it is, posterior probabilities decide
    (:mod:`pmcl.criticism.naming.search`): half of the prior is on nothing, and the evidence of each effect is that of
    the whole log. The most probable effect is added, and told with those that may be meant instead. The gap is that of
    the last 40 % of the rows, predicted by models whose parameters are fitted to the rows before, or that of the other
    log. An alarm that is not beyond doubt is judged again with up to three times as many simulated logs, unless some
    effect explains it beyond doubt.

    If the filter of the base model loses the robot, scores mean nothing. Effects of the motion are refitted then, and
    after them effects of the sensors; the first one that lets the filter follow is added. If there is none, gross
    errors are allowed for among the readings, and effects are sought beside them. In the end gross errors are left out
    again, if the filter follows without them and the log does not speak for them. If the filter is lost with gross
    errors, too, only the rows before the loss are judged. If these are too few, the result says where the robot is
    lost. Notes tell what of this was done. The verdict is "unknown effect" then, unless effects were found on the whole
    log and no alarm is left.
    """
    logs = log_sequence(log)
    check_arguments(
        logs, held_out, model, effects,
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
    checked_logs(logs, model)
    log = join_logs([one.without_truth() for one in logs])
    _check(log)
    base = model or default_model(log)
    other = None
    if held_out is not None:
        other = held_out.without_truth()
        check_other(log, other)
        checked_logs((other,), model)

    def run(task: Task) -> Criticism:
        state = Loop(task, rounds).run()
        return concluded(task, state, draws=draws if joint and (state.answers or posterior) else 0)

    with Progress(progress) as reporter:
        threads = workers or os.cpu_count() or 1
        settings = Settings(
            particles, seed, level, simulations, paths, threads, progress, reporter=reporter,
            statistics=own_statistics,
        )  # fmt: skip
        if other is not None:
            # Formulas that are found on the log may need the path of the other one.
            other = with_estimated_path(other, base, always=True, seed=seed)
        runs = Runs(
            settings,
            offered=candidates if effects is None else lambda log: effects,
            run=run,
            other=other,
        )
        found = runs.criticism_of(log, base)
    return replace(found, notes=(*_joined(log), *found.notes))


def _joined(log: RobotLog) -> list[str]:
    """Return notes on what a joined log consists of."""
    return [
        f"{joint.where} begins at t={joint.time:g} s of the logs together, which is t={joint.own_time:g} s of its own"
        for joint in joints_of(log)
    ]


def _check(log: RobotLog) -> None:
    if log.n_steps < LEAST_ROWS:
        # The rows of a lidar's log are those scans that a filter uses; recordings hold more.
        more = "; record longer"
        if log.lidars:
            more += ", or convert with more scans (--update-min-d 0.1 --update-min-a 0.1; 0 takes every scan)"
        raise CriticismError(
            f"{log.where}: expected at least {LEAST_ROWS} rows, to fit on one part and judge on another, but got "
            f"{log.n_steps}{more}"
        )
    split = round((1.0 - HELD_OUT_SHARE) * log.n_steps)
    parts = [_readings(log, rows) for rows in (slice(0, split), slice(split, None))]
    if min(parts) < _LEAST_READINGS:
        raise CriticismError(
            f"{log.where}: expected at least {_LEAST_READINGS} readings in the first {1.0 - HELD_OUT_SHARE:.0%} of the "
            f"log and in the rest, but got {parts[0]} and {parts[1]}; record more"
        )
    if not np.any(log.odometry[1:] != 0.0):
        raise CriticismError(
            f"{log.where}: expected a robot that moves, but all odometry is zero; drive, and turn both ways"
        )


def _readings(log: RobotLog, rows: slice) -> int:
    """Return how many numbers the sensors have read in some rows."""
    variables = (log.dataset[name].values[rows] for name in readings(log.dataset) if name in log.dataset)
    return sum(int((~np.isnan(values)).sum()) for values in variables)
