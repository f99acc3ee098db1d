"""What is believed about a robot: parameters with priors, motion, sensors and start.

A :class:`~pmcl.models.robot_model.RobotModel` bound to logs turns a parameter vector theta into coefficient tables
(:mod:`pmcl.models.tables`), which the compiled kernels of :mod:`pmcl.filtering` consume.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmcl.lazy import lazy_names

if TYPE_CHECKING:
    from pmcl.models.model_file import read_model
    from pmcl.models.motions.increments.motion import GrowingIncrementNoise, IncrementNoise
    from pmcl.models.parameters import Parameter
    from pmcl.models.robot_model import RobotModel, default_model
    from pmcl.models.sensors.landmarks.sensor import LandmarkNoise
    from pmcl.models.sensors.range_beams.sensor import RangeNoise
    from pmcl.models.starts.belief import StartBelief

__all__ = [
    "GrowingIncrementNoise",
    "IncrementNoise",
    "LandmarkNoise",
    "Parameter",
    "RangeNoise",
    "RobotModel",
    "StartBelief",
    "default_model",
    "read_model",
]

_HOMES = {
    "GrowingIncrementNoise": "pmcl.models.motions.increments.motion",
    "IncrementNoise": "pmcl.models.motions.increments.motion",
    "LandmarkNoise": "pmcl.models.sensors.landmarks.sensor",
    "Parameter": "pmcl.models.parameters",
    "RangeNoise": "pmcl.models.sensors.range_beams.sensor",
    "RobotModel": "pmcl.models.robot_model",
    "StartBelief": "pmcl.models.starts.belief",
    "default_model": "pmcl.models.robot_model",
    "read_model": "pmcl.models.model_file",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
