"""Systematic errors of odometry."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import stats

from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.editing import edit_motion
from pmcl.models.effects.effect import Effect, Where
from pmcl.models.motions.increments.kernels.delayed import delayed_increments
from pmcl.models.parameters import Parameter
from pmcl.models.part import Float
from pmcl.models.tables import Tables

__all__ = ["ODOMETRY_EFFECTS"]

_BORENSTEIN = "Borenstein, Feng, Measurement and Correction of Systematic Odometry Errors in Mobile Robots, 1996"
_THRUN = "Thrun, Burgard, Fox, Probabilistic Robotics, 2005, section 5.4"


def drives(log: RobotLog) -> bool:
    """Return whether the odometry reports any translation."""
    return bool(np.any(log.odometry[1:, :2] != 0.0))


def turns(log: RobotLog) -> bool:
    """Return whether the odometry reports any turn."""
    return bool(np.any(log.odometry[1:, 2] != 0.0))


def moves(log: RobotLog) -> bool:
    """Return whether the odometry reports any motion."""
    return drives(log) or turns(log)


def _mean(tables: Tables, name: str, change: Any) -> Tables:
    def edit(motion: Any) -> Any:
        mean = motion.mean.copy()
        change(mean)
        return {"mean": mean}

    return edit_motion(tables, edit, name)


def _forward_scale(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    def edit(mean: Float) -> None:
        mean[:, :2] *= 1.0 + values[0]

    return _mean(tables, "odometry-forward-scale", edit)


def _turn_scale(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    def edit(mean: Float) -> None:
        mean[:, 2] *= 1.0 + values[0]

    return _mean(tables, "odometry-turn-scale", edit)


def _arc(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    def edit(mean: Float) -> None:
        mean[:, 2] += values[0] * mean[:, 0]

    return _mean(tables, "odometry-arc", edit)


def _turn_bias(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    def edit(mean: Float) -> None:
        mean[1:, 2] += values[0] * np.diff(log.times)

    return _mean(tables, "odometry-turn-bias", edit)


def _side_drift(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    def edit(mean: Float) -> None:
        mean[:, 1] += values[0] * mean[:, 0]

    return _mean(tables, "odometry-side-drift", edit)


def _latency(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    def edit(mean: Float) -> None:
        mean[1:] = delayed_increments(mean, log.times, float(values[0]))

    return _mean(tables, "odometry-latency", edit)


ODOMETRY_EFFECTS = (
    Effect(
        name="odometry-forward-scale",
        summary="The robot goes a fixed share farther (or less far) than its odometry says, as with a wrong wheel "
        "radius.",
        finding="the robot goes {0:%} {0:farther|less far} than its odometry says",
        parameters=(Parameter("odometry_forward_scale", "1", stats.norm(scale=0.1), "share by which distances exceed "
                              "odometry"),),
        null=(0.0,),
        change=_forward_scale,
        carrier="motion",
        symptom="Readings ahead shrink faster than odometry predicts, whatever the place; forward residuals grow with "
        "the distance driven.",
        typical={"just visible": (0.02,), "clear": (0.06,), "large": (0.15,)},
        means_only=True,
        near_twins={
            "odometry-latency": "change the speed: a delay shows only then",
            "slippery-patch": "drive all over the floor: a patch shows in one place",
            "range-scale": "drive where one wall stays beside the robot",
        },
        references=(_BORENSTEIN,),
        needs=drives,
    ),
    Effect(
        name="odometry-turn-scale",
        summary="The robot turns a fixed share farther (or less far) than its odometry says, as with a wrong wheel "
        "base.",
        finding="the robot turns {0:%} {0:farther|less far} than its odometry says",
        parameters=(Parameter("odometry_turn_scale", "1", stats.norm(scale=0.15), "share by which turns exceed "
                              "odometry"),),
        null=(0.0,),
        change=_turn_scale,
        carrier="motion",
        symptom="After a turn to the left all beams are turned one way, after a turn to the right the other way.",
        typical={"just visible": (0.03,), "clear": (0.1,), "large": (0.25,)},
        means_only=True,
        near_twins={"odometry-arc": "turn both ways, also on the spot"},
        references=(_BORENSTEIN,),
        needs=turns,
    ),
    Effect(
        name="odometry-arc",
        summary="Driving straight is really driving an arc, as with wheels of unequal size.",
        finding="driving straight is really driving an arc to the {0:left|right}, {0}",
        parameters=(Parameter("odometry_arc", "rad/m", stats.norm(scale=0.3), "turn per metre driven forward"),),
        null=(0.0,),
        change=_arc,
        carrier="motion",
        symptom="The heading drifts to one side on straight stretches, in proportion to the distance.",
        typical={"just visible": (0.05,), "clear": (0.2,), "large": (0.5,)},
        means_only=True,
        near_twins={
            "odometry-turn-bias": "drive at different speeds, or stand still",
            "odometry-turn-scale": "turn both ways, also on the spot",
        },
        references=(_BORENSTEIN,),
        needs=drives,
    ),
    Effect(
        name="odometry-turn-bias",
        summary="The heading drifts at a constant rate, moving or not, as with the offset of a gyro.",
        finding="the heading drifts to the {0:left|right} by {0} that odometry does not see",
        parameters=(Parameter("odometry_turn_bias", "rad/s", stats.norm(scale=0.1), "rate at which the heading "
                              "drifts"),),
        null=(0.0,),
        change=_turn_bias,
        carrier="motion",
        symptom="Turn residuals have one sign throughout, also while the robot stands.",
        typical={"just visible": (0.01,), "clear": (0.03,), "large": (0.08,)},
        means_only=True,
        near_twins={
            "odometry-arc": "drive at different speeds, or stand still",
            "turn-noise-correlated": "record longer: a wandering rate changes its sign",
        },
        references=("Titterton, Weston, Strapdown Inertial Navigation Technology, 2004, section 8.4",),
    ),
    Effect(
        name="odometry-side-drift",
        summary="The robot slides to one side in proportion to how far it drives.",
        finding="the robot slides {0} m to the {0:left|right} for each metre ahead",
        parameters=(Parameter("odometry_side_drift", "1", stats.norm(scale=0.1), "metres to the left per metre "
                              "forward"),),
        null=(0.0,),
        change=_side_drift,
        carrier="motion",
        symptom="Walls beside the robot come closer on one side while it drives along them.",
        typical={"just visible": (0.03,), "clear": (0.08,), "large": (0.2,)},
        means_only=True,
        near_twins={"sensor-yaw": "turn on the spot or drive backwards: for pure forward driving the two are the same"},
        references=(_THRUN,),
        needs=drives,
    ),
    Effect(
        name="odometry-latency",
        summary="The robot really moves some time after odometry says so (or before, when negative).",
        finding="the robot moves {0} {0:after|before} its odometry says so",
        parameters=(Parameter("odometry_latency", "s", stats.norm(scale=0.3), "how much later than odometry the robot "
                              "moves"),),
        null=(0.0,),
        change=_latency,
        carrier="motion",
        symptom="Residuals of forward and turn have opposite signs when a motion begins and when it ends.",
        typical={"just visible": (0.05,), "clear": (0.2,), "large": (0.5,)},
        means_only=True,
        near_twins={
            "sensor-latency": "the same in relative terms: only an absolute pose, or odometry noise, tells which of "
            "the two is late",
            "odometry-forward-scale": "start and stop often",
        },
        references=("Furgale, Rehder, Siegwart, Unified Temporal and Spatial Calibration, IROS 2013",),
        needs=moves,
    ),
)  # fmt: skip
