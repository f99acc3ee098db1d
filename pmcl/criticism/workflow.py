"""The critic's entry point: check the arguments, then run the loop."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from pmcl import defaults
from pmcl.criticism.arguments import check_arguments
from pmcl.criticism.findings.result import Criticism
from pmcl.criticism.lost_filter import LEAST_ROWS, Runs
from pmcl.criticism.progress import Progress
from pmcl.criticism.settings import Settings
from pmcl.errors import CriticismError
from pmcl.interrupts import stopping_on_interrupt
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.models.effects.registry import candidates
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.preflight.check import checked_logs

__all__ = ["criticize"]


@stopping_on_interrupt()
def criticize(
    log: RobotLog,
    model: RobotModel | None = None,
    *,
    effects: Sequence[Effect] | None = None,
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
    effects : sequence of Effect, optional
        Candidates; when left out, all effects of the catalogue at all places that the log has.
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
    PmclError
        When model and log do not fit each other.

    Notes
    -----
    An effect is chosen on the first 60 % of the rows. The other rows, which alone give the gap, must confirm it. If the
    disagreement begins too late for that, the shares are 80 and 20 %. An alarm that is not beyond doubt is judged again
    with three times as many simulated logs. This is not necessary when an effect gains more than two standard errors on
    the held-out part, or when it gains one standard error there and, on the whole log, two and more than chance can. A
    number that deviates by z standard errors costs a model at least z^2 / 2 nats. An effect that gains less must
    therefore also be the best one among all effects of the whole robot and formulas.

    If the filter of the base model loses the robot, scores mean nothing. Effects of the motion are refitted then, and
    after them effects of the sensors; the first one that lets the filter follow is added. If there is none, gross
    errors are allowed for among the readings, and effects are sought beside them. In the end gross errors are left out
    again, if the filter follows without them and held-out rows lose nothing. If the filter is lost with gross errors,
    too, only the rows before the loss are judged. If these are too few, the result says where the robot is lost. Notes
    tell what of this was done. The verdict is "unknown effect" then, unless effects were found on the whole log and no
    alarm is left.
    """
    check_arguments(
        log, model, effects, {"particles": particles, "simulations": simulations, "paths": paths, "rounds": rounds,
                              "draws": draws, "workers": workers},
        {"joint": joint, "progress": progress, "posterior": posterior}, seed, level,
    )  # fmt: skip
    if posterior and not joint:
        raise CriticismError(
            "expected full chains for a posterior, but joint=False switches them off; leave joint at True, or ask "
            "for no posterior"
        )
    log = log.without_truth()
    _check(log)
    checked_logs((log,), model)
    base = model or default_model(log)
    with Progress(progress) as reporter:
        threads = workers or os.cpu_count() or 1
        settings = Settings(particles, seed, level, simulations, paths, threads, progress, reporter=reporter)
        runs = Runs(
            settings,
            offered=candidates if effects is None else lambda log: effects,
            run=lambda loop: loop.run(rounds, joint, draws, always=posterior),
        )
        return runs.criticism_of(log, base)


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
    if not np.any(log.odometry[1:] != 0.0):
        raise CriticismError(
            f"{log.where}: expected a robot that moves, but all odometry is zero; drive, and turn both ways"
        )
