"""Statistics of trajectories for the Metropolis block, over all parts and logs of a bound model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.residuals import GaussianSums
from pmcl.models.robot_model import BoundModel
from pmcl.models.sensor import sensor_of
from pmcl.models.tables import Tables

__all__ = ["block_statistics", "trajectory_statistics"]

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
        None when a part with free parameters offers none, or an effect has free parameters: the joint density must then
        be evaluated as a whole. Cost: O(readings).
    """
    found, covered = block_statistics(bound, theta, all_tables, paths)
    return found if covered.size == theta.size else None


def block_statistics(
    bound: BoundModel, theta: Float, all_tables: Sequence[Tables], paths: Sequence[Float]
) -> tuple[tuple[NamedTuple, ...], NDArray[np.int64]]:
    """Return statistics for those parameters that have some, given the trajectories and all other parameters.

    Parameters
    ----------
    bound, theta, all_tables, paths
        As for :func:`trajectory_statistics`.

    Returns
    -------
    statistics : tuple of statistics
        Their slots count the covered parameters only.
    covered : ndarray of int, shape (k,)
        Positions in theta of the parameters on which the statistics tell everything. Those of effects are not among
        them, nor those of parts whose scatter an effect changes.
    """
    offered: dict[int, list[NamedTuple]] = {}
    lacking: set[int] = set()
    for parts, tables, path in zip(bound.parts, all_tables, paths, strict=True):
        of_parts = (tables.start, tables.motion, *tables.sensors)
        for position, (part, table) in enumerate(zip(parts, of_parts, strict=True)):
            slots = bound.slots[position]
            if not (slots.index >= 0).any() or position in lacking:
                continue
            statistics = None
            if bound.has_statistics(position):
                ideal = sensor_of(table).ideal_readings(table, path) if position > 1 else None
                statistics = part.statistics(table, path, ideal, slots.index, slots.take(theta))
            if statistics is None:
                lacking.add(position)
                offered.pop(position, None)
            else:
                offered.setdefault(position, []).append(statistics)
    covered = np.array(
        sorted(int(k) for position in offered for k in bound.slots[position].index if k >= 0), dtype=np.int64
    )
    found = [statistics for position in sorted(offered) for statistics in offered[position]]
    if covered.size < theta.size:
        rank = np.full(theta.size + 1, -1, dtype=np.int64)  # the last entry serves the slot -1 of fixed values
        rank[covered] = np.arange(covered.size)
        found = [_reslotted(statistics, rank) for statistics in found]
    return _merged(found), covered


def _reslotted(statistics: Any, rank: NDArray[np.int64]) -> NamedTuple:
    moved: NamedTuple = statistics._replace(theta_index=rank[statistics.theta_index])
    return moved


def _merged(found: list[NamedTuple]) -> tuple[NamedTuple, ...]:
    """Put all sums of squares into one table: fewer parts compile faster, and several logs cost no more than one."""
    sums = [statistics for statistics in found if isinstance(statistics, GaussianSums)]
    others = [statistics for statistics in found if not isinstance(statistics, GaussianSums)]
    if not sums:
        return tuple(others)
    joined = GaussianSums(
        np.concatenate([s.theta_index for s in sums]),
        np.concatenate([s.value for s in sums]),
        np.concatenate([s.counts for s in sums]),
        np.concatenate([s.squares for s in sums]),
    )
    return (joined, *others)
