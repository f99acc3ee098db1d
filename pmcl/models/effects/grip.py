"""Wheels that slip, at random or in one place, and motion noise with heavy tails or memory."""

from __future__ import annotations

import numpy as np
from scipy import stats

from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.editing import edit_motion
from pmcl.models.effects.effect import Effect, Where
from pmcl.models.effects.odometry import drives, moves
from pmcl.models.effects.places import at_place, floor_places, has_floor
from pmcl.models.parameters import Parameter, gamma_prior
from pmcl.models.part import Float
from pmcl.models.starts.table import wider_start
from pmcl.models.tables import Tables

__all__ = ["GRIP_EFFECTS"]


def _wheel_slip(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    weight, share = (float(value) for value in values)
    return edit_motion(tables, lambda motion: {"slip_weight": weight, "slip_share": share}, "wheel-slip")


def _heavy_tails(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return edit_motion(tables, lambda motion: {"tail": float(values[0])}, "heavy-tailed-motion-noise")


def _patch(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    lost, x, y, radius = values
    row = np.array([[x, y, radius, lost]])
    return edit_motion(tables, lambda motion: {"patches": np.concatenate([motion.patches, row])}, "slippery-patch")


def _wandering(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    rate, time = values
    pause = np.diff(log.times, prepend=log.times[:1])
    # With a correlation of exactly one the fourth state component would have no noise of its own.
    keep = np.minimum(np.exp(-pause / time), 1.0 - 1e-9)
    keep[0] = 0.0
    tables = edit_motion(tables, lambda motion: {"wander": rate * pause, "keep": keep}, "turn-noise-correlated")
    return tables._replace(start=wider_start(tables.start, 0.0, 1.0))  # type: ignore[arg-type]


def _has_floor_and_drives(log: RobotLog) -> bool:
    return has_floor(log) and drives(log)


GRIP_EFFECTS = (
    Effect(
        name="wheel-slip",
        summary="Now and then the wheels slip, and a step falls far short of what odometry says.",
        finding="in {0:%} of the steps the wheels slip and lose {1:%} of the distance",
        parameters=(
            Parameter("wheel_slip_weight", "1", stats.beta(1.0, 15.0), "share of steps that slip", role="weight"),
            Parameter("wheel_slip_share", "1", stats.beta(6.0, 3.0), "share of its distance that such a step loses"),
        ),
        null=(0.0, 0.7),
        change=_wheel_slip,
        carrier="motion",
        symptom="Single steps fall far short, always short; the others are fine.",
        typical={"just visible": (0.02, 0.7), "clear": (0.08, 0.8), "large": (0.2, 0.9)},
        shape=("wheel_slip_share",),
        near_twins={
            "heavy-tailed-motion-noise": "none: look whether the gross errors are all too short",
            "forward-noise-grows-with-distance": "record longer: slips are rare and only fall short",
        },
        references=("Ward, Iagnemma, A dynamic-model-based wheel slip detector for mobile robots, 2008",),
        needs=drives,
    ),
    Effect(
        name="heavy-tailed-motion-noise",
        summary="Most steps are as precise as ever, but some are off by much more than noise explains.",
        finding="some steps are off by much more than noise explains (inverse degrees of freedom of Student's t {0})",
        parameters=(Parameter("heavy_tailed_motion_noise", "1", stats.uniform(scale=0.5), "inverse degrees of freedom "
                              "of Student's t"),),
        null=(0.0,),
        change=_heavy_tails,
        carrier="motion",
        symptom="Increment residuals are peaked in the middle and have outliers to both sides.",
        typical={"just visible": (0.1,), "clear": (0.25,), "large": (0.45,)},
        absorber=True,
        near_twins={"wheel-slip": "none: look whether the gross errors are all too short"},
        references=("Lange, Little, Taylor, Robust Statistical Modeling Using the t Distribution, 1989",),
        needs=moves,
    ),
    Effect(
        name="turn-noise-correlated",
        summary="The turn rate is off by an amount that wanders slowly, as with the drift of a gyro.",
        finding="the turn rate is off by {0} and wanders over {1}",
        parameters=(
            Parameter("turn_noise_correlated", "rad/s", stats.halfnorm(scale=0.1), "standard deviation of the rate"),
            Parameter("turn_noise_correlated_time", "s", gamma_prior(30.0), "time over which it forgets itself"),
        ),
        null=(0.0, 20.0),
        change=_wandering,
        carrier="motion",
        symptom="Turn residuals keep their sign for a while, then change it.",
        typical={"just visible": (0.015, 20.0), "clear": (0.05, 20.0), "large": (0.12, 20.0)},
        shape=("turn_noise_correlated_time",),
        squared=True,
        absorber=True,
        near_twins={"odometry-turn-bias": "record longer: a wandering rate changes its sign"},
        references=("El-Sheimy, Hou, Niu, Analysis and Modeling of Inertial Sensors Using Allan Variance, 2008",),
    ),
    Effect(
        name="slippery-patch",
        summary="In one part of the floor the robot gets less far than its odometry says.",
        finding="within {3} of ({1:+}, {2:+}) the robot loses {0:%} of its distance",
        parameters=(
            Parameter("slippery_patch", "1", stats.beta(1.0, 2.0), "share of the distance that is lost there"),
            Parameter("slippery_patch_x", "m", stats.norm(scale=5.0), "centre of the patch"),
            Parameter("slippery_patch_y", "m", stats.norm(scale=5.0), "centre of the patch"),
            Parameter("slippery_patch_radius", "m", gamma_prior(1.0, 8.0), "radius of the patch"),
        ),
        # Until the effect has a place, the radius is a share of a cell of the grid.
        null=(0.0, 0.0, 0.0, 0.6),
        change=_patch,
        carrier="motion",
        symptom="Steps fall short in one part of the map only.",
        typical={
            "just visible": (0.15, 0.0, 0.0, 0.6),
            "clear": (0.4, 0.0, 0.0, 0.6),
            "large": (0.8, 0.0, 0.0, 0.6),
        },
        shape=("slippery_patch_x", "slippery_patch_y", "slippery_patch_radius"),
        may_begin=False,
        near_twins={"odometry-forward-scale": "drive all over the floor: a patch shows in one place"},
        references=("Angelova, Matthies, Helmick, Perona, Learning and Prediction of Slip from Visual Information, "
                    "2007",),
        needs=_has_floor_and_drives,
        places=floor_places,
        fitted=at_place,
    ),
)  # fmt: skip
