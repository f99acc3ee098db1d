"""The last step of a calibration: check the model on its own log, and keep the result for ArviZ and reports.

The group ``predictive_check`` holds the normal scores of all readings under the posterior mean. The groups
``log_likelihood`` and ``posterior_predictive`` hold, for some draws of theta, the log density of each reading given all
before it, and replicated readings (:mod:`pmcl.posterior.predictive_draws`).
"""

from __future__ import annotations

import json
import logging
from typing import Any

import numpy as np
import xarray as xr

from pmcl.errors import PmclError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.robot_model import BoundModel
from pmcl.posterior.access import theta_draws
from pmcl.posterior.compat import Posterior, extended, find_group
from pmcl.posterior.diagnostics import verdict
from pmcl.posterior.findings import kind_label
from pmcl.posterior.log_groups import over_channels, reading_kinds, suffixes_for
from pmcl.posterior.model_check import LEVEL, ModelCheck, ScoredPass, check_model
from pmcl.posterior.predictive_draws import predictive_groups

__all__ = ["check_group", "checked"]

_logger = logging.getLogger("pmcl.posterior")


def checked(data: Posterior, bound: BoundModel, seed: int) -> Posterior:
    """Check the model of a posterior on its logs, and add the result and the verdict.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
        The posterior of the model's parameters; it stays as it is.
    bound : BoundModel
        The model bound to the logs that were calibrated.
    seed : int
        Determines all random numbers.

    Returns
    -------
    arviz.InferenceData or xarray.DataTree
        With the groups ``predictive_check``, ``log_likelihood`` and ``posterior_predictive``, and the attributes
        ``converged`` and ``adequate`` (0 or 1; the second only if something could be tested) and ``verdict``.
        A group that sensors or filter do not allow is left out; the logger ``pmcl`` gets a message.
    """
    theta = theta_draws(data)
    groups: dict[str, xr.Dataset] = {}
    # An error of the check must not lose the draws.
    try:
        result = check_model(bound, theta.mean(axis=(0, 1)), seed)
        if result.adequate is not None:
            groups["predictive_check"] = check_group(result, bound.logs)
        groups |= predictive_groups(bound, theta, find_group(data, "observed_data"), seed)
    except PmclError as error:
        left_out = "the check of the model and " if not groups else ""
        _logger.warning("%slog_likelihood and posterior_predictive are left out: %s", left_out, error)
    with_groups = extended(data, groups, {})
    judged = verdict(with_groups)
    attrs: dict[str, Any] = {"converged": int(judged.converged), "verdict": judged.message}
    if judged.adequate is not None:
        attrs["adequate"] = int(judged.adequate)
    return extended(with_groups, {}, attrs)


def check_group(check: ModelCheck, logs: tuple[RobotLog, ...]) -> xr.Dataset:
    """Label the result of a model check.

    Parameters
    ----------
    check : ModelCheck
    logs : tuple of RobotLog
        In the order of ``check.passes``.

    Returns
    -------
    xarray.Dataset
        ``residual_<kind>`` over time and beam or landmark: normal scores, NaN where nothing was measured. Attributes:
        ``adequate`` (0 or 1), ``p_value``, ``level``, ``particles``, ``readings`` and ``findings`` (JSON).
    """
    variables: dict[str, xr.DataArray] = {}
    coords: dict[str, Any] = {}
    for scored_pass, log, suffix in zip(check.passes, logs, suffixes_for(len(logs)), strict=True):
        coords[f"time{suffix}"] = ((f"time{suffix}",), log.times, {"units": "s", "long_name": "time"})
        variables |= _residuals(scored_pass, log, suffix)
        channels = {dimension for kind in reading_kinds(log.dataset) for dimension in log.dataset[kind].dims[1:]}
        for dimension in sorted(map(str, channels)):
            if dimension in log.dataset.coords:
                coords[f"{dimension}{suffix}"] = log.dataset.coords[dimension].values
    findings = [
        {**finding._asdict(), "z": finding.z if np.isfinite(finding.z) else None} for finding in check.findings
    ]
    attrs = {
        "adequate": int(bool(check.adequate)),
        "p_value": check.p_value,
        "level": LEVEL,
        "particles": max(scored_pass.particles for scored_pass in check.passes),
        "readings": sum(int(np.count_nonzero(~np.isnan(scored_pass.scores))) for scored_pass in check.passes),
        "findings": json.dumps(findings),
        "long_name": "normal scores of readings given all before them, under the posterior mean",
    }
    return xr.Dataset(variables, coords=coords, attrs=attrs)


def _residuals(scored_pass: ScoredPass, log: RobotLog, suffix: str) -> dict[str, xr.DataArray]:
    variables = {}
    for kind in reading_kinds(log.dataset):
        template = log.dataset[kind]
        values = np.full(template.shape, np.nan)
        # A filter that lost the robot entirely has no predictions; the variable exists all the same.
        predictions = scored_pass.predictions
        if predictions is not None and kind in predictions.kinds:
            selected = predictions.kind == predictions.kinds.index(kind)
            places = predictions.time[selected], predictions.channel[selected]
            over_channels(values)[places] = scored_pass.scores[selected]
        variables[f"residual_{kind}{suffix}"] = xr.DataArray(
            values,
            dims=[f"{dimension}{suffix}" for dimension in template.dims],
            attrs={"units": "1", "long_name": f"normal scores of {kind_label(kind)}"},
        )
    return variables
