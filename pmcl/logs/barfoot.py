"""Reader of the "Lost in the Woods" recording of T. Barfoot's course on state estimation for robotics.

A MAT-file with wheel odometry, a laser that detects 17 tubes, and motion-capture poses, all at 10 Hz. The laser sits
`d` metres ahead of the robot's centre, which the log states as ``landmark_sensor_pose``. The poses are those of the
centre: with the laser `d` = 0.219 m ahead of them the distances fit within 0.030 m (the publisher's figure), with the
laser on them only within 0.12 m, and turning in place moves them sideways by 0.009 m per radian. Their heading is the
laser's (bearings fit without offset); the robot itself drives 0.08 rad to the right of it. The data stay as they are.
"""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat, whosmat

from pmcl.errors import LogError
from pmcl.logs.recording import LandmarkRecording, landmark_map, resample_recording
from pmcl.logs.robot_log import RobotLog
from pmcl.logs.schema import MOST_NUMBERS
from pmcl.logs.validation import fail
from pmcl.maps.arrays import as_numbers

__all__ = ["read_barfoot"]

Float = NDArray[np.float64]

_VECTORS = ("t", "v", "om", "x_true", "y_true", "th_true", "true_valid")
_FILE = "dataset2.mat"


def read_barfoot(
    path: str | os.PathLike[str],
    period: float = 1.0,
    *,
    start: str = "reference",
    begin: float = 0.0,
    duration: float | None = None,
    max_offset: float | None = 0.05,
) -> RobotLog:
    """Read the recording.

    Parameters
    ----------
    path : path
        The MAT-file, or the folder with ``dataset2.mat``.
    period : float, optional
        Time between samples [s]. One second turns 21 minutes at 10 Hz into 1261 samples: a tenth of the work, steps of
        some 0.25 m, and errors of the measured turns that are independent from step to step (correlation 0.04 between
        neighbours), as noise models assume; at 10 Hz it is -0.2.
    start : {"reference", "anywhere"}, optional
        What is believed about the first pose: the robot was placed at a known pose (the first reference pose, within
        0.1 m and 0.1 rad), or nothing.
    begin, duration : float, optional
        Part of the recording [s]; all of it by default.
    max_offset : float or None, optional
        Readings further from the nearest sample are dropped [s]. The default keeps the scan taken at each sample and
        nothing else; None takes the scan nearest to the sample that saw the landmark.

    Returns
    -------
    RobotLog
        The reference is NaN where the publisher marks it as not valid for longer than half a second.

    Raises
    ------
    LogError
        When the file is missing, no MAT-file, or lacks a variable; see also
        :func:`~pmcl.logs.recording.resample_recording`.
    """
    file = Path(path)
    file = file / _FILE if file.is_dir() else file
    where = os.fspath(file)
    data = _load(file, where)
    times = data["t"]
    if not (np.diff(times) > 0.0).all():
        k = int(np.argmax(np.diff(times) <= 0.0)) + 1
        fail(where, f"expected increasing times in 't', got {times[k]:g} s at index {k}: sort the rows")
    step, tube = np.nonzero(data["r"] > 0.0)
    valid = data["true_valid"] == 1.0
    recording = LandmarkRecording(
        hold_times=times,
        forward_velocity=data["v"],
        angular_velocity=data["om"],
        reading_times=times[step],
        reading_landmark=tube.astype(np.int64),
        reading_values=np.column_stack((data["r"][step, tube], data["b"][step, tube])),
        landmarks=landmark_map(data["l"], f"{where}, 'l'"),
        sensor_pose=np.array([data["d"][0], 0.0, 0.0]),
        pose_times=times[valid],
        poses=np.column_stack((data["x_true"], data["y_true"], data["th_true"]))[valid],
    )
    return resample_recording(
        recording,
        period=period,
        start=start,
        begin=begin,
        duration=duration,
        max_offset=max_offset,
        robot="wheeled robot with a laser",
        source="Lost in the Woods (T. Barfoot)",
        dropped={},
        where=where,
    )


def _load(file: Path, where: str) -> dict[str, Float]:
    if not file.is_file():
        fail(where, "expected the MAT-file of the recording, got no such file: check the path")
    try:
        shapes = {name: shape for name, shape, _ in whosmat(file)}
        names = [name for name in (*_VECTORS, "d", "r", "b", "l") if name in shapes]
        n_numbers = sum(math.prod(shapes[name]) for name in names)
        if n_numbers > MOST_NUMBERS:
            fail(where, f"expected at most {MOST_NUMBERS} numbers, got {n_numbers}: cut the recording into parts")
        content = loadmat(file, variable_names=names)
    except LogError:
        raise
    except MemoryError:
        raise
    except Exception as problem:  # a damaged file makes the parser fail in whatever way its bytes suggest
        fail(where, f"expected a MAT-file, got one that cannot be read ({problem}): copy it again")
    data: dict[str, Float] = {}
    for name in (*_VECTORS, "d", "r", "b", "l"):
        if name not in content:
            fail(where, f"expected variable '{name}', got none: is this the Lost in the Woods recording?")
        try:
            data[name] = as_numbers(content[name])
        except TypeError as problem:
            fail(where, f"expected numbers in '{name}', got {problem}: copy the file again")
        if not data[name].size or not np.isfinite(data[name]).all():
            fail(where, f"expected finite numbers in '{name}', got none or others: copy the file again")
    data |= {name: data[name].ravel() for name in (*_VECTORS, "d")}
    n, tubes = len(data["t"]), len(data["l"])
    shapes = {**dict.fromkeys(_VECTORS, (n,)), "d": (1,), "r": (n, tubes), "b": (n, tubes), "l": (tubes, 2)}
    for name, shape in shapes.items():
        if data[name].shape != shape:
            fail(
                where, f"expected '{name}' of shape {shape} as 't' and 'l' imply, got {data[name].shape}: copy it again"
            )
    return data
