"""Readings that are no echo of the wall the beam points at: mixtures."""

from __future__ import annotations

from typing import Any

from scipy import stats

from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.editing import change_beams
from pmcl.models.effects.effect import Effect, Where
from pmcl.models.effects.ranges import reads_ranges
from pmcl.models.parameters import Parameter
from pmcl.models.parts import Float
from pmcl.models.tables import Tables

__all__ = ["ECHO_EFFECTS"]

_THRUN = "Thrun, Burgard, Fox, Probabilistic Robotics, 2005, section 6.3"


def _random(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    def edit(beams: Any) -> Any:
        return beams._replace(outlier_weight=1.0 - (1.0 - beams.outlier_weight) * (1.0 - values[0]))

    return change_beams(tables, edit, "random-readings")


ECHO_EFFECTS = (
    Effect(
        name="random-readings",
        summary="Some readings have nothing to do with the room: any length is as likely as any other.",
        parameters=(Parameter("random_readings_weight", "1", stats.beta(1.0, 15.0), "share of random readings"),),
        null=(0.0,),
        change=_random,
        carrier="range",
        look="Single readings are off by a lot, to both sides, in all beams and places.",
        typical={"just visible": (0.01,), "clear": (0.05,), "large": (0.15,)},
        absorber=True,
        near_twins={
            "heavy-tailed-range-noise": "record longer: heavy tails thin out away from the wall",
            "short-readings": "none: look whether the gross errors are all too short",
        },
        references=(_THRUN,),
        needs=reads_ranges,
    ),
)  # fmt: skip
