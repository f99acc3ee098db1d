"""Errors of landmark sightings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import stats

from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.editing import edit_landmarks
from pmcl.models.effects.effect import Effect, Where
from pmcl.models.effects.ranges import reads_ranges_or_scans
from pmcl.models.parameters import Parameter
from pmcl.models.part import Float
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


def _reads_landmarks_only(log: RobotLog) -> bool:
    return not reads_ranges_or_scans(log)


def _bearing_bias(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return edit_landmarks(
        tables, lambda seen: {"bearing_bias": seen.bearing_bias + values[0]}, "bearing-bias"
    )


def _range_bias(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return edit_landmarks(
        tables, lambda seen: {"range_bias": seen.range_bias + values[0]}, "landmark-range-bias"
    )


def _range_scale(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return edit_landmarks(
        tables, lambda seen: {"range_scale": seen.range_scale * (1.0 + values[0])}, "landmark-range-scale"
    )


def _size_scale(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return edit_landmarks(
        tables, lambda seen: {"size_constant": seen.size_constant * (1.0 + values[0])}, "landmark-size-scale"
    )


def _range_noise(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return edit_landmarks(
        tables,
        lambda seen: {"range_growth": seen.range_growth + values[0]},
        "landmark-range-noise-grows-with-range",
    )


def _bearing_noise(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return edit_landmarks(
        tables, lambda seen: {"bearing_falloff": seen.bearing_falloff + values[0]}, "bearing-noise-falls-with-range"
    )


def _correlated(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    def edit(seen: Any) -> Mapping[str, Any]:
        n_landmarks = seen.position.shape[0]
        return {
            "range_correlation": np.full(n_landmarks, values[0]),
            "bearing_correlation": np.full(n_landmarks, values[1]),
        }

    return edit_landmarks(tables, edit, "landmark-noise-correlated")


def _misread(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    return edit_landmarks(
        tables,
        lambda seen: {"misread_weight": 1.0 - (1.0 - seen.misread_weight) * (1.0 - values[0])},
        "landmark-misread",
    )


def _reads_size(log: RobotLog) -> bool:
    return _read(log.landmark_size)


def _read_row_after_row(log: RobotLog) -> bool:
    """Return whether landmarks are often read at consecutive rows: the density depends on the row before only."""
    channels = [values for values in (log.landmark_range, log.landmark_bearing) if values is not None]
    read = [~np.isnan(values) for values in channels]
    again = sum(int((seen[1:] & seen[:-1]).sum()) for seen in read)
    return again > 0.2 * sum(int(seen.sum()) for seen in read)


def _reads_several(log: RobotLog) -> bool:
    return reads_landmarks(log) and log.landmarks is not None and len(log.landmarks.positions) > 1


LANDMARK_EFFECTS = (
    Effect(
        name="bearing-bias",
        summary="All bearings to landmarks are off by the same angle.",
        finding="all bearings to landmarks read {0} too far {0:left|right}",
        parameters=(Parameter("bearing_bias", "rad", stats.norm(scale=0.15), "how far too far left bearings read"),),
        null=(0.0,),
        change=_bearing_bias,
        carrier="landmark",
        symptom="The robot seems to drive sideways: the heading that fits the bearings is not the one it drives along.",
        typical={"just visible": (0.02,), "clear": (0.06,), "large": (0.15,)},
        means_only=True,
        near_twins={
            "sensor-yaw": "the same for a sensor of landmarks: no motion tells them apart",
            "odometry-side-drift": "turn on the spot or drive backwards",
        },
        same_as={"sensor-yaw": _reads_landmarks_only},
        references=(_THRUN,),
        needs=reads_bearing,
    ),
    Effect(
        name="landmark-range-bias",
        summary="All distances to landmarks read too long (or too short) by the same length.",
        finding="all distances to landmarks read {0} {0:too long|too short}",
        parameters=(Parameter("landmark_range_bias", "m", stats.norm(scale=0.3), "how much too long distances read"),),
        null=(0.0,),
        change=_range_bias,
        carrier="landmark",
        symptom="Distance residuals have one sign, near and far alike.",
        typical={"just visible": (0.05,), "clear": (0.2,), "large": (0.5,)},
        means_only=True,
        near_twins={"landmark-range-scale": "see landmarks near and far"},
        references=(_THRUN,),
        needs=reads_distance,
    ),
    Effect(
        name="landmark-range-scale",
        summary="All distances to landmarks read too long (or too short) by the same share.",
        finding="all distances to landmarks read {0:%} {0:too long|too short}",
        parameters=(Parameter("landmark_range_scale", "1", stats.norm(scale=0.1), "share by which distances read too "
                              "long"),),
        null=(0.0,),
        change=_range_scale,
        carrier="landmark",
        symptom="Distance residuals have one sign and grow with the distance.",
        typical={"just visible": (0.01,), "clear": (0.04,), "large": (0.1,)},
        means_only=True,
        near_twins={
            "landmark-range-bias": "see landmarks near and far",
            "odometry-forward-scale": "see landmarks on all sides",
        },
        references=(_THRUN,),
        needs=reads_distance,
    ),
    Effect(
        name="landmark-size-scale",
        summary="All landmarks look larger (or smaller) than they should by the same share.",
        finding="all landmarks look {0:%} {0:too large|too small}",
        parameters=(Parameter("landmark_size_scale", "1", stats.norm(scale=0.3), "share by which areas are too "
                              "large"),),
        null=(0.0,),
        change=_size_scale,
        carrier="landmark",
        symptom="Landmarks seem nearer than they are, near and far alike.",
        typical={"just visible": (0.05,), "clear": (0.15,), "large": (0.4,)},
        means_only=True,
        near_twins={"odometry-forward-scale": "see landmarks on all sides"},
        references=("Kaboli, Bowling, Musilek, Bayesian Calibration for Monte Carlo Localization, AAAI 2006",),
        needs=_reads_size,
    ),
    Effect(
        name="landmark-range-noise-grows-with-range",
        summary="Distances to far landmarks are noisier than to near ones.",
        finding="the noise of distances to landmarks grows by {0:%} for each metre of distance",
        parameters=(Parameter("landmark_range_noise_grows_with_range", "1/m", stats.halfnorm(scale=0.3), "growth of "
                              "the noise per metre, as a share of it"),),
        null=(0.0,),
        change=_range_noise,
        carrier="landmark",
        symptom="Distance residuals scatter more the farther the landmark.",
        typical={"just visible": (0.02,), "clear": (0.1,), "large": (0.4,)},
        absorber=True,
        near_twins={"landmark-range-scale": "record longer: a scale errs always the same way"},
        references=(_THRUN,),
        needs=reads_distance,
    ),
    Effect(
        name="bearing-noise-falls-with-range",
        summary="Bearings to near landmarks are noisier than to far ones: near ones are wide.",
        finding="bearings to near landmarks are noisier, at {0} twice as noisy as to far ones",
        parameters=(Parameter("bearing_noise_falls_with_range", "m", stats.halfnorm(scale=3.0), "distance at which the "
                              "noise is twice that of a far landmark"),),
        null=(0.0,),
        change=_bearing_noise,
        carrier="landmark",
        symptom="Bearing residuals scatter more the nearer the landmark.",
        typical={"just visible": (0.7,), "clear": (2.5,), "large": (7.0,)},
        absorber=True,
        near_twins={"sensor-offset": "turn on the spot: an offset errs always the same way"},
        references=(_THRUN,),
        needs=reads_bearing,
    ),
    Effect(
        name="landmark-noise-correlated",
        summary="Errors of a landmark's distance and bearing last from one sighting to the next instead of being new.",
        finding="errors of a landmark last from one sighting to the next, with correlation {0:+} of distances "
        "and {1:+} of bearings",
        parameters=(
            Parameter("landmark_noise_correlated_range", "1", stats.uniform(scale=0.99), "correlation of the error of "
                      "a distance with that of the same landmark a row before"),
            Parameter("landmark_noise_correlated_bearing", "1", stats.uniform(scale=0.99), "correlation of the error "
                      "of a bearing with that of the same landmark a row before"),
        ),
        null=(0.0, 0.0),
        change=_correlated,
        carrier="landmark",
        symptom="Residuals of a landmark resemble its residuals at the row before; the robot seems to slip to and fro.",
        typical={"just visible": (0.1, 0.1), "clear": (0.4, 0.4), "large": (0.8, 0.8)},
        absorber=True,
        near_twins={
            "landmark-moved": "come back later: errors of the map are still there",
            "landmark-range-bias": "look at other landmarks: a bias is the same for all of them, and stays",
            "bearing-bias": "look at other landmarks: a bias is the same for all of them, and stays",
        },
        references=(
            "Thrun, Burgard, Fox, Probabilistic Robotics, 2005, section 6.3.4",
            "Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 8.1",
        ),
        needs=_read_row_after_row,
    ),
    Effect(
        name="landmark-misread",
        summary="Now and then a landmark is taken for another one.",
        finding="{0:%} of the sightings are of another landmark than said",
        parameters=(Parameter("landmark_misread_weight", "1", stats.beta(1.0, 10.0), "share of sightings of another "
                              "landmark than said", role="weight"),),
        null=(0.0,),
        change=_misread,
        carrier="landmark",
        symptom="Single sightings are far off, and fit another landmark well.",
        typical={"just visible": (0.01,), "clear": (0.06,), "large": (0.2,)},
        near_twins={"landmark-moved": "look again later: a misread landmark is right the next time"},
        references=(_THRUN,),
        needs=_reads_several,
    ),
)  # fmt: skip
