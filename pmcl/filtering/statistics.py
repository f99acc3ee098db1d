"""Statistics of trajectories for the Metropolis block, over all parts and logs of a bound model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.filtering.predict import ideal_readings
from pmcl.models.robot_model import BoundModel
from pmcl.models.statistics import GaussianSums
from pmcl.models.tables import Tables

__all__ = ["trajectory_statistics"]

Float = NDArray[np.float64]


def trajectory_statistics(
    bound: BoundModel, theta: Float, all_tables: Sequence[Tables], paths: Sequence[Float]
) -> tuple[NamedTuple, ...] | None:
    """Return all that the density of theta given the trajectories depends on.

    Parameters
    ----------
    bound : BoundModel
        The model bound to L logs.
    theta : ndarray, shape (d,)
        Current parameters.
    all_tables : sequence of Tables
        The coefficient tables of each log at `theta`.
    paths : sequence of ndarray, shape (T_l, D)
        One trajectory for each log, possibly shorter than the log while data is being included.

    Returns
    -------
    tuple of statistics, or None
        None when a part with free parameters offers none: the joint density must then be evaluated as a whole.
        Cost: O(readings).
    """
    found: list[NamedTuple] = []
    for parts, tables, path in zip(bound.parts, all_tables, paths, strict=True):
        made = (tables.start, tables.motion, *tables.sensors)
        for position, (part, table, slots) in enumerate(zip(parts, made, bound.slots, strict=True)):
            if not (slots.index >= 0).any():
                continue
            ideal = ideal_readings(table, path) if position > 1 else None
            statistics = part.statistics(table, path, ideal, slots.index, slots.take(theta))
            if statistics is None:
                return None
            found.append(statistics)
    return _merged(found)


def _merged(found: list[NamedTuple]) -> tuple[NamedTuple, ...]:
    """Put all sums of squares into one table: fewer parts compile faster, and several logs cost no more than one."""
    sums = [statistics for statistics in found if isinstance(statistics, GaussianSums)]
    others = [statistics for statistics in found if not isinstance(statistics, GaussianSums)]
    if not sums:
        return tuple(others)
    joined = GaussianSums(
        np.concatenate([s.slots for s in sums]),
        np.concatenate([s.value for s in sums]),
        np.concatenate([s.counts for s in sums]),
        np.concatenate([s.squares for s in sums]),
    )
    return (joined, *others)
