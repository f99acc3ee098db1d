"""Simulated robots with effects that plain models lack.

The effect edits the tables from which paths and readings are drawn, so that a simulated effect has exactly the density
of a model with the effect. Odometry stays as the robot logged it; an effect of the motion changes the true path, and
the robot, which is steered from its true pose, reacts to it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.checks import check_flag, check_type
from pmcl.engine import contract
from pmcl.errors import ModelError
from pmcl.logs.robot_log import RobotLog
from pmcl.maps.arrays import as_numbers
from pmcl.models.effects.effect import Effect, named_apart
from pmcl.models.effects.selection import check_values, parse_effect
from pmcl.models.part import Part
from pmcl.models.starts.belief import StartBelief
from pmcl.models.tables import Tables
from pmcl.simulations.simulate import make_rng

__all__ = ["Affected", "Given", "affected_by"]

Float = NDArray[np.float64]
Given = str | tuple[Effect, Sequence[float]]
"""An effect to simulate: a text such as ``"beam-bias@2=0.06"``, or an effect and the values of its parameters."""


@dataclass(frozen=True, eq=False, repr=False)
class _Unfolding(RobotLog):
    """A log during the drive: odometry of rows that are not driven yet is zero."""

    command: Float = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def odometry(self) -> Float:
        """The commands so far."""
        return self.command


@dataclass(frozen=True)
class Affected:
    """Effects with their true values, and the model that they act on.

    Attributes
    ----------
    effects : tuple of Effect
        Instances, their parameters named apart.
    values : tuple of ndarray
        True values of each one's parameters.
    motion, sensor : Part
        Parts of the robot's model.
    truth : mapping of str to float
        True values of their parameters.
    """

    effects: tuple[Effect, ...]
    values: tuple[Float, ...]
    motion: Part
    sensor: Part
    truth: Mapping[str, float]

    @property
    def moves_differently(self) -> bool:
        """Whether any effect changes the true path."""
        return any(effect.carrier == "motion" for effect in self.effects)

    @property
    def true_theta(self) -> dict[str, float]:
        """All true parameters, those of the effects last."""
        named = {
            parameter.name: float(value)
            for effect, values in zip(self.effects, self.values, strict=True)
            for parameter, value in zip(effect.parameters, values, strict=True)
        }
        return {**self.truth, **named}

    def described(self) -> str:
        """Return the effects as JSON: name, place and values of each."""
        descriptions = [
            {
                "name": effect.name,
                "where": {key: list(place) for key, place in effect.where.items()},
                "parameters": {p.name: float(value) for p, value in zip(effect.parameters, values, strict=True)},
            }
            for effect, values in zip(self.effects, self.values, strict=True)
        ]
        return json.dumps(descriptions)

    def tables(self, log: RobotLog) -> Tables:
        """Return the true coefficient tables of a log."""
        start = StartBelief().bind(log).table(np.empty(0))
        return self._edited(Tables(start, self._table(self.motion, log), (self._table(self.sensor, log),)), log)

    def _table(self, part: Part, log: RobotLog) -> NamedTuple:
        return part.bind(log).table(np.array([self.truth[parameter.name] for parameter in part.parameters]))

    def _edited(self, tables: Tables, log: RobotLog) -> Tables:
        for effect, values in zip(self.effects, self.values, strict=True):
            tables = effect.edit(tables, values, log)
        return tables

    def drive(
        self, log: RobotLog, start: Float, steer: Callable[[Float], Float], rng: np.random.Generator
    ) -> tuple[Float, Float]:
        """Drive the robot with the effects: each increment is drawn from the true motion table at that row.

        Parameters
        ----------
        log : RobotLog
            The log; only its times and its map are used.
        start : ndarray, shape (3,)
            First pose.
        steer : callable
            True pose (3,) to commanded increment (3,).
        rng : numpy.random.Generator
            Source of randomness.

        Returns
        -------
        path : ndarray, shape (T, 3)
            True poses; headings are not wrapped.
        command : ndarray, shape (T, 3)
            Commanded increments, which odometry reports.

        Raises
        ------
        ModelError
            When an effect makes the motion depend on commands of later rows.
        """
        command = np.zeros((log.n_steps, 3))
        unfolding = _Unfolding(log.dataset, log.where, log.grid_map, command)
        start_table = StartBelief().bind(unfolding).table(np.empty(0))
        plain = Tables(start_table, self._table(self.motion, unfolding), (self._table(self.sensor, unfolding),))
        tables = self._edited(plain, unfolding)
        size = int(contract.state_size(tables.motion))
        current, used = np.empty((size, 1)), np.zeros((log.n_steps, 3))
        contract.draw_start(tables.start, rng, current)
        current[:3, 0] = start
        path = np.empty((log.n_steps, 3))
        path[0] = start
        scratch = np.empty((int(contract.scratch_rows(tables.motion)), 1))
        for t in range(1, log.n_steps):
            command[t] = steer(path[t - 1])
            # Only odometry is new, and later rows are not used yet.
            motion = self._edited(plain._replace(motion=self._table(self.motion, unfolding)), unfolding).motion
            before = current.copy()
            contract.propagate(motion, t, rng, before, current, scratch)
            path[t], used[t] = current[:3, 0], motion.mean[t]  # type: ignore[attr-defined]
        final = self.tables(unfolding).motion.mean  # type: ignore[attr-defined]
        if not np.allclose(used[1:], final[1:], rtol=0.0, atol=1e-9):
            raise ModelError(
                f"{log.where}: expected effects by which the robot moves after it is told to, but got "
                f"{self.described()}, which needs commands of later rows; choose a delay >= 0"
            )
        return path, command


def check_given(given: Any, hide: Any) -> None:
    """Check the types of effects to simulate, before anything is simulated.

    Parameters
    ----------
    given : Any
        The argument ``effects``, which should be a list of texts and of pairs of an effect and its values.
    hide : Any
        The argument ``hide_effects``, which should be True or False.

    Raises
    ------
    ModelError
        When one of them is of another type.
    """
    check_type("effects", given, (list, tuple), error=ModelError, advice="write a list, also around one effect")
    for entry in given:
        pair = isinstance(entry, tuple | list) and len(entry) == 2 and isinstance(entry[0], Effect)
        if not isinstance(entry, str) and not pair:
            raise ModelError(
                "expected each effect as text or as a pair of an effect and its values, but got "
                f"{type(entry).__name__}; write for example 'range-bias=0.05'"
            )
    check_flag("hide_effects", hide, error=ModelError)


def affected_by(
    given: Sequence[Given], log: RobotLog, seed: int, motion: Part, sensor: Part, truth: Mapping[str, float]
) -> Affected:
    """Resolve the effects of a simulation.

    Parameters
    ----------
    given : sequence of str or (Effect, values)
        Texts as for :func:`pmcl.models.effects.selection.parse_effect`.
    log : RobotLog
        The same simulation without them; it decides which effects can be simulated and which places exist.
    seed : int
        Seed of the simulation; places that are not given follow from it.
    motion, sensor : Part
        Parts of the robot's model.
    truth : mapping of str to float
        True values of their parameters.

    Raises
    ------
    ModelError
        When an effect, its place or its values are not usable, or an effect is given twice at one place.
    """
    rng = make_rng(np.random.SeedSequence([seed, len("effects")]))
    effects, values = [], []
    for entry in given:
        if isinstance(entry, str):
            effect, numbers = parse_effect(entry, log, rng)
        else:
            effect, given_values = entry
            try:
                numbers = as_numbers(given_values)
            except TypeError as problem:
                raise ModelError(
                    f"{log.where}: expected numbers for effect {effect.name}, but got {problem}; correct them"
                ) from None
            if numbers.shape != (len(effect.parameters),):
                raise ModelError(
                    f"{log.where}: expected {len(effect.parameters)} values for effect {effect.name}, but got shape "
                    f"{numbers.shape}; give one for each parameter"
                )
            check_values(effect, numbers)
        effects.append(effect)
        values.append(numbers)
    return Affected(named_apart(effects), tuple(values), motion, sensor, truth)
