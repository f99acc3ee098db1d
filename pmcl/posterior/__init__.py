"""The posterior of a calibration, labelled: ArviZ groups, one NetCDF file, estimates and a verdict.

:mod:`~pmcl.posterior.convert` labels the plain arrays of :class:`pmcl.sampling.chains.Chains`,
:mod:`~pmcl.posterior.files` keeps them on disk, :mod:`~pmcl.posterior.access` is how the rest of pmcl reads them,
:mod:`~pmcl.posterior.estimates` reduces them to a mean, a MAP estimate or a few draws. Every calibration ends with
:mod:`~pmcl.posterior.predictive_check`: a filter predicts the log's own readings, and
:mod:`~pmcl.posterior.model_check` judges how well. :mod:`~pmcl.posterior.diagnostics` judges the result:
whether the chains have converged, and whether the model fits. The posterior goes on to
:mod:`pmcl.localization` (which drives a filter with it), :mod:`pmcl.criticism` and :mod:`pmcl.reports`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmcl.lazy import lazy_names

if TYPE_CHECKING:
    from pmcl.posterior.diagnostics import summarize, verdict
    from pmcl.posterior.estimates import map_estimate, path_summary, posterior_mean
    from pmcl.posterior.files import read_posterior, write_posterior

__all__ = [
    "map_estimate",
    "path_summary",
    "posterior_mean",
    "read_posterior",
    "summarize",
    "verdict",
    "write_posterior",
]

_HOMES = {
    "map_estimate": "pmcl.posterior.estimates",
    "path_summary": "pmcl.posterior.estimates",
    "posterior_mean": "pmcl.posterior.estimates",
    "read_posterior": "pmcl.posterior.files",
    "summarize": "pmcl.posterior.diagnostics",
    "verdict": "pmcl.posterior.diagnostics",
    "write_posterior": "pmcl.posterior.files",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
