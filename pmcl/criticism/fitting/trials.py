"""One candidate effect refitted: the model with it, its fit to the whole log, and its evidence."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from pmcl.criticism.fitting.evidence import NestedEvidence, nested_evidence
from pmcl.criticism.fitting.held_out import mixed_rows, noise_of_rows, row_scores
from pmcl.criticism.fitting.quick_fit import GLANCE, THOROUGH, Effort, Fit, quick_fit
from pmcl.criticism.fitting.starting_point import starting_point
from pmcl.errors import DensityError, PmclError
from pmcl.filtering.paired_scores import Gain, paired_gain
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.models.robot_model import RobotModel

__all__ = [
    "Trial", "effect_of", "evidence_between", "log_prior_and_volume", "refitted", "trial_of_base", "try_effect",
]  # fmt: skip

_logger = logging.getLogger("pmcl.criticism")
Float = NDArray[np.float64]

# Gains are all over the current model, which is therefore scored by so many passes of the filter.
_PASSES_OF_CURRENT = 8
# The evidence of a mixture's weight by filters counts instead of that from draws, if it is greater by more than so many
# standard deviations of the noise of both (chosen by hand).
_BEYOND_NOISE = 3.0
# Draws of a short chain that tell as much about its spread as an independent one: with this number, log volumes after a
# glance, a brief and a thorough fit agree to a nat on average (24 fits of analyses/hidden_effects, block 105).
_DRAWS_PER_INDEPENDENT = 2.5
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
        Its log score of each row [nat], by all passes together.
    z : float
        Standardised score of its effect.
    gain : Gain
        Gain of its row scores over those of the current model.
    evidence : float
        Its log evidence less that of the current model [nat]: from its draws where these come near no effect
        (:func:`pmcl.criticism.fitting.evidence.nested_evidence`), else from the gain, whose largest block of rows is
        bounded (:func:`log_prior_and_volume`).
    noise : float
        Standard deviation of its evidence: from its draws, or because the particles that scored it are random [nat].
    of_passes : ndarray, shape (K, T)
        Log scores of the rows by each pass of the filter [nat].
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
    of_passes: Float
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


def effect_of(trial: Trial) -> Effect:
    """Return the effect that a trial has and the current model lacks, where it is known to have one."""
    assert trial.effect is not None
    return trial.effect


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

    Notes
    -----
    The covariance of few draws spans too small a volume on average. What it lacks is added: for six parameters, 3.5
    nats after a glance and 0.6 after a brief fit.
    """
    covariance = np.atleast_2d(np.cov(fit.draws.T))
    scale = np.sqrt(np.diag(covariance)) + 1e-12
    correlation = covariance / np.outer(scale, scale) + _RIDGE * np.eye(scale.size)
    log_volume = 0.5 * np.linalg.slogdet(2.0 * np.pi * correlation)[1] + np.log(scale).sum()
    return float(fit.bound.log_prior(fit.theta) + log_volume + _missing_volume(len(fit.draws), scale.size))


def _missing_volume(draws: int, size: int) -> float:
    """Return by how much the log volume of the covariance of few draws is too small on average [nat].

    From the expected log determinant of a Wishart matrix of `size` dimensions.
    """
    independent = max(draws / _DRAWS_PER_INDEPENDENT, size + 1.0)
    freedom = independent - 1.0
    expected = special.digamma(0.5 * (independent - np.arange(1, size + 1))) - np.log(0.5 * freedom)
    return float(-0.5 * expected.sum())


def evidence_between(trial: Trial, without: Trial) -> float:
    """Return the log evidence for what only one of two models has [nat].

    Parameters
    ----------
    trial, without : Trial
        The models, fitted and scored.
    """
    gain = _score(trial.of_passes, without) - _score(without.of_passes, without)
    return gain + log_prior_and_volume(trial.fit) - log_prior_and_volume(without.fit)


def try_effect(
    current: Trial,
    effect: Effect,
    z: float,
    log: RobotLog,
    *,
    seed: int,
    effort: Effort,
    at: Float | None = None,
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
    effort : Effort
        Length of the fit.
    at : ndarray, shape (k,), optional
        Values of the effect's parameters at which the fit starts, instead of some near its null.

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
        values, path = starting_point(bound, current.fit, effect, z, free, at)
        theta = np.concatenate([current.fit.theta, values[free]])
        fitted = quick_fit(bound, seed, theta=theta, path=path, effort=effort)
        return _scored(effect, model, fitted, z, current, seed=seed, effort=effort)
    except DensityError:
        raise
    except PmclError as error:
        _logger.debug("%s cannot be fitted: %s", effect.name, error)
        return None


def refitted(trial: Trial, current: Trial, *, seed: int, effort: Effort) -> Trial:
    """Continue the fit of a trial, and score it again against the current model.

    Parameters
    ----------
    trial : Trial
        The trial.
    current : Trial
        The current model.
    seed, effort
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
            trial.effect, trial.model, fitted, trial.z, current, seed=seed, effort=effort
        )
    except DensityError:
        raise
    except PmclError as error:
        _logger.debug("a longer fit with %s fails: %s", trial.model.effects[-1].name, error)
        return replace(trial, effort=effort)


def trial_of_base(fit: Fit, *, seed: int) -> Trial:
    """Score a fitted model, with which candidates are compared.

    Parameters
    ----------
    fit : Fit
        The fit.
    seed : int
        As for :func:`try_effect`.
    """
    return _scored(None, fit.bound.model, fit, 0.0, None, seed=seed, effort=THOROUGH)


def _scored(
    effect: Effect | None,
    model: RobotModel,
    fit: Fit,
    z: float,
    current: Trial | None,
    *,
    seed: int,
    effort: Effort,
) -> Trial:
    """Return a fitted model as a trial; it is compared with itself when there is no current model."""
    passes = _PASSES_OF_CURRENT if current is None else effort.passes
    scores = row_scores(fit.bound, fit.theta, fit.paths, seed=seed, passes=passes)
    trial = Trial(
        effect, model, fit, scores.rows, z, Gain(0.0, 0.0), 0.0, scores.noise, scores.of_passes, effort
    )  # fmt: skip
    if current is None:
        return trial
    gain = paired_gain(scores.rows, current.row_scores, slice(None))
    evidence = gain.bounded + _bias(current.of_passes, current) - _bias(scores.of_passes, current)
    # An additional parameter never makes the prior lose less; a chain that has not settled may seem to say so.
    evidence += min(log_prior_and_volume(fit) - log_prior_and_volume(current.fit), 0.0)
    trial = replace(trial, gain=gain, evidence=evidence, noise=_noise(scores.of_passes, current))
    if effect is None or trial.glanced:
        return trial
    nested = nested_evidence(fit, model.effects[-1], _free_parameters(model))
    if nested is None or (nested.of_weight and _exceeds(trial, nested)):
        return trial
    return replace(trial, evidence=nested.value, noise=nested.noise, nested=True)


def _exceeds(trial: Trial, nested: NestedEvidence) -> bool:
    """Return whether the filters' evidence is greater than that from draws, beyond the noise of both."""
    return trial.evidence - nested.value > _BEYOND_NOISE * float(np.hypot(trial.noise, nested.noise))


def _noise(of_passes: Float, current: Trial) -> float:
    """Return the noise of the score by some passes; a single one has that of one pass of the current model."""
    if len(of_passes) > 1:
        return noise_of_rows(of_passes)
    return noise_of_rows(current.of_passes) * math.sqrt(len(current.of_passes))


def _bias(of_passes: Float, current: Trial) -> float:
    """Return the bias of a score: the log of an estimate lies below that of what it estimates, by half its variance."""
    return -0.5 * _noise(of_passes, current) ** 2


def _score(of_passes: Float, current: Trial) -> float:
    return float(mixed_rows(of_passes).sum()) - _bias(of_passes, current)


def _free_parameters(model: RobotModel) -> NDArray[np.bool_]:
    """Return which parameters of a model's newest effect are fitted."""
    return np.array([parameter.name not in model.fixed for parameter in model.named_effects[-1].parameters])
