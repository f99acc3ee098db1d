"""One candidate effect refitted: the model with it, its fit, and its gain on each part of the log."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from pmcl.criticism.fitting.held_out import row_scores
from pmcl.criticism.fitting.quick_fit import BRIEF, THOROUGH, Effort, Fit, quick_fit
from pmcl.criticism.scoring.scores import probe_values
from pmcl.errors import DensityError, PmclError
from pmcl.filtering.paired_scores import Gain, paired_gain
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.models.parameters import prior_support
from pmcl.models.robot_model import RobotModel, log_sequence

__all__ = [
    "PRACTICAL", "Trial", "from_null", "occam_factor", "refitted", "scored_anew", "spare_effects", "trial_of_base",
    "try_effect",
]  # fmt: skip

_logger = logging.getLogger("pmcl.criticism")
Float = NDArray[np.float64]

# Chosen by hand on simulated logs with hidden effects (block 0 of analyses/hidden_effects).
PRACTICAL = 3.0
"""Smaller gains are never worth a parameter, even if they are real [nat]."""
# The best of a hundred candidates gains some 5 nats by chance on a log without an effect, and never this many [nat]
# (analyses/hidden_effects).
_NO_CHANCE = 15.0
# The refit of a candidate starts at this share of its clear magnitude (chosen by hand).
_START_SHARE = 0.25


@dataclass(frozen=True)
class Trial:
    """A model that was refitted on the fit part of the log.

    Attributes
    ----------
    effect : Effect or None
        The effect that it has and the current model lacks; None for the current model itself.
    model : RobotModel
        The whole model.
    fit : Fit
        Its fit on the fit part.
    row_scores : ndarray, shape (T,)
        Its log score of each row of the whole log [nat]; then those of a second log that is held out.
    z : float
        Standardised score of its effect.
    on_fit, on_heldout, on_all : Gain
        Gain over the current model on the fit part, on the held-out part and on the whole log.
    particles : int
        Particles of the filter that scored the rows.
    thorough : bool
        Whether the fit is a thorough one.
    occam : float
        What the prior of the effect's parameters loses, see :func:`occam_factor` [nat].
    from_null : float
        Distance of the effect's strengths from no effect, see :func:`from_null` [standard deviations].
    noise : float
        Standard deviation of the sum of its row scores, because particles are random [nat]; NaN after a glance.
    """

    effect: Effect | None
    model: RobotModel
    fit: Fit
    row_scores: Float
    z: float
    on_fit: Gain
    on_heldout: Gain
    on_all: Gain
    particles: int = 0
    thorough: bool = False
    occam: float = 0.0
    from_null: float = np.inf
    noise: float = 0.0

    @property
    def p_value(self) -> float:
        """Two-sided p-value of its score, not corrected for the number of candidates."""
        return float(2.0 * special.ndtr(-abs(self.z)))

    @property
    def merit(self) -> float:
        """Gain on the fit part [nat], less one for each additional parameter (Akaike 1974)."""
        return self.on_fit.total - (len(self.effect.parameters) if self.effect is not None else 0)

    @property
    def evidence(self) -> float:
        """Gain in log evidence over the current model [nat], by Laplace's method on the fit part.

        It is the gain on the whole log, less what the prior loses: the rows of the fit part are scored with parameters
        that these rows have chosen. A parameter that they determine to a hundredth of its prior costs 4.6 nats, one
        that they cannot tell costs nothing. Held-out rows count as far as the fit part's own gain: an effect that acts
        later only was fitted to nothing.
        """
        return self.on_fit.total + min(self.on_heldout.total, max(self.on_fit.total, 0.0)) - self.occam

    @property
    def absorber(self) -> bool:
        """Whether its effect is an absorber, see :class:`~pmcl.models.effects.effect.Effect`."""
        return self.effect is not None and self.effect.absorber

    @property
    def in_several_blocks(self) -> bool:
        """Whether its gains, on the held-out part and on the whole log, remain gains without their largest blocks.

        One row may gain a dozen nats by accident, an effect that the robot has gains again.
        """
        return self.on_heldout.without_largest > 0.0 and self.on_all.without_largest > PRACTICAL

    @property
    def confirmed(self) -> bool:
        """Whether rows that did not choose it confirm it.

        Its gain on the held-out part must exceed two standard errors. One is enough if its gain on the whole log
        exceeds two standard errors and any gain that occurs by chance. An effect that explains a few gross errors
        gains in a few rows, and the standard error of its gain is large for that reason: heavy-tailed motion noise
        once gained 126 +- 47 nats on the whole log and 51 +- 27 on the held-out part.
        """
        held, whole = self.on_heldout, self.on_all
        if held.total <= PRACTICAL or not self.in_several_blocks:
            return False
        return held.significant or (held.total > held.se and whole.significant and whole.total > _NO_CHANCE)


class _Gains(NamedTuple):
    """Gains on the fit part, on the held-out part and on the whole log."""

    on_fit: Gain
    on_heldout: Gain
    on_all: Gain


def try_effect(
    current: Trial,
    effect: Effect,
    z: float,
    logs: RobotLog | Sequence[RobotLog],
    split: int,
    *,
    seed: int,
    particles: int,
    effort: Effort = BRIEF,
) -> Trial | None:
    """Refit the current model with one additional effect on the fit part, and score the whole log.

    Parameters
    ----------
    current : Trial
        The current model.
    effect : Effect
        The additional effect.
    z : float
        Its standardised score; its sign gives the side on which the fit starts.
    logs : RobotLog or sequence of RobotLog
        The log; or the log on which models are fitted and the one that is held out.
    split : int
        First row of the held-out part: the number of rows of the first log, if there are two.
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
    log, *others = log_sequence(logs)
    try:
        held_fixed = {} if effect.tells is None else dict(effect.tells(log))
        free = np.array([parameter.name not in held_fixed for parameter in effect.parameters])
        model = replace(
            current.model, effects=(*current.model.effects, effect), fixed={**current.model.fixed, **held_fixed}
        )
        bound = model.bind(log)
        theta = np.concatenate([current.fit.theta, _start_values(effect, z)[free]])
        fitted = quick_fit(bound.restricted(split), seed, theta=theta, path=current.fit.path, effort=effort)
        scores = row_scores(
            bound, fitted.theta, particles=particles, seed=seed, passes=effort.passes, others=others
        )
    except DensityError:
        raise
    except PmclError as error:
        _logger.debug("%s cannot be fitted: %s", effect.name, error)
        return None
    gains = _gains(scores.rows, current.row_scores, split)
    return Trial(
        effect, model, fitted, scores.rows, z, *gains, particles, effort == THOROUGH,
        occam=occam_factor(fitted, int(free.sum())), from_null=from_null(fitted, effect, free), noise=scores.noise,
    )  # fmt: skip


def occam_factor(fit: Fit, count: int) -> float:
    """Return the log of the prior's density over its mean under a Gaussian posterior, for the last parameters of a fit.

    Parameters
    ----------
    fit : Fit
        The fit.
    count : int
        Number of parameters, those of the newest effect.

    Returns
    -------
    float
        Zero for parameters of which the log tells nothing [nat]; see MacKay (2003), Information Theory, Inference, and
        Learning Algorithms, chapter 28.
    """
    if not count:
        return 0.0
    prior = sum(
        float(parameter.prior.logpdf(value))
        for parameter, value in zip(fit.bound.parameters[-count:], fit.theta[-count:], strict=True)
    )
    covariance = np.atleast_2d(np.cov(fit.draws[:, -count:].T))
    log_volume = 0.5 * np.linalg.slogdet(2.0 * np.pi * (covariance + 1e-12 * np.eye(count)))[1]
    return max(0.0, -prior - float(log_volume))


def from_null(fit: Fit, effect: Effect, free: NDArray[np.bool_]) -> float:
    """Return how far the last parameters of a fit, those of an effect, are from no effect.

    Parameters
    ----------
    fit : Fit
        The fit.
    effect : Effect
        The effect.
    free : ndarray of bool, shape (k,)
        Which of its parameters are fitted.

    Returns
    -------
    float
        The greatest distance of a strength from its null in standard deviations of its draws. A strength with a bound
        at the null, such as the weight of a mixture, never lies far from it in these terms: it has no distance, and
        neither has an effect that the data show without a fit. The distance of these is infinite.
    """
    strengths = [k for k in effect.strengths if free[k]]
    if not strengths or any(effect.squared or effect.one_sided(k) for k in strengths):
        return float("inf")
    draws = fit.draws[:, -int(free.sum()) :]
    position = np.cumsum(free) - 1
    return max(
        float(abs(draws[:, position[k]].mean() - effect.null[k]) / (draws[:, position[k]].std() + 1e-300))
        for k in strengths
    )


def refitted(
    trial: Trial,
    current: Trial,
    logs: RobotLog | Sequence[RobotLog],
    split: int,
    *,
    seed: int,
    particles: int,
    effort: Effort,
) -> Trial:
    """Continue the fit of a trial, and score it again against the current model.

    Parameters
    ----------
    trial : Trial
        The trial.
    current : Trial
        The current model.
    logs, split, seed, particles, effort
        As for :func:`try_effect`.

    Returns
    -------
    Trial
        The trial without any change if the filter loses the robot after the longer fit.
    """
    bound = trial.model.bind(log_sequence(logs)[0])
    try:
        before = trial.fit
        fitted = quick_fit(
            bound.restricted(split), seed, theta=before.theta, path=before.path, draws=before.draws, effort=effort
        )
        count = fitted.theta.size - current.fit.theta.size
        longer = replace(
            trial, fit=fitted, thorough=effort == THOROUGH, occam=occam_factor(fitted, count),
            from_null=_distance_of(trial, fitted),
        )  # fmt: skip
        return scored_anew(longer, current, logs, split, seed=seed, particles=particles)
    except DensityError:
        raise
    except PmclError as error:
        _logger.debug("a longer fit with %s fails: %s", trial.model.effects[-1].name, error)
        return trial


def _distance_of(trial: Trial, fit: Fit) -> float:
    """Return the distance of a trial's effect from none under a longer fit."""
    if trial.effect is None:
        return float("inf")
    newest = trial.model.named_effects[-1]
    free = np.array([parameter.name not in trial.model.fixed for parameter in newest.parameters])
    return from_null(fit, trial.effect, free)


def scored_anew(
    trial: Trial, current: Trial, logs: RobotLog | Sequence[RobotLog], split: int, *, seed: int, particles: int
) -> Trial:
    """Score the rows of a trial with its present fit and another number of particles.

    Parameters
    ----------
    trial : Trial
        The trial.
    current : Trial
        The current model, scored with the same number of particles; it may be the trial itself.
    logs, split, seed, particles
        As for :func:`try_effect`.
    """
    log, *others = log_sequence(logs)
    scores = row_scores(trial.model.bind(log), trial.fit.theta, particles=particles, seed=seed, others=others)
    rows = scores.rows
    gains = _gains(rows, rows if trial is current else current.row_scores, split)
    return replace(trial, row_scores=rows, noise=scores.noise, particles=particles, **gains._asdict())


def _gains(new: Float, old: Float, split: int) -> _Gains:
    return _Gains(*(paired_gain(new, old, rows) for rows in (slice(0, split), slice(split, None), slice(None))))


def trial_of_base(
    model: RobotModel,
    logs: RobotLog | Sequence[RobotLog],
    split: int,
    *,
    seed: int,
    particles: int,
    theta: Float,
    path: Float,
    draws: Float | None = None,
) -> Trial:
    """Fit a model without additional effects on the fit part, and score all rows.

    Parameters
    ----------
    model : RobotModel
        The model.
    logs, split, seed, particles
        As for :func:`try_effect`.
    theta : ndarray, shape (d,)
        Parameters of a fit of the whole log, from which this one starts.
    path : ndarray, shape (T, D)
        Path of that fit.
    draws : ndarray, shape (N, d), optional
        Draws of that fit.
    """
    log, *others = log_sequence(logs)
    bound = model.bind(log)
    fitted = quick_fit(bound.restricted(split), seed, theta=theta, path=path[:split], draws=draws)
    scores = row_scores(bound, fitted.theta, particles=particles, seed=seed, others=others)
    no_gain = Gain(0.0, 0.0)
    return Trial(
        None, model, fitted, scores.rows, 0.0, no_gain, no_gain, no_gain, particles, noise=scores.noise
    )


def _start_values(effect: Effect, z: float) -> Float:
    """Return values near the null, on the side that the score points to, inside the priors."""
    values = np.array(effect.null, dtype=float)
    for k in effect.strengths:
        one_sided = effect.squared or effect.one_sided(k)
        values[k] = probe_values(effect, _START_SHARE if one_sided else _START_SHARE * float(np.sign(z) or 1.0), k)[k]
    for k, parameter in enumerate(effect.parameters):
        low, high = prior_support(parameter.prior)
        margin = 1e-6 * (high - low) if np.isfinite(high - low) else 1e-6
        values[k] = float(np.clip(values[k], low + margin, high - margin))
    return values


def spare_effects(
    accepted: Trial,
    n_base: int,
    logs: RobotLog | Sequence[RobotLog],
    split: int,
    *,
    seed: int,
    particles: int,
) -> tuple[Trial, list[int]]:
    """Remove each effect that was added before the newest one and that held-out rows no longer need.

    Parameters
    ----------
    accepted : Trial
        The model with the newest effect last.
    n_base : int
        Number of effects of the base model, which stay.
    logs, split, seed, particles
        As for :func:`try_effect`.

    Returns
    -------
    trial : Trial
        The model without the effects that were removed.
    dropped : list of int
        Their positions among the model's effects, each counted after the removals before it.
    """
    trial, dropped, position = accepted, [], n_base
    while position < len(trial.model.effects) - 1:
        effects = trial.model.effects
        if effects[position].tells is not None:  # the data show it without a fit
            position += 1
            continue
        model = replace(trial.model, effects=effects[:position] + effects[position + 1 :])
        # Parameters are found by position: those of effects that occur several times get other names without one.
        counts = [
            sum(parameter.name not in trial.model.fixed for parameter in effect.parameters)
            for effect in trial.model.named_effects
        ]
        begin = trial.fit.theta.size - sum(counts[position:])
        try:
            theta = np.delete(trial.fit.theta, np.s_[begin : begin + counts[position]])
            without = trial_of_base(
                model, logs, split, seed=seed, particles=particles, theta=theta, path=trial.fit.path
            )
        except DensityError:
            raise
        except PmclError:
            position += 1
            continue
        loss = paired_gain(trial.row_scores, without.row_scores, slice(split, None))
        if loss.total < max(PRACTICAL, loss.se):
            trial = replace(without, effect=trial.effect, z=trial.z)
            dropped.append(position)
        else:
            position += 1
    return trial, dropped
