"""The arguments of :meth:`pmcl.logs.robot_log.RobotLog.build`, brought into the format's variables."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from pmcl.checks import check_type
from pmcl.errors import LogError, did_you_mean
from pmcl.logs.arrays import LidarScans
from pmcl.logs.schema import variables
from pmcl.logs.validation import fail

__all__ = ["of_further_sensors", "of_lidars", "plain_number"]


def of_further_sensors(
    given: Mapping[str, ArrayLike | None], arguments: Mapping[str, object], where: str
) -> dict[str, ArrayLike | None]:
    """Check the names in the argument `variables`: those of registered sensors that no other argument sets.

    Parameters
    ----------
    given : mapping of str to array_like
        The argument.
    arguments : mapping of str to object
        Variables that have an argument of their own.
    where : str
        The call, for messages.

    Returns
    -------
    dict of str to array_like
        What was given.

    Raises
    ------
    LogError
        When a name is unknown, or has an argument of its own.
    """
    known = [name for name in variables(given) if name not in arguments]
    for name in given:
        if name in arguments:
            fail(where, f"expected '{name}' as an argument of its own, got it in 'variables': move it")
        if name not in known:
            advice = did_you_mean(name, known, "install the package of its sensor, or register it with register_sensor")
            fail(where, f"expected variables of registered sensors, got '{name}': {advice}")
    return dict(given)


def of_lidars(
    lidars: Mapping[str, LidarScans], where: str
) -> dict[str, tuple[ArrayLike, dict[str, object]]]:
    """Return the variables of lidars.

    Parameters
    ----------
    lidars : mapping of str to LidarScans
        By the name of each lidar.
    where : str
        The call, for messages.

    Returns
    -------
    dict of str to (array_like, dict)
        By its name in the file, each variable and its attributes.

    Raises
    ------
    LogError
        When a name is not one, or a value no LidarScans.
    """
    found: dict[str, tuple[ArrayLike, dict[str, object]]] = {}
    for label, laser in lidars.items():
        check_type(f"lidars[{label!r}]", laser, LidarScans, error=LogError, advice="write pmcl.logs.LidarScans(...)")
        scan, angle = (f"{name}_{label}" if label else name for name in ("scan", "scan_angle"))
        if scan not in variables([scan]) or scan == "scan_angle" or scan.startswith("scan_angle_"):
            fail(where, f"expected names of lidars of letters, digits and '_', got {label!r:.40}: rename the lidar")
        reach = {"min_range": laser.min_range, "max_range": laser.max_range, "pose": laser.pose}
        found[scan], found[angle] = (laser.ranges, reach), (laser.angles, {})
    return found


def plain_number(value: object) -> float | str:
    """Return a value for JSON: numpy's scalars are numbers too; what is none is left to the validation, as text."""
    return float(value) if isinstance(value, np.number) else str(value)
