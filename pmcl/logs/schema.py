"""The variables of a robot log: names, dimensions, units.

Every log has the variables that are declared here; each sensor declares its own (:mod:`pmcl.logs.sensor_variables`).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from pmcl.registry import sensor_variables

__all__ = [
    "FORMAT",
    "LABELS",
    "MOST_NUMBERS",
    "REFERENCE",
    "Variable",
    "named",
    "plural_of",
    "readings",
    "variables",
]

FORMAT = "pmcl-log/1"

MOST_NUMBERS = 20_000_000
"""The greatest count of numbers in a log, NaN included. Each takes up to 50 bytes while a log is built and checked, so
these take 1 GB."""


class Variable(NamedTuple):
    """One variable of the format.

    Attributes
    ----------
    dims : tuple of str
        Dimensions, in the order in which pmcl stores them. Those of a pattern (:func:`named`) may hold ``{name}``.
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


# Where a pattern such as "scan_{name}" has the name, and what such a name is.
_SLOT, _NAME = "{name}", r"[A-Za-z0-9_]+"


def named(declared: Mapping[str, Variable], name: str) -> Variable | None:
    """Return what is declared for a name in a log: for itself, or by a pattern that it matches.

    A sensor of which a robot may have several declares a pattern: ``"scan_{name}"`` stands for ``scan_front`` as well
    as ``scan_rear``. An exact name comes first, then the longest pattern that matches.

    Parameters
    ----------
    declared : mapping of str to Variable
        By names and patterns.
    name : str
        The name of a variable in a log.

    Returns
    -------
    Variable or None
        Of a pattern, with the name put into its dimensions.
    """
    if name in declared and _SLOT not in name:
        return declared[name]
    for pattern in sorted((key for key in declared if _SLOT in key), key=len, reverse=True):
        before, after = pattern.split(_SLOT)
        match = re.fullmatch(re.escape(before) + f"({_NAME})" + re.escape(after), name)
        if match:
            found = declared[pattern]
            return found._replace(dims=tuple(dim.replace(_SLOT, match[1]) for dim in found.dims))
    return None


_GENERAL: dict[str, Variable] = {
    "time": Variable(("time",), "s", "sample times"),
    "odometry": Variable(("time", "increment"), "m, m, rad", "displacement from the previous sample, in its frame"),
    "wall": Variable(("wall_index", "end", "xy"), "m", "segment map"),
    "start_mean": Variable(("pose",), "m, m, rad", "mean of the belief about the pose at row 0"),
    "start_std": Variable(("pose",), "m, m, rad", "standard deviation of that belief; inf anywhere on the map"),
    "true_pose": Variable(("time", "pose"), "m, m, rad", "reference trajectory, for scoring only"),
}


def variables(held: Iterable[object] = ()) -> dict[str, Variable]:
    """Return all variables of the format: those of every log, and those of each registered sensor.

    Parameters
    ----------
    held : iterable of str
        Names of variables in a log (a dataset will do): those that match the pattern of a sensor are returned too.

    Returns
    -------
    dict of str to Variable
        In the order in which checks and files name them.
    """
    names = [str(name) for name in held]
    of_sensors: dict[str, Variable] = {}
    for sensor in sensor_variables().values():
        of_sensors |= sensor.declared(names)
    return {"time": _GENERAL["time"], "odometry": _GENERAL["odometry"], **of_sensors, **_GENERAL}


def readings(held: Iterable[object] = ()) -> tuple[str, ...]:
    """Return the names of the variables that read the world; a log holds at least one of them.

    Parameters
    ----------
    held : iterable of str
        As for :func:`variables`.

    Returns
    -------
    tuple of str
    """
    return tuple(name for name, variable in variables(held).items() if variable.is_reading)


def plural_of(name: str) -> str:
    """Return what several readings of a variable are called, e.g. "landmark bearings"."""
    declared = variables([name]).get(name)
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
