"""The variables of a robot log: names, dimensions, units. The one place that spells the file format out."""

from __future__ import annotations

from typing import NamedTuple

__all__ = [
    "FORMAT",
    "LABELS",
    "LANDMARK_READINGS",
    "READINGS",
    "REFERENCE",
    "VARIABLES",
    "Variable",
]

FORMAT = "pmcl-log/1"


class Variable(NamedTuple):
    """One variable of the format.

    Attributes
    ----------
    dims : tuple of str
        Dimensions, in the order in which pmcl stores them.
    units : str
        One unit, or one for each component of the last axis.
    long_name : str
        What it means.
    """

    dims: tuple[str, ...]
    units: str
    long_name: str


_SIGHTING = ("time", "landmark")

VARIABLES: dict[str, Variable] = {
    "time": Variable(("time",), "s", "sample times"),
    "odometry": Variable(("time", "increment"), "m, m, rad", "displacement from the previous sample, in its frame"),
    "range": Variable(("time", "beam"), "m", "range readings; NaN not measured, inf or max_range no echo"),
    "beam_pose": Variable(("beam", "pose"), "m, m, rad", "where each beam sits on the robot"),
    "landmark_range": Variable(_SIGHTING, "m", "distance reading to a landmark; NaN not seen"),
    "landmark_bearing": Variable(_SIGHTING, "rad", "bearing reading in the sensor frame; NaN not seen"),
    "landmark_size": Variable(_SIGHTING, "pixel", "apparent size; NaN not seen"),
    "landmark_time_offset": Variable(_SIGHTING, "s", "time of the reading minus time of its sample"),
    "landmark_position": Variable(("landmark", "xy"), "m", "landmark map"),
    "landmark_sensor_pose": Variable(("pose",), "m, m, rad", "where the landmark sensor sits on the robot"),
    "wall": Variable(("wall_index", "end", "xy"), "m", "segment map"),
    "start_mean": Variable(("pose",), "m, m, rad", "mean of the belief about the pose at row 0"),
    "start_std": Variable(("pose",), "m, m, rad", "standard deviation of that belief; inf anywhere on the map"),
    "true_pose": Variable(("time", "pose"), "m, m, rad", "reference trajectory, for scoring only"),
}

LANDMARK_READINGS = ("landmark_range", "landmark_bearing", "landmark_size")
"""Variables that read known landmarks."""

READINGS = ("range", *LANDMARK_READINGS)
"""Variables that read the world; a log holds at least one."""

REFERENCE = ("true_pose",)
"""Variables that calibration and criticism never read."""

LABELS: dict[str, tuple[str, ...]] = {
    "increment": ("forward", "left", "turn"),
    "pose": ("x", "y", "heading"),
    "xy": ("x", "y"),
    "end": ("start", "stop"),
}
"""Dimensions of fixed size, and what their components are called."""
