"""The result of the critic: the models that it compared, its verdict, and the files that hold them."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pmcl.criticism.findings.json_text import (
    FORMAT,
    effect_entry,
    estimates_entry,
    json_text,
    step_entry,
    unexplained_entry,
)
from pmcl.criticism.findings.parts import Estimate, FoundEffect, Step, Unexplained
from pmcl.criticism.fitting.quick_fit import Fit
from pmcl.criticism.judging.alarms import Judgement
from pmcl.criticism.scoring.scored_log import ScoredLog
from pmcl.errors import PosteriorError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.model_text import model_text
from pmcl.models.robot_model import RobotModel
from pmcl.posterior.files import write_posterior
from pmcl.whole_file import replacing

__all__ = ["Criticism", "JudgedFit"]


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
        First row of the held-out part; the number of rows of the log if another log is held out.
    held_out : RobotLog or None
        The other log that was held out.
    first, last : JudgedFit or None
        The first and the last model, with the log's tests under each; None where nothing could be judged, because the
        filter loses the robot.
    posterior : ArviZ posterior or None
        The posterior of the final model, if full chains were run. It holds that model, so that
        :func:`pmcl.localization.offline.localize` and :func:`pmcl.localization.model_choice.model_for` need no other
        input.
    notes : tuple of str
        Limits of the result.
    settings : mapping
        Settings that reproduce the run.
    nothing_probability : float
        Posterior probability that the base model lacks nothing, see :mod:`pmcl.criticism.naming.probability`; NaN where
        its filter loses the robot.
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
    first: JudgedFit | None
    last: JudgedFit | None
    posterior: Any = None
    notes: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    nothing_probability: float = math.nan
    held_out: RobotLog | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the content of the JSON file."""
        times = self.log.times.tolist()
        return {
            "format": FORMAT,
            "verdict": self.verdict,
            "nothing_probability": self.nothing_probability,
            "sentence": self.sentence,
            "effects": [effect_entry(effect, (times[0], times[-1])) for effect in self.effects],
            "unexplained": [unexplained_entry(disagreement) for disagreement in self.unexplained],
            "steps": [step_entry(step) for step in self.steps],
            "parameters": {"before": estimates_entry(self.before), "after": estimates_entry(self.after)},
            "notes": list(self.notes),
            "settings": dict(self.settings),
        }

    def to_json(self) -> str:
        """Return the JSON text, in which numbers that are not finite are null."""
        return json_text(self.to_dict())

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
