"""Motion noise whose size depends on the step."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import stats

from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.editing import edit_motion
from pmcl.models.effects.effect import Effect, Where
from pmcl.models.effects.odometry import drives, turns
from pmcl.models.parameters import Parameter
from pmcl.models.part import Float
from pmcl.models.tables import Tables

__all__ = ["MOTION_NOISE_EFFECTS"]

_THRUN = "Thrun, Burgard, Fox, Probabilistic Robotics, 2005, section 5.4 (alpha1 to alpha4)"


def _grown(tables: Tables, name: str, component: int, slope: float, size: Any) -> Tables:
    """Add ``slope * size(mean)`` to the standard deviation of one component; the squares are added."""

    def edit(motion: Any) -> Any:
        std = motion.std.copy()
        std[:, component] = np.hypot(std[:, component], slope * size(motion.mean))
        return {"std": std}

    return edit_motion(tables, edit, name)


def _distance(mean: Float) -> Float:
    return np.asarray(np.hypot(mean[:, 0], mean[:, 1]))


def _forward_with_distance(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return _grown(tables, "forward-noise-grows-with-distance", 0, values[0], _distance)


def _turn_with_turn(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return _grown(tables, "turn-noise-grows-with-turn", 2, values[0], lambda mean: np.abs(mean[:, 2]))


def _turn_with_distance(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return _grown(tables, "turn-noise-grows-with-distance", 2, values[0], _distance)


GROWING = (
    Effect(
        name="forward-noise-grows-with-distance",
        summary="How far the robot gets is the less certain the longer the step.",
        finding="forward noise grows by {0} m for each metre of a step",
        parameters=(Parameter("forward_noise_grows_with_distance", "1", stats.halfnorm(scale=0.5), "forward noise per "
                              "metre of the increment, added in squares"),),
        null=(0.0,),
        change=_forward_with_distance,
        carrier="motion",
        symptom="Forward residuals scatter more on long steps than while the robot turns or stands.",
        typical={"just visible": (0.2,), "clear": (0.5,), "large": (1.0,)},
        squared=True,
        absorber=True,
        near_twins={"wheel-slip": "record longer: slips are rare and only fall short"},
        references=(_THRUN,),
        needs=drives,
    ),
    Effect(
        name="turn-noise-grows-with-turn",
        summary="How far the robot turns is the less certain the more it turns.",
        finding="turn noise grows by {0} rad for each radian of a turn",
        parameters=(Parameter("turn_noise_grows_with_turn", "1", stats.halfnorm(scale=0.3), "turn noise per radian of "
                              "the increment, added in squares"),),
        null=(0.0,),
        change=_turn_with_turn,
        carrier="motion",
        symptom="Turn residuals scatter more in sharp turns than on straight stretches.",
        typical={"just visible": (0.15,), "clear": (0.35,), "large": (0.7,)},
        squared=True,
        absorber=True,
        near_twins={"odometry-turn-scale": "record longer: a scale errs always the same way"},
        references=(_THRUN,),
        needs=turns,
    ),
    Effect(
        name="turn-noise-grows-with-distance",
        summary="The heading gets the less certain the farther the robot drives.",
        finding="turn noise grows by {0} with the length of a step",
        parameters=(Parameter("turn_noise_grows_with_distance", "rad/m", stats.halfnorm(scale=0.5), "turn noise per "
                              "metre of the increment, added in squares"),),
        null=(0.0,),
        change=_turn_with_distance,
        carrier="motion",
        symptom="Turn residuals scatter more on long steps than while the robot stands or turns on the spot.",
        typical={"just visible": (0.3,), "clear": (0.8,), "large": (1.5,)},
        squared=True,
        absorber=True,
        near_twins={"odometry-arc": "record longer: an arc errs always to the same side"},
        references=(_THRUN,),
        needs=drives,
    ),
)  # fmt: skip

MOTION_NOISE_EFFECTS = GROWING
