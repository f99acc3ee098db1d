"""Results for a reader: figures and self-contained HTML files.

:mod:`~pmcl.reports.figures` draws a posterior, :mod:`~pmcl.reports.posterior_report` puts verdict, table and figures on
one page, and :mod:`~pmcl.reports.html` makes pages of every kind. This is the only package that imports
matplotlib. Its output goes to people, through :mod:`pmcl.cli`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmcl.lazy import lazy_names

if TYPE_CHECKING:
    from pmcl.reports.criticism_report import write_criticism_report
    from pmcl.reports.figures import plot_pair, plot_trajectory
    from pmcl.reports.posterior_report import write_report

__all__ = [
    "plot_pair",
    "plot_trajectory",
    "write_criticism_report",
    "write_report",
]

_HOMES = {
    "plot_pair": "pmcl.reports.figures",
    "plot_trajectory": "pmcl.reports.figures",
    "write_criticism_report": "pmcl.reports.criticism_report",
    "write_report": "pmcl.reports.posterior_report",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
