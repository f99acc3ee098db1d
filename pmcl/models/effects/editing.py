"""How effects edit tables: find the one they are about, replace fields, keep arrays as compiled code wants them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from pmcl.errors import ModelError
from pmcl.models.rich_tables import (
    RichLandmarks,
    RichMotion,
    RichRangeBeams,
    WanderingMotion,
    rich_beams,
    rich_landmarks,
    rich_motion,
)
from pmcl.models.tables import IncrementMotion, LandmarkSightings, RangeBeams, Tables

__all__ = [
    "change_beams",
    "change_landmarks",
    "change_motion",
    "enrich_beams",
    "enrich_landmarks",
    "enrich_motion",
    "settled",
]

MOTIONS = (IncrementMotion, RichMotion, WanderingMotion)
BEAMS = (RangeBeams, RichRangeBeams)
LANDMARKS = (LandmarkSightings, RichLandmarks)


def change_motion(tables: Tables, change: Callable[[Any], Any], name: str) -> Tables:
    """Return the tables with `change` applied to the motion table.

    Raises
    ------
    ModelError
        When the motion is of a type that effect `name` does not know.
    """
    if not isinstance(tables.motion, MOTIONS):
        raise ModelError(
            f"effect {name}: expected motion by noisy increments, but got a {type(tables.motion).__name__}; "
            "leave the effect out"
        )
    return tables._replace(motion=change(tables.motion))


def change_beams(tables: Tables, change: Callable[[Any], Any], name: str, *, required: bool = True) -> Tables:
    """Return the tables with `change` applied to every table of range beams; see :func:`change_motion`."""
    return _change_sensors(tables, BEAMS, change, name, "range beams", required)


def change_landmarks(tables: Tables, change: Callable[[Any], Any], name: str, *, required: bool = True) -> Tables:
    """Return the tables with `change` applied to every table of landmark sightings; see :func:`change_motion`."""
    return _change_sensors(tables, LANDMARKS, change, name, "landmark sightings", required)


def enrich_motion(tables: Tables, change: Callable[[Any], Mapping[str, Any]], name: str) -> Tables:
    """Return the tables with fields of the richer motion table replaced by what `change` returns for it."""

    def edit(motion: Any) -> Any:
        rich = rich_motion(motion)
        return rich._replace(**change(rich))

    return change_motion(tables, edit, name)


def enrich_beams(
    tables: Tables, change: Callable[[Any], Mapping[str, Any]], name: str, *, required: bool = True
) -> Tables:
    """Return the tables with fields of every richer table of beams replaced by what `change` returns for it."""

    def edit(beams: Any) -> Any:
        rich = rich_beams(beams)
        return rich._replace(**change(rich))

    return change_beams(tables, edit, name, required=required)


def enrich_landmarks(
    tables: Tables, change: Callable[[Any], Mapping[str, Any]], name: str, *, required: bool = True
) -> Tables:
    """Return the tables with fields of every richer table of sightings replaced by what `change` returns for it."""

    def edit(seen: Any) -> Any:
        rich = rich_landmarks(seen)
        return rich._replace(**change(rich))

    return change_landmarks(tables, edit, name, required=required)


def _change_sensors(
    tables: Tables, kinds: tuple[type, ...], change: Callable[[Any], Any], name: str, what: str, required: bool
) -> Tables:
    found = [isinstance(sensor, kinds) for sensor in tables.sensors]
    if required and not any(found):
        raise ModelError(
            f"effect {name}: expected a model with {what}, but its sensors are "
            f"{[type(sensor).__name__ for sensor in tables.sensors]}; leave the effect out"
        )
    sensors = (change(s) if yes else s for s, yes in zip(tables.sensors, found, strict=True))
    return tables._replace(sensors=tuple(sensors))


def settled(tables: Any, before: Tables, name: str) -> Tables:
    """Return tables whose arrays are all contiguous and writable, for which kernels are compiled once and for all.

    What effect `name` left as it was `before` is so already.

    Raises
    ------
    ModelError
        When effect `name` returned no tables.
    """
    if not isinstance(tables, Tables):
        raise ModelError(
            f"effect {name}: expected its change to return Tables, but got {type(tables).__name__}; "
            "return tables._replace(...)"
        )
    known = {id(table) for table in (before.start, before.motion, *before.sensors)}
    start, motion, *sensors = (
        table if id(table) in known else _settled(table) for table in (tables.start, tables.motion, *tables.sensors)
    )
    return Tables(start, motion, tuple(sensors))


def _settled(table: NamedTuple) -> Any:
    # `carray` is contiguous, aligned and writable at once: tables are settled for each proposal.
    awkward = {
        name: np.array(value, dtype=np.int64 if value.dtype.kind in "iu" else np.float64, order="C")
        for name, value in zip(table._fields, table, strict=True)
        if isinstance(value, np.ndarray) and not value.flags.carray
    }
    return table._replace(**awkward) if awkward else table
