"""Range noise that is not Gaussian or not constant, and readings that drift or are rounded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import stats

from pmcl.errors import ModelError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.editing import edit_beams
from pmcl.models.effects.effect import Effect, Where
from pmcl.models.effects.ranges import reads_ranges
from pmcl.models.parameters import Parameter
from pmcl.models.part import Float
from pmcl.models.tables import Tables

__all__ = ["RANGE_NOISE_EFFECTS"]

_THRUN = "Thrun, Burgard, Fox, Probabilistic Robotics, 2005, section 6.3"
# Share of the log over which the noise changes from its early to its late size (chosen by hand).
_TRANSITION = 0.05


def elapsed(log: RobotLog) -> Float:
    """Return the share of the log that has passed at each row, 0 to 1; it is not known while the robot is running."""
    if not log.is_whole:
        raise ModelError(
            f"{log.where}: expected a whole log for an effect that changes in the course of it, but the robot is still "
            "running; leave the effect out, or localize afterwards"
        )
    return np.asarray((log.times - log.times[0]) / (log.times[-1] - log.times[0]))


def _heavy_tails(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return edit_beams(tables, lambda beams: {"tail": float(values[0])}, "heavy-tailed-range-noise")


def _grows(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return edit_beams(tables, lambda beams: {"growth": beams.growth + values[0]}, "range-noise-grows-with-range")


def _changes(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    change, when = values
    late = 0.5 * (1.0 + np.tanh((elapsed(log) - when) / _TRANSITION))
    factor = np.exp(change * late)
    return edit_beams(
        tables, lambda beams: {"std_factor": beams.std_factor * factor}, "range-noise-changes-in-time"
    )


def _drifts(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    shift = values[0] * elapsed(log)[:, None]
    return edit_beams(tables, lambda beams: {"bias_at": beams.bias_at + shift}, "range-bias-drifts")


def _correlated(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    def edit(beams: Any) -> Mapping[str, Any]:
        return {"correlation": np.full(beams.correlation.size, values[0])}

    return edit_beams(tables, edit, "range-noise-correlated")


def _rounded(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return edit_beams(tables, lambda beams: {"step": float(values[0])}, "quantized-readings")


def _read_row_after_row(log: RobotLog) -> bool:
    """Return whether beams are often read at consecutive rows: the density depends on the row before only."""
    if not reads_ranges(log):
        return False
    assert log.ranges is not None
    read = ~np.isnan(log.ranges)
    return bool((read[1:] & read[:-1]).sum() > 0.2 * read.sum())


def raw_step(log: RobotLog) -> Mapping[str, float]:
    """Return the step to whose multiples all range readings are rounded, if their digits show one.

    Rounding hardly changes the spread of readings, but it shows in their digits.
    """
    if log.ranges is None:
        return {}
    inside = log.ranges[(log.ranges > 0.0) & (log.ranges < log.max_range)]
    distinct = np.unique(np.round(inside, 7))
    if distinct.size < 3 or distinct.size > 0.5 * inside.size:
        return {}
    step = float(np.diff(distinct).min())
    multiple = np.round(distinct / step)
    step = float(distinct @ multiple / (multiple @ multiple))
    if np.abs(distinct - multiple * step).max() > 0.02 * step:
        return {}
    return {"quantized_readings": step}


RANGE_NOISE_EFFECTS = (
    Effect(
        name="heavy-tailed-range-noise",
        summary="Most ranges are as precise as ever, but some are off by much more than noise explains.",
        finding="some ranges are off by much more than noise explains (inverse degrees of freedom of Student's t {0})",
        parameters=(Parameter("heavy_tailed_range_noise", "1", stats.uniform(scale=0.5), "inverse degrees of freedom "
                              "of Student's t"),),
        null=(0.0,),
        change=_heavy_tails,
        carrier="range",
        symptom="Range residuals are peaked in the middle and have outliers to both sides that thin out slowly.",
        typical={"just visible": (0.1,), "clear": (0.25,), "large": (0.45,)},
        absorber=True,
        near_twins={"random-readings": "record longer: random readings do not thin out away from the wall"},
        references=("Lange, Little, Taylor, Robust Statistical Modeling Using the t Distribution, 1989",),
        needs=reads_ranges,
    ),
    Effect(
        name="range-noise-grows-with-range",
        summary="Long ranges are noisier than short ones.",
        finding="range noise grows by {0:%} for each metre of range",
        parameters=(Parameter("range_noise_grows_with_range", "1/m", stats.halfnorm(scale=1.0), "growth of the noise "
                              "per metre, as a share of it"),),
        null=(0.0,),
        change=_grows,
        carrier="range",
        symptom="Range residuals scatter more the longer the range.",
        typical={"just visible": (0.1,), "clear": (0.5,), "large": (1.5,)},
        absorber=True,
        near_twins={"beam-width": "look at walls both square and at a slant: noise depends on the distance alone"},
        references=(_THRUN,),
        needs=reads_ranges,
    ),
    Effect(
        name="range-noise-changes-in-time",
        summary="From some time on ranges are noisier (or less noisy) than before.",
        finding="range noise {0:rises|falls} after {1:%} of the log, its logarithm by {0}",
        parameters=(
            Parameter("range_noise_changes_in_time", "1", stats.norm(scale=0.7), "log of the ratio of noise after to "
                      "before"),
            Parameter("range_noise_changes_in_time_when", "1", stats.uniform(), "share of the log before the change"),
        ),
        null=(0.0, 0.5),
        change=_changes,
        carrier="range",
        symptom="Range residuals scatter differently early and late in the log.",
        typical={"just visible": (0.15, 0.5), "clear": (0.5, 0.6), "large": (1.2, 0.4)},
        shape=("range_noise_changes_in_time_when",),
        absorber=True,
        may_begin=False,
        near_twins={"range-bias-drifts": "visit the same places early and late"},
        references=("Montgomery, Introduction to Statistical Quality Control, 2012, chapter 9",),
        needs=reads_ranges,
    ),
    Effect(
        name="range-bias-drifts",
        summary="All beams read longer and longer (or shorter and shorter) as time goes by, as a sensor warms up.",
        finding="beams come to read {0} {0:too long|too short} by the end of the log",
        parameters=(Parameter("range_bias_drifts", "m", stats.norm(scale=0.2), "how much too long beams read at the "
                              "end"),),
        null=(0.0,),
        change=_drifts,
        carrier="range",
        symptom="Range residuals are fine at first, and move off to one side in the course of the log.",
        typical={"just visible": (0.02,), "clear": (0.08,), "large": (0.25,)},
        may_begin=False,
        near_twins={
            "range-noise-changes-in-time": "visit the same places early and late",
            "range-bias": "record the beginning: a drift starts from nothing",
        },
        references=("Montgomery, Introduction to Statistical Quality Control, 2012, chapter 9",),
        needs=reads_ranges,
    ),
    Effect(
        name="range-noise-correlated",
        summary="Errors of a beam last from one reading to the next instead of being new each time.",
        finding="a beam's error resembles the one before, with correlation {0:+}",
        parameters=(Parameter("range_noise_correlated", "1", stats.uniform(loc=-0.5, scale=1.45), "correlation of a "
                              "beam's error with the one before"),),
        null=(0.0,),
        change=_correlated,
        carrier="range",
        symptom="Residuals of a beam resemble its residuals at the row before.",
        typical={"just visible": (0.1,), "clear": (0.35,), "large": (0.75,)},
        absorber=True,
        near_twins={
            "sensor-yaw": "turn often: errors of a wrong direction change with what the beam hits",
            "wall-moved": "come back later: errors of the map are still there",
        },
        references=("Thrun, Burgard, Fox, Probabilistic Robotics, 2005, section 6.3.4",),
        needs=_read_row_after_row,
    ),
    Effect(
        name="quantized-readings",
        summary="Ranges are rounded to multiples of a step.",
        finding="readings are rounded to multiples of {0}",
        parameters=(Parameter("quantized_readings", "m", stats.halfnorm(scale=0.3), "step of the rounding"),),
        null=(0.0,),
        change=_rounded,
        carrier="range",
        symptom="The digits of the readings: only multiples of one number occur.",
        typical={"just visible": (0.1,), "clear": (0.25,), "large": (0.5,)},
        squared=True,
        near_twins={"range-noise-grows-with-range": "none: look at the digits of the readings"},
        references=("Widrow, Kollar, Quantization Noise, 2008",),
        needs=reads_ranges,
        tells=raw_step,
    ),
)  # fmt: skip
