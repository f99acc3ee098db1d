"""Which trials go on to a longer fit, which one explains the log, and whether held-out rows confirm it.

For absorbers and structured candidates see :mod:`pmcl.criticism.naming.shortlist`. The thresholds of this module were
chosen by hand on simulated logs with hidden effects (blocks 0 to 4 of analyses/hidden_effects) and judged on later
blocks, unless a comment says otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from pmcl.criticism.fitting.trials import PRACTICAL, Trial
from pmcl.criticism.naming.shortlist import are_near_twins
from pmcl.filtering.paired_scores import block_sums, paired_gain

__all__ = [
    "choose", "confirmed_without_score", "contenders", "contenders_when_lost", "leaders", "twins_of", "with_formulas",
    "worth_it",
]  # fmt: skip

# The trials between which the choice is made: at most so many, and at most so far behind the first one [nat]. A brief
# fit misjudges a trial by some nats.
_LEADERS, _LEADER_DISTANCE = 3, 15.0
# A trial is dropped after a glance when it is further behind the first one than this [nat] and than this share of the
# first one's gain. A glance differs from a longer fit by some 4 nats.
_GLANCE_DISTANCE, _GLANCE_SHARE = 15.0, 0.3
# A structured candidate that gains less than this share of an absorber's gain at a glance does not compete with it.
_RIVAL_SHARE = 0.2
# A trial that loses more than this at a glance [nat] hardly ever becomes worth its parameters.
_GLANCE_LOSS = 2.0
# At most so many structured candidates are refitted after a glance, besides near twins of the best one.
_MOST_CONTENDERS = 5
# A standardised score below this never counts as a test by itself.
_LEAST_CRITICAL_Z = 3.0
# An effect that lies closer to none than this is not accepted [standard deviations of its draws]. The usual bound for
# one parameter; what the fit cannot tell from none explains nothing, whatever accident it gains by.
_LEAST_FROM_NULL = 2.0
# Significance level of the sign test over blocks of rows that replaces scores when the filter is lost.
_SIGN_TEST_LEVEL = 0.01
# A near twin that gains this share of the winner's gain is named with it.
_TWIN_SHARE = 0.9


def contenders(glances: Sequence[Trial], rivals: Sequence[Trial] = ()) -> list[Trial]:
    """Return the trials that are worth a longer fit because a glance finds them not far behind others.

    An absorber may gain more than all structured candidates at a glance, and lose to the best of these after a longer
    fit. Structured candidates are therefore compared with each other; they are dropped for an absorber only if it gains
    many times as much. Otherwise near twins of the best trial stay, because a short chain leaves in the path what the
    path can absorb. Where nothing gains much, all trials are close to each other; a glance is some nats off, but hardly
    ever ranks five trials above the best one.

    Parameters
    ----------
    glances : sequence of Trial
        Candidates refitted at a glance.
    rivals : sequence of Trial
        Other trials that they compete with.
    """

    def least_merit(trials: Sequence[Trial]) -> float:
        best_merit = max((trial.merit for trial in trials), default=0.0)
        return max(min(best_merit - _GLANCE_DISTANCE, (1.0 - _GLANCE_SHARE) * best_merit), -_GLANCE_LOSS)

    everyone = [*glances, *rivals]
    best = max(everyone, key=lambda trial: trial.merit, default=None)
    least_of_absorbers = least_merit(everyone)
    least_of_structured = least_merit([trial for trial in everyone if not trial.absorber])
    least_of_all = -np.inf
    if best is not None and best.absorber and best.merit > 0.0:
        least_of_all = min(_RIVAL_SHARE * best.merit, best.merit - _GLANCE_DISTANCE)
    merits = [trial.merit for trial in glances if trial.effect is not None and not trial.absorber]
    if len(merits) >= _MOST_CONTENDERS:
        least_of_structured = max(least_of_structured, sorted(merits, reverse=True)[_MOST_CONTENDERS - 1])

    def goes_on(trial: Trial) -> bool:
        if trial.effect is None:
            return True
        if trial.merit < least_of_all:
            return False
        if trial.merit >= (least_of_absorbers if trial.absorber else least_of_structured):
            return True
        return best is not None and best.effect is not None and are_near_twins(trial.effect, best.effect)

    return [trial for trial in glances if goes_on(trial)]


def contenders_when_lost(glances: Sequence[Trial], current: Trial) -> list[Trial]:
    """Return the trials that are worth a longer fit when the filter has lost the robot.

    Total gains may be due to chance then. The trials that gain in most blocks of rows go on, and the one with the
    greatest total gain.

    Parameters
    ----------
    glances : sequence of Trial
        Candidates refitted at a glance.
    current : Trial
        The current model.
    """
    by_blocks = sorted(glances, key=lambda trial: (-_gaining_blocks(trial, current).sum(), -trial.merit))
    best = max(glances, key=lambda trial: trial.merit, default=None)
    return by_blocks[:_LEADERS] + [trial for trial in by_blocks[_LEADERS:] if trial is best]


def leaders(trials: Sequence[Trial]) -> list[Trial]:
    """Return the trials between which the choice is made; they are fitted thoroughly before it."""
    ranked = sorted(trials, key=lambda trial: -trial.merit)
    return [trial for trial in ranked[:_LEADERS] if trial.merit > max(PRACTICAL, ranked[0].merit - _LEADER_DISTANCE)]


def choose(trials: Sequence[Trial]) -> tuple[Trial | None, list[Trial]]:
    """Choose the trial with the greatest evidence, see :attr:`Trial.evidence`.

    Where held-out rows do not confirm that one, the choice is among those that gain more there and are confirmed: an
    obstacle may explain much of the places that the robot visits first. An absorber is chosen only if it beats the best
    structured candidate by more than two standard errors.

    Parameters
    ----------
    trials : sequence of Trial
        Refitted candidates.

    Returns
    -------
    best : Trial or None
        The choice; None without trials.
    twins : list of Trial
        Trials that the whole log cannot distinguish from it, see :func:`twins_of`.
    """
    if not trials:
        return None, []
    structured = [trial for trial in trials if trial.effect is not None and not trial.absorber]
    best = max(trials, key=lambda trial: trial.evidence)
    if not best.on_heldout.significant:
        least = max(PRACTICAL, best.on_heldout.total)
        confirmed = [
            trial
            for trial in trials
            if trial.merit > 0.0 and trial.on_heldout.significant and trial.on_heldout.total > least
        ]
        best = max(confirmed, key=lambda trial: trial.evidence, default=best)
    if structured and best.absorber:
        rival = max(structured, key=lambda trial: trial.evidence)
        lead = paired_gain(best.row_scores, rival.row_scores, slice(0, best.fit.bound.lengths[0]))
        if not lead.significant and rival.on_fit.significant:
            best = rival
    return best, twins_of(best, trials)


def twins_of(best: Trial, trials: Sequence[Trial]) -> list[Trial]:
    """Return the trials that the whole log cannot distinguish from the best one.

    Such a trial lies less than two standard errors behind, or it gains nearly as much and is a near twin that the
    catalogue knows.

    Parameters
    ----------
    best : Trial
        The best trial.
    trials : sequence of Trial
        All trials.
    """
    assert best.effect is not None
    twins = []
    for trial in trials:
        if trial is best or not trial.on_all.significant:
            continue
        if best.effect.shape and trial.effect is not None and trial.effect.name == best.effect.name:
            continue  # the same effect, fitted from another starting place
        lead = paired_gain(best.row_scores, trial.row_scores, slice(None))
        # The standard error of a lead does not include errors that both models share; near twins need a clearer lead.
        known = trial.effect is not None and are_near_twins(best.effect, trial.effect)
        if lead.total < 2.0 * lead.se or (known and trial.on_all.total > _TWIN_SHARE * best.on_all.total):
            twins.append(trial)
    return twins


def with_formulas(
    best: Trial, twins: Sequence[Trial], formulas: Sequence[Trial], critical_z: float
) -> tuple[Trial, list[Trial]]:
    """Let formulas compete with the best effect of the catalogue.

    A formula replaces an effect that it beats by more than two standard errors on the fit part, and an absorber that it
    beats at all. Other formulas are named as twins if the whole log cannot distinguish them from the effect.

    Parameters
    ----------
    best : Trial
        The best effect of the catalogue.
    twins : sequence of Trial
        Effects that the log cannot distinguish from it.
    formulas : sequence of Trial
        Refitted formulas.
    critical_z : float
        Critical value of the formulas' scores.

    Returns
    -------
    best : Trial
        The effect or formula that explains the log.
    twins : list of Trial
        Effects and formulas that the log cannot distinguish from it.
    """
    better = [trial for trial in formulas if trial.merit > best.merit and worth_it(trial, critical_z)]
    if better:
        formula = max(better, key=lambda trial: trial.merit)
        lead = paired_gain(formula.row_scores, best.row_scores, slice(0, best.fit.bound.lengths[0]))
        if best.absorber or (lead.significant and lead.total > PRACTICAL):
            return formula, []
    leads = [
        (formula, paired_gain(best.row_scores, formula.row_scores, slice(None)))
        for formula in formulas
        if formula.on_all.significant
    ]
    return best, [*twins, *(formula for formula, lead in leads if lead.total < 2.0 * lead.se)]


def worth_it(best: Trial, critical_z: float) -> bool:
    """Return whether held-out rows confirm the trial that the fit part has chosen.

    A gain of z^2 / 2 nats has a standard error of about z. To require two standard errors is therefore to require
    z = 4 on the held-out part alone; one is enough if the whole log leaves no doubt, see :attr:`Trial.confirmed`. An
    effect whose own score exceeds its critical value has passed a test with a known error rate already. Any gain on the
    held-out part confirms it, if the gain on the whole log exceeds its standard error. No gain may come from a single
    block of rows, see :attr:`Trial.in_several_blocks`. An effect that the fit cannot tell from none is none, see
    :attr:`Trial.from_null`.

    Parameters
    ----------
    best : Trial
        The trial.
    critical_z : float
        Critical value of the candidates' scores.
    """
    if best.from_null < _LEAST_FROM_NULL:
        return False
    if abs(best.z) > max(critical_z, _LEAST_CRITICAL_Z):
        return best.in_several_blocks and best.on_all.total > max(PRACTICAL, best.on_all.se)
    return best.confirmed


def _gaining_blocks(trial: Trial, current: Trial) -> NDArray[np.bool_]:
    return block_sums(trial.row_scores - current.row_scores) > 0.0


def confirmed_without_score(trial: Trial, current: Trial) -> bool:
    """Return whether both parts of the log confirm a trial when scores mean nothing because the filter is lost.

    Some rows gain hundreds of nats where a filter is lost, so that standard errors of gains are hardly smaller than the
    gains. An effect that the robot has gains nearly everywhere. An effect that only lets the filter pass the place
    where it is lost gains there alone. A sign test over blocks of rows distinguishes the two.

    Parameters
    ----------
    trial : Trial
        The trial.
    current : Trial
        The current model, which loses the robot.
    """
    gaining = _gaining_blocks(trial, current)
    p_value = float(stats.binomtest(int(gaining.sum()), gaining.size, alternative="greater").pvalue)
    return p_value < _SIGN_TEST_LEVEL and all(
        gain.total > max(PRACTICAL, gain.se) for gain in (trial.on_fit, trial.on_heldout)
    )
