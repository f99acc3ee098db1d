"""What criticism found, as plain data, and as the JSON file that other programs read."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pmcl.criticism.alarms import Alarm, Judgement
from pmcl.criticism.evidence import Evidence
from pmcl.criticism.fit import Fit
from pmcl.criticism.heldout import Gap
from pmcl.errors import PosteriorError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.model_text import model_text
from pmcl.models.robot_model import RobotModel
from pmcl.posterior.files import replacing, write_posterior

__all__ = ["FORMAT", "Candidate", "Criticism", "Estimate", "FoundEffect", "Pass", "Step", "Unexplained"]

FORMAT = "pmcl-criticism/1"


@dataclass(frozen=True)
class Estimate:
    """Posterior mean and standard deviation of a parameter, with its unit.

    Formatted it is text for people: ``+`` keeps the sign, ``%`` gives per cent, ``left|right`` a word for each sign.
    """

    mean: float
    sd: float
    unit: str

    def __format__(self, wanted: str) -> str:
        """Return the size, rounded by its standard deviation, or the word that `wanted` has for its sign."""
        if "|" in wanted:
            positive, negative = wanted.split("|")
            return negative if self.mean < 0.0 else positive
        scale, unit = (100.0, "%") if wanted == "%" else (1.0, "" if self.unit == "1" else self.unit)
        mean, sd = scale * (self.mean if wanted == "+" else abs(self.mean)), scale * self.sd
        if not 0.0 < sd < math.inf:
            return f"{mean:.3g} {unit}".rstrip()
        digits = max(1 - math.floor(math.log10(sd)), 0)
        return f"{mean:.{digits}f} ± {sd:.{digits}f} {unit}".rstrip()


@dataclass(frozen=True)
class FoundEffect:
    """An effect that was accepted.

    Attributes
    ----------
    name, summary : str
        As in the catalogue; a formula for an effect outside it.
    where : mapping
        What it is about, e.g. ``{"beams": [2]}``.
    parameters : mapping of str to Estimate
        Its calibrated parameters.
    p_value : float
        Of its score, or of that of an effect that this log cannot tell from it, before it was added.
    log_score_gain, log_score_gain_se : float
        Gain on held-out data [nat] when it was added, and its standard error.
    not_distinguishable_from : tuple of str
        Effects that this log cannot tell from it.
    advice : tuple of str
        What motion would tell them apart.
    finding : str
        What is said of the log, see :class:`~pmcl.models.effects.effect.Effect`; empty for a formula.
    """

    name: str
    summary: str
    where: Mapping[str, Any]
    parameters: Mapping[str, Estimate]
    p_value: float
    log_score_gain: float
    log_score_gain_se: float
    not_distinguishable_from: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()
    finding: str = ""


@dataclass(frozen=True)
class Unexplained:
    """Where the final model still disagrees with the log.

    Attributes
    ----------
    channel : str
        Variable of the log, or the name of a score.
    beams : tuple of int
        Beams or landmarks; empty for all.
    covariate, moment : str
        What the disagreement depends on, and whether readings are off ("mean") or their spread is ("spread").
    interval : tuple of float
        Where it is worst, in units of the covariate.
    time : tuple of int
        First and last row where it is worst.
    p_value : float
        Probability of such an alarm when the model is right, all families of alarms considered (Holm 1979). It can be
        compared with the rate of false alarms as it is; those of single families are in :attr:`Step.alarms`.
    """

    channel: str
    beams: tuple[int, ...]
    covariate: str
    moment: str
    interval: tuple[float, float]
    time: tuple[int, int]
    p_value: float


@dataclass(frozen=True)
class Candidate:
    """An effect that was refitted, or only scored (its gain is then NaN); `accepted` tells the one that was added."""

    name: str
    where: Mapping[str, Any]
    z: float
    score_p_value: float
    fit_gain: float
    fit_gain_se: float
    log_score_gain: float
    log_score_gain_se: float
    values: Mapping[str, float] = field(default_factory=dict)
    accepted: bool = False


@dataclass(frozen=True)
class Step:
    """One model of the loop and what was done about it.

    Attributes
    ----------
    model : tuple of str
        Effects that the model has.
    gap : Gap
        On held-out data.
    alarms : tuple of Alarm
        What was unusual.
    candidates : tuple of Candidate
        Refitted candidates, then the best of those that were only scored.
    decision : str
        What was done, e.g. "add beam-bias".
    critical_z : float
        What the greatest score's deviation exceeds in 5 % of logs without a missing effect; NaN without alarms.
    """

    model: tuple[str, ...]
    gap: Gap
    alarms: tuple[Alarm, ...]
    candidates: tuple[Candidate, ...]
    decision: str
    critical_z: float


@dataclass(frozen=True)
class Pass:
    """One model's pass over the log, for pictures: its fit, its evidence, and what alarms make of it."""

    fit: Fit
    evidence: Evidence
    judgement: Judgement


@dataclass(frozen=True)
class Criticism:
    """The result of :func:`pmcl.criticism.workflow.criticize`.

    Attributes
    ----------
    verdict : str
        "no missing effect", "explained" or "unknown effect".
    sentence : str
        The verdict in one sentence for people.
    effects : tuple of FoundEffect
        Accepted effects.
    unexplained : tuple of Unexplained
        Where the final model still disagrees.
    steps : tuple of Step
        From the base model to the final one.
    base, model : RobotModel
        The model before, and the final one: an ordinary model with the effects in it, for this and other logs of the
        robot.
    before, after : mapping of str to Estimate
        Parameters of both.
    log : RobotLog
        The log; with an estimate of its path where the final model has formulas that need one.
    split : int
        First row of the held-out part.
    first, last : Pass
        The first and the last model's pass.
    posterior : ArviZ posterior or None
        The joint calibration of the final model, when there was one; it holds that model, so that
        :func:`pmcl.localization.offline.localize` and :func:`pmcl.localization.model_choice.model_for` need no more.
    notes : tuple of str
        What limits the result.
    settings : mapping
        Enough to run it again.
    """

    verdict: str
    sentence: str
    effects: tuple[FoundEffect, ...]
    unexplained: tuple[Unexplained, ...]
    steps: tuple[Step, ...]
    base: RobotModel
    model: RobotModel
    before: Mapping[str, Estimate]
    after: Mapping[str, Estimate]
    log: RobotLog
    split: int
    first: Pass
    last: Pass
    posterior: Any = None
    notes: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of the JSON file."""
        return {
            "format": FORMAT,
            "verdict": self.verdict,
            "sentence": self.sentence,
            "effects": [_effect(effect) for effect in self.effects],
            "unexplained": [_unexplained(one) for one in self.unexplained],
            "steps": [_step(step) for step in self.steps],
            "parameters": {"before": _estimates(self.before), "after": _estimates(self.after)},
            "notes": list(self.notes),
            "settings": dict(self.settings),
        }

    def to_json(self) -> str:
        """Return the JSON text; numbers that are not finite become null."""
        return json.dumps(_finite(self.to_dict()), indent=1, allow_nan=False)

    def write_model(self, path: str | os.PathLike[str]) -> None:
        """Write the final model as a model file, all or nothing.

        Raises
        ------
        ModelError
            When the model has a part or an effect of its user's own, which a file cannot hold.
        PosteriorError
            When the file cannot be written.
        """
        text = model_text(self.model, self.log)
        with replacing(path) as temporary:
            temporary.write_text(text, encoding="utf-8")

    def write_posterior(self, path: str | os.PathLike[str]) -> None:
        """Write the posterior of the final model, all or nothing.

        Raises
        ------
        PosteriorError
            When there is none, or the file cannot be written.
        """
        if self.posterior is None:
            raise PosteriorError(
                "expected a posterior of the final model, but no full chains were run; criticize with joint=True and "
                "posterior=True"
            )
        write_posterior(self.posterior, path)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the JSON file, all or nothing; raises PosteriorError when it cannot be written."""
        with replacing(path) as temporary:
            temporary.write_text(self.to_json() + "\n", encoding="utf-8")


def _estimates(estimates: Mapping[str, Estimate]) -> dict[str, Any]:
    return {name: {"mean": one.mean, "sd": one.sd, "unit": one.unit} for name, one in estimates.items()}


def _where(where: Mapping[str, Any]) -> dict[str, Any]:
    return {key: list(values) for key, values in where.items()}


def _effect(effect: FoundEffect) -> dict[str, Any]:
    return {
        "name": effect.name,
        "where": _where(effect.where),
        "parameters": _estimates(effect.parameters),
        "p_value": effect.p_value,
        "log_score_gain": effect.log_score_gain,
        "log_score_gain_se": effect.log_score_gain_se,
        "not_distinguishable_from": list(effect.not_distinguishable_from),
        "summary": effect.summary,
        "advice": list(effect.advice),
    }


def _unexplained(one: Unexplained) -> dict[str, Any]:
    return {
        "channel": one.channel,
        "beams": list(one.beams),
        "covariate": one.covariate,
        "moment": one.moment,
        "interval": list(one.interval),
        "time": list(one.time),
        "p_value": one.p_value,
    }


def _step(step: Step) -> dict[str, Any]:
    return {
        "model": list(step.model),
        "gap": step.gap._asdict(),
        "alarms": [
            {"family": alarm.family, "p_value": alarm.p_value, "raised": alarm.raised, "z": alarm.z}
            for alarm in step.alarms
        ],
        "candidates": [
            {
                "name": one.name,
                "where": _where(one.where),
                "score_p_value": one.score_p_value,
                "log_score_gain": one.log_score_gain,
                "log_score_gain_se": one.log_score_gain_se,
            }
            for one in step.candidates
        ],
        "decision": step.decision,
    }


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
