"""Tables: what their fields declare fits their arrays, and neutral extras change nothing."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from oracles import made_tables

from pmcl.engine.compile import entry, generic
from pmcl.engine.tables import (
    Axes,
    FieldView,
    NoExtras,
    axes_of,
    axis_sizes,
    channels_that_differ,
    extras_types,
    field_of,
    same_extras,
    some_channels,
    with_extras,
    with_fields,
)
from pmcl.models.motions.increments.table import IncrementMotion, MotionExtras, WanderingExtras
from pmcl.models.motions.odometry.table import DifferentialMotion, OmniMotion
from pmcl.models.sensors.landmarks.table import LandmarkSightings
from pmcl.models.sensors.lidar.table import LidarTable
from pmcl.models.sensors.range_beams.table import RangeBeams, RangeExtras
from pmcl.registry import registered


def own_tables(rng):
    """A table of each of pmcl's own types."""
    poses = made_tables.poses_in_room(rng, 6)
    return {
        IncrementMotion: made_tables.increment_motion(rng),
        DifferentialMotion: DifferentialMotion(np.zeros((6, 3)), np.full(4, 0.1)),
        OmniMotion: OmniMotion(np.zeros((6, 3)), np.full(5, 0.1)),
        RangeBeams: made_tables.range_beams(poses, rng),
        LandmarkSightings: made_tables.sightings(6, rng),
        LidarTable: made_tables.lidar_scans(6, rng),
    }


OWN = [IncrementMotion, DifferentialMotion, OmniMotion, RangeBeams, LandmarkSightings, LidarTable]


def with_all_extras(table):
    """The table with no extras, and with each type of extras that it may have."""
    return [table, *(with_extras(table, kind) for kind in extras_types(table))]


def misfits(table):
    """Fields that are not declared, or whose arrays do not have the declared axes; of extras too."""
    found, sizes = [], dict(axis_sizes(table))
    for part in (table, *([table.extras] if "extras" in table._fields else [])):
        declared = axes_of(type(part))
        for name in part._fields:
            if name == "extras":
                continue
            if name not in declared:
                found.append(name)
                continue
            shape = np.shape(getattr(part, name))
            expected = [axis if isinstance(axis, int) else sizes.setdefault(axis, size)
                        for axis, size in zip(declared[name], shape, strict=False)]  # fmt: skip
            if len(shape) != len(declared[name]) or list(shape) != expected:
                found.append(name)
    return found


@pytest.mark.parametrize("kind", OWN)
def test_every_field_declares_axes_that_fit(kind, rng):
    for table in with_all_extras(own_tables(rng)[kind]):
        assert misfits(table) == []


def test_every_table_of_a_sensor_of_pmcl_is_in_the_list():
    kinds = {sensor.table_type for sensor in registered("pmcl.sensors").values()}
    assert {kind for kind in kinds if kind.__module__.startswith("pmcl.models.")} <= set(OWN)


def test_an_undeclared_or_wrongly_declared_field_is_found(rng):
    class Undeclared(NamedTuple):
        reading: Annotated[NDArray[np.float64], Axes("time", "beam")]
        forgotten: NDArray[np.float64]
        transposed: Annotated[NDArray[np.float64], Axes("beam", "time")]
        flat: Annotated[NDArray[np.float64], Axes("time", 2)]

    assert misfits(Undeclared(np.zeros((4, 3)), np.zeros(3), np.zeros((3, 4)), np.zeros((4, 2)))) == ["forgotten"]
    wrong = Undeclared(np.zeros((4, 3)), np.zeros(3), np.zeros((4, 3)), np.zeros((4, 3)))
    assert misfits(wrong) == ["forgotten", "transposed", "flat"]


@pytest.mark.parametrize("kind", OWN)
def test_extras_begin_neutral_and_keep_what_they_have(kind, rng):
    table = own_tables(rng)[kind]
    for extras_type in extras_types(table):
        full = with_extras(table, extras_type)
        assert type(full.extras) is extras_type
        assert all(getattr(full, name) is getattr(table, name) for name in kind._fields if name != "extras")
        assert with_extras(full, extras_type) is full
        for name in extras_type._fields:
            np.testing.assert_array_equal(field_of(table, name), getattr(full.extras, name))
            np.testing.assert_array_equal(getattr(FieldView(table), name), field_of(full, name))
    with pytest.raises(AttributeError, match="has no field 'colour'"):
        field_of(table, "colour")
    with pytest.raises(ValueError, match="has no field 'colour'"):
        with_fields(table, {"colour": 1.0})


def test_a_field_adds_the_least_extras_that_have_it(rng):
    motion = own_tables(rng)[IncrementMotion]
    slipping = with_fields(motion, {"slip_weight": 0.2})
    assert type(slipping.extras) is MotionExtras
    assert with_fields(motion, {"std": 2.0 * motion.std}).extras == NoExtras()
    wandering = with_fields(slipping, {"keep": np.full(6, 0.5)})
    assert type(wandering.extras) is WanderingExtras
    assert wandering.extras.slip_weight == 0.2
    # What has more extras keeps them when asked for fewer.
    assert with_extras(wandering, MotionExtras) is wandering
    first, second = same_extras(motion, wandering)
    assert type(first.extras) is type(second.extras) is WanderingExtras


AXES = [(RangeBeams, "beam"), (LandmarkSightings, "landmark"), (IncrementMotion, "time"), (LidarTable, "beam")]


def changed(table, name, axis, place):
    """The table with one entry of one field changed at one place of an axis."""
    part = table if name in table._fields else table.extras
    values = np.array(getattr(part, name))
    axes = axes_of(type(part))[name]
    entry = tuple(place if other == axis else 0 for other in axes)
    values[entry] = 7 if np.isnan(values[entry]) else values[entry] + 1
    if part is table:
        return table._replace(**{name: values})
    return table._replace(extras=table.extras._replace(**{name: values}))


@pytest.mark.parametrize(("kind", "axis"), AXES)
def test_channels_that_differ_are_found_in_every_field(kind, axis, rng):
    for table in with_all_extras(own_tables(rng)[kind]):
        size = axis_sizes(table)[axis]
        np.testing.assert_array_equal(channels_that_differ(table, table, axis), np.zeros(size, dtype=bool))
        parts = (table, *([] if isinstance(table.extras, NoExtras) else [table.extras]))
        for part in parts:
            for name, axes in axes_of(type(part)).items():
                if np.size(getattr(part, name)) == 0 or axes == ():
                    continue
                place = size - 1 if axis in axes else 0
                found = channels_that_differ(table, changed(table, name, axis, place), axis)
                if axis in axes:
                    np.testing.assert_array_equal(found, np.arange(size) == place, err_msg=name)
                    ignored = channels_that_differ(table, changed(table, name, axis, place), axis, ignore=(name,))
                    assert not ignored.any(), name
                else:
                    assert found is None, name


def test_a_number_that_differs_concerns_all_channels(rng):
    beams = with_extras(own_tables(rng)[RangeBeams])
    assert channels_that_differ(beams, with_fields(beams, {"tail": 0.1}), "beam") is None


@pytest.mark.parametrize(("kind", "axis"), AXES)
def test_some_channels_are_taken_from_every_field(kind, axis, rng):
    kept = np.array([2, 0])
    for table in with_all_extras(own_tables(rng)[kind]):
        some = some_channels(table, axis, kept)
        pairs = [(table, some)]
        if not isinstance(table.extras, NoExtras):
            pairs.append((table.extras, some.extras))
        for before, after in pairs:
            for name, axes in axes_of(type(before)).items():
                values = getattr(before, name)
                expected = np.take(values, kept, axis=axes.index(axis)) if axis in axes else values
                np.testing.assert_array_equal(getattr(after, name), expected)
                assert axis not in axes or getattr(after, name).flags.c_contiguous


class Small(NamedTuple):
    """A table of one's own, with or without extras."""

    number: float
    extras: NoExtras | RangeExtras = NoExtras()


@generic
def answer(table):
    """Return which implementation serves the table."""


@answer.register(Small)
def _any_extras(table):
    return 1.0


@answer.register(Small, NoExtras)
def _no_extras(table):
    return 2.0 + table.number


@entry
def compiled_answer(table):
    return answer(table)


def test_compiled_code_takes_tables_with_empty_extras_and_chooses_by_them(rng):
    extras = with_extras(own_tables(rng)[RangeBeams]).extras
    for function in (answer, compiled_answer):
        assert function(Small(0.5)) == 2.5
        assert function(Small(0.5, extras)) == 1.0
