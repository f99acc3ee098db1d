"""One candidate effect refitted: the model with it, its fit to the whole log, and its evidence."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from pmcl.criticism.fitting.evidence import nested_evidence
from pmcl.criticism.fitting.held_out import row_scores
from pmcl.criticism.fitting.quick_fit import GLANCE, THOROUGH, Effort, Fit, quick_fit
from pmcl.criticism.fitting.starting_point import starting_point
from pmcl.errors import DensityError, PmclError
from pmcl.filtering.paired_scores import Gain, paired_gain
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.models.robot_model import RobotModel

__all__ = [
    "Trial", "evidence_between", "log_prior_and_volume", "refitted", "scored_anew", "trial_of_base", "try_effect",
]  # fmt: skip

_logger = logging.getLogger("pmcl.criticism")
Float = NDArray[np.float64]

# All gains are over the current model, whose score is therefore the mean of so many passes of the filter.
_PASSES_OF_CURRENT = 8
# So many passes of a filter tell how much their scores differ.
_FEWEST_TELLING = 2
# Added to the diagonal of a covariance, in units of its own diagonal: a parameter that a short chain has not moved.
_RIDGE = 1e-9


@dataclass(frozen=True)
class Trial:
    """A model that was fitted to the log.

    Attributes
    ----------
    effect : Effect or None
        The effect that it has and the current model lacks; None for the current model itself.
    model : RobotModel
        The whole model.
    fit : Fit
        Its fit.
    row_scores : ndarray, shape (T,)
        Its log score of each row [nat].
    z : float
        Standardised score of its effect.
    gain : Gain
        Gain of its row scores over those of the current model.
    evidence : float
        Its log evidence less that of the current model [nat]: from its draws where these come near no effect
        (:func:`pmcl.criticism.fitting.evidence.nested_evidence`), else from the gain, whose largest block of rows is
        bounded (:func:`log_prior_and_volume`).
    noise : float
        Standard deviation of its evidence: from its draws, or because the particles that scored it are random [nat]. A
        single pass cannot tell the latter; it then has the noise of one pass of the current model.
    particles : int
        Particles of the filter that scored the rows.
    effort : Effort
        Length of the fit.
    nested : bool
        Whether its evidence is from its draws.
    """

    effect: Effect | None
    model: RobotModel
    fit: Fit
    row_scores: Float
    z: float
    gain: Gain
    evidence: float
    noise: float
    particles: int
    effort: Effort = THOROUGH
    nested: bool = False

    @property
    def p_value(self) -> float:
        """Two-sided p-value of its score, not corrected for the number of candidates."""
        return float(2.0 * special.ndtr(-abs(self.z)))

    @property
    def glanced(self) -> bool:
        """Whether the fit was only a glance."""
        return self.effort == GLANCE

    @property
    def thorough(self) -> bool:
        """Whether the fit is as long as fits get."""
        return self.effort == THOROUGH


def log_prior_and_volume(fit: Fit) -> float:
    """Return what makes evidence of the log score at the posterior mean, by Laplace's method [nat].

    Parameters
    ----------
    fit : Fit
        The fit of a model.

    Returns
    -------
    float
        Log density of the prior at the mean of the draws, plus the log volume of a normal with their covariance. It is
        about zero for parameters of which the log tells nothing, and negative for what it determines: Occam's factor.
        MacKay (2003), Information Theory, Inference, and Learning Algorithms, chapter 28.
    """
    covariance = np.atleast_2d(np.cov(fit.draws.T))
    scale = np.sqrt(np.diag(covariance)) + 1e-12
    correlation = covariance / np.outer(scale, scale) + _RIDGE * np.eye(scale.size)
    log_volume = 0.5 * np.linalg.slogdet(2.0 * np.pi * correlation)[1] + np.log(scale).sum()
    return float(fit.bound.log_prior(fit.theta) + log_volume)


def evidence_between(trial: Trial, without: Trial) -> float:
    """Return the log evidence for what only one of two models has [nat].

    Parameters
    ----------
    trial, without : Trial
        The models, scored with as many particles.
    """
    gain = float(trial.row_scores.sum() - without.row_scores.sum()) + 0.5 * (trial.noise**2 - without.noise**2)
    return gain + log_prior_and_volume(trial.fit) - log_prior_and_volume(without.fit)


def try_effect(
    current: Trial,
    effect: Effect,
    z: float,
    log: RobotLog,
    *,
    seed: int,
    particles: int,
    effort: Effort,
) -> Trial | None:
    """Fit the current model with one additional effect.

    Parameters
    ----------
    current : Trial
        The current model.
    effect : Effect
        The additional effect.
    z : float
        Its standardised score; its sign gives the side on which the fit starts.
    log : RobotLog
        The log.
    seed : int
        Determines all random numbers.
    particles : int
        Particles of the filter that scores the rows.
    effort : Effort
        Length of the fit.

    Returns
    -------
    Trial or None
        None when the effect cannot be fitted, because it cannot edit the model's tables or no filter follows.
    """
    try:
        held_fixed = {} if effect.tells is None else dict(effect.tells(log))
        free = np.array([parameter.name not in held_fixed for parameter in effect.parameters])
        model = replace(
            current.model, effects=(*current.model.effects, effect), fixed={**current.model.fixed, **held_fixed}
        )
        bound = model.bind(log)
        values, path = starting_point(bound, current.fit, effect, z, free)
        theta = np.concatenate([current.fit.theta, values[free]])
        fitted = quick_fit(bound, seed, theta=theta, path=path, effort=effort)
        return _scored(effect, model, fitted, z, current, seed=seed, particles=particles, effort=effort)
    except DensityError:
        raise
    except PmclError as error:
        _logger.debug("%s cannot be fitted: %s", effect.name, error)
        return None


def refitted(trial: Trial, current: Trial, *, seed: int, particles: int, effort: Effort) -> Trial:
    """Continue the fit of a trial, and score it again against the current model.

    Parameters
    ----------
    trial : Trial
        The trial.
    current : Trial
        The current model.
    seed, particles, effort
        As for :func:`try_effect`.

    Returns
    -------
    Trial
        With its old fit if the filter loses the robot after the longer one; it is not fitted again then.
    """
    before = trial.fit
    try:
        fitted = quick_fit(
            before.bound, seed, theta=before.theta, path=before.path, draws=before.draws, effort=effort
        )
        return _scored(
            trial.effect, trial.model, fitted, trial.z, current, seed=seed, particles=particles, effort=effort
        )
    except DensityError:
        raise
    except PmclError as error:
        _logger.debug("a longer fit with %s fails: %s", trial.model.effects[-1].name, error)
        return replace(trial, effort=effort)


def scored_anew(trial: Trial, current: Trial, *, seed: int, particles: int) -> Trial:
    """Score a trial with its present fit and another number of particles.

    Parameters
    ----------
    trial : Trial
        The trial.
    current : Trial
        The current model.
    seed, particles
        As for :func:`try_effect`.

    Returns
    -------
    Trial
        From several passes, which tell their noise: that of the current model is one of other particles.
    """
    return _scored(
        trial.effect, trial.model, trial.fit, trial.z, current, seed=seed, particles=particles, effort=trial.effort,
        passes=max(trial.effort.passes, _FEWEST_TELLING),
    )  # fmt: skip


def trial_of_base(fit: Fit, *, seed: int, particles: int) -> Trial:
    """Score a fitted model, with which candidates are compared.

    Parameters
    ----------
    fit : Fit
        The fit.
    seed, particles
        As for :func:`try_effect`.
    """
    return _scored(None, fit.bound.model, fit, 0.0, None, seed=seed, particles=particles, effort=THOROUGH)


def _scored(
    effect: Effect | None,
    model: RobotModel,
    fit: Fit,
    z: float,
    current: Trial | None,
    *,
    seed: int,
    particles: int,
    effort: Effort,
    passes: int | None = None,
) -> Trial:
    """Return a fitted model as a trial; it is compared with itself when there is no current model."""
    if passes is None:
        passes = _PASSES_OF_CURRENT if current is None else effort.passes
    scores = row_scores(fit.bound, fit.theta, particles=particles, seed=seed, passes=passes)
    gain, evidence, noise = Gain(0.0, 0.0), 0.0, scores.noise
    if current is not None:
        noise = current.noise * np.sqrt(_PASSES_OF_CURRENT) if passes == 1 else noise
        gain = paired_gain(scores.rows, current.row_scores, slice(None))
        # The log of an estimate lies below the log of what it estimates, by half of its variance on average.
        evidence = gain.bounded + 0.5 * (noise**2 - current.noise**2)
        # An additional parameter never makes the prior lose less; a chain that has not settled may seem to say so.
        evidence += min(log_prior_and_volume(fit) - log_prior_and_volume(current.fit), 0.0)
    trial = Trial(effect, model, fit, scores.rows, z, gain, evidence, noise, particles, effort)
    if effect is None or trial.glanced:
        return trial
    nested = nested_evidence(fit, model.effects[-1], _free_parameters(model))
    return trial if nested is None else replace(trial, evidence=nested.value, noise=nested.noise, nested=True)


def _free_parameters(model: RobotModel) -> NDArray[np.bool_]:
    """Return which parameters of a model's newest effect are fitted."""
    return np.array([parameter.name not in model.fixed for parameter in model.named_effects[-1].parameters])
