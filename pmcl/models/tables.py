"""What a model hands to the compiled kernels for one value of its parameters.

A model turns theta into plain arrays once per sweep: one coefficient table for its start, its motion and each of its
sensors. The kernels see only these NamedTuples (:mod:`pmcl.engine.tables`) and choose their code by the tuple's type.
A missing effect is then a function that edits a table. Headings are not wrapped inside the kernels (they live on the
real line, so that the noise of a turn is exactly Gaussian); only differences of bearings are.
"""

from __future__ import annotations

from typing import NamedTuple

from pmcl.engine.tables import NoExtras, with_extras

__all__ = ["Tables", "has_extras", "uniform"]


class Tables(NamedTuple):
    """Everything the kernels need to know about one log under one theta.

    Attributes
    ----------
    start : NamedTuple
        Belief about the first state.
    motion : NamedTuple
        Transition from each state to the next.
    sensors : tuple of NamedTuple
        One table for each sensor.
    """

    start: NamedTuple
    motion: NamedTuple
    sensors: tuple[NamedTuple, ...]


def uniform(tables: Tables) -> Tables:
    """Return tables that all have extras where a sensor's has; densities stay the same.

    Kernels are compiled for each combination of table types, and this keeps them few. An effect of the motion alone
    leaves sensors as they are, since the full kernels of sensors cost some three times as much.
    """
    if not any(has_extras(table) for table in tables.sensors):
        return tables
    return Tables(tables.start, with_extras(tables.motion), tuple(with_extras(table) for table in tables.sensors))


def has_extras(table: NamedTuple) -> bool:
    """Return whether a table has the further fields that effects use, so that the full kernels serve it."""
    return not isinstance(getattr(table, "extras", NoExtras()), NoExtras)
