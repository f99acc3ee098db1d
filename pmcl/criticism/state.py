"""What a run of the critic is about, and what it knows so far: frozen values that its steps take and return."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from pmcl.criticism.findings.parts import FoundEffect, Step, Unexplained
from pmcl.criticism.findings.result import JudgedFit
from pmcl.criticism.fitting.held_out import HELD_OUT_SHARE, HeldOut
from pmcl.criticism.naming.revision import Answer
from pmcl.criticism.naming.search import Search
from pmcl.logs.robot_log import RobotLog
from pmcl.models.robot_model import RobotModel

__all__ = ["Loss", "State", "Task"]


class Loss(NamedTuple):
    """Why not the log as it is and the model that was asked for are criticised: the filter loses the robot.

    Attributes
    ----------
    model : RobotModel
        The model that was asked for.
    what : str
        What is missing by that, for the sentence, e.g. "from t=330.5 s on the filter loses the robot".
    place : Unexplained
        The rows.
    partial : bool
        Whether the log is only a part of the one that was asked for. Otherwise the model has gross errors in addition.
    """

    model: RobotModel
    what: str
    place: Unexplained
    partial: bool = False


@dataclass(frozen=True)
class Task:
    """What is criticised.

    Attributes
    ----------
    base : RobotModel
        The base model.
    search : Search
        Searches through the candidates for the log. It remembers what it has fitted and simulated, and uses more
        particles where the filter needs them.
    loss : Loss, optional
        Why these are not the model and the log that were asked for.
    notes : tuple of str
        Notes with which the result begins.
    other : RobotLog, optional
        Another log of the robot, on which gaps are shown instead of on the last part of the log.
    """

    base: RobotModel
    search: Search
    loss: Loss | None = None
    notes: tuple[str, ...] = ()
    other: RobotLog | None = None

    @property
    def log(self) -> RobotLog:
        """The log."""
        return self.search.log

    @property
    def split(self) -> int:
        """First row of the held-out part, on which gaps are shown."""
        n_steps = self.log.n_steps
        return n_steps if self.other is not None else round((1.0 - HELD_OUT_SHARE) * n_steps)


@dataclass(frozen=True)
class State:
    """What a run knows so far.

    Attributes
    ----------
    judged : JudgedFit
        The current model, fitted and judged.
    first : JudgedFit
        The base model, fitted and judged.
    answers : tuple of Answer
        Accepted effects that the current model has.
    steps : tuple of Step
        The models so far, with what was decided about each.
    finished : bool
        Whether nothing is to be added any more.
    held_out : HeldOut or None
        How the current model predicts the held-out part; None before that was asked, and where its filter loses the
        robot.
    nothing_probability : float
        Posterior probability that the base model lacks nothing; NaN where its filter loses the robot.
    notes : tuple of str
        Limits of the result.
    """

    judged: JudgedFit
    first: JudgedFit
    answers: tuple[Answer, ...] = ()
    steps: tuple[Step, ...] = ()
    finished: bool = False
    held_out: HeldOut | None = field(default=None, repr=False)
    nothing_probability: float = math.nan
    notes: tuple[str, ...] = ()

    @property
    def found(self) -> tuple[FoundEffect, ...]:
        """Accepted effects that the current model has."""
        return tuple(answer.found for answer in self.answers)

    def noted(self, *notes: str) -> State:
        """Return the state with further notes."""
        return replace(self, notes=(*self.notes, *notes))
