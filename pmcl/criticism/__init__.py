"""The critic finds where a model and a log disagree, names the missing effect, and measures what it explains.

:func:`~pmcl.criticism.workflow.criticize` runs the whole loop. Its parts are packages, to be read in this order:

1. :mod:`~pmcl.criticism.scoring`: one filter pass over a log gives residuals and scores; the same from logs that the
   fitted model simulates.
2. :mod:`~pmcl.criticism.fitting`: quick calibrations of many models, their evidence, and their predictions.
3. :mod:`~pmcl.criticism.judging`: which numbers of the log are unusual among those of the simulated logs, at a known
   rate of false alarms, and where in the log they come from.
4. :mod:`~pmcl.criticism.findings`: the result as plain data, its verdict and its sentences.
5. :mod:`~pmcl.criticism.naming`: the search for the effect that explains an alarm, in the catalogue and among formulas.

:mod:`~pmcl.criticism.loop` joins them, one step after another on a frozen :mod:`~pmcl.criticism.state`, and
:mod:`~pmcl.criticism.conclusion` makes the result of the last one. :mod:`~pmcl.criticism.lost_filter` goes on with
another model or a part of the log where the filter loses the robot.

A package imports only from packages before it. :mod:`~pmcl.criticism.settings` and :mod:`~pmcl.criticism.progress` hold
the settings of a run and report how far it has come. The result goes to :mod:`pmcl.reports` and to files: JSON, model
file and posterior.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmcl.lazy import lazy_names

if TYPE_CHECKING:
    from pmcl.criticism.findings.result import Criticism
    from pmcl.criticism.scoring.statistics import Residuals, Statistic
    from pmcl.criticism.workflow import criticize

__all__ = [
    "Criticism",
    "Residuals",
    "Statistic",
    "criticize",
]

_HOMES = {
    "Criticism": "pmcl.criticism.findings.result",
    "Residuals": "pmcl.criticism.scoring.statistics",
    "Statistic": "pmcl.criticism.scoring.statistics",
    "criticize": "pmcl.criticism.workflow",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
