"""Functions by which effects edit tables: find the tables, replace fields, keep arrays as compiled code needs them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from pmcl.engine.tables import FieldView, with_fields
from pmcl.errors import ModelError
from pmcl.models.motions.increments.table import IncrementMotion
from pmcl.models.motions.odometry.table import DifferentialMotion, OmniMotion
from pmcl.models.sensors.landmarks.table import LandmarkSightings
from pmcl.models.sensors.lidar.table import LidarTable
from pmcl.models.sensors.range_beams.table import RangeBeams
from pmcl.models.tables import Tables

__all__ = [
    "Change", "edit_beams", "edit_landmarks", "edit_lidars", "edit_motion", "edit_ranges", "edit_sensors", "settled",
]  # fmt: skip

Change = Callable[[Any], Mapping[str, Any]]
"""Takes a table, whose extras read as its own fields, and returns new values of fields by their names."""


def edit_motion(tables: Tables, change: Change, name: str) -> Tables:
    """Return the tables with fields of the motion table replaced.

    Parameters
    ----------
    tables : Tables
        The tables; they are not changed.
    change : callable
        ``change(motion)`` returns new values by the name of the field. Fields of the table and of its extras are read
        and named alike; extras are added when one of them is changed.
    name : str
        Name of the effect, for messages.

    Returns
    -------
    Tables

    Raises
    ------
    ModelError
        When the motion is of a type that effect `name` does not know, or has no field that the effect changes: the
        noise of motion by odometry follows from its alphas.
    """
    motion: Any = tables.motion
    if isinstance(motion, (DifferentialMotion, OmniMotion)):
        try:
            return tables._replace(motion=motion._replace(**change(FieldView(motion))))
        except (AttributeError, ValueError) as error:  # it has the increments themselves, and nothing of their noise
            raise ModelError(
                f"effect {name}: expected increments with a noise of their own, but the noise of a "
                f"{type(motion).__name__} follows from its alphas; leave the effect out, or use motion = 'increment'"
            ) from error
    if not isinstance(motion, IncrementMotion):
        raise ModelError(
            f"effect {name}: expected motion by noisy increments or by odometry, but got a {type(motion).__name__}; "
            "leave the effect out"
        )
    return tables._replace(motion=with_fields(motion, change(FieldView(motion))))


def edit_beams(tables: Tables, change: Change, name: str, *, required: bool = True) -> Tables:
    """Return the tables with fields of every table of range beams replaced; see :func:`edit_sensors`.

    Parameters
    ----------
    tables : Tables
        The tables; they are not changed.
    change : callable
        As for :func:`edit_motion`.
    name : str
        Name of the effect, for messages.
    required : bool
        Whether there must be such a sensor.
    """
    return edit_sensors(tables, RangeBeams, change, name, "range beams", required=required)


def edit_lidars(tables: Tables, change: Change, name: str, *, required: bool = True) -> Tables:
    """Return the tables with fields of every table of lidar scans replaced; see :func:`edit_sensors`.

    Parameters
    ----------
    tables : Tables
        The tables; they are not changed.
    change : callable
        As for :func:`edit_motion`.
    name : str
        Name of the effect, for messages.
    required : bool
        Whether there must be such a sensor.
    """
    return edit_sensors(tables, LidarTable, change, name, "a lidar", required=required)


def edit_ranges(tables: Tables, change: Change, name: str) -> Tables:
    """Return the tables with fields of range beams and of lidars replaced, which have the same names in both.

    Parameters
    ----------
    tables : Tables
        The tables; they are not changed.
    change : callable
        As for :func:`edit_motion`.
    name : str
        Name of the effect, for messages.

    Raises
    ------
    ModelError
        When the model has neither.
    """
    if any(isinstance(sensor, LidarTable) for sensor in tables.sensors):
        return edit_beams(edit_lidars(tables, change, name), change, name, required=False)
    return edit_beams(tables, change, name)


def edit_landmarks(tables: Tables, change: Change, name: str, *, required: bool = True) -> Tables:
    """Return the tables with fields of every table of landmark sightings replaced; see :func:`edit_sensors`.

    Parameters
    ----------
    tables : Tables
        The tables; they are not changed.
    change : callable
        As for :func:`edit_motion`.
    name : str
        Name of the effect, for messages.
    required : bool
        Whether there must be such a sensor.
    """
    return edit_sensors(tables, LandmarkSightings, change, name, "landmark sightings", required=required)


def edit_sensors(
    tables: Tables, table_type: type, change: Change, name: str, words: str, *, required: bool = True
) -> Tables:
    """Return the tables with fields of every sensor table of one type replaced.

    Parameters
    ----------
    tables : Tables
        The tables; they are not changed.
    table_type : type
        The type of the tables.
    change : callable
        As for :func:`edit_motion`.
    name : str
        Name of the effect, for messages.
    words : str
        The readings of such a sensor, for messages.
    required : bool
        Whether there must be such a sensor.

    Returns
    -------
    Tables

    Raises
    ------
    ModelError
        When there is no such sensor, and one is required.
    """
    found = [isinstance(sensor, table_type) for sensor in tables.sensors]
    if required and not any(found):
        raise ModelError(
            f"effect {name}: expected a model with {words}, but its sensors are "
            f"{[type(sensor).__name__ for sensor in tables.sensors]}; leave the effect out"
        )
    sensors = tuple(
        with_fields(sensor, change(FieldView(sensor))) if yes else sensor
        for sensor, yes in zip(tables.sensors, found, strict=True)
    )
    return tables._replace(sensors=sensors)


def settled(tables: Any, before: Tables, name: str) -> Tables:
    """Return tables whose arrays are all contiguous and writable, for which kernels are compiled once and for all.

    Parts that are the same objects as in `before` are not checked again.

    Parameters
    ----------
    tables : Tables
        The tables that an effect has returned.
    before : Tables
        The tables before the edit.
    name : str
        Name of the effect, for messages.

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


def _settled(table: Any) -> Any:
    awkward: dict[str, Any] = {}
    for name, value in zip(table._fields, table, strict=True):
        if isinstance(value, np.ndarray):
            # `carray` is contiguous, aligned and writable at once: tables are settled for each proposal.
            if not value.flags.carray:
                awkward[name] = np.array(value, dtype=np.int64 if value.dtype.kind in "iu" else np.float64, order="C")
        elif isinstance(value, tuple) and (inner := _settled(value)) is not value:
            awkward[name] = inner
    return table._replace(**awkward) if awkward else table
