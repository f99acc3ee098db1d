"""Scores of candidate effects without derivatives, from what editing the tables a little does to the log density.

By Fisher's identity the score of the readings is the posterior mean, over trajectories, of the score of trajectory and
readings together; and that one is a finite difference of densities between tables edited to either side of "no
effect". So every effect is scored alike, also one of a user's own, and row by row, which says where and when.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from pmcl.filtering.kernels import smc
from pmcl.filtering.kernels.contract import state_size
from pmcl.filtering.kernels.rich_ranges import rays_along, terms_given_rays
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.models.rich_tables import RichLandmarks, RichRangeBeams, WanderingMotion, rich_beams, rich_landmarks
from pmcl.models.robot_model import BoundModel
from pmcl.models.tables import LandmarkSightings, RangeBeams, Tables

__all__ = ["Direction", "base_rows", "directions", "effect_rows", "fits", "probe_values"]

Float = NDArray[np.float64]

# Half the distance between two edits, as a share of a clear effect: a slope, but not one taken within a hair's
# breadth, where a beam that grazes an edge would dominate it and a mixture's score has no variance.
_SIZE = 0.25
_BASE_SIZE = 0.02
# One row of one trajectory never counts for more [nat]: a reading that is impossible under a model says no more.
_MOST = 50.0

_Beams = RangeBeams | RichRangeBeams
_Sightings = LandmarkSightings | RichLandmarks
_BEAMS, _SIGHTINGS = (RangeBeams, RichRangeBeams), (LandmarkSightings, RichLandmarks)
# Fields whose first axis is the beams.
_OF_BEAMS = (
    "beam_pose", "bias", "scale", "std", "outlier_weight", "growth", "width", "short_weight", "no_echo_weight",
    "specular_weight", "talk_weight", "correlation",
)  # fmt: skip
# Fields whose first axis is the landmarks; and those whose first axis is the sightings.
_OF_LANDMARKS = (
    "position", "range_scale", "range_bias", "range_std", "bearing_bias", "bearing_std", "size_constant", "size_std",
    "outlier_weight", "range_growth", "bearing_falloff", "misread_weight", "range_correlation", "bearing_correlation",
)  # fmt: skip
_OF_SIGHTINGS = ("time", "landmark", "range", "bearing", "size")


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
    return _same_states(edited, tables) or isinstance(edited.motion, WanderingMotion)


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


def _differing_beams(one: _Beams, other: _Beams) -> tuple[_Beams, _Beams]:
    """Keep the beams of two tables that are not the same in both: an effect of one beam costs no more than one beam."""
    first, second = (one, other) if type(one) is type(other) else (rich_beams(one), rich_beams(other))
    differ = _differing(first, second, _OF_BEAMS, apart=("neighbours", "bias_at"))
    # A beam that may show its neighbour's echo cannot be judged without it.
    if differ is None or any((table.talk_weight > 0.0).any() for table in (first, second) if _is_rich(table)):
        return one, other
    if _is_rich(first) and _is_rich(second) and first.bias_at is not second.bias_at:
        differ |= (first.bias_at != second.bias_at).any(axis=0)
    if differ.all():
        return one, other
    kept = np.flatnonzero(differ)
    return _some_beams(first, kept), _some_beams(second, kept)


def _differing_sightings(one: _Sightings, other: _Sightings) -> tuple[_Sightings, _Sightings]:
    """Keep the sightings of landmarks that are not the same in two tables."""
    first, second = (one, other) if type(one) is type(other) else (rich_landmarks(one), rich_landmarks(other))
    differ = _differing(first, second, _OF_LANDMARKS)
    # A sighting that may be of any landmark cannot be judged without the others.
    misread = (table.misread_weight for table in (first, second) if isinstance(table, RichLandmarks))
    if differ is None or differ.all() or any((weight > 0.0).any() for weight in misread):
        return one, other
    return _some_sightings(first, differ), _some_sightings(second, differ)


def _differing(one: Any, other: Any, fields: Sequence[str], apart: Sequence[str] = ()) -> NDArray[np.bool_] | None:
    """Return in which elements of the first axis of some fields two tables of one type differ.

    None where they differ in other fields as well; those named `apart` are not looked at.
    """
    differ = np.zeros(len(getattr(one, fields[0])), dtype=bool)
    for name in one._fields:
        a, b = getattr(one, name), getattr(other, name)
        if a is b or name in apart:
            continue
        if name in fields:
            differ |= (a != b).reshape(differ.size, -1).any(axis=1)
        elif not np.array_equal(a, b):
            return None
    return differ


def _some_beams(beams: _Beams, kept: NDArray[np.int64]) -> _Beams:
    """Return a table of some beams only; neighbours lose their meaning."""
    changes = {name: getattr(beams, name)[kept] for name in _OF_BEAMS if name in beams._fields}
    columns = ("reading", "bias_at") if _is_rich(beams) else ("reading",)
    changes |= {name: np.ascontiguousarray(getattr(beams, name)[:, kept]) for name in columns}
    if _is_rich(beams):
        changes["neighbours"] = np.zeros((kept.size, 2), dtype=np.int64)
    return beams._replace(**changes)


def _some_sightings(seen: _Sightings, landmarks: NDArray[np.bool_]) -> _Sightings:
    """Return a table of the sightings of some landmarks only."""
    kept = landmarks[seen.landmark]
    before = np.concatenate([[0], np.cumsum(kept)])
    return seen._replace(first=before[seen.first], **{name: getattr(seen, name)[kept] for name in _OF_SIGHTINGS})


def _is_rich(beams: _Beams) -> TypeGuard[RichRangeBeams]:
    return isinstance(beams, RichRangeBeams)


def _bounded(above: Float, below: Float) -> Float:
    """Return the mean change over trajectories (M, T), each within what a score can mean; impossible both ways is 0."""
    with np.errstate(invalid="ignore"):
        change = np.clip(above - below, -_MOST, _MOST)
    return np.asarray(np.where(np.isnan(change), 0.0, change).mean(axis=0))


class _Rays:
    """The rays of a table of beams along trajectories, cast once for all tables that leave them as they are."""

    def __init__(self, beams: _Beams, columns: Float) -> None:
        self.columns, self.beams = columns, rich_beams(beams)
        self.position = {key: k for k, key in enumerate(self._keys(self.beams))}
        self.cast: Float | None = None

    def terms(self, beams: _Beams) -> Float | None:
        """Return log densities (M, T) of readings; None when the table has rays of its own."""
        sensor, mine = rich_beams(beams), self.beams
        if any(getattr(sensor, name) is not getattr(mine, name) for name in ("vertices", "wall_start", "wall_stop")):
            return None
        if sensor.lag.any() or sensor.specular_weight.any():
            return None
        which = [self.position.get(key, -1) for key in self._keys(sensor)]
        if min(which) < 0:
            return None
        if self.cast is None:
            self.cast = rays_along(mine._replace(lag=np.zeros_like(mine.lag)), self.columns)
        return np.asarray(terms_given_rays(sensor, self.columns, self.cast, np.array(which, dtype=np.int64)))

    @staticmethod
    def _keys(beams: RichRangeBeams) -> list[tuple[float, ...]]:
        return [(*pose, width) for pose, width in zip(beams.beam_pose.tolist(), beams.width.tolist(), strict=True)]


class _Terms:
    """Log densities of trajectories under tables, evaluated once for each table; most are like those given."""

    def __init__(self, columns: Float, tables: Tables) -> None:
        self.columns = columns
        self.known: dict[int, tuple[Any, Float]] = {}
        self.rays = [_Rays(one, columns) if isinstance(one, _BEAMS) else None for one in tables.sensors]

    def difference(self, above: Tables, below: Tables, row: Float) -> None:
        """Add the change of each row's density from one set of tables to another; equal tables are skipped."""
        if above.motion is not below.motion or above.start is not below.start:
            row += _bounded(self._motion(above), self._motion(below))
        for one, other, rays in zip(above.sensors, below.sensors, self.rays, strict=True):
            if one is other:
                continue
            if isinstance(one, _BEAMS) and isinstance(other, _BEAMS):
                one, other = _differing_beams(one, other)
                if one.reading.shape[1] == 0:
                    continue
            elif isinstance(one, _SIGHTINGS) and isinstance(other, _SIGHTINGS):
                one, other = _differing_sightings(one, other)
            row += _bounded(self._sensor(one, rays), self._sensor(other, rays))

    def _motion(self, tables: Tables) -> Float:
        return self._once(tables.motion, lambda: smc.motion_terms(tables.start, tables.motion, self.columns))

    def _sensor(self, sensor: Any, rays: _Rays | None) -> Float:
        def evaluate() -> Float:
            terms = rays.terms(sensor) if rays is not None and isinstance(sensor, _BEAMS) else None
            return np.asarray(smc.sensor_terms(sensor, self.columns)) if terms is None else terms

        return self._once(sensor, evaluate)

    def _once(self, table: Any, evaluate: Callable[[], Float]) -> Float:
        # The table is kept with its value, so that its identity cannot pass to another one. Edited tables are not
        # met twice; only the plain ones are worth remembering.
        key = id(table)
        if key not in self.known:
            self.known[key] = (table, np.asarray(evaluate()))
        return self.known[key][1]
