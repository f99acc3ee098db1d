"""Effects that a model has and no longer needs, because a later one explains what they stood for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pmcl.criticism.fitting.quick_fit import quick_fit
from pmcl.criticism.fitting.trials import Trial, log_prior_and_volume, trial_of_base
from pmcl.errors import DensityError, PmclError
from pmcl.models.effects.effect import Effect

__all__ = ["evidence_between", "without_spare_effects"]


def without_spare_effects(
    newest: Trial, n_base: int, log_prior_odds: Callable[[Effect], float], *, seed: int
) -> tuple[Trial, list[int]]:
    """Remove each effect that was added before the newest one and is now less probable than that it is absent.

    Parameters
    ----------
    newest : Trial
        The model with the newest effect last.
    n_base : int
        Number of effects of the base model, which stay.
    log_prior_odds : callable
        ``log_prior_odds(effect)``: log of the prior probability that the robot has an effect over that it has none.
    seed : int
        Determines all random numbers.

    Returns
    -------
    trial : Trial
        The model without the effects that were removed.
    dropped : list of int
        Their positions among the model's effects, each counted after the removals before it.
    """
    trial, dropped, position = newest, [], n_base
    while position < len(trial.model.effects) - 1:
        without = _without(trial, position, seed) if trial.model.effects[position].tells is None else None
        if without is None or evidence_between(trial, without) + log_prior_odds(trial.model.effects[position]) > 0.0:
            position += 1
            continue
        trial = replace(without, effect=newest.effect, z=newest.z, gain=newest.gain)
        dropped.append(position)
    return trial, dropped


def evidence_between(trial: Trial, without: Trial) -> float:
    """Return the log evidence for what only one of two models has [nat].

    Parameters
    ----------
    trial, without : Trial
        The models, scored with as many particles.
    """
    gain = float(trial.row_scores.sum() - without.row_scores.sum()) + 0.5 * (trial.noise**2 - without.noise**2)
    return gain + log_prior_and_volume(trial.fit) - log_prior_and_volume(without.fit)


def _without(trial: Trial, position: int, seed: int) -> Trial | None:
    """Return the model without one of its effects; None when no filter follows the robot then."""
    effects = trial.model.effects
    model = replace(trial.model, effects=effects[:position] + effects[position + 1 :])
    # Parameters are found by position: those of effects that occur several times get other names without one.
    counts = [
        sum(parameter.name not in trial.model.fixed for parameter in effect.parameters)
        for effect in trial.model.named_effects
    ]
    begin = trial.fit.theta.size - sum(counts[position:])
    try:
        theta = np.delete(trial.fit.theta, np.s_[begin : begin + counts[position]])
        fit = quick_fit(model.bind(trial.fit.bound.logs), seed, theta=theta, path=trial.fit.path)
        return trial_of_base(fit, seed=seed, particles=trial.particles)
    except DensityError:
        raise
    except PmclError:
        return None
