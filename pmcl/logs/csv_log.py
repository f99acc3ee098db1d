"""Reader of CSV tables with a recording of one's own: one row for each sample.

Lengths are in metres, angles in radians, times in seconds, as everywhere. Columns:

========================================= ====================================================================
``time``                                  when the row was taken, strictly increasing
``odometry_forward``, ``odometry_left``,  the displacement since the row before, in the robot's frame there;
``odometry_turn``                         row 0 is ignored
``odom_x``, ``odom_y``, ``odom_heading``  or the pose that odometry has integrated, in any fixed frame
``range_0``, ``range_1``, ...             ranges of single beams
``scan_0``, ``scan_1``, ...               ranges of a lidar, ray by ray
``range_to_NAME``, ``bearing_to_NAME``    sightings of the landmark NAME
``true_x``, ``true_y``, ``true_heading``  reference trajectory, for scoring only
========================================= ====================================================================

An empty cell was not measured, ``inf`` is no echo. What the readings need stands above the header, as comments:

================================== ====================================================================================
``# robot: NAME``                  what moved
``# beam_0: X Y YAW``              where each beam sits on the robot
``# max_range: M``                 longest range of the beams
``# wall: X1 Y1 X2 Y2``            a wall of the map (one line for each)
``# scan_pose: X Y YAW``           where the lidar sits on the robot; at its centre by default
``# scan_angles: FIRST STEP``      angle of ray 0 in the lidar's frame, and angle between rays
``# scan_limits: MIN MAX``         limits of the lidar's readings
``# landmark NAME: X Y``           position of a landmark on the map
``# landmark_sensor: X Y YAW``     where the landmark sensor sits on the robot; at its centre by default
``# start: X Y YAW SX SY SYAW``    belief about the first pose, with its standard deviations; anywhere by default
================================== ====================================================================================

Landmarks that are seen at times of their own may stand in a second table with the columns ``time``, ``landmark``,
``range`` and ``bearing``, of which one of the last two may be missing.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import did_you_mean
from pmcl.logs.arrays import LidarScans
from pmcl.logs.csv_table import Table, read_csv_table
from pmcl.logs.odometry import odometry_from_poses
from pmcl.logs.recording import REFERENCE_START_STD, landmark_map
from pmcl.logs.robot_log import RobotLog
from pmcl.logs.streams import landmark_rows
from pmcl.logs.validation import fail
from pmcl.maps.landmarks import LandmarkMap
from pmcl.maps.occupancy_grid import OccupancyGrid

__all__ = ["read_csv"]

Float = NDArray[np.float64]

_INCREMENTS = ("odometry_forward", "odometry_left", "odometry_turn")
_POSES = ("odom_x", "odom_y", "odom_heading")
_TRUTH = ("true_x", "true_y", "true_heading")
_SETTINGS = (
    "robot", r"beam_\d+", "max_range", "wall", "scan_pose", "scan_angles", "scan_limits", r"landmark .+",
    "landmark_sensor", "start",
)  # fmt: skip
_COLUMNS = ("time", *_INCREMENTS, *_POSES, *_TRUTH)
_PATTERNS = (r"range_\d+", r"scan_\d+", r"range_to_.+", r"bearing_to_.+")


def read_csv(
    path: str | os.PathLike[str],
    *,
    sightings: str | os.PathLike[str] | None = None,
    grid_map: OccupancyGrid | None = None,
    start: str | Sequence[float] | None = None,
) -> RobotLog:
    """Read a table with one row for each sample, in the format that this module describes.

    Parameters
    ----------
    path : path
        The table.
    sightings : path, optional
        A second table, with sightings of landmarks at times of their own.
    grid_map : OccupancyGrid, optional
        The map of a lidar.
    start : {"reference", "anywhere"} or three floats, optional
        Belief about the first pose in place of the one in the table: the first reference pose, nothing, or this pose
        [m, m, rad]; poses within :data:`~pmcl.logs.recording.REFERENCE_START_STD`.

    Returns
    -------
    RobotLog

    Raises
    ------
    LogError, MapError
        When a file is missing, a column or setting is unknown, missing or malformed, or the log is not valid.
    """
    table = read_csv_table(path, _SETTINGS)
    where = table.where
    for name in table.columns:
        if name not in _COLUMNS and not any(re.fullmatch(pattern, name) for pattern in _PATTERNS):
            advice = did_you_mean(name, _COLUMNS, "'pmcl convert csv --help' lists them")
            fail(where, f"expected known columns, got '{name}': {advice}")
    times = _required(table, "time")
    truth = np.column_stack([table.numbers(n, may_be_missing=True) for n in _TRUTH]) if _has(table, _TRUTH) else None
    mean, std = _start(table, start, truth)
    odometry = _odometry(table)
    arguments: dict[str, Any] = {
        **_beams(table),
        **_lidar(table),
        **_landmarks(table, times, sightings),
    }
    return RobotLog.build(
        time=times,
        odometry=odometry,
        **arguments,
        start_mean=mean,
        start_std=std,
        true_poses=truth,
        grid_map=grid_map,
        robot=next((text for name, text, _ in table.settings if name == "robot"), ""),
        source=Path(path).name,
        where=where,
    )


def _required(table: Table, name: str) -> Float:
    if name not in table.columns:
        fail(table.where, f"expected a column '{name}', got {', '.join(list(table.columns)[:8])}: add it to the header")
    return table.numbers(name)


def _has(table: Table, names: Sequence[str]) -> bool:
    """Tell whether the table has some columns that belong together; LogError when it has a part of them."""
    found = [name in table.columns for name in names]
    if any(found) and not all(found):
        missing = ", ".join(name for name, there in zip(names, found, strict=True) if not there)
        fail(table.where, f"expected the columns {', '.join(names)} together, got no {missing}: add it")
    return all(found)


def _odometry(table: Table) -> Float:
    increments, poses = _has(table, _INCREMENTS), _has(table, _POSES)
    if increments == poses:
        came = "both" if poses else "neither"
        fail(
            table.where,
            f"expected odometry as increments ({', '.join(_INCREMENTS)}) or as poses ({', '.join(_POSES)}), got "
            f"{came}: give one of them",
        )
    columns = np.column_stack([table.numbers(name) for name in (_POSES if poses else _INCREMENTS)])
    return odometry_from_poses(columns) if poses else columns


def _series(table: Table, prefix: str) -> Float | None:
    """Return the columns ``prefix_0``, ``prefix_1``, ... as one array, shape (T, B); None when there are none."""
    count = sum(re.fullmatch(rf"{prefix}_\d+", name) is not None for name in table.columns)
    names = [f"{prefix}_{k}" for k in range(count)]
    missing = [name for name in names if name not in table.columns]
    if missing:
        fail(table.where, f"expected {count} columns {prefix}_0 to {prefix}_{count - 1}, got no {missing[0]}: add it")
    if not count:
        return None
    return np.column_stack([table.numbers(name, may_be_missing=True) for name in names])


def _needed(table: Table, name: str, count: int, what: str) -> Float:
    values = table.setting(name, count)
    if values is None:
        fail(table.where, f"expected the comment '# {name}: {what}' above the header, got none: add it")
    return values


def _beams(table: Table) -> dict[str, Any]:
    walls = [table.values_of(setting, 4) for setting in table.settings if setting[0] == "wall"]
    found: dict[str, Any] = {"walls": np.array(walls).reshape(-1, 2, 2)} if walls else {}
    ranges = _series(table, "range")
    if ranges is not None:
        poses = [_needed(table, f"beam_{k}", 3, "X Y YAW") for k in range(ranges.shape[1])]
        found |= {"ranges": ranges, "beam_poses": poses, "max_range": float(_needed(table, "max_range", 1, "M")[0])}
    return found


def _lidar(table: Table) -> dict[str, Any]:
    ranges = _series(table, "scan")
    if ranges is None:
        return {}
    first, step = _needed(table, "scan_angles", 2, "FIRST STEP")
    low, high = _needed(table, "scan_limits", 2, "MIN MAX")
    pose = table.setting("scan_pose", 3)
    angles = first + step * np.arange(ranges.shape[1])
    scans = LidarScans(ranges, angles, float(low), float(high), np.zeros(3) if pose is None else pose)
    return {"lidars": {"": scans}}


def _landmarks(table: Table, times: Float, sightings: str | os.PathLike[str] | None) -> dict[str, Any]:
    stated = [setting for setting in table.settings if setting[0].startswith("landmark ")]
    seen = [name for name in table.columns if re.fullmatch(r"(range|bearing)_to_.+", name)]
    if sightings is not None and seen:
        fail(table.where, f"expected sightings in this table or in {os.fspath(sightings)}, got both: give one of them")
    if not stated:
        if seen or sightings is not None:
            fail(table.where, "expected the comments '# landmark NAME: X Y' above the header, got none: add the map")
        return {}
    names = [setting[0].removeprefix("landmark ").strip() for setting in stated]
    landmarks = landmark_map([table.values_of(setting, 2) for setting in stated], table.where, tuple(names))
    found: dict[str, Any] = {"landmarks": landmarks}
    sensor = table.setting("landmark_sensor", 3)
    if sensor is not None:
        found["landmark_sensor_pose"] = sensor
    if sightings is not None:
        return found | _of_second_table(sightings, landmarks, times)
    for name in seen:
        kind, landmark = name.split("_to_", 1)
        if landmark not in names:
            fail(table.where, f"expected a comment '# landmark {landmark}: X Y' for column '{name}', got none: add it")
        column = found.setdefault(f"landmark_{kind}", np.full((len(times), len(names)), np.nan))
        column[:, names.index(landmark)] = table.numbers(name, may_be_missing=True)
    return found


def _of_second_table(path: str | os.PathLike[str], landmarks: LandmarkMap, times: Float) -> dict[str, Any]:
    table = read_csv_table(path, texts=("landmark",))
    seen_at = _required(table, "time")
    if "landmark" not in table.columns or not {"range", "bearing"} & set(table.columns):
        fail(table.where, "expected the columns time, landmark, and range or bearing, got others: correct the header")
    kinds = [name for name in ("range", "bearing") if name in table.columns]
    read: dict[str, Any] = {f"{name}s": table.numbers(name) for name in kinds}
    return landmark_rows(times, landmarks, seen_at, table.texts["landmark"], **read)


def _start(table: Table, start: str | Sequence[float] | None, truth: Float | None) -> tuple[Float | None, Float | None]:
    """Return mean and standard deviations of the belief about the first pose."""
    if start is None:
        stated = table.setting("start", 6)
        return (None, None) if stated is None else (stated[:3], stated[3:])
    if isinstance(start, str):
        if start != "reference":
            return None, None
        if truth is None or np.isnan(truth[0]).any():
            fail(table.where, "expected a true pose in the first row for start = 'reference', got none: state a pose")
        return truth[0], np.array(REFERENCE_START_STD)
    return np.asarray(start, dtype=np.float64), np.array(REFERENCE_START_STD)
