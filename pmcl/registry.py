"""What installed packages add to pmcl: sensors, motion models, effects and calibration methods, by entry points.

pmcl's own sensors, motion models and methods stand in the tables below, and generic code asks this registry for them as
for any other: it lists no sensor by name. An installed package adds one with an entry point. In its pyproject.toml it
says, for example, ``[project.entry-points."pmcl.sensors"]`` and below ``compass = "my_package.compass:Compass"``. A
script or a notebook calls :func:`register` instead.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from typing import Any, NamedTuple

from pmcl.errors import ModelError

__all__ = [
    "EFFECTS",
    "METHODS",
    "MOTIONS",
    "SENSORS",
    "names_of_others",
    "origin",
    "register",
    "registered",
    "sensor_variables",
]

SENSORS, MOTIONS, EFFECTS, METHODS = "pmcl.sensors", "pmcl.motions", "pmcl.effects", "pmcl.methods"
"""Groups of entry points: classes of sensors and motion models, effects or sequences of them, calibration methods."""

_OWN: dict[str, dict[str, str]] = {
    SENSORS: {
        "range": "pmcl.models.sensors.range_beams.sensor:RangeNoise",
        "landmarks": "pmcl.models.sensors.landmarks.sensor:LandmarkNoise",
        "lidar": "pmcl.models.sensors.lidar.sensor:Lidar",
    },
    MOTIONS: {
        "increment": "pmcl.models.motions.increments.motion:IncrementNoise",
        "growing": "pmcl.models.motions.increments.motion:GrowingIncrementNoise",
        "differential": "pmcl.models.motions.odometry.motion:Differential",
        "omni": "pmcl.models.motions.odometry.motion:Omni",
    },
    EFFECTS: {},
    METHODS: {
        "particle-gibbs": "pmcl.calibration.particle_gibbs:ParticleGibbs",
        "ensemble": "pmcl.calibration.ensemble:Ensemble",
        "pmmh": "pmcl.calibration.pmmh:ParticleMetropolis",
        "marginal-gibbs": "pmcl.calibration.marginal_gibbs:MarginalGibbs",
        "nuts": "pmcl.calibration.nuts:NoUTurn",
        "andrews": "pmcl.calibration.andrews:TrajectorySets",
        "ekf": "pmcl.calibration.kalman:ExtendedKalman",
        "ukf": "pmcl.calibration.kalman:UnscentedKalman",
        "em": "pmcl.calibration.em:ExpectationMaximisation",
        "roy-thrun": "pmcl.calibration.roy_thrun:OnlineOdometryBias",
        "stronger-stone": "pmcl.calibration.stronger_stone:MeanFunctions",
        "least-squares": "pmcl.calibration.least_squares:LeastSquares",
        "liu-west": "pmcl.calibration.liu_west:LiuWest",
        "storvik": "pmcl.calibration.storvik:Storvik",
        "optimiser": "pmcl.calibration.optimiser:EvidenceOptimiser",
        "prior": "pmcl.calibration.prior_mean:PriorMean",
        "truth": "pmcl.calibration.truth:TrueResiduals",
    },
}

# What the sensors above are in a log, without their models: reading a log needs no compiler and no statistics.
_OWN_VARIABLES: dict[str, str] = {
    "range": "pmcl.models.sensors.range_beams.log_variables:RangeVariables",
    "landmarks": "pmcl.models.sensors.landmarks.log_variables:LandmarkVariables",
    "lidar": "pmcl.models.sensors.lidar.log_variables:LidarVariables",
}


class _Kind(NamedTuple):
    """What a group may hold: in words, and a test of a value."""

    words: str
    holds: Callable[[Any], bool]


_KINDS: dict[str, _Kind] = {
    SENSORS: _Kind(
        "a class that derives from pmcl.models.Sensor", lambda value: isinstance(value, type) and _has_variables(value)
    ),
    MOTIONS: _Kind("a class of motion models", lambda value: isinstance(value, type)),
    EFFECTS: _Kind("an effect or a sequence of effects", lambda value: not isinstance(value, type)),
    METHODS: _Kind("a class of calibration methods", lambda value: isinstance(value, type)),
}

_added: dict[str, dict[str, Any]] = {SENSORS: {}, MOTIONS: {}, EFFECTS: {}, METHODS: {}}


def _has_variables(value: type) -> bool:
    return hasattr(value, "variables") and hasattr(value, "count")


def _imported(place: str) -> Any:
    module, attribute = place.split(":")
    return getattr(importlib.import_module(module), attribute)


@functools.cache
def _own(group: str) -> dict[str, Any]:
    return {name: _imported(place) for name, place in _OWN[group].items()}


@functools.cache
def _own_variables() -> dict[str, Any]:
    return {name: _imported(place) for name, place in _OWN_VARIABLES.items()}


@functools.cache
def _of_packages(group: str) -> dict[str, Any]:
    """Return the objects that installed packages register in a group."""
    found: dict[str, Any] = {}
    for point in entry_points(group=group):
        where = f"{group}, {_described(point)}"
        if point.name in _OWN[group]:
            raise ModelError(
                f"{where}: expected another name than '{point.name}', which pmcl itself has, but {point.value} is "
                "registered by it; rename the entry point"
            )
        try:
            value = point.load()
        except Exception as problem:
            reason = " ".join(f"{type(problem).__name__}: {problem}".split())
            raise ModelError(
                f"{where}: expected {_KINDS[group].words}, but loading {point.value} failed ({reason}); "
                "repair or remove that package"
            ) from problem
        if not _KINDS[group].holds(value):
            raise ModelError(
                f"{where}: expected {_KINDS[group].words}, but {point.value} is a {type(value).__name__}; "
                "repair or remove that package"
            )
        found[point.name] = value
    return found


def _described(point: EntryPoint) -> str:
    return f"entry point '{point.name}' of {point.dist.name if point.dist is not None else 'a package'}"


def registered(group: str) -> dict[str, Any]:
    """Return everything that is registered in a group.

    Parameters
    ----------
    group : str
        One of :data:`SENSORS`, :data:`MOTIONS`, :data:`EFFECTS` and :data:`METHODS`.

    Returns
    -------
    dict of str to object
        By name, pmcl's own first, then those of installed packages, then those of this process.

    Raises
    ------
    ModelError
        When an installed package registers something that cannot be used.
    """
    return {**_own(group), **_of_packages(group), **_added[group]}


def names_of_others(group: str) -> tuple[str, ...]:
    """Return the names in a group that are not pmcl's own, without loading what they stand for."""
    points = (point.name for point in entry_points(group=group))
    return tuple(dict.fromkeys((*points, *_added[group])))


def sensor_variables() -> dict[str, Any]:
    """Return what each registered sensor is in a log, by the sensor's name.

    Returns
    -------
    dict of str to type
        Classes that derive from :class:`pmcl.logs.sensor_variables.SensorVariables`, in the order of
        :func:`registered`. pmcl's own are loaded without their models.

    Raises
    ------
    ModelError
        When an installed package registers something that is no sensor.
    """
    return {**_own_variables(), **_of_packages(SENSORS), **_added[SENSORS]}


def origin(group: str, name: str) -> str:
    """Return where a registered object comes from, for messages.

    Parameters
    ----------
    group : str
        One of :data:`SENSORS`, :data:`MOTIONS` and :data:`EFFECTS`.
    name : str
        Its name there.

    Returns
    -------
    str
    """
    for point in entry_points(group=group):
        if point.name == name:
            return _described(point)
    return f"'{name}' of group {group}"


def register(group: str, name: str, value: Any) -> None:
    """Register an object for this process, as an entry point would for all.

    Parameters
    ----------
    group : str
        One of :data:`SENSORS`, :data:`MOTIONS`, :data:`EFFECTS` and :data:`METHODS`.
    name : str
        Its name: for sensors and motion models the one that model files use.
    value : object
        The class, or the effect. One of the same name that was registered in this way before is replaced.

    Raises
    ------
    ModelError
        When pmcl itself or an installed package has the name, or the group holds objects of another kind.
    """
    if name in _OWN[group] or name in _of_packages(group):
        raise ModelError(f"{group}: expected a new name, but '{name}' is registered already; choose another")
    if not _KINDS[group].holds(value):
        raise ModelError(f"{group}, '{name}': expected {_KINDS[group].words}, but got a {type(value).__name__}")
    _added[group][name] = value
