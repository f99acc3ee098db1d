"""Reader of the UTIAS Multi-Robot Cooperative Localization and Mapping data sets.

Leung, Halpern, Barfoot, Liu, "The UTIAS multi-robot cooperative localization and mapping dataset", IJRR 30(8), 2011.
Text tables: commanded velocities, distance and bearing to barcodes seen by a camera, motion-capture poses. The camera's
readings refer to the robot's centre.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pmcl.logs.recording import LandmarkRecording, landmark_map, resample_recording
from pmcl.logs.robot_log import RobotLog
from pmcl.logs.text_table import read_table
from pmcl.logs.validation import fail
from pmcl.maps.landmarks import LandmarkMap

__all__ = ["read_mrclam"]

Float = NDArray[np.float64]

# Subjects 1 to 5 are the robots themselves, which move.
_LAST_ROBOT = 5
# The published numbers have two digits.
_GREATEST_NUMBER = 1e9


def read_mrclam(
    folder: str | os.PathLike[str],
    robot: int = 1,
    period: float = 0.5,
    *,
    start: str = "reference",
    begin: float = 0.0,
    duration: float | None = None,
    max_offset: float | None = None,
) -> RobotLog:
    """Read one robot's log of a data set.

    Parameters
    ----------
    folder : path
        Folder with ``Barcodes.dat``, ``Landmark_Groundtruth.dat`` and ``RobotN_*.dat``. Without
        ``RobotN_Groundtruth.dat`` the log has no reference trajectory, and only ``start="anywhere"`` is possible.
    robot : int, optional
        N.
    period : float, optional
        Time between samples [s]. At the robots' speeds of about 0.1 m/s, half a second is a step of a few centimetres.
    start : {"reference", "anywhere"}, optional
        What is believed about the first pose: the robot was placed at a known pose (the first reference pose, within
        0.1 m and 0.1 rad), or nothing.
    begin, duration : float, optional
        Part of the recording [s]; all of it by default. Time zero is when both velocities and reference have begun.
    max_offset : float, optional
        Readings further from the nearest sample are dropped [s]; half a period by default, which keeps all.

    Returns
    -------
    RobotLog
        Landmarks are named by their subject number. Sightings of other robots and of barcodes that no subject carries
        are left out; attributes ``dropped_robots`` and ``dropped_unknown_barcodes`` count them.

    Raises
    ------
    LogError
        When a file is missing, a line is malformed, or there is no such robot; see also
        :func:`~pmcl.logs.recording.resample_recording`.
    """
    place = Path(folder)
    where = os.fspath(folder)
    if not place.is_dir():
        fail(where, "expected a folder with RobotN_Odometry.dat, got no such folder: check the path")
    numbers = sorted(int(m[1]) for p in place.iterdir() if (m := re.fullmatch(r"Robot(\d+)_Odometry\.dat", p.name)))
    if robot not in numbers:
        known = ", ".join(map(str, numbers)) or "none"
        fail(where, f"expected the number of a robot in this folder ({known}), got {robot}: choose one of these")
    odometry = _in_order(place / f"Robot{robot}_Odometry.dat", ("time", "forward velocity", "angular velocity"))
    readings = read_table(place / f"Robot{robot}_Measurement.dat", ("time", "barcode", "range", "bearing"))
    truth_path = place / f"Robot{robot}_Groundtruth.dat"
    truth = _in_order(truth_path, ("time", "x", "y", "heading")) if truth_path.exists() else np.empty((0, 4))
    if (np.diff(truth[:, 0]) == 0.0).any():
        truth = truth[np.append(True, np.diff(truth[:, 0]) > 0.0)]
    landmarks, subject_of, index_of = _landmarks(place)
    _require_whole(readings[:, 1:2], place / f"Robot{robot}_Measurement.dat")
    subject = np.array([subject_of.get(int(code), 0) for code in readings[:, 1]], dtype=np.int64)
    index = np.array([index_of.get(s, -1) for s in subject], dtype=np.int64)
    robots = (subject >= 1) & (subject <= _LAST_ROBOT)
    seen = index >= 0
    recording = LandmarkRecording(
        hold_times=odometry[:, 0],
        forward_velocity=odometry[:, 1],
        angular_velocity=odometry[:, 2],
        reading_times=readings[seen, 0],
        reading_landmark=index[seen],
        reading_values=readings[seen, 2:],
        landmarks=landmarks,
        sensor_pose=np.zeros(3),
        pose_times=truth[:, 0],
        poses=truth[:, 1:],
    )
    return resample_recording(
        recording,
        period=period,
        start=start,
        begin=begin,
        duration=duration,
        max_offset=max_offset,
        robot=f"iRobot Create {robot}",
        source=f"UTIAS MRCLAM, robot {robot}",
        dropped={"dropped_robots": int(robots.sum()), "dropped_unknown_barcodes": int((~seen & ~robots).sum())},
        where=where,
    )


def _landmarks(folder: Path) -> tuple[LandmarkMap, dict[int, int], dict[int, int]]:
    """Map of landmarks, subject of each barcode, and index of each subject that is a landmark."""
    barcodes = read_table(folder / "Barcodes.dat", ("subject", "barcode"))
    table = read_table(folder / "Landmark_Groundtruth.dat", ("subject", "x", "y", "x std-dev", "y std-dev"))
    _require_whole(barcodes, folder / "Barcodes.dat")
    _require_whole(table[:, :1], folder / "Landmark_Groundtruth.dat")
    table = table[table[:, 0] > _LAST_ROBOT]
    subjects = [int(s) for s in table[:, 0]]
    if not subjects:
        fail(
            os.fspath(folder / "Landmark_Groundtruth.dat"), "expected landmarks (subjects 6 and up), got none: add them"
        )
    index_of = {subject: j for j, subject in enumerate(subjects)}
    subject_of = {int(barcode): int(subject) for subject, barcode in barcodes}
    landmarks = landmark_map(table[:, 1:3], os.fspath(folder / "Landmark_Groundtruth.dat"), tuple(map(str, subjects)))
    return landmarks, subject_of, index_of


def _require_whole(numbers: Float, path: Path) -> None:
    bad = np.argwhere((numbers != np.rint(numbers)) | (np.abs(numbers) > _GREATEST_NUMBER))
    if len(bad):
        row, column = (int(k) for k in bad[0])
        fail(
            os.fspath(path),
            f"expected whole numbers of subjects and barcodes, got {numbers[row, column]:g} in data row {row}: "
            "correct it",
        )


def _in_order(path: Path, columns: tuple[str, ...]) -> Float:
    table = read_table(path, columns)
    back = np.flatnonzero(np.diff(table[:, 0]) < 0.0)
    if back.size:
        k = int(back[0]) + 1
        fail(
            os.fspath(path),
            f"expected times that do not decrease, got {table[k, 0]:.3f} s after {table[k - 1, 0]:.3f} s "
            f"in data row {k}: sort the lines",
        )
    return table
