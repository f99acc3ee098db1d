"""Errors of a sensor's mount: its place, its direction, its delay, or the quantity that it reads."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import stats

from pmcl.geometry import wrap
from pmcl.logs.joined import first_rows
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.editing import edit_beams, edit_landmarks, edit_lidars
from pmcl.models.effects.effect import Effect, Where
from pmcl.models.effects.landmarks import reads_bearing, reads_distance
from pmcl.models.effects.odometry import moves
from pmcl.models.effects.ranges import reads_ranges, reads_ranges_or_scans
from pmcl.models.parameters import Parameter
from pmcl.models.part import Float
from pmcl.models.tables import Tables

__all__ = ["MOUNT_EFFECTS"]

# Greatest angle to the optical axis [rad] at which the depth still determines the distance (chosen by hand).
_WIDEST = 1.4


def reads_anything(log: RobotLog) -> bool:
    """Return whether the log has any readings."""
    return log.n_readings > 0


def has_direction(log: RobotLog) -> bool:
    """Return whether turning the sensor would change its readings; it does not change distances to landmarks."""
    bearing = log.landmark_bearing
    return reads_ranges_or_scans(log) or (bearing is not None and not bool(np.isnan(bearing).all()))


def _remount(tables: Tables, name: str, beams: Any, landmarks: Any, lidars: Any) -> Tables:
    tables = edit_beams(tables, beams, name, required=False)
    tables = edit_lidars(tables, lidars, name, required=False)
    return edit_landmarks(tables, landmarks, name, required=False)


def _sensor_yaw(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    (yaw,) = values
    c, s = np.cos(yaw), np.sin(yaw)

    def ring(beams: Any) -> Any:
        # The ring turns as a whole, around the robot's centre.
        pose = beams.beam_pose.copy()
        x, y = beams.beam_pose[:, 0], beams.beam_pose[:, 1]
        pose[:, 0], pose[:, 1] = c * x - s * y, s * x + c * y
        pose[:, 2] += yaw
        return {"beam_pose": pose}

    def camera(seen: Any) -> Any:
        # A camera turns about its own axis.
        return {"sensor_pose": seen.sensor_pose + np.array([0.0, 0.0, yaw])}

    def laser(scans: Any) -> Any:
        # So does each laser.
        return {"beam_pose": scans.beam_pose + np.array([0.0, 0.0, yaw])}

    return _remount(tables, "sensor-yaw", ring, camera, laser)


def _turned_back(path: Float, values: Float, log: RobotLog) -> Float:
    carried = path.copy()
    carried[:, 2] -= values[0]
    return carried


def _sensor_offset(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    offset = np.array([values[0], values[1], 0.0])
    return _remount(
        tables,
        "sensor-offset",
        lambda beams: {"beam_pose": beams.beam_pose + offset},
        lambda seen: {"sensor_pose": seen.sensor_pose + offset},
        lambda scans: {"beam_pose": scans.beam_pose + offset},
    )


def _moved_back(path: Float, values: Float, log: RobotLog) -> Float:
    carried = path.copy()
    c, s = np.cos(path[:, 2]), np.sin(path[:, 2])
    carried[:, 0] -= c * values[0] - s * values[1]
    carried[:, 1] -= s * values[0] + c * values[1]
    return carried


def _latency(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    pause = np.diff(log.times)
    lag = np.concatenate([[0.0], values[0] / pause])
    lag[first_rows(log)] = 0.0  # what a joined log read at first is not of where another one ended

    def edit(table: Any) -> dict[str, Any]:
        return {"lag": table.lag + lag}

    return _remount(tables, "sensor-latency", edit, edit, edit)


def _sooner(path: Float, values: Float, log: RobotLog) -> Float:
    carried = path.copy()
    for d in range(3):
        carried[:, d] = np.interp(log.times + values[0], log.times, path[:, d])
    return carried


def _moves_and_reads(log: RobotLog) -> bool:
    return reads_anything(log) and moves(log)


def _depth(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    (depth,) = values

    def ring(beams: Any) -> Any:
        return {"scale": beams.scale * (1.0 - depth + depth * np.cos(beams.beam_pose[:, 2]))}

    tables = edit_beams(tables, ring, "range-is-depth", required=False)
    return edit_landmarks(tables, lambda seen: {"depth": float(depth)}, "range-is-depth", required=False)


def _looks_ahead(log: RobotLog) -> bool:
    """Return whether the range sensor may have an optical axis: its beams differ and all point ahead."""
    if reads_ranges(log) and log.beam_poses is not None:
        aside = np.abs(wrap(log.beam_poses[:, 2]))
    elif reads_distance(log) and reads_bearing(log) and log.landmark_bearing is not None:
        aside = np.abs(wrap(log.landmark_bearing[~np.isnan(log.landmark_bearing)]))
    else:
        return False
    return bool(0.05 < aside.max(initial=0.0) < _WIDEST)


MOUNT_EFFECTS = (
    Effect(
        name="sensor-yaw",
        summary="The whole sensor (ring of beams, camera) is mounted at another angle than described.",
        finding="the whole sensor points {0} too far {0:left|right}",
        parameters=(Parameter("sensor_yaw", "rad", stats.norm(scale=0.15), "by how much the sensor points too far "
                              "left"),),
        null=(0.0,),
        change=_sensor_yaw,
        symptom="The robot seems to drive sideways: the heading that fits the readings is not the one it drives along.",
        typical={"just visible": (0.03,), "clear": (0.1,), "large": (0.25,)},
        means_only=True,
        near_twins={
            "odometry-side-drift": "turn on the spot or drive backwards: for pure forward driving the two are the same",
            "range-noise-correlated": "turn often",
        },
        references=("Censi, Franchi, Marchionni, Oriolo, Simultaneous Calibration of Odometry and Sensor Parameters "
                    "for Mobile Robots, 2013",),
        needs=has_direction,
        carries=_turned_back,
        rigid=True,
    ),
    Effect(
        name="sensor-offset",
        summary="The whole sensor sits ahead of, behind or beside where it is described.",
        finding="the whole sensor sits {0} farther {0:ahead|back} and {1} farther {1:left|right} than described",
        parameters=(
            Parameter("sensor_offset_x", "m", stats.norm(scale=0.15), "how far ahead of its described place"),
            Parameter("sensor_offset_y", "m", stats.norm(scale=0.15), "how far left of its described place"),
        ),
        null=(0.0, 0.0),
        change=_sensor_offset,
        symptom="When the robot turns on the spot, its readings move as if it went around a circle.",
        typical={"just visible": (0.03, 0.0), "clear": (0.1, 0.05), "large": (0.25, 0.15)},
        means_only=True,
        near_twins={"odometry-turn-bias": "turn both ways: without turns an offset cannot be told from the pose"},
        references=("Censi, Franchi, Marchionni, Oriolo, Simultaneous Calibration of Odometry and Sensor Parameters "
                    "for Mobile Robots, 2013",),
        needs=reads_anything,
        carries=_moved_back,
        rigid=True,
    ),
    Effect(
        name="sensor-latency",
        summary="Readings are older than their time stamps say (or newer, when negative).",
        finding="readings are {0} {0:older|newer} than their time stamps say",
        parameters=(Parameter("sensor_latency", "s", stats.norm(scale=0.3), "how old readings are"),),
        null=(0.0,),
        change=_latency,
        symptom="Readings lag behind while the robot turns or speeds up, and are right while it stands.",
        typical={"just visible": (0.05,), "clear": (0.2,), "large": (0.5,)},
        near_twins={
            "odometry-forward-scale": "start and stop often: when driving straight at one speed the two are the same",
            "odometry-latency": "the same in relative terms: only an absolute pose, or odometry noise, tells which of "
            "the two is late",
        },
        references=("Furgale, Rehder, Siegwart, Unified Temporal and Spatial Calibration, IROS 2013",),
        needs=_moves_and_reads,
        carries=_sooner,
    ),
    Effect(
        name="range-is-depth",
        summary="What is logged as distance is the depth along the optical axis, shorter towards the edge of the view.",
        finding="what is logged as distance is to {0:%} the depth along the optical axis",
        parameters=(Parameter("range_is_depth", "1", stats.uniform(), "how much so: 0 distance, 1 depth"),),
        null=(0.0,),
        change=_depth,
        symptom="Distances are right in the middle of the view and too short at its edges.",
        typical={"just visible": (0.15,), "clear": (0.5,), "large": (0.9,)},
        near_twins={"range-scale": "see things both in the middle and at the edge of the view"},
        references=("Szeliski, Computer Vision: Algorithms and Applications, 2022, section 13.2",),
        needs=_looks_ahead,
    ),
)  # fmt: skip
