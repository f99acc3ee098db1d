"""Systematic errors of range readings: biases and scales, of all beams or of one."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import stats

from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.editing import edit_beams, edit_ranges
from pmcl.models.effects.effect import Effect, Where
from pmcl.models.parameters import Parameter
from pmcl.models.part import Float
from pmcl.models.tables import Tables

__all__ = ["RANGE_EFFECTS", "each_beam", "reads_ranges", "reads_ranges_or_scans", "reads_scans"]

_THRUN = "Thrun, Burgard, Fox, Probabilistic Robotics, 2005, section 6.3"


def reads_ranges(log: RobotLog) -> bool:
    """Return whether the log has range beams with readings."""
    return log.ranges is not None and not bool(np.isnan(log.ranges).all())


def reads_scans(log: RobotLog) -> bool:
    """Return whether the log has lidars with readings."""
    return any(not bool(np.isnan(laser.ranges).all()) for laser in log.lidars.values())


def reads_ranges_or_scans(log: RobotLog) -> bool:
    """Return whether the log has readings of range beams or of lidars."""
    return reads_ranges(log) or reads_scans(log)


def each_beam(log: RobotLog) -> list[Where]:
    """Return one place for each beam that was read."""
    assert log.ranges is not None
    return [{"beams": (int(beam),)} for beam in np.flatnonzero(~np.isnan(log.ranges).all(axis=0))]


def chosen_beams(where: Where) -> list[int]:
    """Return the beams of an instance; the first one for the general effect of one beam."""
    return [int(beam) for beam in where.get("beams", (0,))]


def _range_bias(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return edit_ranges(tables, lambda beams: {"bias": beams.bias + values[0]}, "range-bias")


def _range_scale(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return edit_ranges(tables, lambda beams: {"scale": beams.scale * (1.0 + values[0])}, "range-scale")


def _beam_bias(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    def edit(beams: Any) -> Any:
        bias = beams.bias.copy()
        bias[chosen_beams(where)] += values[0]
        return {"bias": bias}

    return edit_beams(tables, edit, "beam-bias")


def _beam_yaw(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    def edit(beams: Any) -> Any:
        pose = beams.beam_pose.copy()
        pose[chosen_beams(where), 2] += values[0]
        return {"beam_pose": pose}

    return edit_beams(tables, edit, "beam-yaw")


RANGE_EFFECTS = (
    Effect(
        name="range-bias",
        summary="All beams read too long (or too short) by the same length.",
        finding="all beams read {0} {0:too long|too short}",
        parameters=(Parameter("range_bias", "m", stats.norm(scale=0.1), "how much too long all beams read"),),
        null=(0.0,),
        change=_range_bias,
        carrier="range",
        symptom="Range residuals have one sign, at all distances alike.",
        typical={"just visible": (0.01,), "clear": (0.04,), "large": (0.1,)},
        means_only=True,
        near_twins={
            "range-scale": "visit walls near and far",
            "wall-moved": "look at every wall from several sides",
        },
        references=(_THRUN,),
        needs=reads_ranges_or_scans,
    ),
    Effect(
        name="range-scale",
        summary="All beams read too long (or too short) by the same share, as with a wrong speed of sound.",
        finding="all beams read {0:%} {0:too long|too short}",
        parameters=(Parameter("range_scale", "1", stats.norm(scale=0.1), "share by which all beams read too long"),),
        null=(0.0,),
        change=_range_scale,
        carrier="range",
        symptom="Range residuals have one sign and grow with the distance.",
        typical={"just visible": (0.01,), "clear": (0.04,), "large": (0.1,)},
        means_only=True,
        near_twins={
            "range-bias": "visit walls near and far",
            "beam-width": "look at walls both square and at a slant",
            "odometry-forward-scale": "drive where one wall stays beside the robot",
        },
        references=(_THRUN,),
        needs=reads_ranges_or_scans,
    ),
    Effect(
        name="beam-bias",
        summary="One beam reads too long (or too short) by a fixed length.",
        finding="beam {beams} reads {0} {0:too long|too short}",
        parameters=(Parameter("beam_bias", "m", stats.norm(scale=0.2), "how much too long the beam reads"),),
        null=(0.0,),
        change=_beam_bias,
        carrier="range",
        symptom="Residuals of one beam have one sign while those of its neighbours scatter around zero.",
        typical={"just visible": (0.03,), "clear": (0.1,), "large": (0.25,)},
        means_only=True,
        near_twins={"beam-yaw": "turn beside a wall: a wrong direction errs to either side, a bias to one"},
        references=(_THRUN,),
        needs=reads_ranges,
        places=each_beam,
    ),
    Effect(
        name="beam-yaw",
        summary="One beam points to another direction than its mount says.",
        finding="beam {beams} points {0} too far {0:left|right}",
        parameters=(Parameter("beam_yaw", "rad", stats.norm(scale=0.2), "by how much the beam points too far left"),),
        null=(0.0,),
        change=_beam_yaw,
        carrier="range",
        symptom="Residuals of one beam change their sign with the slant of the wall that it hits.",
        typical={"just visible": (0.04,), "clear": (0.12,), "large": (0.3,)},
        means_only=True,
        near_twins={"beam-bias": "turn beside a wall: a wrong direction errs to either side, a bias to one"},
        references=(_THRUN,),
        needs=reads_ranges,
        places=each_beam,
    ),
)  # fmt: skip

