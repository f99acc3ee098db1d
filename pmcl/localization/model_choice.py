"""Which model a posterior belongs to, when nobody says."""

from __future__ import annotations

from dataclasses import replace

from pmcl.logs.robot_log import RobotLog
from pmcl.models.model_file import model_of_text
from pmcl.models.motion import motions
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.models.starts.belief import StartBelief
from pmcl.posterior.access import parameter_names
from pmcl.posterior.compat import Posterior
from pmcl.posterior.settings import settings

__all__ = ["model_for"]


def model_for(log: RobotLog, posterior: Posterior | None) -> RobotModel:
    """Return the model that a posterior was calibrated with, for another log of the same robot.

    Parameters
    ----------
    log : RobotLog
        The log to localize; the robot begins where this log says.
    posterior : arviz.InferenceData or xarray.DataTree, optional
        It holds the model, unless that was one of its user's own; then the built-in model that has its parameters is
        tried. The default model when left out.

    Returns
    -------
    RobotModel
        Its parameters may still be others than the posterior's; localization then says so.

    Raises
    ------
    PosteriorError
        When the posterior is empty.
    ModelError
        When the log lacks what the model needs.
    """
    if posterior is None:
        return default_model(log)
    names = parameter_names(posterior)
    text = settings(posterior).get("model")
    if isinstance(text, str) and text:
        return replace(model_of_text(text, log, "the posterior's model"), start=StartBelief())
    # Which of the models that can be made of registered parts has these parameters; the default one if none has.
    candidates = [
        replace(default_model(log, outliers=outliers), motion=motion())
        for outliers in (False, True)
        for motion in motions().values()
    ]
    return next((model for model in candidates if set(_names(model)) == set(names)), default_model(log))


def _names(model: RobotModel) -> list[str]:
    return [parameter.name for parameter in model.parameters]
