"""The interface of a missing effect."""

from __future__ import annotations

import string
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pmcl.errors import ModelError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.editing import settled
from pmcl.models.motions.joined.table import joined_tables, parts_of_joined
from pmcl.models.parameters import Parameter, prior_support
from pmcl.models.part import Float
from pmcl.models.tables import Tables
from pmcl.registry import SENSORS, names_of_others

__all__ = ["CARRIERS", "MAGNITUDES", "Effect", "Where", "always", "named_apart"]

Where = Mapping[str, Sequence[float]]
"""What an effect is about, for people and files: ``{"beams": [2]}``; empty for an effect of the whole robot."""

CARRIERS = ("motion", "range", "landmark", "sensor", "map")
"""What an effect is carried by; "sensor" is any sensor, or all of the robot. Names of others' sensors serve, too."""

MAGNITUDES = ("just visible", "clear", "large")
"""Names of typical magnitudes, for a log of some hundred readings of each kind."""


def always(log: RobotLog) -> bool:
    """Return True: for effects that any log may hold."""
    return True


@dataclass(frozen=True)
class Effect:
    """One effect that a model may lack.

    Attributes
    ----------
    name : str
        Lower case with hyphens, e.g. "beam-bias".
    summary : str
        One sentence that a roboticist understands.
    parameters : tuple of Parameter
        Named after the effect (``beam_bias``), with weakly informative priors.
    null : tuple of float
        Values at which there is no effect. For a parameter in `shape` a place where to look.
    change : callable
        ``change(tables, values, log, where) -> Tables``: the edit, plain numpy. It must not alter the arrays given.
    carrier : str
        One of :data:`CARRIERS`, or the name that model files have for the sensor of an installed package.
    symptom : str
        How it shows in the data, in one sentence.
    finding : str
        What is said of a log that has it, with what was measured, e.g. ``"beam {beams} reads {0} {0:too long|too
        short}"``: its place by name, its parameters by number. ``{0}`` is the size with unit and standard deviation,
        ``{0:+}`` the same with its sign, ``{0:%}`` in per cent, ``{0:left|right}`` a word for each sign. Without it
        the summary and the values are told.
    typical : mapping of str to tuple of float
        A value of each parameter at each of :data:`MAGNITUDES`.
    where : mapping
        What this instance is about; empty for the general effect.
    shape : tuple of str
        Names of parameters that mean nothing at the null, such as the place of a patch that does not slip.
    squared : bool
        Whether the effect enters densities through its square, as an added standard deviation does.
    means_only : bool
        Whether it changes only where plain tables expect increments and readings, not how they scatter. Sums of
        squares then still serve the other parameters.
    absorber : bool
        Whether it is so general that it also absorbs what other effects cause: correlated noise, outliers, more noise.
    may_begin : bool
        Whether it may begin or end in the course of a log, so that the critic says when it acts. False for effects that
        are about time themselves, such as a drift, and for those at a place of the map, which show only there.
    near_twins : mapping of str to str
        Effects that look alike, and the motion that tells them apart.
    same_as : mapping of str to callable
        Effects that are this one under another name, with the same prior, in logs for which ``same_as[name](log)``
        holds: no log of that kind tells them apart.
    references : tuple of str
        Where it is described.
    needs : callable
        ``needs(log)``: whether the log can show it at all.
    places : callable, optional
        ``places(log)``: the different values of `where` that the log offers, e.g. one for each beam.
    fitted : callable, optional
        ``fitted(effect, log)``: adapts null, priors and magnitudes of an instance to its place.
    tells : callable, optional
        ``tells(log)``: values that the data show by themselves, by parameter name, to be held fixed.
    carries : callable, optional
        ``carries(path, values, log)``: the path (T, D) along which the readings with the effect are about those along
        `path` without it, for an effect that moves the whole sensor. Only the motion then tells its size. A fit starts
        there: from the path without the effect, all readings would have to be left behind to come to a large one.
    rigid : bool
        Whether it carries each pose of a path by itself and rigidly, as a turned or shifted sensor does.
    """

    name: str
    summary: str
    parameters: tuple[Parameter, ...]
    null: tuple[float, ...]
    change: Callable[[Tables, Any, RobotLog, Where], Tables]
    carrier: str = "sensor"
    symptom: str = ""
    finding: str = ""
    typical: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    where: Where = field(default_factory=dict)
    shape: tuple[str, ...] = ()
    squared: bool = False
    means_only: bool = False
    absorber: bool = False
    may_begin: bool = True
    near_twins: Mapping[str, str] = field(default_factory=dict)
    same_as: Mapping[str, Callable[[RobotLog], bool]] = field(default_factory=dict)
    references: tuple[str, ...] = ()
    needs: Callable[[RobotLog], bool] = always
    places: Callable[[RobotLog], Sequence[Where]] | None = None
    fitted: Callable[[Effect, RobotLog], Effect] | None = None
    tells: Callable[[RobotLog], Mapping[str, float]] | None = None
    carries: Callable[[Float, Float, RobotLog], Float] | None = None
    rigid: bool = False

    def __post_init__(self) -> None:
        """Check that names, values and priors belong together."""
        own = [parameter.name for parameter in self.parameters]
        if self.carrier not in CARRIERS and self.carrier not in names_of_others(SENSORS):
            carriers = ", ".join((*CARRIERS, *names_of_others(SENSORS)))
            raise ModelError(
                f"effect {self.name}: expected a carrier out of {carriers}, but got {self.carrier!r}; choose one"
            )
        if not own or len(set(own)) < len(own) or len(self.null) != len(own):
            raise ModelError(
                f"effect {self.name}: expected parameters of different names and one null value for each, but got "
                f"{own} and {len(self.null)} values; give each parameter its null"
            )
        for magnitude, values in self.typical.items():
            if magnitude not in MAGNITUDES or len(values) != len(own):
                raise ModelError(
                    f"effect {self.name}: expected typical values for {', '.join(MAGNITUDES)}, {len(own)} each, but "
                    f"got {len(values)} for {magnitude!r}; correct them"
                )
        for parameter, value in zip(self.parameters, self.null, strict=True):
            low, high = prior_support(parameter.prior)
            if not low <= value <= high:
                raise ModelError(
                    f"effect {self.name}: expected the null of {parameter.name} within its prior, {low:g} to {high:g}, "
                    f"but got {value:g}; widen the prior"
                )
        known = {str(k) for k in range(len(own))} | set(self.where)
        named = {name for _, name, _, _ in string.Formatter().parse(self.finding) if name is not None}
        # Which places an effect has is known of its instances only.
        strange = sorted(name for name in named - known if name.isdecimal() or self.where or self.places is None)
        if strange:
            raise ModelError(
                f"effect {self.name}: expected a finding about {', '.join(sorted(known))}, but got "
                f"{', '.join(strange)}; correct what is in braces"
            )
        unknown = sorted(set(self.shape) - set(own))
        if unknown or len(self.shape) == len(own):
            raise ModelError(
                f"effect {self.name}: expected shape to name some of {own}, but not all, and got {list(self.shape)}; "
                "leave out what is no parameter, or what is the strength of the effect"
            )

    @property
    def strengths(self) -> tuple[int, ...]:
        """Positions of the parameters that are zero effect at their null: all but those in `shape`."""
        return tuple(k for k, parameter in enumerate(self.parameters) if parameter.name not in self.shape)

    def edit(self, tables: Tables, values: Any, log: RobotLog) -> Tables:
        """Return the tables with the effect in them.

        Parameters
        ----------
        tables : Tables
            Of one log; left as they are.
        values : array_like, shape (k,)
            Of the effect's parameters.
        log : RobotLog
            The log that the tables belong to.

        Returns
        -------
        Tables
            Arrays that nothing changes are shared with `tables`.

        Raises
        ------
        ModelError
            When the tables are not of a kind that the effect can edit.
        """
        own, seams = parts_of_joined(tables)
        edited = settled(self.change(own, np.asarray(values, dtype=float), log, self.where), own, self.name)
        if seams is None:
            return edited
        if edited.motion is own.motion and edited.start is own.start:
            return edited._replace(motion=tables.motion)
        return joined_tables(edited, seams)

    def applies(self, log: RobotLog) -> bool:
        """Return whether a log can show the effect: it has the readings or the motion that the effect is about."""
        return self.needs(log)

    def instances(self, log: RobotLog) -> tuple[Effect, ...]:
        """Return the effect once for each thing that it may be about: beams, landmarks, walls; most give one.

        An instance gives itself; an effect that does not apply gives none.
        """
        if not self.applies(log):
            return ()
        if self.places is None or self.where:
            return (self,)
        return tuple(self.at(where, log) for where in self.places(log))

    def at(self, where: Where, log: RobotLog) -> Effect:
        """Return the instance at one place.

        Parameters
        ----------
        where : mapping of str to sequence of float
            The place, e.g. ``{"beams": [2]}``.
        log : RobotLog
            It must have the place.

        Returns
        -------
        Effect

        Raises
        ------
        ModelError
            When the effect has no places, or `where` names another kind of place.
        """
        offered = self.places(log) if self.places is not None else ()
        kinds = {tuple(place) for place in offered}
        plain = {str(key): tuple(float(value) for value in values) for key, values in where.items()}
        if tuple(plain) not in kinds:
            places = " or ".join(", ".join(kind) for kind in sorted(kinds)) or "no place"
            raise ModelError(
                f"{log.where}: effect {self.name} expected {places}, but got {', '.join(plain) or 'none'}; "
                "correct where it is"
            )
        whole = all(value == int(value) for place in offered for values in place.values() for value in values)
        # A beam or landmark that this log has but never read is a place, too: a model may come from another log.
        held = all(value in range(_count(log, key)) for key, values in plain.items() for value in values)
        if whole and not held and not any(all(tuple(place[key]) == plain[key] for key in plain) for place in offered):
            raise ModelError(
                f"{log.where}: effect {self.name} expected one of the {len(offered)} places that the log has, but got "
                f"{', '.join(f'{v:g}' for values in plain.values() for v in values)}; count from 0"
            )
        integers = {key: tuple(int(v) if whole else v for v in values) for key, values in plain.items()}
        made = replace(self, where=integers)
        return made if self.fitted is None else self.fitted(made, log)

    def magnitude(self, name: str) -> Float:
        """Return the typical values (k,) of one of :data:`MAGNITUDES`; raises ModelError for another name."""
        plain = name.replace("-", " ")
        if plain not in self.typical:
            raise ModelError(
                f"effect {self.name}: expected a magnitude out of {', '.join(self.typical) or 'none'}, but got "
                f"{name!r}; choose one, or give a number"
            )
        return np.array(self.typical[plain], dtype=float)

    def one_sided(self, strength: int) -> bool:
        """Return whether the parameter at position `strength` has its null at the edge of its prior."""
        low, high = prior_support(self.parameters[strength].prior)
        return self.null[strength] in (low, high)

    def probe(self, size: float, strength: int | None = None) -> Float:
        """Return values on a curve from the null (size 0) to a clear effect (size 1), for scores and scans.

        Along it the log density has a slope at the null that is a proper score, also for effects that enter through
        their square (the curve is then a square root, and negative sizes are not possible).

        Parameters
        ----------
        size : float
            Share of the clear magnitude; negative only for effects with two sides.
        strength : int, optional
            Position of the parameter that is moved, one of :attr:`strengths`; all of them when left out.

        Returns
        -------
        ndarray, shape (k,)
        """
        values = np.array(self.null, dtype=float)
        clear = self.magnitude("clear")
        way = np.sqrt(max(size, 0.0)) if self.squared else size
        for k in self.strengths if strength is None else (strength,):
            values[k] += way * (clear[k] - self.null[k])
        return values


def _count(log: RobotLog, kind: str) -> int:
    """Return how many places of a kind a log has: ``"beams"`` are the size of its dimension ``beam``."""
    sizes = log.dataset.sizes
    name = kind.removesuffix("s")
    return int(sizes.get(name, sizes.get(f"{name}_index", 0)))


def named_apart(effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """Give the parameters of effects that occur several times different names.

    ``beam_bias`` of two instances becomes ``beam_bias_2`` and ``beam_bias_5`` by their beams; instances without whole
    numbers in `where` are counted from 1.

    Raises
    ------
    ModelError
        When the same effect occurs twice at the same place.
    """
    names = [effect.name for effect in effects]
    made, count = [], dict.fromkeys(names, 0)
    for position, effect in enumerate(effects):
        count[effect.name] += 1
        if names.count(effect.name) == 1:
            made.append(effect)
            continue
        if any(other.name == effect.name and other.where == effect.where for other in effects[:position]):
            raise ModelError(
                f"expected each effect once, but got {effect.name} twice at {dict(effect.where) or 'no place'}; "
                "remove one"
            )
        numbers = [value for values in effect.where.values() for value in values]
        whole = bool(numbers) and all(isinstance(value, int) for value in numbers)
        ending = "_".join(str(value) for value in numbers) if whole else str(count[effect.name])
        renamed = {parameter.name: f"{parameter.name}_{ending}" for parameter in effect.parameters}
        parameters = tuple(replace(parameter, name=renamed[parameter.name]) for parameter in effect.parameters)
        made.append(replace(effect, parameters=parameters, shape=tuple(renamed[name] for name in effect.shape)))
    return tuple(made)
