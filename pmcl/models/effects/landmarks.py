"""Errors of landmark sightings."""

from __future__ import annotations

import numpy as np
from scipy import stats

from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.editing import change_landmarks
from pmcl.models.effects.effect import Effect, Where
from pmcl.models.parameters import Parameter
from pmcl.models.parts import Float
from pmcl.models.tables import Tables

__all__ = ["LANDMARK_EFFECTS", "reads_bearing", "reads_distance", "reads_landmarks"]

_THRUN = "Thrun, Burgard, Fox, Probabilistic Robotics, 2005, section 6.6"


def _read(values: Float | None) -> bool:
    return values is not None and not bool(np.isnan(values).all())


def reads_distance(log: RobotLog) -> bool:
    """Return whether the log has distances to landmarks."""
    return _read(log.landmark_range)


def reads_bearing(log: RobotLog) -> bool:
    """Return whether the log has bearings to landmarks."""
    return _read(log.landmark_bearing)


def reads_landmarks(log: RobotLog) -> bool:
    """Return whether the log has landmark sightings of any kind."""
    return reads_distance(log) or reads_bearing(log) or _read(log.landmark_size)


def _bearing_bias(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return change_landmarks(
        tables, lambda seen: seen._replace(bearing_bias=seen.bearing_bias + values[0]), "bearing-bias"
    )


def _range_bias(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return change_landmarks(
        tables, lambda seen: seen._replace(range_bias=seen.range_bias + values[0]), "landmark-range-bias"
    )


def _range_scale(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return change_landmarks(
        tables, lambda seen: seen._replace(range_scale=seen.range_scale * (1.0 + values[0])), "landmark-range-scale"
    )


LANDMARK_EFFECTS = (
    Effect(
        name="bearing-bias",
        summary="All bearings to landmarks are off by the same angle.",
        parameters=(Parameter("bearing_bias", "rad", stats.norm(scale=0.15), "how far too far left bearings read"),),
        null=(0.0,),
        change=_bearing_bias,
        carrier="landmark",
        look="The robot seems to drive sideways: the heading that fits the bearings is not the one it drives along.",
        typical={"just visible": (0.02,), "clear": (0.06,), "large": (0.15,)},
        means_only=True,
        near_twins={
            "sensor-yaw": "the same for a sensor at the robot's centre: no motion tells them apart",
            "odometry-side-drift": "turn on the spot or drive backwards",
        },
        references=(_THRUN,),
        needs=reads_bearing,
    ),
    Effect(
        name="landmark-range-bias",
        summary="All distances to landmarks read too long (or too short) by the same length.",
        parameters=(Parameter("landmark_range_bias", "m", stats.norm(scale=0.3), "how much too long distances read"),),
        null=(0.0,),
        change=_range_bias,
        carrier="landmark",
        look="Distance residuals have one sign, near and far alike.",
        typical={"just visible": (0.05,), "clear": (0.2,), "large": (0.5,)},
        means_only=True,
        near_twins={"landmark-range-scale": "see landmarks near and far"},
        references=(_THRUN,),
        needs=reads_distance,
    ),
    Effect(
        name="landmark-range-scale",
        summary="All distances to landmarks read too long (or too short) by the same share.",
        parameters=(Parameter("landmark_range_scale", "1", stats.norm(scale=0.1), "share by which distances read too "
                              "long"),),
        null=(0.0,),
        change=_range_scale,
        carrier="landmark",
        look="Distance residuals have one sign and grow with the distance.",
        typical={"just visible": (0.01,), "clear": (0.04,), "large": (0.1,)},
        means_only=True,
        near_twins={
            "landmark-range-bias": "see landmarks near and far",
            "odometry-forward-scale": "see landmarks on all sides",
        },
        references=(_THRUN,),
        needs=reads_distance,
    ),
)  # fmt: skip
