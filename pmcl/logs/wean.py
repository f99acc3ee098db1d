"""Reader of the Wean Hall recordings of CMU: laser and odometry of a robot in an office building.

Lines ``O x y heading time`` hold odometry poses, lines ``L x y heading xl yl headingl r1 ... r180 time`` the poses of
robot and laser in the odometry's frame at a scan, and its ranges from right to left. Lengths are in centimetres, angles
in radians, times in seconds.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pmcl.defaults import MAX_BEAMS, UPDATE_MIN_A, UPDATE_MIN_D, UPDATE_RULES
from pmcl.geometry import between
from pmcl.logs.amcl_rows import thinned
from pmcl.logs.lidar_recording import LidarRecording, RowSettings, log_of_lidars, require_few_readings
from pmcl.logs.robot_log import RobotLog
from pmcl.logs.scan_lines import PoseLines, ScanLines
from pmcl.logs.text_lines import lines_of, numbers_in
from pmcl.logs.validation import fail
from pmcl.maps.occupancy_grid import OccupancyGrid

__all__ = ["find_wean_log", "read_wean"]

Float = NDArray[np.float64]

# The laser writes 8183 cm and more where nothing came back; the longest echo in both recordings is below 60 m.
_MAX_RANGE = 81.83
_CENTIMETRE = 0.01
_N_POSES = 6  # numbers of both poses before the ranges


def find_wean_log(source: str | os.PathLike[str]) -> Path:
    """Return the recording that a path means: the file itself, or the only ``robotdataN.log`` in a folder.

    Raises
    ------
    LogError
        When a folder holds none, or several.
    """
    path = Path(source)
    if not path.is_dir():
        return path
    logs = sorted(path.glob("robotdata*.log*"))
    if len(logs) != 1:
        held = ", ".join(log.name for log in logs) or "none"
        fail(os.fspath(source), f"expected a folder with one robotdataN.log, got {held}: give the file itself")
    return logs[0]


def read_wean(
    path: str | os.PathLike[str],
    *,
    grid_map: OccupancyGrid | None = None,
    update_min_d: float = UPDATE_MIN_D,
    update_min_a: float = UPDATE_MIN_A,
    update_rule: str = UPDATE_RULES[0],
    max_beams: int | None = MAX_BEAMS,
    begin: float = 0.0,
    duration: float | None = None,
    start: str | Sequence[float] | None = None,
) -> RobotLog:
    """Read scans and odometry of a Wean Hall recording.

    Parameters
    ----------
    path : path
        A ``robotdataN.log``, or a folder with one of them.
    grid_map, update_min_d, update_min_a, update_rule, max_beams, begin, duration, start : optional
        As :func:`~pmcl.logs.bags.read.read_bag` takes them; :func:`pmcl.maps.wean.read_wean_map` reads the map.

    Returns
    -------
    RobotLog
        The poses that the scans state are used as they are, and say where the laser sits on the robot.

    Raises
    ------
    LogError
        When the file is missing or of another format, or a line is malformed; and as
        :func:`~pmcl.logs.lidar_recording.log_of_lidars` raises it.
    """
    file = find_wean_log(path)
    where = os.fspath(file)
    thinned(1, max_beams)
    scans, odometry = ScanLines(max_beams), PoseLines()
    mounts: list[Float] = []
    cut_off = 0
    for line in lines_of(file):
        kind, numbers = line.words[0], numbers_in(line.words[1:])
        fits = numbers is not None and (
            (kind == "O" and len(numbers) == 4) or (kind == "L" and len(numbers) > _N_POSES + 1)
        )
        if not line.is_whole:
            # A line that is cut off still holds numbers, of which the last one would pass for its time.
            cut_off += 1
        elif not fits or numbers is None:
            fail(
                f"{where}, line {line.number}",
                "expected 'O x y heading time' or 'L x y heading xl yl headingl ranges time', got "
                f"'{' '.join(line.words)[:40]}': check that this is a Wean recording",
            )
        else:
            robot = _in_metres(numbers[:3])
            odometry.add(numbers[-1], robot)
            if kind == "L":
                scans.add(numbers[-1], robot, _CENTIMETRE * numbers[_N_POSES:-1])
                require_few_readings(scans.n_readings, where)
                mounts.append(between(robot, _in_metres(numbers[3:_N_POSES])))
    if not len(scans):
        fail(where, "expected scans (lines L), got none: check the file")
    # Poses are written with six digits, so each line tells the mount within a few micrometres.
    mount = np.median(np.array(mounts), axis=0)
    lidar, n_others = scans.stream(-0.5 * math.pi, None, 0.0, _MAX_RANGE, mount, where)
    return log_of_lidars(
        LidarRecording((lidar,), *odometry.arrays(), np.zeros(0), np.zeros((0, 3))),
        RowSettings(update_min_d, update_min_a, update_rule, begin, duration, start),
        grid_map=grid_map,
        robot="Wean robot",
        source=f"CMU Wean Hall, {file.name}",
        dropped={"dropped_scans_of_another_shape": n_others, "dropped_lines_that_are_cut_off": cut_off},
        where=where,
    )


def _in_metres(pose: Float) -> Float:
    return np.array([_CENTIMETRE * pose[0], _CENTIMETRE * pose[1], pose[2]])
