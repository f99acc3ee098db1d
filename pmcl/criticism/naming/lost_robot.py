"""The search for an effect with which the filter follows a robot that it loses without this effect."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from pmcl.criticism.fitting.quick_fit import Fit, quick_fit
from pmcl.criticism.fitting.trials import Trial
from pmcl.criticism.naming.choice import confirmed_without_score
from pmcl.criticism.naming.refits import Refits
from pmcl.criticism.naming.shortlist import RankedEffect, of_carrier, of_sensors
from pmcl.criticism.scoring.scores import Direction, effect_scores
from pmcl.errors import FilterError

__all__ = ["Recovery", "recover"]

# The filter is run again with at most so many models (chosen by hand).
_FOLLOWED = 3


class Recovery(NamedTuple):
    """An effect with which the filter follows the robot.

    Attributes
    ----------
    accepted : Trial
        The model with the effect.
    trials : list of Trial
        All candidates that were refitted.
    """

    accepted: Trial
    trials: list[Trial]


def recover(
    fit: Fit, directions: Sequence[Direction], refits: Refits, follow: Callable[[Fit], None]
) -> Recovery | None:
    """Look for an effect with which the filter follows a robot that it loses without.

    Scores of a lost filter mean nothing, but a trajectory that is sampled together with the parameters is not lost so
    easily. All effects of the motion are refitted, and if none helps those of the sensors. Scores along that trajectory
    still show which beams and landmarks are the likeliest. A sensor that is trusted less lets a filter follow even if
    the motion is wrong. An effect of a sensor is therefore refused if it gains less than a confirmed effect of the
    motion with which the filter does not follow.

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
    scores = effect_scores(fit.tables, refits.log, np.ascontiguousarray(fit.path.T[None]), directions)
    z = scores.sum(axis=1) / np.sqrt((scores**2).sum(axis=1) + np.finfo(float).tiny)
    z = np.where([direction.one_sided for direction in directions], np.maximum(z, 0.0), z)
    least_merit = 0.0
    for offered in (of_carrier(directions, z, "motion"), of_sensors(directions, z)):
        # The scores only rank the candidates, because their distribution is unknown here; fits start without them.
        unranked = [RankedEffect(candidate.effect, 0.0) for candidate in offered]
        refitted = refits.refit_leaders(current, refits.refit(current, unranked, lost=True))
        trials += refitted
        confirmed = [
            trial for trial in refitted if trial.merit > least_merit and confirmed_without_score(trial, current)
        ]
        for trial in sorted(confirmed, key=lambda trial: -trial.merit)[:_FOLLOWED]:
            bound = trial.model.bind(refits.log)
            try:
                follow(quick_fit(bound, refits.seed, theta=trial.fit.theta, path=fit.path, draws=trial.fit.draws))
            except FilterError:
                continue
            return Recovery(trial, trials)
        least_merit = max((trial.merit for trial in confirmed), default=0.0)
    return None
