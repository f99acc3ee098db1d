"""Which model a posterior belongs to, when nobody says."""

from __future__ import annotations

from dataclasses import replace

from pmcl.logs.robot_log import RobotLog
from pmcl.models.motion import GrowingIncrementNoise
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.posterior.access import parameter_names
from pmcl.posterior.compat import Posterior

__all__ = ["model_for"]


def model_for(log: RobotLog, posterior: Posterior | None) -> RobotModel:
    """Return the built-in model for a log that has the parameters of a posterior.

    Parameters
    ----------
    log : RobotLog
        Decides on sensors and start.
    posterior : arviz.InferenceData or xarray.DataTree, optional
        Its parameters decide on outliers and on noise that grows with motion. The default model when left out.

    Returns
    -------
    RobotModel
        Its parameters may still be others than the posterior's; localization then says so.

    Raises
    ------
    PosteriorError
        When the posterior is empty.
    """
    names = parameter_names(posterior) if posterior is not None else ()
    model = default_model(log, outliers=any(name.endswith("_outlier_weight") for name in names))
    return replace(model, motion=GrowingIncrementNoise()) if any("_per_" in name for name in names) else model
