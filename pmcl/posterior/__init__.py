"""The posterior of a calibration, labelled: ArviZ groups, one NetCDF file, estimates and a verdict on convergence.

:mod:`~pmcl.posterior.convert` labels the plain arrays of :class:`pmcl.sampling.chains.Chains`,
:mod:`~pmcl.posterior.files` keeps them on disk, :mod:`~pmcl.posterior.access` is how the rest of pmcl reads them,
:mod:`~pmcl.posterior.estimates` reduces them to a mean, a MAP estimate or a few draws, and
:mod:`~pmcl.posterior.diagnostics` says whether they can be believed. The posterior goes on to
:mod:`pmcl.localization` (which drives a filter with it), :mod:`pmcl.criticism` and :mod:`pmcl.reports`.
"""
