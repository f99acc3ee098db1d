"""Gross errors among the readings: the default prior of their share, and models that allow for them."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from scipy import stats

if TYPE_CHECKING:
    from pmcl.models.robot_model import RobotModel

__all__ = ["OUTLIER_WEIGHT", "outlier_prior", "with_gross_errors"]

OUTLIER_WEIGHT = "outlier_weight"
"""Names of parameters that are shares of gross errors end so."""


@functools.cache  # scipy takes a millisecond to make it
def outlier_prior() -> Any:
    """Return the default prior of an outlier weight: beta(1, 30), mean 3 %, 95 % below 10 %.

    It makes outliers rare on purpose: with a flat prior a chain can lock into the mode in which the robot is lost and
    every reading is an outlier.
    """
    return stats.beta(1.0, 30.0)


def with_gross_errors(model: RobotModel) -> RobotModel:
    """Return a model whose sensors all allow for gross errors, where they can.

    Parameters
    ----------
    model : RobotModel
        The model.

    Returns
    -------
    RobotModel
        The model itself if there is nothing to change: a lidar has a share of readings that nothing explains anyway.
    """
    if all(getattr(sensor, "outliers", True) for sensor in model.sensors):
        return model
    allowing: list[Any] = list(model.sensors)
    sensors = [sensor if getattr(sensor, "outliers", True) else replace(sensor, outliers=True) for sensor in allowing]
    return replace(model, sensors=tuple(sensors))
