"""One candidate refitted beside the others: the model with it, its fit, and what it gains on each part of the log."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from pmcl.criticism.fit import BRIEF, THOROUGH, Effort, Fit, quick_fit
from pmcl.criticism.heldout import Gain, paired_gain, row_scores
from pmcl.criticism.scores import probe_values
from pmcl.errors import PmclError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.models.parameters import prior_support
from pmcl.models.robot_model import RobotModel

__all__ = ["PRACTICAL", "Trial", "refitted", "scored_anew", "spare_effects", "trial_of_base", "try_effect"]

_logger = logging.getLogger("pmcl.criticism")
Float = NDArray[np.float64]

PRACTICAL = 3.0
"""Gains below this are real at best, never worth a parameter [nat]."""
# The best of a hundred candidates gains some 5 nats by chance on a log without an effect, and never this many.
_NO_CHANCE = 15.0
_START = 0.25


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
    particles : int
        Of the filter that scored the rows.
    thorough : bool
        Whether it was fitted at length.
    """

    effect: Effect | None
    model: RobotModel
    fit: Fit
    rows: Float
    z: float
    on_fit: Gain
    on_heldout: Gain
    on_all: Gain
    particles: int = 0
    thorough: bool = False

    @property
    def p_value(self) -> float:
        """Two-sided p-value of its score by itself."""
        return float(2.0 * special.ndtr(-abs(self.z)))

    @property
    def merit(self) -> float:
        """Gain on the fit part [nat], less one for each parameter it has more (Akaike)."""
        return self.on_fit.total - (len(self.effect.parameters) if self.effect is not None else 0)

    @property
    def confirmed(self) -> bool:
        """Whether rows confirm it that did not choose it.

        The held-out part by two standard errors; or by one, where the whole log gains more than two and than chance
        can. What explains a few gross errors gains in a few rows, and the error of its gain is great for that.
        """
        held, whole = self.on_heldout, self.on_all
        if held.total <= PRACTICAL:
            return False
        return held.significant or (held.total > held.se and whole.significant and whole.total > _NO_CHANCE)


def try_effect(
    current: Trial,
    effect: Effect,
    z: float,
    log: RobotLog,
    split: int,
    *,
    seed: int,
    particles: int,
    effort: Effort = BRIEF,
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
        fitted = quick_fit(bound.restricted(split), seed, theta=theta, path=current.fit.path, effort=effort)
        rows = row_scores(bound, fitted.theta, particles=particles, seed=seed, passes=effort.passes)
    except PmclError as error:
        _logger.debug("%s cannot be fitted: %s", effect.name, error)
        return None
    on_fit, on_heldout, on_all = _gains(rows, current.rows, split)
    return Trial(effect, model, fitted, rows, z, on_fit, on_heldout, on_all, particles)


def refitted(
    trial: Trial, current: Trial, log: RobotLog, split: int, *, seed: int, particles: int, effort: Effort
) -> Trial:
    """Go on with the fit of a trial, and score it anew against the current model; all as for :func:`try_effect`.

    Returns the trial as it was where the filter loses the robot after the longer fit.
    """
    bound = trial.model.bind(log)
    try:
        made = trial.fit
        fitted = quick_fit(
            bound.restricted(split), seed, theta=made.theta, path=made.path, draws=made.draws, effort=effort
        )
        longer = replace(trial, fit=fitted, thorough=effort == THOROUGH)
        return scored_anew(longer, current, log, split, seed=seed, particles=particles)
    except PmclError as error:
        _logger.debug("a longer fit with %s fails: %s", trial.model.effects[-1].name, error)
        return trial


def scored_anew(trial: Trial, current: Trial, log: RobotLog, split: int, *, seed: int, particles: int) -> Trial:
    """Score the rows of a trial as it is fitted, with some number of particles; all as for :func:`try_effect`."""
    rows = row_scores(trial.model.bind(log), trial.fit.theta, particles=particles, seed=seed)
    gains = _gains(rows, rows if trial is current else current.rows, split)
    return replace(trial, rows=rows, on_fit=gains[0], on_heldout=gains[1], on_all=gains[2], particles=particles)


def _gains(new: Float, old: Float, split: int) -> list[Gain]:
    """Return the gains on the fit part, on the held-out part, and on both."""
    return [paired_gain(new, old, rows) for rows in (slice(0, split), slice(split, None), slice(None))]


def trial_of_base(
    model: RobotModel,
    log: RobotLog,
    split: int,
    *,
    seed: int,
    particles: int,
    theta: Float,
    path: Float,
    draws: Float | None = None,
) -> Trial:
    """Fit a model as it is on the fit part, from what a fit of the whole log found, and score all rows."""
    bound = model.bind(log)
    fitted = quick_fit(bound.restricted(split), seed, theta=theta, path=path[:split], draws=draws)
    rows = row_scores(bound, fitted.theta, particles=particles, seed=seed)
    nothing = Gain(0.0, 0.0)
    return Trial(None, model, fitted, rows, 0.0, nothing, nothing, nothing, particles)


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
        if missed.total < max(PRACTICAL, missed.se):
            trial = replace(without, effect=trial.effect, z=trial.z)
            dropped.append(position)
        else:
            position += 1
    return trial, dropped
