"""The contract's sensor functions for a tuple of sensors: the densities of independent sensors add up."""

from __future__ import annotations

from numba import types

from pmcl.engine.compile import overload_for_types
from pmcl.engine.contract import (
    has_reading,
    linear_information,
    looks_back,
    path_reading_logpdf,
    reading_count,
    reading_logpdf,
    scratch_rows,
)

__all__ = [
    "any_look_back",
    "any_reading",
    "count_slots",
    "is_empty",
    "is_single",
    "most_rows",
    "sum_information",
    "sum_logpdf",
    "sum_path_logpdf",
]


def any_reading(sensors, t):
    """Return whether any sensor measured anything at time t."""
    return any(has_reading(sensor, t) for sensor in sensors)


def any_look_back(sensors):
    """Return whether any sensor looks back at the previous state."""
    return any(looks_back(sensor) for sensor in sensors)


def most_rows(sensors):
    """Return the greatest number of scratch rows that any sensor needs."""
    return max((scratch_rows(sensor) for sensor in sensors), default=0)


def count_slots(sensors, n_steps):
    """Return how many single readings all sensors have over `n_steps` rows, measured or not."""
    return sum(reading_count(sensor, n_steps) for sensor in sensors)


def sum_logpdf(sensors, t, previous, current, logp, scratch):
    """Add the log densities of all readings at time t to `logp`."""
    for sensor in sensors:
        reading_logpdf(sensor, t, previous, current, logp, scratch)


def sum_path_logpdf(sensors, n_steps, path, logp, scratch):
    """Add the log densities of all readings along one trajectory `path` (D, T) to `logp` (T,)."""
    for sensor in sensors:
        path_reading_logpdf(sensor, n_steps, path, logp, scratch)


def sum_information(sensors, linear_readings, t, precision, shift):
    """Add the linearised information of all readings at time t."""
    for sensor, linear in zip(sensors, linear_readings, strict=True):
        linear_information(sensor, linear, t, precision, shift)


def is_empty(sensors):
    """Return whether the numba type of a tuple of sensors is that of an empty one."""
    return isinstance(sensors, types.BaseTuple) and len(sensors) == 0


def is_single(sensors):
    """Return whether it is that of a tuple of one: then nothing needs to be sliced, which takes long to compile."""
    return isinstance(sensors, types.BaseTuple) and len(sensors) == 1


@overload_for_types(any_reading)
def _any_reading(sensors, t):
    if is_empty(sensors):
        return lambda sensors, t: False
    if is_single(sensors):
        return lambda sensors, t: has_reading(sensors[0], t)
    return lambda sensors, t: has_reading(sensors[0], t) or any_reading(sensors[1:], t)


@overload_for_types(any_look_back)
def _any_look_back(sensors):
    if is_empty(sensors):
        return lambda sensors: False
    if is_single(sensors):
        return lambda sensors: looks_back(sensors[0])
    return lambda sensors: looks_back(sensors[0]) or any_look_back(sensors[1:])


@overload_for_types(most_rows)
def _most_rows(sensors):
    if is_empty(sensors):
        return lambda sensors: 0
    if is_single(sensors):
        return lambda sensors: scratch_rows(sensors[0])
    return lambda sensors: max(scratch_rows(sensors[0]), most_rows(sensors[1:]))


@overload_for_types(count_slots)
def _count_slots(sensors, n_steps):
    if is_empty(sensors):
        return lambda sensors, n_steps: 0
    if is_single(sensors):
        return lambda sensors, n_steps: reading_count(sensors[0], n_steps)
    return lambda sensors, n_steps: reading_count(sensors[0], n_steps) + count_slots(sensors[1:], n_steps)


@overload_for_types(sum_logpdf)
def _sum_logpdf(sensors, t, previous, current, logp, scratch):
    if is_empty(sensors):
        return lambda sensors, t, previous, current, logp, scratch: None
    if is_single(sensors):
        return lambda sensors, t, previous, current, logp, scratch: reading_logpdf(
            sensors[0], t, previous, current, logp, scratch
        )

    def both(sensors, t, previous, current, logp, scratch):
        reading_logpdf(sensors[0], t, previous, current, logp, scratch)
        sum_logpdf(sensors[1:], t, previous, current, logp, scratch)

    return both


@overload_for_types(sum_path_logpdf)
def _sum_path_logpdf(sensors, n_steps, path, logp, scratch):
    if is_empty(sensors):
        return lambda sensors, n_steps, path, logp, scratch: None
    if is_single(sensors):
        return lambda sensors, n_steps, path, logp, scratch: path_reading_logpdf(
            sensors[0], n_steps, path, logp, scratch
        )

    def both(sensors, n_steps, path, logp, scratch):
        path_reading_logpdf(sensors[0], n_steps, path, logp, scratch)
        sum_path_logpdf(sensors[1:], n_steps, path, logp, scratch)

    return both


@overload_for_types(sum_information)
def _sum_information(sensors, linear_readings, t, precision, shift):
    if is_empty(sensors):
        return lambda sensors, linear_readings, t, precision, shift: None
    if is_single(sensors):
        return lambda sensors, linear_readings, t, precision, shift: linear_information(
            sensors[0], linear_readings[0], t, precision, shift
        )

    def both(sensors, linear_readings, t, precision, shift):
        linear_information(sensors[0], linear_readings[0], t, precision, shift)
        sum_information(sensors[1:], linear_readings[1:], t, precision, shift)

    return both
