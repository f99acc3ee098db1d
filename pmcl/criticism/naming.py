"""Naming the effect that explains an alarm: rank all candidates, refit a few, let the fit part of the log choose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from pmcl.criticism.alarms import Judgement
from pmcl.criticism.heldout import block_sums, paired_gain
from pmcl.criticism.scores import Direction, probe_values
from pmcl.criticism.trials import PRACTICAL, Trial
from pmcl.errors import PmclError
from pmcl.filtering.particle_filter import make_rng, run_filter
from pmcl.models.effects.effect import Effect
from pmcl.models.robot_model import BoundModel
from pmcl.models.tables import Tables, uniform

__all__ = [
    "choose", "confirmed_without_score", "contenders", "contenders_when_lost", "leaders", "of_a_carrier",
    "of_the_sensors", "of_the_whole_robot", "scan", "shortlist", "twins_of", "untried", "untried_twins",
    "with_rules", "worth_it",
]  # fmt: skip

Float = NDArray[np.float64]

_BY_SCORE, _BY_SCAN, _ABSORBERS = 4, 2, 2
# What is among so many first by the score of the whole log, and remarkable there, is refitted though it comes late.
_BY_WHOLE = 3
# Absorbers that lead call for this many more structured candidates, as far as their scores are remarkable.
_MORE_STRUCTURED, _REMARKABLE = 8, 2.5
# Evidence of 500 particles has a standard deviation of some 8 nats: a scan sees only what is far larger.
_SCAN_Z, _SCAN_GAIN = 6.0, 30.0
# Most of what is not in the data is far behind after this share of the rows, and is followed no further.
_SCAN_FIRST = 0.25
# Trials that are refitted at length before the choice where they gain something, and how far behind the first they may
# be [nat].
_LEADERS, _BEHIND = 3, 15.0
# Trials that a glance finds further behind the first than this [nat], and than this share of its gain, are dropped.
_FAR, _FAR_SHARE = 15.0, 0.3
# A structured candidate that gains less than this share of what an absorber gains at a glance is no rival of it.
_RIVAL_SHARE = 0.2
# A glance is some 4 nats off; what is further below nothing than this [nat] hardly ever becomes worth its parameters.
_HOPE = 2.0
# Of structured candidates no more than this many are refitted at length, besides near twins of the best.
_AT_MOST = 5
# One-sided candidates with smaller scores than this are not refitted for a steady error that the path takes up.
_SOME_SCORE = 1.0
# Scores below this are never beyond doubt.
_CRITICAL = 3.0
# Where scores mean nothing a sign test over blocks of rows must be as clear as this.
_BY_CHANCE = 0.01
# A near twin that gains this share of what the winner gains is named with it.
_NEARLY_ALL = 0.9


def shortlist(
    wanted: Sequence[Direction], z: Float, scanned: dict[int, float], judgement: Judgement, more: bool = False
) -> list[tuple[Effect, float]]:
    """Return the candidates worth a refit with their deviations: structured ones by score, by scan, and absorbers.

    What the whole log speaks for most is among them, though it may be one of many absorbers or come late.

    Parameters
    ----------
    wanted : sequence of Direction
        All K directions.
    z : ndarray, shape (K,)
        Their deviations on the fit part.
    scanned : dict
        Gain of the finite scan by position of a direction, where there was one.
    judgement : Judgement
        Of all rows.
    more : bool
        Return instead the further structured candidates that must have lost before an absorber may win.
    """
    order = [int(k) for k in np.argsort(-np.abs(z))]
    structured = _distinct(wanted, [k for k in order if not wanted[k].effect.absorber])
    if more:
        rest = structured[_BY_SCORE : _BY_SCORE + _MORE_STRUCTURED]
        return [(wanted[k].effect, float(z[k])) for k in rest if abs(z[k]) > _REMARKABLE]
    absorbers = _distinct(wanted, [k for k in order if wanted[k].effect.absorber])
    whole = np.abs(judgement.z)
    by_whole = _distinct(wanted, [int(k) for k in np.argsort(-whole) if whole[k] > judgement.critical_z])
    first = structured[:_BY_SCORE] + absorbers[:_ABSORBERS]
    chosen = [wanted[k].effect for k in _distinct(wanted, first + by_whole[:_BY_WHOLE])]
    known = {id(wanted[k].effect): float(z[k]) for k in reversed(order)}
    by_scan = sorted((k for k in scanned if scanned[k] > _SCAN_GAIN), key=lambda k: -scanned[k])
    scanned_first = [wanted[k].effect for k in _distinct(wanted, by_scan)]
    fresh = [effect for effect in scanned_first if not any(_same(effect, one) for one in chosen)]
    return [(effect, known[id(effect)]) for effect in chosen + fresh[:_BY_SCAN]]


def of_the_whole_robot(wanted: Sequence[Direction], z: Float) -> list[tuple[Effect, float]]:
    """Return the structured candidates that have no place, greatest scores first.

    A steady error of the mount or of odometry is mostly taken up by the path: it may have hardly a score, and show
    only when it is refitted. What can only be there or not, as the weight of a mixture, is not taken up: without a
    score it is not there.
    """
    order = [int(k) for k in np.argsort(-np.abs(z))]
    able = [
        k for k in order
        if not wanted[k].effect.where and not wanted[k].effect.absorber
        and (abs(z[k]) > _SOME_SCORE or not wanted[k].one_sided)
    ]  # fmt: skip
    return [(wanted[k].effect, float(z[k])) for k in _distinct(wanted, able)]


def of_a_carrier(wanted: Sequence[Direction], z: Float, carrier: str) -> list[tuple[Effect, float]]:
    """Return the candidates of one carrier that have no place, absorbers too, greatest scores first."""
    order = [int(k) for k in np.argsort(-np.abs(z))]
    able = [k for k in order if wanted[k].effect.carrier == carrier and not wanted[k].effect.where]
    return [(wanted[k].effect, float(z[k])) for k in _distinct(wanted, able)]


def of_the_sensors(wanted: Sequence[Direction], z: Float) -> list[tuple[Effect, float]]:
    """Return the effects of sensors, those of many places only where they are most likely, greatest scores first."""
    order = [int(k) for k in np.argsort(-np.abs(z))]
    able = [k for k in order if wanted[k].effect.carrier not in ("motion", "map")]
    return [(wanted[k].effect, float(z[k])) for k in _distinct(wanted, able)]


def untried_twins(
    best: Effect, wanted: Sequence[Direction], z: Float, trials: Sequence[Trial]
) -> list[tuple[Effect, float]]:
    """Return the near twins of an effect that were not refitted yet, with their deviations.

    A twin that the path absorbs has hardly a score, and would never be refitted for it: a constant error of bearings is
    a heading. Of twins with many places only the one with the greatest score is returned.
    """
    order = [int(k) for k in np.argsort(-np.abs(z))]
    made: dict[str, tuple[Effect, float]] = {}
    for effect, deviation in untried([(wanted[k].effect, float(z[k])) for k in order], trials):
        if _near_twins(effect, best):
            made.setdefault(effect.name, (effect, deviation))
    return list(made.values())


def untried(chosen: Sequence[tuple[Effect, float]], trials: Sequence[Trial]) -> list[tuple[Effect, float]]:
    """Return those effects that were not refitted yet, with their deviations."""
    tried = [trial.effect for trial in trials if trial.effect is not None]
    return [(effect, z) for effect, z in chosen if not any(_same(effect, one) for one in tried)]


def _near_twins(one: Effect, other: Effect) -> bool:
    return one.name != other.name and (one.name in other.near_twins or other.name in one.near_twins)


def _same(one: Effect, other: Effect) -> bool:
    return one.name == other.name and one.where == other.where


def _distinct(wanted: Sequence[Direction], order: Sequence[int]) -> list[int]:
    """Keep the first direction of each effect, and of effects of many places only the first few.

    An effect that can move to its place when it is refitted needs one; two beams may be much alike.
    """
    kept: list[int] = []
    for k in order:
        effect = wanted[k].effect
        alike = [wanted[other].effect for other in kept if wanted[other].effect.name == effect.name]
        if not any(_same(effect, other) for other in alike) and len(alike) < (1 if effect.shape else 2):
            kept.append(k)
    return kept


def scan(
    bound: BoundModel, theta: Float, wanted: Sequence[Direction], z: Float, seed: int, particles: int
) -> dict[int, float]:
    """Run the filter with each candidate at a clear magnitude, to both sides where it has two.

    Scores rank what is small; an effect that is large, or that the path absorbs, shows here. Only candidates of the
    whole robot and those with a remarkable score are tried, these in their likeliest places and to the side that the
    score tells, and only when some score is large.

    Returns
    -------
    dict of int to float
        Gain in log evidence of the fit part [nat] by position of the direction; of its beginning where that is a great
        loss.
    """
    if np.abs(z).max(initial=0.0) < _SCAN_Z:
        return {}
    log, tables, n_steps = bound.logs[0], bound.tables(theta)[0], bound.lengths[0]

    def evidence(trial: Tables, rows: int) -> Float:
        rng = make_rng(np.random.SeedSequence((seed, 17)))
        try:
            return run_filter(trial, rows, particles, rng).log_increments
        except PmclError:
            return np.full(rows, -np.inf)

    base, few, gains = evidence(tables, n_steps), int(_SCAN_FIRST * n_steps), {}

    def gain(trial: Tables) -> float:
        first = float(evidence(trial, few).sum()) - float(base[:few].sum())
        return first if first < -_SCAN_GAIN else float(evidence(trial, n_steps).sum()) - float(base.sum())

    order = [int(k) for k in np.argsort(-np.abs(z))]
    placed = set(_distinct(wanted, [k for k in order if wanted[k].effect.where and abs(z[k]) > _REMARKABLE]))
    for k, direction in enumerate(wanted):
        if direction.effect.where and k not in placed:
            continue
        sides = (1.0,) if direction.one_sided else (float(np.sign(z[k])),) if abs(z[k]) > _REMARKABLE else (1.0, -1.0)
        values = [probe_values(direction.effect, side, direction.strength) for side in sides]
        gains[k] = max(gain(uniform(direction.effect.edit(tables, one, log))) for one in values)
    return gains


def contenders(glances: Sequence[Trial], rivals: Sequence[Trial] = ()) -> list[Trial]:
    """Return the trials that are worth a longer fit: those that a glance does not find far behind others or rivals.

    Absorbers may gain more than any structured candidate and lose to the best of these all the same: structured ones
    are compared with each other, and dropped for an absorber only where that gains many times as much. Else near twins
    of the best stay: what the path can take up, a short chain leaves there. Where nothing gains much all are close to
    each other; a glance is some nats off, but hardly ever finds five others before the best.
    """

    def least(among: Sequence[Trial]) -> float:
        best = max((trial.merit for trial in among), default=0.0)
        return max(min(best - _FAR, (1.0 - _FAR_SHARE) * best), -_HOPE)

    everyone = [*glances, *rivals]
    structured = [one for one in everyone if one.effect is None or not one.effect.absorber]
    best = max(everyone, key=lambda one: one.merit, default=None)
    bounds, no_rival = {False: least(structured), True: least(everyone)}, -np.inf
    if best is not None and best.effect is not None and best.effect.absorber and best.merit > 0.0:
        no_rival = min(_RIVAL_SHARE * best.merit, best.merit - _FAR)
    merits = sorted((one.merit for one in glances if one.effect is not None and not one.effect.absorber), reverse=True)
    bounds[False] = max([bounds[False], *merits[_AT_MOST - 1 : _AT_MOST]])
    return [
        one for one in glances
        if one.effect is None
        or one.merit >= max(bounds[one.effect.absorber], no_rival)
        or (best is not None and best.effect is not None and _near_twins(one.effect, best.effect)
            and one.merit >= no_rival)
    ]  # fmt: skip


def leaders(trials: Sequence[Trial]) -> list[Trial]:
    """Return the trials between which the choice will be made: brief fits may misjudge them by some nats."""
    ranked = sorted(trials, key=lambda trial: -trial.merit)
    return [trial for trial in ranked[:_LEADERS] if trial.merit > max(PRACTICAL, ranked[0].merit - _BEHIND)]


def choose(trials: Sequence[Trial]) -> tuple[Trial | None, list[Trial]]:
    """Return the trial that the fit part names, and those that the whole log cannot tell from it.

    An absorber wins only when it beats the best structured candidate by more than two standard errors. What the whole
    log cannot tell from the winner lies less than two standard errors behind, or gains nearly as much and is a twin of
    it that the catalogue knows.
    """
    if not trials:
        return None, []
    structured = [trial for trial in trials if trial.effect is not None and not trial.effect.absorber]
    best = max(trials, key=lambda trial: trial.merit)
    if structured and best.effect is not None and best.effect.absorber:
        rival = max(structured, key=lambda trial: trial.merit)
        lead = paired_gain(best.rows, rival.rows, slice(0, best.fit.bound.lengths[0]))
        if not lead.significant and rival.on_fit.significant:
            best = rival
    return best, twins_of(best, trials)


def twins_of(best: Trial, trials: Sequence[Trial]) -> list[Trial]:
    """Return the trials that the whole log cannot tell from one of them."""
    assert best.effect is not None
    twins = []
    for trial in trials:
        if trial is best or not trial.on_all.significant:
            continue
        if best.effect.shape and trial.effect is not None and trial.effect.name == best.effect.name:
            continue  # the same effect, found from another place
        lead = paired_gain(best.rows, trial.rows, slice(None))
        # The error of a lead knows nothing of what both models still lack; near twins need a clearer one.
        known = trial.effect is not None and _near_twins(best.effect, trial.effect)
        if lead.total < 2.0 * lead.se or (known and trial.on_all.total > _NEARLY_ALL * best.on_all.total):
            twins.append(trial)
    return twins


def with_rules(
    best: Trial, twins: Sequence[Trial], rules: Sequence[Trial], critical_z: float
) -> tuple[Trial, list[Trial]]:
    """Return the trial that explains the log, and what cannot be told from it, after formulas have competed.

    A formula replaces a known effect that is beaten by more than two standard errors on the fit part, or an absorber
    that is beaten at all. What does neither is named beside the effect when the whole log cannot tell the two apart.
    """
    better = [rule for rule in rules if rule.merit > best.merit and worth_it(rule, critical_z)]
    if better:
        rule = max(better, key=lambda trial: trial.merit)
        lead = paired_gain(rule.rows, best.rows, slice(0, best.fit.bound.lengths[0]))
        if (best.effect is not None and best.effect.absorber) or (lead.significant and lead.total > PRACTICAL):
            return rule, []
    leads = [(rule, paired_gain(best.rows, rule.rows, slice(None))) for rule in rules if rule.on_all.significant]
    return best, [*twins, *(rule for rule, lead in leads if lead.total < 2.0 * lead.se)]


def worth_it(best: Trial, critical_z: float) -> bool:
    """Return whether the winner of the fit part is accepted by the held-out part.

    A gain of z^2 / 2 nats has a standard error of about z: to ask for two of them is to ask for z = 4 on the
    held-out part alone; one is enough where the whole log leaves no doubt. Where the effect's own score is beyond its
    critical value already, which is a test at a known rate of errors, any gain on the held-out part confirms it, if the
    whole log's gain exceeds its error.
    """
    if abs(best.z) > max(critical_z, _CRITICAL):
        return best.on_heldout.total > 0.0 and best.on_all.total > max(PRACTICAL, best.on_all.se)
    return best.confirmed


def contenders_when_lost(glances: Sequence[Trial], current: Trial) -> list[Trial]:
    """Return the trials worth a longer fit where the filter is lost: total gains may be chance there.

    Those that gain in most places go on, and the one that gains most.
    """
    by_places = sorted(glances, key=lambda trial: (-_gaining(trial, current).sum(), -trial.merit))
    first = max(glances, key=lambda trial: trial.merit, default=None)
    return by_places[:_LEADERS] + [one for one in by_places[_LEADERS:] if one is first]


def _gaining(trial: Trial, current: Trial) -> NDArray[np.bool_]:
    return block_sums(trial.rows - current.rows) > 0.0


def confirmed_without_score(trial: Trial, current: Trial) -> bool:
    """Return whether both parts of the log speak for a trial whose score means nothing.

    Where a filter is lost some rows gain hundreds of nats: errors of gains are then hardly smaller than gains. But what
    is true of the robot gains nearly everywhere; what only helps a filter over the place where it is lost gains there.
    """
    gaining = _gaining(trial, current)
    by_chance = float(stats.binomtest(int(gaining.sum()), gaining.size, alternative="greater").pvalue)
    return by_chance < _BY_CHANCE and all(
        gain.total > max(PRACTICAL, gain.se) for gain in (trial.on_fit, trial.on_heldout)
    )
