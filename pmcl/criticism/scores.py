"""Scores of candidate effects without derivatives, from what editing the tables a little does to the log density.

By Fisher's identity the score of the readings is the posterior mean, over trajectories, of the score of trajectory and
readings together; and that one is a finite difference of densities between tables edited to either side of "no
effect". So every effect is scored alike, also one of a user's own, and row by row, which says where and when.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.contract import state_size
from pmcl.filtering.kernels import smc
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.models.motions.increments.table import WanderingExtras
from pmcl.models.robot_model import BoundModel
from pmcl.models.sensor import sensor_of
from pmcl.models.tables import Tables

__all__ = ["Direction", "base_rows", "directions", "effect_rows", "fits", "probe_values"]

Float = NDArray[np.float64]

# Half the distance between two edits, as a share of a clear effect: a slope, but not one taken within a hair's
# breadth, where a beam that grazes an edge would dominate it and a mixture's score has no variance.
_SIZE = 0.25
_BASE_SIZE = 0.02
# One row of one trajectory never counts for more [nat]: a reading that is impossible under a model says no more.
_MOST = 50.0


@dataclass(frozen=True)
class Direction:
    """One parameter of one candidate effect, moved away from "no effect".

    Attributes
    ----------
    effect : Effect
        The candidate, at one place.
    strength : int
        Which of its parameters is moved.
    above, below : ndarray, shape (k,)
        Values between which the density is compared; `below` is the null of a one-sided effect.
    one_sided : bool
        Whether only a rise of the density speaks for the effect.
    """

    effect: Effect
    strength: int
    above: Float
    below: Float
    one_sided: bool


def probe_values(effect: Effect, size: float, strength: int) -> Float:
    """Return values (k,) at `size` times a clear magnitude; an effect without typical ones uses its prior's spread."""
    if "clear" in effect.typical:
        return effect.probe(size, strength)
    values = np.array(effect.null, dtype=float)
    spread = float(effect.parameters[strength].prior.std())
    values[strength] += (np.sqrt(max(size, 0.0)) if effect.squared else size) * (spread if np.isfinite(spread) else 1.0)
    return values


def directions(effects: Sequence[Effect]) -> tuple[Direction, ...]:
    """Return the directions in which candidate effects leave the null."""
    made = []
    for effect in effects:
        for strength in effect.strengths:
            one_sided = effect.squared or effect.one_sided(strength)
            above = probe_values(effect, _SIZE, strength)
            below = np.array(effect.null) if one_sided else probe_values(effect, -_SIZE, strength)
            made.append(Direction(effect, strength, above, below, one_sided))
    return tuple(made)


def fits(effect: Effect, tables: Tables, log: RobotLog) -> bool:
    """Return whether trajectories of the model can score an effect, and the log itself does not rule it out.

    They can when it leaves the states as they are, or when its motion also has a density of trajectories without the
    component that it adds.
    """
    if effect.tells is not None and not effect.tells(log):
        return False
    edited = effect.edit(tables, np.array(effect.null), log)
    return _same_states(edited, tables) or isinstance(getattr(edited.motion, "extras", None), WanderingExtras)


def _same_states(edited: Tables, tables: Tables) -> bool:
    return int(state_size(edited.motion)) == int(state_size(tables.motion))


def effect_rows(tables: Tables, log: RobotLog, columns: Float, wanted: Sequence[Direction]) -> Float:
    """Score candidate effects along trajectories.

    Parameters
    ----------
    tables : Tables
        Of the current model.
    log : RobotLog
        The log they belong to.
    columns : ndarray, shape (M, D, T)
        Trajectories drawn given all readings.
    wanted : sequence of Direction
        K directions.

    Returns
    -------
    ndarray, shape (K, T)
        Change of the log density [nat] of each row from `below` to `above` (from the middle, for two sides), mean over
        the trajectories. Cost: K times two densities of M paths, of the tables that the effect edits only.
    """
    rows = np.zeros((len(wanted), columns.shape[2]))
    terms = _Terms(columns, tables)
    for row, direction in zip(rows, wanted, strict=True):
        above = _on_the_same_states(direction.effect.edit(tables, direction.above, log), tables)
        if direction.one_sided:
            terms.difference(above, tables, row)
        else:
            below = _on_the_same_states(direction.effect.edit(tables, direction.below, log), tables)
            terms.difference(above, below, row)
            row *= 0.5
    return rows


def _on_the_same_states(edited: Tables, tables: Tables) -> Tables:
    return edited if _same_states(edited, tables) else edited._replace(start=tables.start)


def base_rows(bound: BoundModel, theta: Float, columns: Float) -> Float:
    """Score the model's own parameters along trajectories, (d, T), by differences of 2 % of each to either side."""
    rows = np.zeros((theta.size, columns.shape[2]))
    terms = _Terms(columns, bound.tables(theta)[0])
    spread = np.array([min(float(p.prior.std()), 1.0) for p in bound.parameters])
    step = _BASE_SIZE * np.maximum(np.abs(theta), 0.1 * spread)
    for k, row in enumerate(rows):
        shift = step[k] * (np.arange(theta.size) == k)
        terms.difference(bound.tables(theta + shift)[0], bound.tables(theta - shift)[0], row)
    return 0.5 * rows


def _bounded(above: Float, below: Float) -> Float:
    """Return the mean change over trajectories (M, T), each within what a score can mean; impossible both ways is 0."""
    with np.errstate(invalid="ignore"):
        change = np.clip(above - below, -_MOST, _MOST)
    return np.asarray(np.where(np.isnan(change), 0.0, change).mean(axis=0))


class _Terms:
    """Log densities of trajectories under tables, evaluated once for each table; most are like those given."""

    def __init__(self, columns: Float, tables: Tables) -> None:
        self.columns = columns
        self.known: dict[int, tuple[Any, Float]] = {}
        self.caches = [sensor_of(table).score_cache(table, columns) for table in tables.sensors]

    def difference(self, above: Tables, below: Tables, row: Float) -> None:
        """Add the change of each row's density from one set of tables to another; equal tables are skipped."""
        if above.motion is not below.motion or above.start is not below.start:
            row += _bounded(self._motion(above), self._motion(below))
        for one, other, cache in zip(above.sensors, below.sensors, self.caches, strict=True):
            if one is other:
                continue
            if type(one) is type(other):
                one, other = sensor_of(one).parts_that_differ(one, other)
                if one is None:
                    continue
            row += _bounded(self._sensor(one, cache), self._sensor(other, cache))

    def _motion(self, tables: Tables) -> Float:
        return self._once(tables.motion, lambda: smc.motion_terms(tables.start, tables.motion, self.columns))

    def _sensor(self, sensor: Any, cache: Any) -> Float:
        def evaluate() -> Float:
            terms = None if cache is None else cache.terms(sensor)
            return np.asarray(smc.sensor_terms(sensor, self.columns)) if terms is None else terms

        return self._once(sensor, evaluate)

    def _once(self, table: Any, evaluate: Callable[[], Float]) -> Float:
        # The table is kept with its value, so that its identity cannot pass to another one. Edited tables are not
        # met twice; only the plain ones are worth remembering.
        key = id(table)
        if key not in self.known:
            self.known[key] = (table, np.asarray(evaluate()))
        return self.known[key][1]
