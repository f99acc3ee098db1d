"""Formulas: effects written as a coefficient times a term, added to an increment or a range reading.

``turn += c*sin(2*pi*(time - 59)/60)`` is a gyro that swings, ``range += c*cos(world_direction)`` an error of ranges
that depends on where a beam points. The critic finds formulas where no effect of the catalogue explains a log; model
files hold them (:mod:`pmcl.models.model_file`), and anybody may write one with :func:`formula_effect`.

Terms that depend on the pose of the robot (heading, place, direction of a beam) are evaluated along an estimate of its
path, which :func:`pmcl.filtering.estimated_path.with_estimated_path` puts into the log. So the edit stays a plain
table. The error of the estimate, some centimetres and hundredths of a radian, is neglected.
"""

from __future__ import annotations

import ast
import weakref
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from pmcl.errors import ModelError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.editing import edit_beams
from pmcl.models.effects.effect import Effect, Where
from pmcl.models.effects.terms import OF_BEAMS, evaluated, motion_of_rows, names_in, needs_path, parsed, pose_of_rows
from pmcl.models.parameters import Parameter
from pmcl.models.tables import Tables

__all__ = ["FORMULA_CARRIERS", "PREFIX", "Formula", "FormulaCarrier", "formula_effect", "path_formulas", "portable"]

Float = NDArray[np.float64]

PREFIX = "formula: "
"""What the name of every formula begins with."""

# A formula of these says itself when or where it acts.
_TIME_AND_PLACE = {"time", "x", "y", "x_before", "y_before"}
# Standard deviation of the default prior of a coefficient, in changes that are clearly visible.
_PRIOR_WIDTH = 3.0


class FormulaCarrier(NamedTuple):
    """What a formula changes.

    Attributes
    ----------
    text : str
        The left side, e.g. ``"turn += "``.
    unit : str
        Unit of the change.
    clear : float
        A change that a log of some hundred readings shows clearly, in that unit.
    edit : callable
        ``edit(tables, change) -> Tables``; `change` has shape (T,), or (T, B) for beams.
    carrier : str
        Of the effect, one of :data:`pmcl.models.effects.effect.CARRIERS`.
    of_beams : bool
        Whether the change may differ from beam to beam.
    """

    text: str
    unit: str
    clear: float
    edit: Callable[[Tables, Float], Tables]
    carrier: str
    of_beams: bool = False


def _of_motion(tables: Tables, name: str, change: Callable[[Float], None]) -> Tables:
    """Return the tables with one array of the motion table changed in place on a copy."""
    motion: Any = tables.motion
    if not hasattr(motion, name):
        raise ModelError(
            f"expected a motion by increments, which a formula can change, but got a {type(motion).__name__}; leave "
            "the formula out"
        )
    values = getattr(motion, name).copy()
    change(values)
    return tables._replace(motion=motion._replace(**{name: values}))


def _translation(tables: Tables, change: Float) -> Tables:
    def edit(mean: Float) -> None:
        mean[:, :2] *= 1.0 + change[:, None]

    return _of_motion(tables, "mean", edit)


def _turn(tables: Tables, change: Float) -> Tables:
    def edit(mean: Float) -> None:
        mean[:, 2] += change

    return _of_motion(tables, "mean", edit)


def _noise(component: int) -> Callable[[Tables, Float], Tables]:
    def edit_tables(tables: Tables, change: Float) -> Tables:
        def edit(std: Float) -> None:
            std[:, component] *= _factor(change)

        return _of_motion(tables, "std", edit)

    return edit_tables


def _range(tables: Tables, change: Float) -> Tables:
    return edit_beams(tables, lambda beams: {"bias_at": beams.bias_at + change}, "formula of the ranges")


def _range_noise(tables: Tables, change: Float) -> Tables:
    return edit_beams(
        tables, lambda beams: {"std_factor": beams.std_factor * _factor(change)}, "formula of the range noise"
    )


def _factor(change: Float) -> Float:
    # A chain far from the posterior must not overflow. With a standard deviation 148 times as large, readings tell
    # nothing any more.
    return np.asarray(np.exp(np.clip(change, -5.0, 5.0)))


FORMULA_CARRIERS: dict[str, FormulaCarrier] = {
    "translation": FormulaCarrier("translation *= 1 + ", "1", 0.1, _translation, "motion"),
    "turn": FormulaCarrier("turn += ", "rad", 0.04, _turn, "motion"),
    "log sigma_forward": FormulaCarrier("log sigma_forward += ", "1", 0.5, _noise(0), "motion"),
    "log sigma_left": FormulaCarrier("log sigma_left += ", "1", 0.5, _noise(1), "motion"),
    "log sigma_turn": FormulaCarrier("log sigma_turn += ", "1", 0.5, _noise(2), "motion"),
    "range": FormulaCarrier("range += ", "m", 0.04, _range, "range", of_beams=True),
    "log sigma_range": FormulaCarrier("log sigma_range += ", "1", 0.5, _range_noise, "range"),
}
"""What formulas can change, by the name that model files have for it."""


@dataclass(frozen=True)
class Formula:
    """The edit of a formula: the sum of coefficients times terms, inside a window of time.

    Attributes
    ----------
    carrier : str
        One of :data:`FORMULA_CARRIERS`.
    terms : tuple of str
        K terms, see :mod:`pmcl.models.effects.terms`; one coefficient each.
    constants : mapping of str to float
        Fixed numbers that the terms name, such as the period of a wave.
    window : tuple of float, optional
        First and last time [s] at which the formula holds; always when left out.
    features : tuple of ndarray
        Values of the terms along one known path of one log, (T,) or (T, B) each, or none. The critic computes them
        once for all logs that it simulates; they belong to that log alone, see :func:`portable`.

    Raises
    ------
    ModelError
        When carrier, terms, constants and window do not go together.
    """

    carrier: str
    terms: tuple[str, ...]
    constants: Mapping[str, float] = field(default_factory=dict)
    window: tuple[float, float] | None = None
    features: tuple[Float, ...] = field(default=(), compare=False, repr=False)

    def __post_init__(self) -> None:
        if self.carrier not in FORMULA_CARRIERS:
            raise ModelError(
                f"expected a formula of {', '.join(FORMULA_CARRIERS)}, but got {self.carrier!r}; choose one"
            )
        if not self.terms:
            raise ModelError("expected at least one term of a formula, but got none; write for example 'cos(heading)'")
        trees = self._trees
        unused = sorted(set(self.constants) - {name for tree in trees for name in names_in(tree)})
        if unused:
            raise ModelError(f"expected terms that use the constant '{unused[0]}', but none does; remove it")
        of_beams = {name for tree in trees for name in names_in(tree)} & set(OF_BEAMS)
        if of_beams and not FORMULA_CARRIERS[self.carrier].of_beams:
            raise ModelError(
                f"a formula of {self.carrier} expected terms with one value for each row, but got "
                f"'{sorted(of_beams)[0]}', which each beam has for itself; choose another variable"
            )
        if self.window is not None and not self.window[0] < self.window[1]:
            raise ModelError(f"expected a window [begin, end] with begin < end [s], but got {list(self.window)}")

    @cached_property
    def _trees(self) -> tuple[ast.expr, ...]:
        return tuple(parsed(term, self.constants) for term in self.terms)

    @cached_property
    def _known(self) -> weakref.WeakKeyDictionary[RobotLog, tuple[Float, ...]]:
        return weakref.WeakKeyDictionary()

    def __getstate__(self) -> dict[str, Any]:
        # Syntax trees and weak references stay behind when a pool of processes pickles a model.
        return {name: value for name, value in self.__dict__.items() if name not in ("_trees", "_known")}

    @property
    def needs_path(self) -> bool:
        """Whether a log must hold an estimate of its path before the formula can be evaluated on it."""
        return not self.features and any(needs_path(tree) for tree in self._trees)

    def __call__(self, tables: Tables, values: Any, log: RobotLog, where: Where) -> Tables:
        """Return the tables with the formula in them, see :class:`~pmcl.models.effects.effect.Effect`."""
        if not np.any(values):
            # No path is needed to add nothing: so a model can estimate the path that its formulas need.
            change = np.zeros(log.n_steps)
        else:
            features = self.values(log)
            change = float(values[0]) * features[0][: log.n_steps]
            for value, feature in zip(values[1:], features[1:], strict=True):
                change = change + float(value) * feature[: log.n_steps]
        carrier = FORMULA_CARRIERS[self.carrier]
        return carrier.edit(tables, change[:, None] if carrier.of_beams and change.ndim == 1 else change)

    def values(self, log: RobotLog) -> tuple[Float, ...]:
        """Return the values of the terms on a log, (T,) or (T, B) each, zero outside the window.

        Raises
        ------
        ModelError
            When the log holds no estimate of the path that a term needs, or a value is not finite.
        """
        if self.features:
            return self.features
        if not log.is_whole:
            return self._evaluated(log)
        # Tables are made for each proposal; the terms of a log stay the same.
        if log not in self._known:
            self._known[log] = self._evaluated(log)
        return self._known[log]

    def _evaluated(self, log: RobotLog) -> tuple[Float, ...]:
        variables: dict[str, Float | float] = {**motion_of_rows(log), **self.constants}
        if self.needs_path:
            variables |= _along_path(log, self)
        found = []
        for text, tree in zip(self.terms, self._trees, strict=True):
            with np.errstate(all="ignore"):
                value = evaluated(tree, variables)
            value = np.broadcast_to(value, (log.n_steps,)) if value.ndim == 0 else value
            if self.window is not None:
                times = np.asarray(log.times)
                inside = (self.window[0] <= times) & (times <= self.window[1])
                value = np.where(inside if value.ndim == 1 else inside[:, None], value, 0.0)
            # Nothing is known of the motion into row 0, and no density reads what is changed there.
            bad = np.flatnonzero(~np.isfinite(value[1:]).reshape(max(log.n_steps - 1, 0), -1).all(axis=1))
            if bad.size:
                raise ModelError(
                    f"{log.where}: expected finite values of the term '{text}', but at row {bad[0] + 1} it is "
                    f"{value[bad[0] + 1]}; correct the term"
                )
            found.append(np.ascontiguousarray(value))
        return tuple(found)


def _along_path(log: RobotLog, formula: Formula) -> dict[str, Float]:
    path = log.estimated("path")
    if path is None or not log.is_whole:
        raise ModelError(
            f"{log.where}: expected a log with an estimate of its path, on which the formula '{formula.terms[0]}' "
            "depends, but it has none; get one from pmcl.filtering.estimated_path.with_estimated_path (calibrate, "
            "localize and criticize do), and leave such a formula out where a robot is followed row by row"
        )
    beams = {name: log.estimated(name) for name in OF_BEAMS}
    return pose_of_rows(path) | {name: values for name, values in beams.items() if values is not None}


def formula_effect(
    carrier: str,
    terms: Sequence[str],
    constants: Mapping[str, float] | None = None,
    window: tuple[float, float] | None = None,
    *,
    name: str | None = None,
    coefficients: Sequence[str] | None = None,
    spread: Sequence[float] | None = None,
    features: Sequence[Float] = (),
) -> Effect:
    """Return a formula as an effect.

    Parameters
    ----------
    carrier : str
        What is changed, one of :data:`FORMULA_CARRIERS`.
    terms : sequence of str
        K terms, see :mod:`pmcl.models.effects.terms`.
    constants : mapping of str to float, optional
        Fixed numbers that the terms name.
    window : tuple of float, optional
        First and last time [s] at which it holds.
    name : str, optional
        What the effect is called; :data:`PREFIX` and the formula itself when left out.
    coefficients : sequence of str, optional
        Names of the K parameters; made from the effect's name when left out.
    spread : sequence of float, optional
        Root mean square of each term, 1 when left out. The default prior of a coefficient is a normal distribution
        around zero that is as wide as three clearly visible changes.
    features : sequence of ndarray
        See :class:`Formula`.

    Raises
    ------
    ModelError
        When the parts do not go together.

    Examples
    --------
    >>> from pmcl.models.effects.formula import formula_effect
    >>> swinging = formula_effect("turn", ["sin(2*pi*time/period)"], {"period": 60.0})
    >>> swinging.name
    'formula: turn += c*sin(2*pi*time/period)'
    """
    change = Formula(carrier, tuple(terms), dict(constants or {}), window, tuple(features))
    kind, count = FORMULA_CARRIERS[carrier], len(change.terms)
    if name is None:
        numbers = [""] if count == 1 else [str(k + 1) for k in range(count)]
        name = f"{PREFIX}{kind.text}" + " + ".join(f"c{n}*{term}" for n, term in zip(numbers, terms, strict=True))
    depends = name.removeprefix(PREFIX).removeprefix(kind.text)
    depends = depends.removeprefix("c*") if count == 1 else " and ".join(change.terms)
    if coefficients is None:
        stem = _identifier(f"formula {kind.text}{depends}")
        coefficients = [stem] if count == 1 else [f"{stem}_{k + 1}" for k in range(count)]
    spread = [1.0] * count if spread is None else spread
    if not len(coefficients) == len(spread) == count:
        raise ModelError(
            f"{name}: expected one coefficient for each of {count} terms, but got {len(coefficients)}; name them all"
        )
    clear = [kind.clear / size for size in spread]
    parameters = tuple(
        Parameter(parameter, kind.unit, stats.norm(scale=_PRIOR_WIDTH * size), "coefficient")
        for parameter, size in zip(coefficients, clear, strict=True)
    )
    return Effect(
        name=name,
        summary=f"{kind.text.removeprefix('log ').split()[0]} depends on {depends}",
        parameters=parameters,
        null=(0.0,) * count,
        change=change,
        carrier=kind.carrier,
        symptom=f"Residuals depend on {depends}.",
        typical={"clear": tuple(clear)},
        absorber=True,  # noise that depends on something takes up much of what any effect causes
        may_begin=window is None and not _TIME_AND_PLACE & {name for tree in change._trees for name in names_in(tree)},
    )


def _identifier(text: str) -> str:
    plain = "".join(letter if letter.isalnum() else "_" for letter in text)
    return "_".join(part for part in plain.split("_") if part)


def path_formulas(effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """Return those effects that are formulas of a path, which a log must hold an estimate of."""
    return tuple(effect for effect in effects if isinstance(effect.change, Formula) and effect.change.needs_path)


def portable(effect: Effect) -> Effect:
    """Return an effect that is the same on any log: a formula forgets the values that it had on one."""
    if isinstance(effect.change, Formula) and effect.change.features:
        return replace(effect, change=replace(effect.change, features=()))
    return effect
