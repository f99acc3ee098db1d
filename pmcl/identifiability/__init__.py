"""Which parameters a log can tell, and how well, before an hour of sampling; and what to drive to learn the rest.

:func:`~pmcl.identifiability.workflow.identify` linearises a model along the smoothed path of a log, integrates the path
out, and predicts the posterior standard deviation of each parameter. Its result goes to :mod:`pmcl.reports` and the
command line.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmcl.lazy import lazy_names

if TYPE_CHECKING:
    from pmcl.identifiability.result import Identification, Prediction
    from pmcl.identifiability.workflow import identify

__all__ = [
    "Identification",
    "Prediction",
    "identify",
]

_HOMES = {
    "Identification": "pmcl.identifiability.result",
    "Prediction": "pmcl.identifiability.result",
    "identify": "pmcl.identifiability.workflow",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
