"""Reader of CARMEN's text logs (http://carmen.sourceforge.net/logger_playback.html).

Each line is a message: a name, its fields, a time stamp, a host, and the time of logging. Poses are in metres and
radians. Scans are lines ``FLASER`` (the older form: ranges, pose of the laser, pose of the robot) or ``ROBOTLASER1``
(angles and the greatest range besides). Odometry is in ``ODOM`` and in the scans themselves; ``TRUEPOS`` comes from
CARMEN's simulator.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.defaults import MAX_BEAMS, UPDATE_MIN_A, UPDATE_MIN_D, UPDATE_RULES
from pmcl.geometry import between, wrap
from pmcl.logs.amcl_rows import thinned
from pmcl.logs.lidar_recording import LidarRecording, RowSettings, log_of_lidars, require_few_readings
from pmcl.logs.robot_log import RobotLog
from pmcl.logs.scan_lines import PoseLines, ScanLines
from pmcl.logs.text_lines import Line, lines_of, numbers_in
from pmcl.logs.validation import fail
from pmcl.maps.occupancy_grid import OccupancyGrid

__all__ = ["read_carmen"]

Float = NDArray[np.float64]

# Greatest range of the laser of FLASER lines, where no PARAM line states it [m]: what the SICK LMS of these robots
# reports in its mode of centimetres.
_FLASER_MAX_RANGE = 81.9
# Fields after those that a message names: time stamp, host, time of logging.
_TAIL = 3
# How far poses of laser and robot may stray from a fixed mount [m, rad]; they are written with six digits.
_SAME_MOUNT = 0.01


class _Message(NamedTuple):
    """What a line of a scan says."""

    ranges: Float
    laser: Float
    robot: Float
    first: float
    step: float
    max_range: float | None


class _Contents:
    """What was read of a file."""

    def __init__(self, max_beams: int | None) -> None:
        self.scans = {"FLASER": ScanLines(max_beams), "ROBOTLASER1": ScanLines(max_beams)}
        self.first_scan: dict[str, _Message] = {}
        self.mounts: dict[str, list[Float]] = {name: [] for name in self.scans}
        self.odometry, self.truth = PoseLines(), PoseLines()
        self.parameters: dict[str, str] = {}
        self.n_cut_off = 0


def read_carmen(
    path: str | os.PathLike[str],
    *,
    laser_pose: Sequence[float] | None = None,
    grid_map: OccupancyGrid | None = None,
    update_min_d: float = UPDATE_MIN_D,
    update_min_a: float = UPDATE_MIN_A,
    update_rule: str = UPDATE_RULES[0],
    max_beams: int | None = MAX_BEAMS,
    begin: float = 0.0,
    duration: float | None = None,
    start: str | Sequence[float] | None = None,
) -> RobotLog:
    """Read scans and odometry of a CARMEN log.

    Parameters
    ----------
    path : path
        The text, compressed by gzip or not.
    laser_pose : sequence of float, optional
        Where the laser sits on the robot (x, y, yaw) [m, m, rad]. By default what ``PARAM robot_frontlaser_offset``
        says, else what the poses of laser and robot in the scans say.
    grid_map, update_min_d, update_min_a, update_rule, max_beams, begin, duration, start : optional
        As :func:`~pmcl.logs.bags.read.read_bag` takes them.

    Returns
    -------
    RobotLog
        Of ``ROBOTLASER1`` where there are such lines, else of ``FLASER``, whose rays span half a turn, with one degree
        between 180 rays and half a degree between 360. ``TRUEPOS`` lines become the reference trajectory.

    Raises
    ------
    LogError
        When the file is missing or no CARMEN log, a line is malformed, or laser and robot have no fixed distance; and
        as :func:`~pmcl.logs.lidar_recording.log_of_lidars` raises it.
    """
    where = os.fspath(path)
    thinned(1, max_beams)
    contents = _read(path, where, max_beams)
    kind = "ROBOTLASER1" if len(contents.scans["ROBOTLASER1"]) else "FLASER"
    scans = contents.scans[kind]
    if not len(scans):
        fail(where, "expected lines FLASER or ROBOTLASER1 of a CARMEN log, got none: check the file")
    message = contents.first_scan[kind]
    max_range = message.max_range
    if max_range is None:
        stated = numbers_in([contents.parameters.get("robot_front_laser_max", str(_FLASER_MAX_RANGE))])
        max_range = float(stated[0]) if stated is not None and stated[0] > 0.0 else _FLASER_MAX_RANGE
    mount = _mount(contents, kind, laser_pose, where)
    lidar, n_others = scans.stream(message.first, message.step, 0.0, max_range, mount, where)
    assert lidar.poses is not None
    times, poses = contents.odometry.arrays()
    if not len(times):
        times, poses = lidar.times, lidar.poses
    return log_of_lidars(
        LidarRecording((lidar,), times, poses, *contents.truth.arrays()),
        RowSettings(update_min_d, update_min_a, update_rule, begin, duration, start),
        grid_map=grid_map,
        robot="CARMEN robot",
        source=f"{Path(path).name}: {kind}",
        dropped={"dropped_scans_of_another_shape": n_others, "dropped_lines_that_are_cut_off": contents.n_cut_off},
        where=where,
    )


def _read(path: str | os.PathLike[str], where: str, max_beams: int | None) -> _Contents:
    contents = _Contents(max_beams)
    for line in lines_of(path):
        name = line.words[0]
        if name == "PARAM" and len(line.words) >= 3:
            contents.parameters[line.words[1]] = line.words[2]
        elif name in ("ODOM", "TRUEPOS", *contents.scans) and not _add(contents, name, line, where):
            if not line.is_whole:
                contents.n_cut_off += 1
                continue
            fail(
                f"{where}, line {line.number}",
                f"expected the fields of a CARMEN message {name}, got {len(line.words) - 1} words that do not fit: "
                "correct or remove the line",
            )
    return contents


def _add(contents: _Contents, name: str, line: Line, where: str) -> bool:
    """Add one message; False when the line is malformed."""
    if len(line.words) <= _TAIL + 1:
        return False
    body, stamp = numbers_in(line.words[1:-_TAIL]), numbers_in([line.words[-_TAIL]])
    if body is None or stamp is None:
        return False
    time = float(stamp[0])
    if name in ("ODOM", "TRUEPOS"):
        if len(body) != 6:
            return False
        (contents.odometry if name == "ODOM" else contents.truth).add(time, body[:3])
        return True
    message = _flaser(body) if name == "FLASER" else _robotlaser(body)
    if message is None:
        return False
    contents.first_scan.setdefault(name, message)
    contents.scans[name].add(time, message.robot, message.ranges)
    require_few_readings(contents.scans[name].n_readings, where)
    contents.mounts[name].append(between(message.robot, message.laser))
    return True


def _flaser(body: Float) -> _Message | None:
    n = int(body[0])
    if n < 0 or len(body) != 1 + n + 6:
        return None
    # A laser with n or n + 1 rays on half a turn: 180 and 181 rays have the same angles.
    step = math.pi / max(n - n % 2, 1)
    return _Message(body[1 : 1 + n], body[1 + n : 4 + n], body[4 + n : 7 + n], -0.5 * math.pi, step, None)


def _robotlaser(body: Float) -> _Message | None:
    # laser_type start_angle field_of_view angular_resolution maximum_range accuracy remission_mode n ranges
    # n_remissions remissions laser_pose robot_pose tv rv forward_safety_dist side_safety_dist turn_axis
    if len(body) < 9 or body[7] < 0:
        return None
    n = int(body[7])
    if len(body) < 9 + n:
        return None
    rest = body[9 + n + max(int(body[8 + n]), 0) :]
    if len(rest) != 11 or body[3] <= 0.0 or body[4] <= 0.0:
        return None
    return _Message(body[8 : 8 + n], rest[:3], rest[3:6], float(body[1]), float(body[3]), float(body[4]))


def _mount(contents: _Contents, kind: str, stated: Sequence[float] | None, where: str) -> Float:
    if stated is not None:
        return np.asarray(stated, dtype=np.float64)
    offset = numbers_in([contents.parameters.get("robot_frontlaser_offset", "none")])
    if offset is not None:
        return np.array([float(offset[0]), 0.0, 0.0])
    mounts = np.array(contents.mounts[kind])
    middle = np.append(np.median(mounts[:, :2], axis=0), mounts[0, 2])
    away = np.abs(np.column_stack((mounts[:, :2] - middle[:2], wrap(mounts[:, 2] - middle[2]))))
    if np.mean((away > _SAME_MOUNT).any(axis=1)) > 0.05:
        fail(
            where,
            f"expected the poses of laser and robot in {kind} lines at a fixed distance, got differences of up to "
            f"{away.max():.3g}: the poses of lasers were corrected afterwards; state the mount with --laser-pose",
        )
    return middle
