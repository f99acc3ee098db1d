"""The variables of a robot log: names, dimensions, units.

Every log has the variables that are declared here; each sensor declares its own (:mod:`pmcl.logs.sensor_variables`).
"""

from __future__ import annotations

from typing import NamedTuple

from pmcl.registry import sensor_variables

__all__ = [
    "FORMAT",
    "LABELS",
    "REFERENCE",
    "Variable",
    "plural_of",
    "readings",
    "variables",
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
    is_reading : bool
        Whether it holds readings of a sensor, NaN where nothing was measured.
    minimum : float or None
        Smallest possible reading; None where any number is possible.
    may_be_infinite : bool
        Whether an infinite reading has a meaning, such as "no echo".
    attributes : tuple of str
        Attributes of the variable that a log needs or may have, e.g. ``("max_range",)``.
    plural : str
        What several of its readings are called in messages and figures; its name with an "s" when left out.
    """

    dims: tuple[str, ...]
    units: str
    long_name: str
    is_reading: bool = False
    minimum: float | None = None
    may_be_infinite: bool = False
    attributes: tuple[str, ...] = ()
    plural: str = ""


_GENERAL: dict[str, Variable] = {
    "time": Variable(("time",), "s", "sample times"),
    "odometry": Variable(("time", "increment"), "m, m, rad", "displacement from the previous sample, in its frame"),
    "wall": Variable(("wall_index", "end", "xy"), "m", "segment map"),
    "start_mean": Variable(("pose",), "m, m, rad", "mean of the belief about the pose at row 0"),
    "start_std": Variable(("pose",), "m, m, rad", "standard deviation of that belief; inf anywhere on the map"),
    "true_pose": Variable(("time", "pose"), "m, m, rad", "reference trajectory, for scoring only"),
}


def variables() -> dict[str, Variable]:
    """Return all variables of the format: those of every log, and those of each registered sensor.

    Returns
    -------
    dict of str to Variable
        In the order in which checks and files name them.
    """
    of_sensors: dict[str, Variable] = {}
    for sensor in sensor_variables().values():
        of_sensors |= sensor.variables
    return {"time": _GENERAL["time"], "odometry": _GENERAL["odometry"], **of_sensors, **_GENERAL}


def readings() -> tuple[str, ...]:
    """Return the names of the variables that read the world; a log holds at least one of them."""
    return tuple(name for name, variable in variables().items() if variable.is_reading)


def plural_of(name: str) -> str:
    """Return what several readings of a variable are called, e.g. "landmark bearings"."""
    declared = variables().get(name)
    return (declared.plural if declared is not None else "") or f"{name.replace('_', ' ')}s"


REFERENCE = ("true_pose",)
"""Variables that calibration and criticism never read."""

LABELS: dict[str, tuple[str, ...]] = {
    "increment": ("forward", "left", "turn"),
    "pose": ("x", "y", "heading"),
    "xy": ("x", "y"),
    "end": ("start", "stop"),
}
"""Dimensions of fixed size, and what their components are called."""
