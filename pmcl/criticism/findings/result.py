"""The result of the critic as plain data, and as the JSON file that other programs read."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pmcl.criticism.fitting.held_out import Gap
from pmcl.criticism.fitting.quick_fit import Fit
from pmcl.criticism.judging.alarms import Alarm, Judgement
from pmcl.criticism.scoring.scored_log import ScoredLog
from pmcl.errors import PosteriorError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.model_text import model_text
from pmcl.models.robot_model import RobotModel
from pmcl.posterior.files import replacing, write_posterior

__all__ = ["FORMAT", "Candidate", "Criticism", "Estimate", "FoundEffect", "JudgedFit", "Step", "Unexplained"]

FORMAT = "pmcl-criticism/1"


@dataclass(frozen=True)
class Estimate:
    """Posterior mean and standard deviation of a parameter, with its unit.

    ``format`` gives text for people. The format ``+`` keeps the sign, ``%`` gives per cent, and ``left|right`` chooses
    a word by the sign.

    Attributes
    ----------
    mean, sd : float
        Posterior mean and standard deviation, in `unit`.
    unit : str
        The unit; "1" for none.
    """

    mean: float
    sd: float
    unit: str

    def __format__(self, spec: str) -> str:
        """Return the size, rounded by its standard deviation, or the word that `spec` has for its sign."""
        if "|" in spec:
            positive, negative = spec.split("|")
            return negative if self.mean < 0.0 else positive
        scale, unit = (100.0, "%") if spec == "%" else (1.0, "" if self.unit == "1" else self.unit)
        mean, sd = scale * (self.mean if spec == "+" else abs(self.mean)), scale * self.sd
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
        The beams, landmarks or walls that have it, e.g. ``{"beams": [2]}``; empty for an effect of the whole robot.
    parameters : mapping of str to Estimate
        Its calibrated parameters.
    p_value : float
        P-value of its score before it was added, or of the score of an effect that this log cannot distinguish from it.
    log_score_gain, log_score_gain_se : float
        Gain on held-out data [nat] when it was added, and its standard error.
    not_distinguishable_from : tuple of str
        Effects that this log cannot distinguish from it.
    advice : tuple of str
        Motions that would distinguish them.
    finding : str
        The sentence about a log that has it, see :class:`~pmcl.models.effects.effect.Effect`; empty for a formula.
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
        The covariate that the disagreement depends on, and whether readings are biased ("mean") or have another spread
        than predicted ("spread").
    interval : tuple of float
        Values of the covariate, in its unit, between which the disagreement is worst.
    time : tuple of int
        First and last row of the interval of rows in which it is worst.
    p_value : float
        Probability of such an alarm when the model is right, all families of alarms considered (Holm 1979). It may be
        compared with the rate of false alarms directly; p-values of single families are in :attr:`Step.alarms`.
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
    """An effect that was tried.

    Attributes
    ----------
    name, where
        As in :class:`FoundEffect`.
    z, score_p_value : float
        Its standardised score on the whole log, and the score's p-value.
    fit_gain, fit_gain_se : float
        Gain on the fit part [nat] and its standard error; NaN for an effect that was scored but not refitted.
    log_score_gain, log_score_gain_se : float
        The same on the held-out part.
    values : mapping of str to float
        Its fitted parameters; empty for an effect that was not refitted.
    accepted : bool
        Whether it was added to the model.
    """

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
    """One model of the loop, and the decision about it.

    Attributes
    ----------
    model : tuple of str
        Names of the effects that the model has.
    gap : Gap
        How well the model predicts held-out data.
    alarms : tuple of Alarm
        The tests of the log.
    candidates : tuple of Candidate
        Refitted candidates, then the best of those that were only scored.
    decision : str
        The decision, e.g. "add beam-bias".
    critical_z : float
        Bound that the greatest standardised score exceeds in 5 % of logs without a missing effect.
    """

    model: tuple[str, ...]
    gap: Gap
    alarms: tuple[Alarm, ...]
    candidates: tuple[Candidate, ...]
    decision: str
    critical_z: float


@dataclass(frozen=True)
class JudgedFit:
    """A model fitted to the whole log, with the log's residuals and tests under it.

    Attributes
    ----------
    fit : Fit
        The fit.
    scored : ScoredLog
        Residuals and scores of the log.
    judgement : Judgement
        Tests of these numbers.
    """

    fit: Fit
    scored: ScoredLog
    judgement: Judgement


@dataclass(frozen=True)
class Criticism:
    """The result of :func:`pmcl.criticism.workflow.criticize`.

    Attributes
    ----------
    verdict : str
        "no missing effect", "explained" or "unknown effect".
    sentence : str
        The verdict in one sentence.
    effects : tuple of FoundEffect
        Accepted effects.
    unexplained : tuple of Unexplained
        Where the final model still disagrees.
    steps : tuple of Step
        All models from the base model to the final one.
    base, model : RobotModel
        The base model and the final one. The final model is an ordinary model that has the effects, for this and other
        logs of the robot.
    before, after : mapping of str to Estimate
        Parameters of the base model and of the final model.
    log : RobotLog
        The log; with an estimate of its path if the final model has formulas that need one.
    split : int
        First row of the held-out part.
    first, last : JudgedFit
        The first and the last model, with the log's tests under each.
    posterior : ArviZ posterior or None
        The posterior of the final model, if full chains were run. It holds that model, so that
        :func:`pmcl.localization.offline.localize` and :func:`pmcl.localization.model_choice.model_for` need no other
        input.
    notes : tuple of str
        Limits of the result.
    settings : mapping
        Settings that reproduce the run.
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
    first: JudgedFit
    last: JudgedFit
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
            "unexplained": [_unexplained(disagreement) for disagreement in self.unexplained],
            "steps": [_step(step) for step in self.steps],
            "parameters": {"before": _estimates(self.before), "after": _estimates(self.after)},
            "notes": list(self.notes),
            "settings": dict(self.settings),
        }

    def to_json(self) -> str:
        """Return the JSON text, in which numbers that are not finite are null."""
        return json.dumps(_finite(self.to_dict()), indent=1, allow_nan=False)

    def write_model(self, path: str | os.PathLike[str]) -> None:
        """Write the final model as a model file; a failure leaves no partial file.

        Parameters
        ----------
        path : str or path-like
            The file.

        Raises
        ------
        ModelError
            When the model has a part or an effect that its user wrote, which a file cannot hold.
        PosteriorError
            When the file cannot be written.
        """
        text = model_text(self.model, self.log)
        with replacing(path) as temporary:
            temporary.write_text(text, encoding="utf-8")

    def write_posterior(self, path: str | os.PathLike[str]) -> None:
        """Write the posterior of the final model; a failure leaves no partial file.

        Parameters
        ----------
        path : str or path-like
            The file.

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
        """Write the JSON file; a failure leaves no partial file.

        Parameters
        ----------
        path : str or path-like
            The file.

        Raises
        ------
        PosteriorError
            When the file cannot be written.
        """
        with replacing(path) as temporary:
            temporary.write_text(self.to_json() + "\n", encoding="utf-8")


def _estimates(estimates: Mapping[str, Estimate]) -> dict[str, Any]:
    return {
        name: {"mean": estimate.mean, "sd": estimate.sd, "unit": estimate.unit} for name, estimate in estimates.items()
    }


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


def _unexplained(disagreement: Unexplained) -> dict[str, Any]:
    return {
        "channel": disagreement.channel,
        "beams": list(disagreement.beams),
        "covariate": disagreement.covariate,
        "moment": disagreement.moment,
        "interval": list(disagreement.interval),
        "time": list(disagreement.time),
        "p_value": disagreement.p_value,
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
                "name": candidate.name,
                "where": _where(candidate.where),
                "score_p_value": candidate.score_p_value,
                "log_score_gain": candidate.log_score_gain,
                "log_score_gain_se": candidate.log_score_gain_se,
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
