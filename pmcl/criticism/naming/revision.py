"""Earlier effects of a model, looked at again when a later one is in it.

The name of an effect was chosen in a model that lacked the later ones. With these in the model the effect may be
unnecessary, and an effect that looks like it may be more probable: a log whose errors are thought to be independent
seems to tell more than it does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pmcl.criticism.findings.parts import FoundEffect
from pmcl.criticism.fitting.quick_fit import quick_fit
from pmcl.criticism.fitting.trials import Trial, evidence_between, trial_of_base
from pmcl.criticism.naming.candidates import RankedEffect
from pmcl.criticism.naming.search import Outcome
from pmcl.errors import DensityError, PmclError
from pmcl.models.effects.effect import Effect
from pmcl.models.robot_model import RobotModel

__all__ = ["Answer", "Exchange", "Revised", "revised"]


class Answer(NamedTuple):
    """An effect that a model has, and what may be meant instead.

    Attributes
    ----------
    found : FoundEffect
        The effect.
    credible : tuple of Trial
        The effects that may be meant, the one that was added first; empty where nothing else may be.
    """

    found: FoundEffect
    credible: tuple[Trial, ...] = ()


class Exchange(NamedTuple):
    """An effect that another one has replaced.

    Attributes
    ----------
    position : int
        Its position among the effects that were added.
    name : str
        Its name.
    without : Trial
        The model without either of them.
    """

    position: int
    name: str
    without: Trial


class Revised(NamedTuple):
    """A model after its earlier effects were looked at again.

    Attributes
    ----------
    trial : Trial
        The model, fitted and scored.
    answers : list of Answer
        Its earlier effects.
    dropped : list of str
        Names of effects that it no longer has.
    exchanged : list of Exchange
        Effects that were replaced.
    """

    trial: Trial
    answers: list[Answer]
    dropped: list[str]
    exchanged: list[Exchange]


def revised(
    newest: Trial,
    answers: Sequence[Answer],
    n_base: int,
    log_prior_odds: Callable[[Effect], float],
    named_again: Callable[[Trial, RankedEffect], Outcome | None],
    *,
    seed: int,
) -> Revised:
    """Remove each earlier effect that is now less probable than that it is absent, and name each other one again.

    Parameters
    ----------
    newest : Trial
        The model with the newest effect last.
    answers : sequence of Answer
        The effects that were added before.
    n_base : int
        Number of effects of the base model, which stay.
    log_prior_odds : callable
        ``log_prior_odds(effect)``: log of the prior probability that the robot has an effect over that it has none.
    named_again : callable
        ``named_again(without, ranked)``: the most probable effect in place of one, given the model `without` it; None
        where nothing looks like it. In place of a score it has the side on which the effect is. Effects that the data
        show without a fit are not asked for.
    seed : int
        Determines all random numbers.
    """
    result = Revised(newest, [], [], [])
    trial = newest
    for found, credible in answers:
        position = n_base + len(result.answers)
        effect = trial.model.effects[position]
        without = _without(trial, position, seed) if effect.tells is None else None
        again = None
        if without is not None:
            if evidence_between(trial, without) + log_prior_odds(effect) <= 0.0:
                trial = replace(without, effect=newest.effect, z=newest.z, gain=newest.gain)
                result.dropped.append(found.name)
                continue
            again = named_again(without, RankedEffect(effect, _side(trial, position)))
        if without is not None and again is not None and again.accepted is not None and again.found is not None:
            same = (again.found.name, again.found.where) == (found.name, found.where)
            other = None if same else _exchanged(trial, position, again.accepted, seed)
            if other is not None:
                trial = replace(other, effect=newest.effect, z=newest.z, gain=newest.gain)
                result.exchanged.append(Exchange(len(result.answers), found.name, without))
                found, credible = again.found, again.credible
            elif same:
                credible = again.credible
                found = replace(
                    found, probability=again.found.probability, alternatives=again.found.alternatives,
                    advice=again.found.advice, not_distinguishable_from=again.found.not_distinguishable_from,
                )  # fmt: skip
        result.answers.append(Answer(found, credible))
    return result._replace(trial=trial)


def _without(trial: Trial, position: int, seed: int) -> Trial | None:
    """Return the model without one of its effects; None when no filter follows the robot then."""
    effects = trial.model.effects
    model = replace(trial.model, effects=effects[:position] + effects[position + 1 :])
    # Parameters are found by position: those of effects that occur several times get other names without one.
    begin, stop = _own_parameters(trial, position)
    return _fitted(trial, model, np.delete(trial.fit.theta, np.s_[begin:stop]), seed)


def _exchanged(trial: Trial, position: int, other: Trial, seed: int) -> Trial | None:
    """Return the model with the newest effect of another one in place of one of its own; None as above."""
    effects, (begin, stop) = trial.model.effects, _own_parameters(trial, position)
    own, _ = _own_parameters(other, len(other.model.effects) - 1)
    model = replace(
        trial.model, fixed={**trial.model.fixed, **other.model.fixed},
        effects=(*effects[:position], other.model.effects[-1], *effects[position + 1 :]),
    )  # fmt: skip
    theta = np.concatenate([trial.fit.theta[:begin], other.fit.theta[own:], trial.fit.theta[stop:]])
    return _fitted(other, model, theta, seed)


def _own_parameters(trial: Trial, position: int) -> tuple[int, int]:
    """Return where the free parameters of an effect begin and end in a model's theta."""
    counts = [
        sum(parameter.name not in trial.model.fixed for parameter in effect.parameters)
        for effect in trial.model.named_effects
    ]
    begin = trial.fit.theta.size - sum(counts[position:])
    return begin, begin + counts[position]


def _side(trial: Trial, position: int) -> float:
    """Return on which side of its null an effect of a model is: 1 or -1."""
    effect, known = trial.model.named_effects[position], {**trial.model.fixed, **trial.fit.values()}
    k = effect.strengths[0]
    return 1.0 if known[effect.parameters[k].name] >= effect.null[k] else -1.0


def _fitted(like: Trial, model: RobotModel, theta: np.ndarray, seed: int) -> Trial | None:
    """Fit a model from some parameters and a trial's path, and score it; None where that cannot be."""
    try:
        fit = quick_fit(model.bind(like.fit.bound.logs), seed, theta=theta, path=like.fit.path)
        return trial_of_base(fit, seed=seed)
    except DensityError:
        raise
    except PmclError:
        return None
