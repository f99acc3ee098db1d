"""What is believed about a robot: parameters with priors, motion, sensors and start.

A :class:`~pmcl.models.robot_model.RobotModel` bound to logs turns a parameter vector theta into coefficient tables
(:mod:`pmcl.models.tables`), which the compiled kernels of :mod:`pmcl.filtering` consume.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmcl.lazy import lazy_names

if TYPE_CHECKING:
    from pmcl.models.model_file import read_model
    from pmcl.models.motion import Motion, register_motion
    from pmcl.models.motions.increments.motion import GrowingIncrementNoise, IncrementNoise
    from pmcl.models.motions.odometry.motion import Differential, Omni
    from pmcl.models.parameters import Parameter, gamma_prior
    from pmcl.models.part import BoundPart, Part
    from pmcl.models.quick import ChannelReading, Misreading, QuickReadings, ReadAs
    from pmcl.models.robot_model import RobotModel, default_model
    from pmcl.models.sensor import ReadingIndex, Sensor, register_sensor
    from pmcl.models.sensors.landmarks.sensor import LandmarkNoise
    from pmcl.models.sensors.lidar.sensor import Lidar
    from pmcl.models.sensors.range_beams.sensor import RangeNoise
    from pmcl.models.starts.belief import StartBelief
    from pmcl.models.tables import Tables

__all__ = [
    "BoundPart",
    "ChannelReading",
    "Differential",
    "GrowingIncrementNoise",
    "IncrementNoise",
    "LandmarkNoise",
    "Lidar",
    "Misreading",
    "Motion",
    "Omni",
    "Parameter",
    "Part",
    "QuickReadings",
    "RangeNoise",
    "ReadAs",
    "ReadingIndex",
    "RobotModel",
    "Sensor",
    "StartBelief",
    "Tables",
    "default_model",
    "gamma_prior",
    "read_model",
    "register_motion",
    "register_sensor",
]

_HOMES = {
    "BoundPart": "pmcl.models.part",
    "ChannelReading": "pmcl.models.quick",
    "Differential": "pmcl.models.motions.odometry.motion",
    "GrowingIncrementNoise": "pmcl.models.motions.increments.motion",
    "IncrementNoise": "pmcl.models.motions.increments.motion",
    "LandmarkNoise": "pmcl.models.sensors.landmarks.sensor",
    "Lidar": "pmcl.models.sensors.lidar.sensor",
    "Misreading": "pmcl.models.quick",
    "Motion": "pmcl.models.motion",
    "Omni": "pmcl.models.motions.odometry.motion",
    "Parameter": "pmcl.models.parameters",
    "Part": "pmcl.models.part",
    "QuickReadings": "pmcl.models.quick",
    "RangeNoise": "pmcl.models.sensors.range_beams.sensor",
    "ReadAs": "pmcl.models.quick",
    "ReadingIndex": "pmcl.models.sensor",
    "RobotModel": "pmcl.models.robot_model",
    "Sensor": "pmcl.models.sensor",
    "StartBelief": "pmcl.models.starts.belief",
    "Tables": "pmcl.models.tables",
    "default_model": "pmcl.models.robot_model",
    "gamma_prior": "pmcl.models.parameters",
    "read_model": "pmcl.models.model_file",
    "register_motion": "pmcl.models.motion",
    "register_sensor": "pmcl.models.sensor",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
