"""The parts of a result, made from trials, fits and alarms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.criticism.findings.parts import Candidate, Estimate, FoundEffect, Unexplained
from pmcl.criticism.findings.result import JudgedFit
from pmcl.criticism.findings.verdict import with_place
from pmcl.criticism.fitting.quick_fit import Fit
from pmcl.criticism.fitting.trials import Trial
from pmcl.criticism.fitting.when import Acting
from pmcl.criticism.judging.alarms import Judgement
from pmcl.criticism.judging.locate import locate
from pmcl.criticism.scoring.scores import Direction, instance_key
from pmcl.models.effects.effect import Effect
from pmcl.models.effects.formula import PREFIX
from pmcl.posterior.access import parameter_draws
from pmcl.posterior.compat import Posterior

__all__ = [
    "candidates_of", "drawn_estimates", "estimates", "filled_in", "found_effect", "unexplained_of", "with_estimates_of",
    "with_window",
]  # fmt: skip

# Number of candidates that are listed although they were only scored.
_LISTED = 10


class _Score(NamedTuple):
    """The greatest standardised score of a candidate, with its p-value."""

    z: float
    p_value: float
    effect: Effect


def estimates(fit: Fit) -> dict[str, Estimate]:
    """Return the parameters of a quick fit."""
    return {
        p.name: Estimate(float(mean), float(sd), p.unit)
        for p, mean, sd in zip(fit.bound.parameters, fit.theta, fit.std, strict=True)
    }


def drawn_estimates(fit: Fit, posterior: Posterior) -> dict[str, Estimate]:
    """Return the parameters of a model from full chains.

    Parameters
    ----------
    fit : Fit
        A quick fit of the same model, for names and units.
    posterior : Posterior
        The full chains.
    """
    drawn = {p.name: parameter_draws(posterior, p.name) for p in fit.bound.parameters}
    return {
        p.name: Estimate(float(drawn[p.name].mean()), float(drawn[p.name].std()), p.unit) for p in fit.bound.parameters
    }


def found_effect(
    accepted: Trial, twins: Sequence[Trial], judgement: Judgement, directions: Sequence[Direction]
) -> FoundEffect:
    """Return an accepted effect, still without its final parameters and its gain on held-out data.

    Parameters
    ----------
    accepted : Trial
        The model with the effect.
    twins : sequence of Trial
        Models with effects that the log cannot distinguish from it.
    judgement : Judgement
        Tests of the log before the effect was added.
    directions : sequence of Direction
        The K candidates of these tests.
    """
    effect = accepted.effect
    assert effect is not None
    others = [trial.effect for trial in twins if trial.effect is not None]
    alike = [effect, *others]
    p_values = [
        float(p)
        for p, direction in zip(judgement.p_values, directions, strict=True)
        if any(direction.effect is other for other in alike)
    ]
    advice = [effect.near_twins.get(other.name) or other.near_twins.get(effect.name, "") for other in others]
    return FoundEffect(
        effect.name, effect.summary, effect.where, {}, min(p_values, default=accepted.p_value),
        float("nan"), float("nan"),
        tuple(with_place(other) for other in others), tuple(dict.fromkeys(text for text in advice if text)),
        effect.finding,
    )  # fmt: skip


def with_estimates_of(
    found: FoundEffect, effect: Effect, after: Mapping[str, Estimate], fixed: Mapping[str, float]
) -> FoundEffect:
    """Return a found effect with its calibrated parameters.

    Parameters
    ----------
    found : FoundEffect
        The effect; a formula gets its coefficient into its name.
    effect : Effect
        The same effect with the parameter names that the final model has.
    after : mapping of str to Estimate
        Parameters of the final model.
    fixed : mapping of str to float
        Parameters that the final model holds fixed.
    """
    parameters = {
        p.name: after[p.name] if p.name in after else Estimate(float(fixed[p.name]), 0.0, p.unit)
        for p in effect.parameters
    }
    name = found.name
    if name.startswith(PREFIX):
        name = filled_in(name, after[effect.parameters[0].name].mean)
    return replace(found, name=name, parameters=parameters)


def with_window(found: FoundEffect, effect: Effect, acts: Acting | None) -> FoundEffect:
    """Return a found effect with its window.

    Parameters
    ----------
    found : FoundEffect
        The effect, with its calibrated parameters.
    effect : Effect
        The same effect with the parameter names that the final model has.
    acts : Acting or None
        When it acts.
    """
    if acts is None:
        return found
    inside = {p.name: Estimate(*acts.values[p.name], p.unit) for p in effect.parameters if p.name in acts.values}
    # What the model holds fixed, it holds fixed there, too.
    return replace(found, acting=acts, while_acting={**found.parameters, **inside} if inside else {})


def filled_in(name: str, value: float) -> str:
    """Return the name of a formula with its coefficient, e.g. ``formula: turn += 0.03*cos(heading)``.

    Parameters
    ----------
    name : str
        The name, with ``c*`` for the coefficient.
    value : float
        The coefficient.
    """
    return name.replace("c*", f"{value:.3g}*", 1).replace("+ -", "- ")


def candidates_of(
    judgement: Judgement, directions: Sequence[Direction], trials: Sequence[Trial], accepted: Trial | None
) -> tuple[Candidate, ...]:
    """Return the refitted candidates, best first, then those with the greatest scores that were not refitted.

    Parameters
    ----------
    judgement : Judgement
        Tests of the log.
    directions : sequence of Direction
        The K candidates of these tests.
    trials : sequence of Trial
        The refitted candidates.
    accepted : Trial or None
        The trial that was added to the model.
    """
    scores: dict[Any, _Score] = {}
    for k in np.argsort(-np.abs(judgement.z)):
        effect = directions[k].effect
        scores.setdefault(instance_key(effect), _Score(float(judgement.z[k]), float(judgement.p_values[k]), effect))
    refitted = []
    for trial in sorted(trials, key=lambda trial: -trial.evidence):
        assert trial.effect is not None
        score = scores.pop(instance_key(trial.effect), _Score(trial.z, trial.p_value, trial.effect))
        known = {**trial.model.fixed, **trial.fit.values()}
        values = {p.name: float(known[p.name]) for p in trial.model.named_effects[-1].parameters}
        refitted.append(
            Candidate(
                *(trial.effect.name, trial.effect.where, score.z, score.p_value),
                *(trial.gain.total, trial.gain.se, trial.evidence),
                values=values,
                accepted=trial is accepted,
            )
        )
    nan = float("nan")
    scored = [
        Candidate(score.effect.name, score.effect.where, score.z, score.p_value, nan, nan, nan)
        for score in list(scores.values())[:_LISTED]
    ]
    return (*refitted, *scored)


def unexplained_of(last: JudgedFit, directions: Sequence[Direction]) -> tuple[Unexplained, ...]:
    """Return where the alarms of a model come from.

    Parameters
    ----------
    last : JudgedFit
        The model and the tests of the log under it.
    directions : sequence of Direction
        The K candidates of these tests.
    """
    scored = last.scored
    labels = (
        *last.fit.bound.names,
        *(direction.effect.name for direction in directions),
        *(direction.effect.parameters[direction.strength].name for direction in directions),
    )
    rows = np.concatenate([scored.parameter_scores, scored.scores, scored.scores])
    scores: dict[str, NDArray[np.float64]] = {}
    for label, row in zip(labels, rows, strict=True):
        scores.setdefault(label, row)
    judgement = last.judgement
    return tuple(
        Unexplained(*locate(alarm, scored, scores), p_value)
        for alarm, p_value in zip(judgement.raised, judgement.raised_p_values, strict=True)
    )
