"""The parts of a result, from what the loop leaves behind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pmcl.criticism.alarms import Judgement
from pmcl.criticism.fit import Fit
from pmcl.criticism.formulas import filled_in
from pmcl.criticism.locate import locate
from pmcl.criticism.passes import key_of
from pmcl.criticism.result import Candidate, Estimate, FoundEffect, Pass, Unexplained
from pmcl.criticism.scores import Direction
from pmcl.criticism.trials import Trial
from pmcl.criticism.verdict import called
from pmcl.models.effects.effect import Effect
from pmcl.models.effects.formula import PREFIX
from pmcl.posterior.access import parameter_draws
from pmcl.posterior.compat import Posterior

__all__ = ["candidates_of", "drawn_estimates", "estimates", "found_effect", "measured", "unexplained_of"]

_SHOWN = 10


def estimates(fit: Fit) -> dict[str, Estimate]:
    """Return the parameters of a quick fit."""
    return {
        p.name: Estimate(float(mean), float(sd), p.unit)
        for p, mean, sd in zip(fit.bound.parameters, fit.theta, fit.std, strict=True)
    }


def drawn_estimates(fit: Fit, posterior: Posterior) -> dict[str, Estimate]:
    """Return the parameters of the same model from full chains."""
    drawn = {p.name: parameter_draws(posterior, p.name) for p in fit.bound.parameters}
    return {
        p.name: Estimate(float(drawn[p.name].mean()), float(drawn[p.name].std()), p.unit) for p in fit.bound.parameters
    }


def found_effect(
    accepted: Trial, twins: Sequence[Trial], judged: Judgement, wanted: Sequence[Direction]
) -> FoundEffect:
    """Return an accepted effect, still without its final parameters."""
    effect = accepted.effect
    assert effect is not None
    others = [trial.effect for trial in twins if trial.effect is not None]
    alike = [effect, *others]
    p_values = [
        float(p) for p, one in zip(judged.p_values, wanted, strict=True) if any(one.effect is same for same in alike)
    ]
    advice = [effect.near_twins.get(other.name) or other.near_twins.get(effect.name, "") for other in others]
    return FoundEffect(
        effect.name, effect.summary, effect.where, {}, min(p_values, default=accepted.p_value), *accepted.on_heldout,
        tuple(called(other) for other in others), tuple(dict.fromkeys(text for text in advice if text)),
        effect.finding,
    )  # fmt: skip


def measured(
    found: FoundEffect, effect: Effect, after: Mapping[str, Estimate], fixed: Mapping[str, float]
) -> FoundEffect:
    """Return a found effect with its calibrated parameters, or those held fixed; a formula gets its coefficient."""
    parameters = {
        p.name: after[p.name] if p.name in after else Estimate(float(fixed[p.name]), 0.0, p.unit)
        for p in effect.parameters
    }
    name = found.name
    if name.startswith(PREFIX):
        name = filled_in(name, after[effect.parameters[0].name].mean)
    return replace(found, name=name, parameters=parameters)


def candidates_of(
    judged: Judgement, wanted: Sequence[Direction], trials: Sequence[Trial], accepted: Trial | None
) -> tuple[Candidate, ...]:
    """Return the refitted candidates, best first, then the greatest scores of those that were not refitted."""
    scored: dict[Any, tuple[float, float, Effect]] = {}
    for k in np.argsort(-np.abs(judged.z)):
        effect = wanted[k].effect
        scored.setdefault(key_of(effect), (float(judged.z[k]), float(judged.p_values[k]), effect))
    made = []
    for trial in sorted(trials, key=lambda one: -one.merit):
        assert trial.effect is not None
        z, p_value, _ = scored.pop(key_of(trial.effect), (trial.z, trial.p_value, trial.effect))
        known = {**trial.model.fixed, **trial.fit.values()}
        values = {p.name: float(known[p.name]) for p in trial.model.named_effects[-1].parameters}
        made.append(
            Candidate(
                *(trial.effect.name, trial.effect.where, z, p_value),
                *(*trial.on_fit, *trial.on_heldout),
                values=values,
                accepted=trial is accepted,
            )
        )
    nan = float("nan")
    rest = list(scored.values())[:_SHOWN]
    return (*made, *(Candidate(e.name, e.where, z, p, nan, nan, nan, nan) for z, p, e in rest))


def unexplained_of(last: Pass, wanted: Sequence[Direction]) -> tuple[Unexplained, ...]:
    """Return where the alarms of a pass come from; `wanted` are the directions it scored."""
    found = last.evidence
    labels = (
        *last.fit.bound.names,
        *(one.effect.name for one in wanted),
        *(one.effect.parameters[one.strength].name for one in wanted),
    )
    rows = np.concatenate([found.base, found.scores, found.scores])
    alarms = zip(last.judgement.raised, last.judgement.raised_p_values, strict=True)
    return tuple(locate(alarm, found, labels, rows, p_value) for alarm, p_value in alarms)
