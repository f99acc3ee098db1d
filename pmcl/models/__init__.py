"""What is believed about a robot: parameters with priors, motion, sensors and start.

A :class:`~pmcl.models.robot_model.RobotModel` bound to logs turns a parameter vector theta into coefficient tables
(:mod:`pmcl.models.tables`), which the compiled kernels of :mod:`pmcl.filtering` consume.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmcl.lazy import lazy_names

if TYPE_CHECKING:
    from pmcl.models.model_file import read_model
    from pmcl.models.motion import GrowingIncrementNoise, IncrementNoise
    from pmcl.models.parameters import Parameter
    from pmcl.models.robot_model import RobotModel, default_model
    from pmcl.models.sensors import LandmarkNoise, RangeNoise
    from pmcl.models.start import StartBelief

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
    "GrowingIncrementNoise": "pmcl.models.motion",
    "IncrementNoise": "pmcl.models.motion",
    "LandmarkNoise": "pmcl.models.sensors",
    "Parameter": "pmcl.models.parameters",
    "RangeNoise": "pmcl.models.sensors",
    "RobotModel": "pmcl.models.robot_model",
    "StartBelief": "pmcl.models.start",
    "default_model": "pmcl.models.robot_model",
    "read_model": "pmcl.models.model_file",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
