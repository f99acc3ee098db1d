"""The search for an effect with which the filter follows a robot that it loses without this effect."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from pmcl.criticism.fitting.quick_fit import THOROUGH, Fit, quick_fit
from pmcl.criticism.fitting.trials import Trial, effect_of
from pmcl.criticism.naming.candidates import RankedEffect, in_order, of_carrier, of_sensors, twins_of, untried
from pmcl.criticism.naming.probability import CREDIBLE, Explanations, explanations
from pmcl.criticism.naming.promises import Promises, bounds_of, with_bounds
from pmcl.criticism.naming.refits import Refits
from pmcl.criticism.scoring.scores import Direction, effect_scores, inside_priors, instance_key, probe_values
from pmcl.criticism.settings import Settings
from pmcl.errors import FilterError
from pmcl.filtering.particle_filter import draw_paths, make_rng, run_filter
from pmcl.logs.robot_log import RobotLog
from pmcl.streams import stream, stream_seed

__all__ = ["Recovery", "recover"]

Float = NDArray[np.float64]

# So many candidates are fitted thoroughly, and the filter is run again with at most so many models (chosen by hand).
_FOLLOWED = 3
# The robot counts as lost by the chain, too, if a filter explains the log better by so many nats: the filter's evidence
# is too small rather than too great, by the noise of its particles (chosen by hand).
_BETTER_PATH = 20.0


class Recovery(NamedTuple):
    """An effect with which the filter follows the robot.

    Attributes
    ----------
    accepted : Trial
        The model with the effect.
    trials : list of Trial
        All candidates that were refitted.
    probable : Explanations
        How probable each of them is, if nothing is missing that has no name: a lost filter has no alarms to go by.
    twins : list of Trial
        Near twins of the effect that may be meant instead.
    """

    accepted: Trial
    trials: list[Trial]
    probable: Explanations
    twins: Sequence[Trial] = ()


def recover(
    fit: Fit, directions: Sequence[Direction], refits: Refits, follow: Callable[[Fit], None]
) -> Recovery | None:
    """Look for an effect with which the filter follows a robot that it loses without.

    Scores of a lost filter mean nothing, but a trajectory that is sampled together with the parameters is not lost so
    easily, and evidence is had along it without a filter that follows (:mod:`pmcl.filtering.guided_filter`). If the
    chain has lost the robot as well, it starts again along the path of a filter that follows further, with an effect of
    the motion. All effects of the motion are refitted, and if none helps those of the sensors. A sensor that is trusted
    less lets a filter follow even if the motion is wrong. An effect of a sensor is therefore refused if it has less
    evidence than one of the motion with which the filter does not follow. One that the catalogue calls a near twin of
    the answer competes with it: a sensor that is turned looks like a robot that slides.

    Parameters
    ----------
    fit : Fit
        A fit of the base model, whose filter loses the robot.
    directions : sequence of Direction
        Candidates.
    refits : Refits
        Refits them.
    follow : callable
        ``follow(fit)`` raises FilterError when the filter of a fitted model does not follow the robot.

    Returns
    -------
    Recovery or None
        The best of the effects with which the filter follows; None if there is none.
    """
    trials: list[Trial] = []
    refits.settings.tell("the filter loses the robot: refitting all effects of its motion, then of its sensors")
    try:
        # A chain that began where a filter had lost the robot may not have settled yet.
        fit = quick_fit(
            fit.bound, stream_seed(refits.settings.seed, "longer fit of a lost robot"), theta=fit.theta,
            path=fit.drawn_path,
        )  # fmt: skip
        current = refits.base_trial(fit)
    except FilterError:
        return None
    candidates = in_order(directions, _promises(directions, fit, refits.log))
    better = _along_a_better_path(current, of_carrier(candidates, "motion"), refits.settings)
    if better is not None:
        fit, current = better, refits.base_trial(better)
        candidates = in_order(directions, _promises(directions, fit, refits.log))
    least_evidence = math.log(len(candidates)) + float(special.logit(CREDIBLE))
    for offered in (of_carrier(candidates, "motion"), of_sensors(candidates)):
        glances = sorted(refits.glances(current, offered), key=lambda trial: -trial.evidence)
        refitted = refits.longer(current, glances[:_FOLLOWED], THOROUGH)
        trials += [*refitted, *glances[_FOLLOWED:]]
        refitted = sorted(refitted, key=lambda trial: -trial.evidence)
        # What is less probable than another one is no answer, whether or not its filter follows.
        likely = [
            trial
            for trial in refitted
            if trial.evidence > least_evidence and _may_be_meant(trial, refitted[0])
        ]
        for trial in likely:
            try:
                follow(trial.fit)
            except FilterError:
                continue
            alike = twins_of([effect_of(trial)], untried(candidates, {instance_key(effect_of(one)) for one in trials}))
            rivals = refits.longer(current, refits.glances(current, alike), THOROUGH)
            best, *others = sorted(
                [trial, *_following(rivals, follow)], key=lambda one: one.evidence, reverse=True
            )
            twins = [other for other in others if _may_be_meant(other, best)]
            tried, seed = [*trials, *rivals], stream_seed(refits.settings.seed, "noise of evidences")
            return Recovery(best, tried, explanations(current, tried, directions, 0, 1.0, seed), twins)
        least_evidence = max([least_evidence, *(trial.evidence for trial in likely)])
    return None


def _promises(directions: Sequence[Direction], fit: Fit, log: RobotLog) -> Promises:
    """Return what candidates promise along the path of a fit; scores of a lost filter only give the order."""
    columns = np.ascontiguousarray(fit.path.T[None])
    scores = effect_scores(fit.tables, log, columns, directions)
    z = scores.sum(axis=1) / np.sqrt((scores**2).sum(axis=1) + np.finfo(float).tiny)
    z = np.where([direction.one_sided for direction in directions], np.maximum(z, 0.0), np.abs(z))
    return with_bounds(0.5 * z**2, np.zeros(z.size), bounds_of(directions, fit, columns))


def _along_a_better_path(current: Trial, candidates: Sequence[RankedEffect], settings: Settings) -> Fit | None:
    """Fit the current model again along the path of a filter with one more effect, if that explains the log far better.

    The effects are as large as is typical for a clear one.
    """
    fit, best = current.fit, current.row_scores.sum() + _BETTER_PATH
    path: Float | None = None
    settings.tell("running filters with effects of the motion")
    for number, candidate in enumerate(candidates):
        effect = candidate.effect
        theta = np.concatenate([fit.theta, inside_priors(effect, probe_values(effect, 1.0, effect.strengths[0]))])
        rng = make_rng(stream(settings.seed, "filter with an effect", number))
        try:
            bound = replace(current.model, effects=(*current.model.effects, effect)).bind(fit.bound.logs)
            tables = bound.tables(theta)[0]
            filtered = run_filter(tables, bound.lengths[0], settings.comparing, rng)
        except FilterError:
            continue
        if filtered.log_evidence > best:
            best, path = filtered.log_evidence, draw_paths(tables, filtered, 1, rng)[0]
    if path is None:
        return None
    settings.tell("the chain had lost the robot as well: fitting the model along another path")
    return quick_fit(fit.bound, stream_seed(settings.seed, "fit along another path"), theta=fit.theta, path=path)


def _following(rivals: Sequence[Trial], follow: Callable[[Fit], None]) -> list[Trial]:
    """Return the rivals with which the filter follows."""
    following = []
    for rival in rivals:
        try:
            follow(rival.fit)
            following.append(rival)
        except FilterError:
            continue
    return following


def _may_be_meant(other: Trial, best: Trial) -> bool:
    """Return whether one of two alike effects belongs to the answer, if the noise of their evidences favours it."""
    lead = best.evidence - other.evidence - math.hypot(best.noise, other.noise)
    return lead < math.log(CREDIBLE / (1.0 - CREDIBLE))
