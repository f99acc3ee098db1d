"""The effects that a name can mean: those of pmcl, of installed packages, and of the user's own files.

An installed package offers effects through an entry point of the group ``pmcl.effects`` (:mod:`pmcl.registry`), whose
object is an :class:`~pmcl.models.effects.effect.Effect` or a sequence of them. In its pyproject.toml it says, for
example, ``[project.entry-points."pmcl.effects"]`` and below ``torque-steer = "my_package.effects:TORQUE_STEER"``. A
file is read with :func:`read_effects`; its effects are known while :func:`use_effects` lasts.
"""

from __future__ import annotations

import functools
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import numpy as np

from pmcl.errors import ModelError, PmclError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.carried import remember_file
from pmcl.models.effects.catalogue import CATALOGUE
from pmcl.models.effects.effect import Effect
from pmcl.models.robot_model import default_model
from pmcl.models.tables import Tables
from pmcl.registry import EFFECTS, origin, registered

__all__ = [
    "candidates", "check_on", "effects_in", "known_effects", "read_effects", "run_file", "told_by_line", "use_effects",
    "values_in",
]  # fmt: skip

_Kind = TypeVar("_Kind")
_in_use: list[Effect] = []

# What counts as no change at the null: effects that interpolate change the last digits.
_ROUNDING: dict[str, Any] = {"rtol": 1e-9, "atol": 1e-12, "equal_nan": True}


def known_effects() -> tuple[Effect, ...]:
    """Return every effect that has a name: the catalogue, then those of installed packages, then those in use.

    Raises
    ------
    ModelError
        When an installed package offers something that cannot be used.
    """
    return (*CATALOGUE, *_installed_effects(), *_in_use)


def candidates(log: RobotLog) -> tuple[Effect, ...]:
    """Return every instance of every known effect that a log can show; checks effects from outside on the log."""
    own = {effect.name for effect in known_effects()} - {effect.name for effect in CATALOGUE}
    instances = tuple(instance for effect in known_effects() for instance in effect.instances(log))
    for instance in instances:
        if instance.name in own:
            check_on(instance, log)
    return instances


@contextmanager
def use_effects(effects: Iterable[Effect]) -> Iterator[None]:
    """Let names mean these effects, too, inside a ``with`` block: for the critic, model files and simulations.

    Parameters
    ----------
    effects : iterable of Effect
        Of the user's own, for example from :func:`read_effects`.

    Raises
    ------
    ModelError
        When an effect has the name of another one, or no typical size.
    """
    before = list(_in_use)
    for effect in effects:
        _check_new(effect, known_effects(), lambda: "use_effects")
        _in_use.append(effect)
    try:
        yield
    finally:
        _in_use[:] = before


def read_effects(path: str | Path) -> tuple[Effect, ...]:
    """Run a Python file and return the effects that it defines.

    Parameters
    ----------
    path : path
        Every :class:`~pmcl.models.effects.effect.Effect` that a name at the top of the file stands for is taken, by
        itself or in a list or tuple.

    Returns
    -------
    tuple of Effect
        In the file's order. What goes wrong in their functions later is told with file and line, too.

    Raises
    ------
    ModelError
        When the file is missing, does not run, or defines no effect that can be used. The message names the line.
    """
    file = Path(path)
    found = effects_in(run_file(file), file)
    if not found:
        raise ModelError(
            f"{file}: expected at least one pmcl.models.effects.Effect, but the file defines none; "
            "'pmcl example own_effect' prints a file to start from"
        )
    return found


def effects_in(module: ModuleType, file: Path) -> tuple[Effect, ...]:
    """Return the effects that names at the top of a user's file stand for, see :func:`read_effects`.

    Parameters
    ----------
    module : module
        From :func:`run_file`.
    file : path
        The file, for messages.
    """
    found: list[Effect] = []
    for effect in values_in(module, Effect):
        if any(effect is known for known in CATALOGUE):
            continue
        _check_new(effect, (*CATALOGUE, *_installed_effects(), *found), lambda: str(file))
        found.append(_told_by_line(effect, file))
    return tuple(found)


def values_in(module: ModuleType, kind: type[_Kind]) -> list[_Kind]:
    """Return the objects of one type that names at the top of a module stand for, alone or in lists and tuples.

    Parameters
    ----------
    module : module
        From :func:`run_file`.
    kind : type
        Their type.
    """
    return _members([value for name, value in vars(module).items() if not name.startswith("__")], kind)


def check_on(effect: Effect, log: RobotLog) -> None:
    """Check on the default model of a log that an effect keeps what every effect must keep.

    Parameters
    ----------
    effect : Effect
        An instance.
    log : RobotLog
        A log that can show it.

    Raises
    ------
    ModelError
        When the effect changes the shape of an array, makes a number that is not finite of a finite one, alters the
        arrays that it was given, or changes something at its null.
    """
    bound = default_model(log).bind(log)
    tables = bound.tables(bound.prior_mean())[0]
    before = _arrays(tables)
    copies = {name: array.copy() for name, array in before.items()}
    for values, what in ((effect.null, "its null"), (effect.magnitude("clear"), "its clear size")):
        after = _arrays(effect.edit(tables, values, log))
        for name, copy in copies.items():
            if not np.array_equal(before[name], copy, equal_nan=True):
                raise ModelError(f"effect {effect.name}: expected new arrays, but it altered '{name}'; change a copy")
            array = after.get(name)
            if array is None:
                continue  # a table with extras has further fields
            if array.shape != copy.shape:
                raise ModelError(
                    f"effect {effect.name}: expected '{name}' of shape {copy.shape}, but got {array.shape} at {what}; "
                    "keep the shapes of the arrays"
                )
            lost = np.isfinite(copy) & ~np.isfinite(array)
            if lost.any():
                raise ModelError(
                    f"effect {effect.name}: expected finite numbers in '{name}', but got {array[lost][0]} at {what}, "
                    f"index {tuple(int(i) for i in np.argwhere(lost)[0])}; correct the change"
                )
            if values is effect.null and not effect.shape and not np.allclose(array, copy, **_ROUNDING):
                raise ModelError(
                    f"effect {effect.name}: expected no change at its null {list(effect.null)}, but '{name}' differs; "
                    "correct the change or the null"
                )


def _installed_effects() -> tuple[Effect, ...]:
    """Return the effects of the registry: those of installed packages, and those that were registered here."""
    found: list[Effect] = []
    for name, offered in registered(EFFECTS).items():
        effects = _members([offered], Effect)
        if not effects:
            raise ModelError(
                f"{origin(EFFECTS, name)}: expected an effect or a sequence of effects, but got a "
                f"{type(offered).__name__}; repair or remove it"
            )
        for effect in effects:
            _check_new(effect, (*CATALOGUE, *found), functools.partial(origin, EFFECTS, name))
            found.append(effect)
    return tuple(found)


def _members(values: Iterable[Any], kind: type[_Kind]) -> list[_Kind]:
    found: list[_Kind] = []
    for value in values:
        for each in value if isinstance(value, list | tuple) else (value,):
            if isinstance(each, kind) and not any(each is other for other in found):
                found.append(each)
    return found


def _check_new(effect: Effect, known: Sequence[Effect], where: Callable[[], str]) -> None:
    if any(effect.name == other.name for other in known):
        raise ModelError(f"{where()}: expected new names, but there is an effect {effect.name} already; rename it")
    if "clear" not in effect.typical:
        raise ModelError(
            f"{where()}, effect {effect.name}: expected typical values for 'clear', but got none; write for example "
            f"typical={{'clear': ({', '.join(['0.1'] * len(effect.parameters))},)}}"
        )


def run_file(file: Path) -> ModuleType:
    """Run a user's file as a module of its own.

    Parameters
    ----------
    file : path
        The Python file.

    Raises
    ------
    ModelError
        Whatever goes wrong becomes one line with the line number.
    """
    try:
        source = file.read_bytes()
    except OSError as error:
        raise ModelError(
            f"{file}: expected a Python file with effects, but got '{error.strerror}'; check the path"
        ) from None
    module = ModuleType(f"pmcl_effects_of_{file.stem}")
    module.__file__ = str(file)
    # Dataclasses and pickles look their module up by its name.
    sys.modules[module.__name__] = module
    try:
        exec(compile(source, str(file), "exec"), vars(module))
    except Exception as error:
        raise _located(file, error) from error
    remember_file(module.__name__, file, source)
    return module


def _located(file: Path, error: Exception) -> ModelError:
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(file)]
    if isinstance(error, SyntaxError) and error.filename == str(file):
        lines.append(error.lineno)
    at = f", line {lines[-1]}" if lines else ""
    # Errors of pmcl say themselves what was expected.
    problem = (
        str(error)
        if isinstance(error, PmclError)
        else (f"expected Python code that runs, but got {_in_one_line(error)}; correct it")
    )
    return ModelError(f"{file}{at}: {problem}")


def _in_one_line(error: Exception) -> str:
    text = error.msg if isinstance(error, SyntaxError) else str(error)
    return f"{type(error).__name__}: {' '.join(text.split())}".rstrip(": ")


class _Located:
    """A function of the user's file, whose failures are told with file and line."""

    def __init__(self, function: Callable[..., Any], file: Path) -> None:
        self.function, self.file = function, file

    def __call__(self, *arguments: Any) -> Any:
        try:
            return self.function(*arguments)
        except PmclError:
            raise
        except Exception as error:
            raise _located(self.file, error) from error


def told_by_line(function: Callable[..., Any], file: Path) -> Callable[..., Any]:
    """Return a function of a user's file, whose failures are told with file and line as ModelError.

    Parameters
    ----------
    function : callable
        The function.
    file : path
        The file.
    """
    return _Located(function, file)


def _told_by_line(effect: Effect, file: Path) -> Effect:
    functions: dict[str, Any] = {
        name: _Located(getattr(effect, name), file)
        for name in ("change", "needs", "places", "fitted", "tells", "carries")
        if getattr(effect, name) is not None
    }
    return replace(effect, **functions)


def _arrays(tables: Tables) -> dict[str, Any]:
    return {
        f"{type_of}.{name}": value
        for type_of, table in (
            ("start", tables.start),
            ("motion", tables.motion),
            *((f"sensors[{k}]", sensor) for k, sensor in enumerate(tables.sensors)),
        )
        for name, value in zip(table._fields, table, strict=True)
        if isinstance(value, np.ndarray)
    }
