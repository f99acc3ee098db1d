"""Readings that are no echo of the wall at which the beam points; they are components of a mixture."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import stats

from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.editing import edit_beams
from pmcl.models.effects.effect import Effect, Where
from pmcl.models.effects.ranges import chosen_beams, each_beam, reads_ranges
from pmcl.models.parameters import Parameter, gamma_prior
from pmcl.models.part import Float
from pmcl.models.tables import Tables

__all__ = ["ECHO_EFFECTS"]

_THRUN = "Thrun, Burgard, Fox, Probabilistic Robotics, 2005, section 6.3"


def _random(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    def edit(beams: Any) -> Any:
        return {"outlier_weight": 1.0 - (1.0 - beams.outlier_weight) * (1.0 - values[0])}

    return edit_beams(tables, edit, "random-readings")


def _joined(weights: Float, weight: float) -> Float:
    """Return the probability that at least one of two independent events occurs."""
    return np.asarray(1.0 - (1.0 - weights) * (1.0 - weight))


def _short(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    weight, length = values
    return edit_beams(
        tables,
        lambda beams: {"short_weight": _joined(beams.short_weight, weight), "short_length": float(length)},
        "short-readings",
    )


def _no_echo(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return edit_beams(
        tables, lambda beams: {"no_echo_weight": _joined(beams.no_echo_weight, values[0])}, "max-range-readings"
    )


def _dead_beam(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    def edit(beams: Any) -> dict[str, Any]:
        weight = beams.no_echo_weight.copy()
        chosen = chosen_beams(where)
        weight[chosen] = _joined(weight[chosen], values[0])
        return {"no_echo_weight": weight}

    return edit_beams(tables, edit, "dead-beam")


def _cross_talk(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return edit_beams(tables, lambda beams: {"talk_weight": _joined(beams.talk_weight, values[0])}, "cross-talk")


def _specular(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    weight, angle = values
    return edit_beams(
        tables,
        lambda beams: {"specular_weight": _joined(beams.specular_weight, weight), "specular_angle": float(angle)},
        "specular-reflection",
    )


def _beam_width(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return edit_beams(tables, lambda beams: {"width": beams.width + values[0]}, "beam-width")


def _several_beams(log: RobotLog) -> bool:
    return reads_ranges(log) and len(each_beam(log)) > 1


ECHO_EFFECTS = (
    Effect(
        name="random-readings",
        summary="Some readings have nothing to do with the room: any length is as likely as any other.",
        finding="{0:%} of the readings have nothing to do with the room",
        parameters=(
            Parameter("random_readings_weight", "1", stats.beta(1.0, 15.0), "share of random readings", role="weight"),
        ),
        null=(0.0,),
        change=_random,
        carrier="range",
        symptom="Single readings are off by a lot, to both sides, in all beams and places.",
        typical={"just visible": (0.01,), "clear": (0.05,), "large": (0.15,)},
        absorber=True,
        near_twins={
            "heavy-tailed-range-noise": "record longer: heavy tails thin out away from the wall",
            "short-readings": "none: look whether the gross errors are all too short",
        },
        references=(_THRUN,),
        needs=reads_ranges,
    ),
    Effect(
        name="short-readings",
        summary="Some readings are too short: people and things that the map does not know pass by.",
        finding="{0:%} of the readings stop short of the wall, some {1} from the robot",
        parameters=(
            Parameter("short_readings_weight", "1", stats.beta(1.0, 8.0), "share of readings that are too short",
                      role="weight"),
            Parameter("short_readings_length", "m", gamma_prior(1.0), "scale of their distance from the robot"),
        ),
        null=(0.0, 1.0),
        change=_short,
        carrier="range",
        symptom="Single readings fall short of the wall, never beyond it.",
        typical={"just visible": (0.02, 1.0), "clear": (0.08, 1.0), "large": (0.25, 1.0)},
        shape=("short_readings_length",),
        near_twins={
            "cross-talk": "turn on the spot: what neighbours read changes with the direction",
            "unmapped-obstacle": "come back: an obstacle is still there",
            "random-readings": "none: look whether the gross errors are all too short",
        },
        references=(_THRUN,),
        needs=reads_ranges,
    ),
    Effect(
        name="max-range-readings",
        summary="Some readings get no echo and show the greatest range.",
        finding="{0:%} of the readings get no echo and show the greatest range",
        parameters=(Parameter("max_range_readings_weight", "1", stats.beta(1.0, 8.0), "share of readings without "
                              "echo", role="weight"),),
        null=(0.0,),
        change=_no_echo,
        carrier="range",
        symptom="Single readings show the greatest range though a wall is near.",
        typical={"just visible": (0.01,), "clear": (0.05,), "large": (0.2,)},
        near_twins={
            "specular-reflection": "look at walls both square and at a slant",
            "dead-beam": "none: look whether one beam has all of them",
        },
        references=(_THRUN,),
        needs=reads_ranges,
    ),
    Effect(
        name="dead-beam",
        summary="One beam often or always shows the greatest range, whatever is in front of it.",
        finding="beam {beams} shows the greatest range in {0:%} of its readings, whatever is in front of it",
        parameters=(Parameter("dead_beam_weight", "1", stats.beta(1.0, 1.0), "share of its readings without echo",
                              role="weight"),),
        null=(0.0,),
        change=_dead_beam,
        carrier="range",
        symptom="One beam shows the greatest range though a wall is near, while its neighbours read the wall.",
        typical={"just visible": (0.05,), "clear": (0.4,), "large": (0.95,)},
        near_twins={"max-range-readings": "none: look whether one beam has all of them"},
        references=(_THRUN,),
        needs=reads_ranges,
        places=each_beam,
    ),
    Effect(
        name="cross-talk",
        summary="Now and then a beam shows the echo of its neighbour.",
        finding="{0:%} of the readings are the echo of a neighbouring beam",
        parameters=(Parameter("cross_talk_weight", "1", stats.beta(1.0, 8.0), "share of readings that are a "
                              "neighbour's", role="weight"),),
        null=(0.0,),
        change=_cross_talk,
        carrier="range",
        symptom="Single readings agree with what the beam beside should read.",
        typical={"just visible": (0.02,), "clear": (0.1,), "large": (0.3,)},
        near_twins={"short-readings": "turn on the spot: what neighbours read changes with the direction"},
        references=("Borenstein, Koren, Error eliminating rapid ultrasonic firing for mobile robot obstacle avoidance, "
                    "1995",),
        needs=_several_beams,
    ),
    Effect(
        name="specular-reflection",
        summary="Beams that graze a wall glance off and come back by a detour, or not at all.",
        finding="{0:%} of the beams that meet a wall at more than {1} from square glance off",
        parameters=(
            Parameter("specular_reflection_weight", "1", stats.beta(1.0, 2.0), "share of grazing beams that glance "
                      "off", role="weight"),
            Parameter("specular_reflection_angle", "rad", stats.norm(loc=0.8, scale=0.2), "incidence from which on "
                      "they do"),
        ),
        null=(0.0, 0.8),
        change=_specular,
        carrier="range",
        symptom="Readings are longer than true where the wall is seen at a slant.",
        typical={"just visible": (0.05, 0.8), "clear": (0.3, 0.8), "large": (0.8, 0.7)},
        shape=("specular_reflection_angle",),
        near_twins={"max-range-readings": "look at walls both square and at a slant"},
        references=("Leonard, Durrant-Whyte, Directed Sonar Sensing for Mobile Robot Navigation, 1992",),
        needs=reads_ranges,
    ),
    Effect(
        name="beam-width",
        summary="A beam is a cone, and what is nearest in it answers.",
        finding="a beam is a cone of {0}, and what is nearest in it answers",
        parameters=(Parameter("beam_width", "rad", stats.halfnorm(scale=0.4), "full angle of the cone"),),
        null=(0.0,),
        change=_beam_width,
        carrier="range",
        symptom="Readings are too short where the wall is seen at a slant, and right where it is square.",
        typical={"just visible": (0.1,), "clear": (0.3,), "large": (0.7,)},
        near_twins={
            "range-scale": "look at walls both square and at a slant",
            "specular-reflection": "none: a cone reads too short at a slant, a reflection too long",
        },
        references=("Leonard, Durrant-Whyte, Directed Sonar Sensing for Mobile Robot Navigation, 1992",),
        needs=reads_ranges,
    ),
)  # fmt: skip
