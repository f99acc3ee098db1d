"""An answer for every log, also where the filter of the base model loses the robot.

A model that lacks something large loses real robots. What is tried then, in this order, costs a known number of fits:
first a single effect with which the filter follows (:mod:`~pmcl.criticism.loop`), then gross errors among the
readings, then only the rows before the loss. Where all of that fails, the result says where the robot is lost.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from pmcl.criticism.findings.parts import Step, Unexplained
from pmcl.criticism.findings.result import Criticism
from pmcl.criticism.findings.verdict import UNKNOWN, sentence_of
from pmcl.criticism.fitting.held_out import HELD_OUT_SHARE, Gap
from pmcl.criticism.naming.search import Search
from pmcl.criticism.settings import Settings
from pmcl.criticism.state import Loss, Task
from pmcl.errors import CriticismError, FilterError
from pmcl.filtering.estimated_path import with_estimated_path
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.models.outliers import with_gross_errors
from pmcl.models.robot_model import RobotModel

__all__ = ["LEAST_ROWS", "Runs"]

LEAST_ROWS = 60
"""A log must have so many rows, for a fit on one part and a comparison on the other (chosen by hand)."""
# Rows before a loss that are left out as well, because a loss shows only after a while; and how often a part of a log
# is shortened again, when its filter loses the robot earlier than that of the whole log. Both are chosen by hand.
_BEFORE_LOSS, _SHORTENED = 20, 3


class _Lost(NamedTuple):
    """A model whose filter loses the robot, and the row where it does."""

    model: RobotModel
    row: int


class Runs(NamedTuple):
    """Criticises a log, with another model or only a part of the log if the filter loses the robot.

    Attributes
    ----------
    settings : Settings
        Settings of the run.
    offered : callable
        Returns the candidates for a log.
    run : callable
        Criticises a model on a log; it raises FilterError when the filter loses the robot.
    other : RobotLog, optional
        Another log of the robot, on which gaps are shown.
    """

    settings: Settings
    offered: Callable[[RobotLog], Sequence[Effect]]
    run: Callable[[Task], Criticism]
    other: RobotLog | None = None

    def criticism_of(self, log: RobotLog, base: RobotModel) -> Criticism:
        """Criticise a model; if its filter loses the robot, one with gross errors, or the log before the loss.

        Parameters
        ----------
        log : RobotLog
            The log.
        base : RobotModel
            The model.

        Returns
        -------
        Criticism
            Its notes tell what was tried. Unless effects that were found explain the whole log, the verdict is "unknown
            effect".
        """
        try:
            return self._criticism(log, base)
        except FilterError as error:
            first = _Lost(base, _row(error, log))
        when = _time(log, first.row)
        tried = f"the filter of the base model loses the robot at {when}, and with no single effect does it follow"
        self.settings.tell(tried, "allowing for gross errors among the readings")
        lost, robust = [first], with_gross_errors(base)
        if robust is not base:
            loss = Loss(
                base, f"without gross errors among the readings the filter loses the robot at {when}",
                _place(log, first.row),
            )  # fmt: skip
            note = f"{tried}; gross errors among the readings are therefore allowed for, and with them it does"
            try:
                return self._criticism(log, robust, loss, note)
            except FilterError as error:
                lost.append(_Lost(robust, _row(error, log)))
            tried += f"; if gross errors are allowed for, it is lost at {_time(log, lost[1].row)}"
        for one in lost:
            found = self._before_the_loss(log, base, one, tried)
            if found is not None:
                return found
        return self._unanswered(log, base, first.row, tried)

    def _criticism(self, log: RobotLog, model: RobotModel, loss: Loss | None = None, *notes: str) -> Criticism:
        log = with_estimated_path(log, model, seed=self.settings.seed)
        return self.run(Task(model, Search(log, self.offered(log), self.settings), loss, notes, self.other))

    def _before_the_loss(self, log: RobotLog, base: RobotModel, lost: _Lost, tried: str) -> Criticism | None:
        """Criticise a model on the rows before its filter loses the robot; return None if these are too few."""
        row = lost.row
        for _ in range(1 + _SHORTENED):
            row -= _BEFORE_LOSS
            if row < LEAST_ROWS:
                return None
            end, part = _time(log, row), log.select(0, row)
            self.settings.tell(f"criticising only the rows before {end}")
            what = f"from {_time(log, lost.row)} on the filter loses the robot"
            loss = Loss(base, what, _place(log, lost.row), partial=True)
            try:
                return self._criticism(part, lost.model, loss, f"{tried}; only the {row} rows before {end} are judged")
            except CriticismError:  # too few readings
                return None
            except FilterError as error:
                # A loss in a log that the fitted model simulates is at no row of this one.
                row = row if error.row is None else min(row, _row(error, part))
        return None

    def _unanswered(self, log: RobotLog, base: RobotModel, row: int, tried: str) -> Criticism:
        """Return the result that says only where the robot is lost."""
        nan, split = math.nan, round((1.0 - HELD_OUT_SHARE) * log.n_steps)
        step = Step((), Gap(nan, nan, nan), (), (), "the filter loses the robot", nan)
        what = f"the filter loses the robot at {_time(log, row)}"
        return Criticism(
            verdict=UNKNOWN,
            sentence=sentence_of(UNKNOWN, (), (), [step], {}, {}, log, what),
            effects=(),
            unexplained=(_place(log, row),),
            steps=(step,),
            base=base,
            model=base,
            before={},
            after={},
            log=log,
            split=split,
            first=None,
            last=None,
            notes=(f"{tried}; the rows before that are too few, or no filter follows there either",),
            settings=self.settings.recorded(split, log.fingerprint(), self.other),
        )


def _row(error: FilterError, log: RobotLog) -> int:
    """Return the row at which a filter lost the robot; the first one where that is not known."""
    return 0 if error.row is None else min(error.row, log.n_steps - 1)


def _time(log: RobotLog, row: int) -> str:
    return f"t={log.times[row]:g} s"


def _place(log: RobotLog, row: int) -> Unexplained:
    last = log.n_steps - 1
    return Unexplained(
        "pose", (), "time", "mean", (float(log.times[row]), float(log.times[last])), (row, last), math.nan
    )

