"""Naming the effect that explains an alarm: rank all candidates, refit a few, let the fit part of the log choose."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from pmcl.criticism.fit import BRIEF, THOROUGH, Fit, quick_fit
from pmcl.criticism.heldout import Gain, paired_gain, row_scores
from pmcl.criticism.scores import Direction, probe_values
from pmcl.errors import PmclError
from pmcl.filtering.particle_filter import make_rng, run_filter
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.models.parameters import prior_support
from pmcl.models.rich_tables import uniform
from pmcl.models.robot_model import BoundModel, RobotModel
from pmcl.models.tables import Tables

__all__ = [
    "Trial", "choose", "leaders", "of_the_whole_robot", "scan", "shortlist", "spare_effects", "thoroughly",
    "trial_of_base", "try_effect", "untried", "untried_twins", "worth_it",
]  # fmt: skip

_logger = logging.getLogger("pmcl.criticism")
Float = NDArray[np.float64]

_BY_SCORE, _BY_SCAN, _ABSORBERS = 4, 2, 2
# Absorbers that lead call for this many more structured candidates, as far as their scores are remarkable.
_MORE_STRUCTURED, _REMARKABLE = 8, 2.5
# Evidence of 500 particles has a standard deviation of some 8 nats: a scan sees only what is far larger.
_SCAN_Z, _SCAN_GAIN = 6.0, 30.0
_START = 0.25
# Trials that are refitted at length before the choice, and how far behind the first they may be [nat].
_LEADERS, _BEHIND = 3, 15.0
# Gains below this are real at best, never worth a parameter [nat]; scores below this are never beyond doubt.
_PRACTICAL, _CRITICAL = 3.0, 3.0
# A near twin that gains this share of what the winner gains is named with it.
_NEARLY_ALL = 0.9


@dataclass(frozen=True)
class Trial:
    """A model that was refitted on the fit part of the log.

    Attributes
    ----------
    effect : Effect or None
        What it has that the current model lacks; None for the current model itself.
    model : RobotModel
        The whole model.
    fit : Fit
        On the fit part.
    rows : ndarray, shape (T,)
        Its score of each row of the whole log.
    z : float
        Deviation of its score.
    on_fit, on_heldout, on_all : Gain
        Gain over the current model.
    """

    effect: Effect | None
    model: RobotModel
    fit: Fit
    rows: Float
    z: float
    on_fit: Gain
    on_heldout: Gain
    on_all: Gain

    @property
    def p_value(self) -> float:
        """Two-sided p-value of its score by itself."""
        return float(2.0 * special.ndtr(-abs(self.z)))

    @property
    def merit(self) -> float:
        """Gain on the fit part [nat], less one for each parameter it has more (Akaike)."""
        return self.on_fit.total - (len(self.effect.parameters) if self.effect is not None else 0)


def shortlist(
    wanted: Sequence[Direction], z: Float, scanned: dict[int, float], more: bool = False
) -> list[tuple[Effect, float]]:
    """Return the candidates worth a refit with their deviations: structured ones by score, by scan, and absorbers.

    Parameters
    ----------
    wanted : sequence of Direction
        All K directions.
    z : ndarray, shape (K,)
        Their deviations on the fit part.
    scanned : dict
        Gain of the finite scan by position of a direction, where there was one.
    more : bool
        Return instead the further structured candidates that must have lost before an absorber may win.
    """
    order = [int(k) for k in np.argsort(-np.abs(z))]
    structured = _distinct(wanted, [k for k in order if not wanted[k].effect.absorber])
    if more:
        rest = structured[_BY_SCORE : _BY_SCORE + _MORE_STRUCTURED]
        return [(wanted[k].effect, float(z[k])) for k in rest if abs(z[k]) > _REMARKABLE]
    absorbers = _distinct(wanted, [k for k in order if wanted[k].effect.absorber])
    chosen = [wanted[k].effect for k in structured[:_BY_SCORE] + absorbers[:_ABSORBERS]]
    known = {id(wanted[k].effect): float(z[k]) for k in reversed(order)}
    by_scan = sorted((k for k in scanned if scanned[k] > _SCAN_GAIN), key=lambda k: -scanned[k])
    scanned_first = [wanted[k].effect for k in _distinct(wanted, by_scan)]
    fresh = [effect for effect in scanned_first if not any(_same(effect, one) for one in chosen)]
    return [(effect, known[id(effect)]) for effect in chosen + fresh[:_BY_SCAN]]


def of_the_whole_robot(
    wanted: Sequence[Direction], z: Float, *, carrier: str = "", absorbers: bool = False
) -> list[tuple[Effect, float]]:
    """Return the candidates that have no place, of one carrier if that is given, greatest scores first.

    A steady error of the mount or of odometry is mostly taken up by the path: it may have hardly a score, and show
    only when it is refitted.
    """
    order = [int(k) for k in np.argsort(-np.abs(z))]
    able = [k for k in order if not wanted[k].effect.where and (absorbers or not wanted[k].effect.absorber)]
    chosen = [k for k in _distinct(wanted, able) if carrier in ("", wanted[k].effect.carrier)]
    return [(wanted[k].effect, float(z[k])) for k in chosen]


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
    whole robot and those with a remarkable score are tried, and only when some score is large.

    Returns
    -------
    dict of int to float
        Gain in log evidence of the fit part [nat] by position of the direction.
    """
    if np.abs(z).max(initial=0.0) < _SCAN_Z:
        return {}
    log, tables, n_steps = bound.logs[0], bound.tables(theta)[0], bound.lengths[0]

    def evidence(trial: Tables) -> float:
        rng = make_rng(np.random.SeedSequence((seed, 17)))
        try:
            return run_filter(trial, n_steps, particles, rng).log_evidence
        except PmclError:
            return -np.inf

    base, gains = evidence(tables), {}
    for k, direction in enumerate(wanted):
        if direction.effect.where and abs(z[k]) < _REMARKABLE:
            continue
        values = [
            probe_values(direction.effect, side, direction.strength)
            for side in ((1.0,) if direction.one_sided else (1.0, -1.0))
        ]
        gains[k] = max(evidence(uniform(direction.effect.edit(tables, one, log))) for one in values) - base
    return gains


def try_effect(
    current: Trial, effect: Effect, z: float, log: RobotLog, split: int, *, seed: int, particles: int
) -> Trial | None:
    """Refit the current model with one effect more on the fit part, and score the whole log.

    Returns None when the effect cannot be fitted (its tables do not go together with the model's).
    """
    try:
        told = {} if effect.tells is None else dict(effect.tells(log))
        free = np.array([parameter.name not in told for parameter in effect.parameters])
        model = replace(
            current.model, effects=(*current.model.effects, effect), fixed={**current.model.fixed, **told}
        )
        bound = model.bind(log)
        theta = np.concatenate([current.fit.theta, _start_values(effect, z)[free]])
        fitted = quick_fit(bound.restricted(split), seed, theta=theta, path=current.fit.path, effort=BRIEF)
        rows = row_scores(bound, fitted.theta, particles=particles, seed=seed)
    except PmclError as error:
        _logger.debug("%s cannot be fitted: %s", effect.name, error)
        return None
    return Trial(effect, model, fitted, rows, z, *_gains(rows, current.rows, split))


def leaders(trials: Sequence[Trial]) -> list[Trial]:
    """Return the trials between which the choice will be made: brief fits may misjudge them by some nats."""
    ranked = sorted(trials, key=lambda trial: -trial.merit)
    return [trial for trial in ranked[:_LEADERS] if trial.merit > max(0.0, ranked[0].merit - _BEHIND)]


def thoroughly(trial: Trial, current: Trial, log: RobotLog, split: int, *, seed: int, particles: int) -> Trial:
    """Go on with the fit of a trial, and score it anew against the current model; all as for :func:`try_effect`."""
    bound = trial.model.bind(log)
    fitted = quick_fit(bound.restricted(split), seed, theta=trial.fit.theta, path=trial.fit.path, effort=THOROUGH)
    rows = row_scores(bound, fitted.theta, particles=particles, seed=seed)
    gains = _gains(rows, current.rows, split)
    return replace(trial, fit=fitted, rows=rows, on_fit=gains[0], on_heldout=gains[1], on_all=gains[2])


def _gains(new: Float, old: Float, split: int) -> list[Gain]:
    """Return the gains on the fit part, on the held-out part, and on both."""
    return [paired_gain(new, old, rows) for rows in (slice(0, split), slice(split, None), slice(None))]


def trial_of_base(
    model: RobotModel, log: RobotLog, split: int, *, seed: int, particles: int, theta: Float, path: Float
) -> Trial:
    """Fit a model as it is on the fit part, from the fit of the whole log, and score all rows."""
    bound = model.bind(log)
    fitted = quick_fit(bound.restricted(split), seed, theta=theta, path=path[:split])
    rows = row_scores(bound, fitted.theta, particles=particles, seed=seed)
    nothing = Gain(0.0, 0.0)
    return Trial(None, model, fitted, rows, 0.0, nothing, nothing, nothing)


def _start_values(effect: Effect, z: float) -> Float:
    """Return values a little way from the null, to the side that the score points to, inside the priors."""
    values = np.array(effect.null, dtype=float)
    for k in effect.strengths:
        one_sided = effect.squared or effect.one_sided(k)
        values[k] = probe_values(effect, _START if one_sided else _START * float(np.sign(z) or 1.0), k)[k]
    for k, parameter in enumerate(effect.parameters):
        low, high = prior_support(parameter.prior)
        margin = 1e-6 * (high - low) if np.isfinite(high - low) else 1e-6
        values[k] = float(np.clip(values[k], low + margin, high - margin))
    return values


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
    return best, twins


def worth_it(best: Trial, critical_z: float) -> bool:
    """Return whether the winner of the fit part is accepted by the held-out part.

    A gain of z^2 / 2 nats has a standard error of about z: to ask for two of them is to ask for z = 4 on the
    held-out part alone. Where the effect's own score is beyond its critical value already, which is a test at a known
    rate of errors, any gain on the held-out part confirms it, if the whole log's gain exceeds its error.
    """
    if abs(best.z) > max(critical_z, _CRITICAL):
        return best.on_heldout.total > 0.0 and best.on_all.total > max(_PRACTICAL, best.on_all.se)
    return best.on_heldout.total > max(_PRACTICAL, 2.0 * best.on_heldout.se)


def spare_effects(
    accepted: Trial, own: int, log: RobotLog, split: int, *, seed: int, particles: int
) -> tuple[Trial, list[int]]:
    """Try to do without each effect that was added before the newest one.

    Parameters
    ----------
    accepted : Trial
        The model with the newest effect last.
    own : int
        Effects of the base model, which stay.
    log, split, seed, particles
        As for :func:`try_effect`.

    Returns
    -------
    trial : Trial
        The model without those that the held-out part does not miss.
    dropped : list of int
        Their positions among the model's effects, each counted after the removals before it.
    """
    trial, dropped, position = accepted, [], own
    while position < len(trial.model.effects) - 1:
        effects = trial.model.effects
        if effects[position].tells is not None:  # the data themselves show it
            position += 1
            continue
        model = replace(trial.model, effects=effects[:position] + effects[position + 1 :])
        # By position, since parameters of effects that occur several times change their names with the others.
        counts = [sum(p.name not in trial.model.fixed for p in one.parameters) for one in trial.model.named_effects]
        begin = trial.fit.theta.size - sum(counts[position:])
        try:
            theta = np.delete(trial.fit.theta, np.s_[begin : begin + counts[position]])
            without = trial_of_base(
                model, log, split, seed=seed, particles=particles, theta=theta, path=trial.fit.path
            )
        except PmclError:
            position += 1
            continue
        missed = paired_gain(trial.rows, without.rows, slice(split, None))
        if missed.total < max(_PRACTICAL, missed.se):
            trial = replace(without, effect=trial.effect, z=trial.z)
            dropped.append(position)
        else:
            position += 1
    return trial, dropped
