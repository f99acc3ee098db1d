"""Criticism finds where simulation and log disagree, names the missing effect, and shows whether it closes the gap.

:func:`~pmcl.criticism.workflow.criticize` runs the whole loop. Its steps are modules of their own, in this order:
:mod:`~pmcl.criticism.fit` (calibrate quickly), :mod:`~pmcl.criticism.evidence` (what one pass over a log tells),
:mod:`~pmcl.criticism.replicate` (the same from logs that the fitted model simulates), :mod:`~pmcl.criticism.alarms`
(what is unusual, at a known false-alarm rate), :mod:`~pmcl.criticism.trials` (candidates refitted),
:mod:`~pmcl.criticism.naming` (which of them explains it), :mod:`~pmcl.criticism.heldout` (what it is worth on data not
used), :mod:`~pmcl.criticism.formulas` and :mod:`~pmcl.criticism.waves` (what no known effect describes).
:mod:`~pmcl.criticism.search` puts them together, and :mod:`~pmcl.criticism.progress` says how far it has come. The
result goes to :mod:`pmcl.reports` and, as JSON, model file and posterior, to files.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmcl.lazy import lazy_names

if TYPE_CHECKING:
    from pmcl.criticism.result import Criticism
    from pmcl.criticism.workflow import criticize

__all__ = [
    "Criticism",
    "criticize",
]

_HOMES = {
    "Criticism": "pmcl.criticism.result",
    "criticize": "pmcl.criticism.workflow",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
