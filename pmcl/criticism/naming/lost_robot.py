"""The search for an effect with which the filter follows a robot that it loses without this effect."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from pmcl.criticism.fitting.quick_fit import THOROUGH, Fit
from pmcl.criticism.fitting.trials import Trial, effect_of
from pmcl.criticism.naming.candidates import in_order, of_carrier, of_sensors, twins_of, untried
from pmcl.criticism.naming.probability import CREDIBLE
from pmcl.criticism.naming.promises import bounds_of, with_bounds
from pmcl.criticism.naming.refits import Refits
from pmcl.criticism.scoring.scores import Direction, effect_scores, instance_key
from pmcl.errors import FilterError
from pmcl.filtering.paired_scores import block_sums

__all__ = ["Recovery", "recover"]

# So many candidates are fitted thoroughly, and the filter is run again with at most so many models (chosen by hand).
_FOLLOWED = 3
# Significance level of the sign test over blocks of rows that replaces evidence when the filter is lost.
_SIGN_TEST_LEVEL = 0.01


class Recovery(NamedTuple):
    """An effect with which the filter follows the robot.

    Attributes
    ----------
    accepted : Trial
        The model with the effect.
    trials : list of Trial
        All candidates that were refitted.
    twins : list of Trial
        Near twins of the effect that may be meant instead.
    """

    accepted: Trial
    trials: list[Trial]
    twins: Sequence[Trial] = ()


def recover(
    fit: Fit, directions: Sequence[Direction], refits: Refits, follow: Callable[[Fit], None]
) -> Recovery | None:
    """Look for an effect with which the filter follows a robot that it loses without.

    Scores of a lost filter mean nothing, but a trajectory that is sampled together with the parameters is not lost so
    easily. All effects of the motion are refitted, and if none helps those of the sensors. Scores along that trajectory
    still show which beams and landmarks are the likeliest. A sensor that is trusted less lets a filter follow even if
    the motion is wrong. An effect of a sensor is therefore refused if it gains less than a confirmed effect of the
    motion with which the filter does not follow. One that the catalogue calls a near twin of the answer competes with
    it: a sensor that is turned looks like a robot that slides.

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
    try:
        current = refits.base_trial(fit)
    except FilterError:
        return None
    refits.settings.tell("the filter loses the robot: refitting all effects of its motion, then of its sensors")
    # Scores of a lost filter have an unknown distribution: they only give the order, and fits start without them.
    columns = np.ascontiguousarray(fit.path.T[None])
    scores = effect_scores(fit.tables, refits.log, columns, directions)
    z = scores.sum(axis=1) / np.sqrt((scores**2).sum(axis=1) + np.finfo(float).tiny)
    z = np.where([direction.one_sided for direction in directions], np.maximum(z, 0.0), np.abs(z))
    candidates = in_order(directions, with_bounds(0.5 * z**2, np.zeros(z.size), bounds_of(directions, fit, columns)))
    least_evidence = 0.0
    for offered in (of_carrier(candidates, "motion"), of_sensors(candidates)):
        glances = refits.glances(current, offered)
        by_blocks = sorted(glances, key=lambda trial: (-_gaining_blocks(trial, current).sum(), -trial.evidence))
        best = max(glances, key=lambda trial: trial.evidence, default=None)
        likely = by_blocks[:_FOLLOWED] + [trial for trial in by_blocks[_FOLLOWED:] if trial is best]
        refitted = refits.longer(current, likely, THOROUGH)
        trials += [*refitted, *(trial for trial in glances if not any(trial is other for other in likely))]
        confirmed = [
            trial for trial in refitted if trial.evidence > least_evidence and _gains_everywhere(trial, current)
        ]
        for trial in sorted(confirmed, key=lambda trial: -trial.evidence)[:_FOLLOWED]:
            try:
                follow(trial.fit)
            except FilterError:
                continue
            alike = twins_of([effect_of(trial)], untried(candidates, {instance_key(effect_of(one)) for one in trials}))
            rivals = refits.longer(current, refits.glances(current, alike), THOROUGH)
            best, *others = sorted(
                [trial, *_following(rivals, current, follow)], key=lambda one: one.evidence, reverse=True
            )
            twins = [other for other in others if _may_be_meant(other, best)]
            return Recovery(best, [*trials, *rivals], twins)
        least_evidence = max((trial.evidence for trial in confirmed), default=0.0)
    return None


def _following(rivals: Sequence[Trial], current: Trial, follow: Callable[[Fit], None]) -> list[Trial]:
    """Return the rivals that gain nearly everywhere and with which the filter follows."""
    following = []
    for rival in rivals:
        try:
            if _gains_everywhere(rival, current):
                follow(rival.fit)
                following.append(rival)
        except FilterError:
            continue
    return following


def _may_be_meant(other: Trial, best: Trial) -> bool:
    """Return whether one of two alike effects belongs to the answer, if the noise of their evidences favours it."""
    lead = best.evidence - other.evidence - math.hypot(best.noise, other.noise)
    return lead < math.log(CREDIBLE / (1.0 - CREDIBLE))


def _gaining_blocks(trial: Trial, current: Trial) -> NDArray[np.bool_]:
    return block_sums(trial.row_scores - current.row_scores) > 0.0


def _gains_everywhere(trial: Trial, current: Trial) -> bool:
    """Return whether a trial gains in so many blocks of rows as chance hardly gives.

    Some rows gain hundreds of nats where a filter is lost, so that standard errors of gains are hardly smaller than the
    gains. An effect that the robot has gains nearly everywhere. An effect that only lets the filter pass the place
    where it is lost gains there alone. A sign test over blocks of rows distinguishes the two.
    """
    gaining = _gaining_blocks(trial, current)
    test = stats.binomtest(int(gaining.sum()), gaining.size, alternative="greater")
    return float(test.pvalue) < _SIGN_TEST_LEVEL
