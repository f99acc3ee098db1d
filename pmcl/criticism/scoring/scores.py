"""Scores of candidate effects by finite differences of log densities.

By Fisher's identity the score of the readings is the posterior mean, over trajectories, of the score of trajectory and
readings together. That score is a finite difference of log densities between tables that the effect has edited a
little to either side of "no effect". Every effect is therefore scored in the same way, also a user's own, and row by
row, which shows where and when it acts.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.contract import state_size
from pmcl.errors import DensityError, PmclError
from pmcl.filtering.kernels import smc
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.models.motions.increments.table import WanderingExtras
from pmcl.models.parameters import prior_support
from pmcl.models.robot_model import BoundModel
from pmcl.models.sensor import sensor_of
from pmcl.models.tables import Tables

__all__ = [
    "ChangedDensity", "Direction", "applicable", "candidate_directions", "directions_of", "effect_scores",
    "inside_priors", "instance_key", "parameter_scores", "probe_values",
]  # fmt: skip

_logger = logging.getLogger("pmcl.criticism")
Float = NDArray[np.float64]

# Size of an edit, as a share of a clear effect. Smaller edits would let a single beam that grazes an edge dominate the
# difference, and the score of a mixture's weight would have no variance. Chosen by hand.
_PROBE_SIZE = 0.25
# Size of an edit of the model's own parameters, as a share of each. Chosen by hand.
_PARAMETER_SHARE = 0.02
# It leads at most this share of the way to the end of the parameter's support. Chosen by hand.
_OF_SUPPORT = 0.5
# Values that a density is asked for lie so far from the edges of their prior, in units of its width (chosen by hand).
_MARGIN = 1e-6
# The change of one row of one trajectory is limited to this [nat]: beyond it a reading is impossible under one of the
# two models, and a larger number holds no more information. Chosen by hand.
_GREATEST_CHANGE = 50.0
# A row whose mean change is smaller than this [nat] did not change. Densities are sums of terms of up to some hundred
# nats and are rounded at 1e-14 of that, more often to one side than to the other: at places where the robot never is,
# rounding alone had scores of 3e-13 with p-values of 1e-9.
_LEAST_CHANGE = 1e-9


@dataclass(frozen=True)
class Direction:
    """One parameter of one candidate effect, moved away from "no effect".

    Attributes
    ----------
    effect : Effect
        The candidate, at one place.
    strength : int
        Position of the parameter that is moved.
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

    @property
    def of_weight(self) -> bool:
        """Whether the parameter is the weight of a mixture, such as a share of readings."""
        return self.effect.parameters[self.strength].role == "weight"


def probe_values(effect: Effect, size: float, strength: int) -> Float:
    """Return the parameters of an effect when one of them is moved away from the null.

    Parameters
    ----------
    effect : Effect
        The effect.
    size : float
        Share of a clear magnitude; an effect without typical values uses its prior's standard deviation instead.
    strength : int
        Position of the parameter that is moved.

    Returns
    -------
    ndarray, shape (k,)
    """
    if "clear" in effect.typical:
        return effect.probe(size, strength)
    values = np.array(effect.null, dtype=float)
    spread = float(effect.parameters[strength].prior.std())
    values[strength] += (np.sqrt(max(size, 0.0)) if effect.squared else size) * (spread if np.isfinite(spread) else 1.0)
    return values


def inside_priors(effect: Effect, values: Float) -> Float:
    """Return values (k,) of an effect's parameters, those at the edge of their prior moved a little inwards."""
    inside = values.copy()
    for k, parameter in enumerate(effect.parameters):
        low, high = prior_support(parameter.prior)
        margin = _MARGIN * (high - low) if np.isfinite(high - low) else _MARGIN
        inside[k] = np.clip(values[k], low + margin, high - margin)
    return inside


def directions_of(effects: Sequence[Effect]) -> tuple[Direction, ...]:
    """Return the directions in which candidate effects leave the null."""
    directions = []
    for effect in effects:
        for strength in effect.strengths:
            one_sided = effect.squared or effect.one_sided(strength)
            above = probe_values(effect, _PROBE_SIZE, strength)
            below = np.array(effect.null) if one_sided else probe_values(effect, -_PROBE_SIZE, strength)
            directions.append(Direction(effect, strength, above, below, one_sided))
    return tuple(directions)


def candidate_directions(
    model_effects: Sequence[Effect], tables: Tables, log: RobotLog, offered: Sequence[Effect]
) -> tuple[Direction, ...]:
    """Return the directions of those effects that a model lacks and that can be added to it.

    Parameters
    ----------
    model_effects : sequence of Effect
        Effects that the model has.
    tables : Tables
        Coefficient tables of the fitted model for the log.
    log : RobotLog
        The log.
    offered : sequence of Effect
        Candidates.
    """
    present = {instance_key(effect) for effect in model_effects}
    usable = []
    for effect in offered:
        try:
            if instance_key(effect) not in present and applicable(effect, tables, log):
                usable.append(effect)
        except PmclError as error:
            _logger.debug("%s is no candidate: %s", effect.name, error)
    return directions_of(usable)


def instance_key(effect: Effect) -> tuple[str, tuple[Any, ...]]:
    """Return the name and place of an effect, which together identify an instance."""
    return effect.name, tuple((name, tuple(values)) for name, values in effect.where.items())


def applicable(effect: Effect, tables: Tables, log: RobotLog) -> bool:
    """Return whether trajectories of a model can score an effect that the log itself does not rule out.

    They can when the effect leaves the states as they are, or when its motion table also has a density of trajectories
    without the state component that it adds.

    Parameters
    ----------
    effect : Effect
        The effect.
    tables : Tables
        Coefficient tables of the model for the log.
    log : RobotLog
        The log.
    """
    if effect.tells is not None and not effect.tells(log):
        return False
    edited = effect.edit(tables, np.array(effect.null), log)
    return _same_states(edited, tables) or isinstance(getattr(edited.motion, "extras", None), WanderingExtras)


def _same_states(edited: Tables, tables: Tables) -> bool:
    return int(state_size(edited.motion)) == int(state_size(tables.motion))


def effect_scores(tables: Tables, log: RobotLog, columns: Float, directions: Sequence[Direction]) -> Float:
    """Score candidate effects along trajectories.

    Parameters
    ----------
    tables : Tables
        Coefficient tables of the current model.
    log : RobotLog
        The log that they belong to.
    columns : ndarray, shape (M, D, T)
        Trajectories drawn given all readings.
    directions : sequence of Direction
        K directions.

    Returns
    -------
    ndarray, shape (K, T)
        Change of the log density [nat] of each row from `below` to `above` (half of it for two-sided directions), mean
        over the trajectories. Cost: K times two densities of M paths, of the tables that the effect edits only.

    Raises
    ------
    DensityError
        When a density is not a number, with the time and the values of the effect.
    """
    scores = np.zeros((len(directions), columns.shape[2]))
    densities = _Densities(columns, tables)
    for score, direction in zip(scores, directions, strict=True):
        above = _on_the_same_states(direction.effect.edit(tables, direction.above, log), tables)
        below = tables
        if not direction.one_sided:
            below = _on_the_same_states(direction.effect.edit(tables, direction.below, log), tables)
        names = [parameter.name for parameter in direction.effect.parameters]
        with _scored_between(direction.effect.name, log, names, direction.below, direction.above):
            densities.add_difference(above, below, score)
        if not direction.one_sided:
            score *= 0.5
    return scores


class ChangedDensity:
    """Changes of the log density of trajectories by effects of any size.

    Attributes
    ----------
    tables : Tables
        Coefficient tables of the current model.
    log : RobotLog
        The log that they belong to.
    """

    def __init__(self, tables: Tables, log: RobotLog, columns: Float) -> None:
        self.tables, self.log = tables, log
        self._densities = _Densities(columns, tables)

    def __call__(self, effect: Effect, values: Float) -> Float:
        """Return the change of the log density [nat] of each row, (T,), mean over the trajectories.

        Parameters
        ----------
        effect : Effect
            An effect that the model lacks.
        values : ndarray, shape (k,)
            Its parameters.

        Raises
        ------
        DensityError
            When a density is not a number, with the time and the values of the effect.
        """
        change = np.zeros(self.log.n_steps)
        names = [parameter.name for parameter in effect.parameters]
        edited = _on_the_same_states(effect.edit(self.tables, values, self.log), self.tables)
        with _scored_between(effect.name, self.log, names, np.array(effect.null), values):
            self._densities.add_difference(edited, self.tables, change)
        self._densities.forget_all_but(self.tables)
        return change


def _on_the_same_states(edited: Tables, tables: Tables) -> Tables:
    return edited if _same_states(edited, tables) else edited._replace(start=tables.start)


def parameter_scores(bound: BoundModel, theta: Float, columns: Float) -> Float:
    """Score the model's own parameters along trajectories, by differences of some 2 % of each to either side.

    Parameters
    ----------
    bound : BoundModel
        The model bound to one log.
    theta : ndarray, shape (d,)
        Its parameters.
    columns : ndarray, shape (M, D, T)
        Trajectories drawn given all readings.

    Returns
    -------
    ndarray, shape (d, T)
        Half the change of the log density [nat] of each row, mean over the trajectories.

    Raises
    ------
    DensityError
        When a density is not a number, with the time and the parameters.
    """
    scores = np.zeros((theta.size, columns.shape[2]))
    densities = _Densities(columns, bound.tables(theta)[0])
    step = parameter_steps(bound, theta)
    for k, score in enumerate(scores):
        shift = step[k] * (np.arange(theta.size) == k)
        below, above = theta - shift, theta + shift
        with _scored_between("the model", bound.logs[0], bound.names, below, above):
            densities.add_difference(bound.tables(above)[0], bound.tables(below)[0], score)
    return 0.5 * scores


def parameter_steps(bound: BoundModel, theta: Float) -> Float:
    """Return how far :func:`parameter_scores` moves each parameter to either side, (d,).

    Parameters
    ----------
    bound : BoundModel
        The model.
    theta : ndarray, shape (d,)
        Its parameters.
    """
    spread = np.array([min(float(p.prior.std()), 1.0) for p in bound.parameters])
    step = _PARAMETER_SHARE * np.maximum(np.abs(theta), 0.1 * spread)
    # A prior with a long tail says little of the size of a parameter: an alpha of 1e-4 under one that reaches 1.
    bounds = np.array([prior_support(p.prior) for p in bound.parameters])
    return np.asarray(np.minimum(step, _OF_SUPPORT * np.minimum(theta - bounds[:, 0], bounds[:, 1] - theta)))


def _mean_change(above: Float, below: Float) -> Float:
    """Return the mean change over trajectories (M, T), limited; 0 for rounding, and where both are impossible."""
    bad = np.isnan(above) | np.isnan(below)
    if bad.any():
        row = int(np.flatnonzero(bad.any(axis=0))[0])
        raise DensityError(f"at row {row} a density is not a number", row=row)
    impossible = (above == -np.inf) & (below == -np.inf)
    with np.errstate(invalid="ignore"):
        change = np.clip(above - below, -_GREATEST_CHANGE, _GREATEST_CHANGE)
    mean = np.where(impossible, 0.0, change).mean(axis=0)
    return np.asarray(np.where(np.abs(mean) < _LEAST_CHANGE, 0.0, mean))


@contextmanager
def _scored_between(what: str, log: RobotLog, names: Sequence[str], below: Float, above: Float) -> Iterator[None]:
    """Add to the message of a density that is not a number what is scored, the time and the parameters."""
    try:
        yield
    except DensityError as error:
        when = "" if error.row is None else f"at t={log.times[error.row]:g} s (row {error.row}) "
        ends = (
            ", ".join(f"{name}={value:.6g}" for name, value in zip(names, values, strict=True))
            for values in (below, above)
        )
        raise DensityError(
            f"{log.where}: {when}a density is not a number where {what} is scored between {' and '.join(ends)}; check "
            "the coefficient tables at that row",
            row=error.row,
        ) from None


class _Densities:
    """Log densities of trajectories under tables, evaluated once for each table; most tables are shared."""

    def __init__(self, columns: Float, tables: Tables) -> None:
        self.columns = columns
        self.known: dict[int, tuple[Any, Float]] = {}
        self.caches = [sensor_of(table).score_cache(table, columns) for table in tables.sensors]

    def add_difference(self, above: Tables, below: Tables, score: Float) -> None:
        """Add the change of each row's density between two sets of tables; equal parts are skipped.

        Parameters
        ----------
        above, below : Tables
            The tables.
        score : ndarray, shape (T,)
            The array to which the change from `below` to `above` is added [nat].
        """
        if above.motion is not below.motion or above.start is not below.start:
            score += _mean_change(self._motion(above), self._motion(below))
        for upper, lower, cache in zip(above.sensors, below.sensors, self.caches, strict=True):
            if upper is lower:
                continue
            if type(upper) is type(lower):
                upper, lower = sensor_of(upper).parts_that_differ(upper, lower)
                if upper is None:
                    continue
            score += _mean_change(self._sensor(upper, cache), self._sensor(lower, cache))

    def forget_all_but(self, tables: Tables) -> None:
        """Forget the densities of tables that are not asked for again."""
        kept = {id(tables.motion), *(id(table) for table in tables.sensors)}
        self.known = {key: value for key, value in self.known.items() if key in kept}

    def _motion(self, tables: Tables) -> Float:
        return self._once(tables.motion, lambda: smc.motion_terms(tables.start, tables.motion, self.columns))

    def _sensor(self, sensor: Any, cache: Any) -> Float:
        def evaluate() -> Float:
            terms = None if cache is None else cache.terms(sensor)
            return np.asarray(smc.sensor_terms(sensor, self.columns)) if terms is None else terms

        return self._once(sensor, evaluate)

    def _once(self, table: Any, evaluate: Callable[[], Float]) -> Float:
        # The table is kept beside its value, so that no other table can get the same id.
        key = id(table)
        if key not in self.known:
            self.known[key] = (table, np.asarray(evaluate()))
        return self.known[key][1]
