"""The pieces of a criticism as the JSON file holds them, which other programs read."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from pmcl.criticism.findings.parts import Estimate, FoundEffect, Step, Unexplained

__all__ = ["FORMAT", "effect_entry", "estimates_entry", "json_text", "step_entry", "unexplained_entry"]

FORMAT = "pmcl-criticism/1"


def json_text(content: dict[str, Any]) -> str:
    """Return JSON text, in which numbers that are not finite are null."""
    return json.dumps(_finite(content), indent=1, allow_nan=False)


def estimates_entry(estimates: Mapping[str, Estimate]) -> dict[str, Any]:
    """Return parameters with mean, standard deviation and unit."""
    return {
        name: {"mean": estimate.mean, "sd": estimate.sd, "unit": estimate.unit} for name, estimate in estimates.items()
    }


def _where(where: Mapping[str, Any]) -> dict[str, Any]:
    return {key: list(values) for key, values in where.items()}


def effect_entry(effect: FoundEffect, log_times: tuple[float, float]) -> dict[str, Any]:
    """Return an accepted effect.

    Parameters
    ----------
    effect : FoundEffect
        The effect.
    log_times : tuple of float
        First and last time of the log [s].
    """
    return {
        "name": effect.name,
        "where": _where(effect.where),
        "parameters": estimates_entry(effect.parameters),
        "p_value": effect.p_value,
        "log_score_gain": effect.log_score_gain,
        "log_score_gain_se": effect.log_score_gain_se,
        "not_distinguishable_from": list(effect.not_distinguishable_from),
        "summary": effect.summary,
        "advice": list(effect.advice),
        "chosen_on_all_rows": effect.chosen_on_all_rows,
        "probability": effect.probability,
        "alternatives": [
            {"name": other.name, "where": _where(other.where), "probability": other.probability}
            for other in effect.alternatives
        ],
        "record_next": effect.record_next._asdict() if effect.record_next is not None else None,
        **_window(effect, log_times),
    }


def _window(effect: FoundEffect, log_times: tuple[float, float]) -> dict[str, Any]:
    """Return when an effect acts; an end that is not the effect's own is that of the log, and has no interval."""
    acts = effect.acting
    if acts is None:
        return {"window": None}
    return {
        "window": [acts.begin.time if acts.begin else log_times[0], acts.end.time if acts.end else log_times[1]],
        "window_intervals": [[moment.low, moment.high] if moment else None for moment in (acts.begin, acts.end)],
        "window_probability": acts.probability,
        "window_parameters": estimates_entry(effect.while_acting),
    }


def unexplained_entry(disagreement: Unexplained) -> dict[str, Any]:
    """Return where the final model still disagrees with the log."""
    return {
        "channel": disagreement.channel,
        "beams": list(disagreement.beams),
        "covariate": disagreement.covariate,
        "moment": disagreement.moment,
        "interval": list(disagreement.interval),
        "time": list(disagreement.time),
        "p_value": disagreement.p_value,
    }


def step_entry(step: Step) -> dict[str, Any]:
    """Return one model of the loop, and the decision about it."""
    return {
        "model": list(step.model),
        "gap": step.gap._asdict(),
        "alarms": [
            {"family": alarm.family, "p_value": alarm.p_value, "raised": alarm.raised, "z": alarm.z}
            for alarm in step.alarms
        ],
        "candidates": [
            {
                "name": candidate.name,
                "where": _where(candidate.where),
                "score_p_value": candidate.score_p_value,
                "log_score_gain": candidate.log_score_gain,
                "log_score_gain_se": candidate.log_score_gain_se,
                "evidence": candidate.evidence,
            }
            for candidate in step.candidates
        ],
        "decision": step.decision,
    }


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
