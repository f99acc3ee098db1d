"""The log judged under one model after another, as the search goes on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pmcl.criticism.findings.result import JudgedFit
from pmcl.criticism.fitting.quick_fit import Fit
from pmcl.criticism.judging.alarms import Judgement
from pmcl.criticism.judging.judged_log import JudgedLog, in_doubt, judge_log, with_more_simulations
from pmcl.criticism.scoring.scores import Direction, candidate_directions
from pmcl.criticism.settings import Settings
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect

__all__ = ["JudgedModels"]


class JudgedModels:
    """Judges one log under one model after another.

    Attributes
    ----------
    log : RobotLog
        The log.
    offered : tuple of Effect
        Candidates of the catalogue.
    directions : tuple of Direction
        Directions of the candidates that the current model lacks.
    current : JudgedLog
        The log judged under the current model.
    """

    def __init__(self, log: RobotLog, offered: Sequence[Effect]) -> None:
        self.log, self.offered = log, tuple(offered)
        self.directions: tuple[Direction, ...] = ()
        self.current: JudgedLog
        self._ahead: tuple[Fit, JudgedLog] | None = None

    def look_for_what_lacks(self, fit: Fit) -> None:
        """Make the model of a fit the current one as far as candidates are concerned, without judging it."""
        self.directions = self._lacking(fit)

    def judge(self, fit: Fit, settings: Settings) -> JudgedFit:
        """Judge the log under a fit, whose model is the current one from now on."""
        self.directions = self._lacking(fit)
        if self._ahead is not None and self._ahead[0] is fit:
            self.current = self._ahead[1]
        else:
            self.current = judge_log(self.log, fit, self.directions, settings)
        self._ahead = None
        return JudgedFit(fit, self.current.scored, self.current.judgement)

    def judge_ahead(self, fit: Fit, settings: Settings) -> Judgement:
        """Judge the log under a fit whose model may become the current one.

        More logs are simulated where an alarm is in doubt. The judgement is kept for :meth:`judge`, so that it costs
        nothing if the model does become the current one.
        """
        directions = self._lacking(fit)
        judged = judge_log(self.log, fit, directions, settings)
        if in_doubt(judged.judgement):
            judged = with_more_simulations(judged, self.log, fit, directions, settings)
        self._ahead = (fit, judged)
        return judged.judgement

    def judge_again(self, last: JudgedFit, settings: Settings) -> JudgedFit:
        """Judge the current model with more simulated logs."""
        self.current = with_more_simulations(self.current, self.log, last.fit, self.directions, settings)
        return replace(last, scored=self.current.scored, judgement=self.current.judgement)

    def _lacking(self, fit: Fit) -> tuple[Direction, ...]:
        return candidate_directions(fit.bound.model.effects, fit.tables, self.log, self.offered)
