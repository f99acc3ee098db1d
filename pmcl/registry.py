"""What installed packages add to pmcl: sensors, motion models and effects, found by their entry points.

pmcl's own sensors and motion models are registered in the same way, by the table below: generic code asks this registry
and lists no sensor. An installed package adds one with an entry point. In its pyproject.toml it says, for example,
``[project.entry-points."pmcl.sensors"]`` and below ``compass = "my_package.compass:Compass"``. A script or a notebook
calls :func:`register` instead.
"""

from __future__ import annotations

import functools
import importlib
from importlib.metadata import entry_points
from typing import Any

from pmcl.errors import ModelError

__all__ = ["EFFECTS", "MOTIONS", "SENSORS", "register", "registered"]

SENSORS, MOTIONS, EFFECTS = "pmcl.sensors", "pmcl.motions", "pmcl.effects"
"""Groups of entry points: classes of sensors, classes of motion models, and effects."""

_OWN: dict[str, dict[str, str]] = {
    SENSORS: {
        "range": "pmcl.models.sensors.range_beams.sensor:RangeNoise",
        "landmarks": "pmcl.models.sensors.landmarks.sensor:LandmarkNoise",
    },
    MOTIONS: {
        "increment": "pmcl.models.motions.increments.motion:IncrementNoise",
        "growing": "pmcl.models.motions.increments.motion:GrowingIncrementNoise",
    },
    EFFECTS: {},
}

_added: dict[str, dict[str, Any]] = {SENSORS: {}, MOTIONS: {}, EFFECTS: {}}


@functools.cache
def _installed(group: str) -> dict[str, Any]:
    """Return pmcl's own objects of a group, then those of installed packages."""
    found = {}
    for name, place in _OWN[group].items():
        module, attribute = place.split(":")
        found[name] = getattr(importlib.import_module(module), attribute)
    for point in entry_points(group=group):
        if point.name in found:
            raise ModelError(
                f"{group}: expected another name than '{point.name}', which pmcl itself has, but {point.value} is "
                "registered by it; rename the entry point"
            )
        try:
            found[point.name] = point.load()
        except Exception as problem:
            raise ModelError(
                f"{group}: expected that {point.value} can be imported, but got '{problem}'; repair or uninstall the "
                "package that registers it"
            ) from problem
    return found


def registered(group: str) -> dict[str, Any]:
    """Return everything that is registered in a group.

    Parameters
    ----------
    group : str
        One of :data:`SENSORS`, :data:`MOTIONS` and :data:`EFFECTS`.

    Returns
    -------
    dict of str to object
        By name, pmcl's own first, in the order in which they were registered.

    Raises
    ------
    ModelError
        When an installed package registers something that cannot be imported.
    """
    return {**_installed(group), **_added[group]}


def register(group: str, name: str, value: Any) -> None:
    """Register an object for this process, as an entry point would for all.

    Parameters
    ----------
    group : str
        One of :data:`SENSORS`, :data:`MOTIONS` and :data:`EFFECTS`.
    name : str
        Its name: for sensors and motion models the one that model files use.
    value : object
        The class, or the effect. One of the same name that was registered in this way before is replaced.

    Raises
    ------
    ModelError
        When pmcl itself or an installed package has the name.
    """
    if name in _installed(group):
        raise ModelError(f"{group}: expected a new name, but '{name}' is registered already; choose another")
    _added[group][name] = value
