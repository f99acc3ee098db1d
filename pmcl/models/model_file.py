"""Model files: a robot model as TOML that people read and edit.

Every key may be left out; what is left out is what :func:`pmcl.models.robot_model.default_model` does with the log.
Effects are tables: those of the catalogue by name and place, formulas by carrier and terms
(:mod:`pmcl.models.effects.formula`)::

    [[effects]]
    name = "beam-bias"
    beams = [2]

    [[effects]]
    name = "formula"                                  # or "formula: " and what people shall call it
    carrier = "turn"                                  # turn += the sum of coefficients times terms
    terms = ["sin(2*pi*(time - begins)/period)"]
    constants = { begins = 59.0, period = 60.0 }      # fixed numbers of the terms
    window = [0.0, 300.0]                             # [s], where it holds; always when left out
    coefficients = ["swing"]                          # names of the parameters, whose priors stand below [priors]
"""

from __future__ import annotations

import dataclasses
import os
import tomllib
from collections.abc import Iterable, Mapping
from typing import Any, NoReturn

import numpy as np

from pmcl.errors import ModelError, did_you_mean
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect, named_apart
from pmcl.models.effects.formula import FORMULA_CARRIERS, PREFIX, Formula, formula_effect
from pmcl.models.effects.selection import effect_named
from pmcl.models.model_text import model_text
from pmcl.models.motion import motions
from pmcl.models.part import Part
from pmcl.models.prior_file import checked_number, prior_from_table
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.models.sensor import Sensor
from pmcl.models.sensor import sensors as registered_sensors
from pmcl.models.starts.belief import StartBelief

__all__ = ["model_of_text", "model_text", "read_model"]

_ANYWHERE = StartBelief(mean=(0.0, 0.0, 0.0), std=(np.inf, np.inf, np.inf))
_FORMULA = "formula"
# The longest model files, of robots with dozens of effects, have some 10 kB.
_LONGEST_FILE = 1_000_000


def read_model(path: str | os.PathLike[str], log: RobotLog) -> RobotModel:
    """Read a model file.

    Parameters
    ----------
    path : path
        TOML, as :func:`pmcl.models.model_text.model_text` writes it.
    log : RobotLog
        Decides what the file leaves open: which sensors there are and what they read.

    Returns
    -------
    RobotModel

    Raises
    ------
    ModelError
        When the file is missing or not TOML, holds an unknown key, a value of the wrong kind, a bad distribution, or
        fixes a parameter outside its range; the message names file and key.
    """
    where = os.fspath(path)
    return _model(where, _load(where), log)


def model_of_text(text: str, log: RobotLog, where: str = "model") -> RobotModel:
    """Undo :func:`pmcl.models.model_text.model_text`.

    Parameters
    ----------
    text : str
        A model file's text.
    log : RobotLog
        Decides what the text leaves open.
    where : str
        What the text is called in messages.

    Returns
    -------
    RobotModel

    Raises
    ------
    ModelError
        As for :func:`read_model`.
    """
    return _model(where, _parsed(where, text), log)


def _model(where: str, content: dict[str, Any], log: RobotLog) -> RobotModel:
    _known_keys(where, "", content, ("motion", "start", "sensors", "effects", "priors", "fixed"))
    usual = default_model(log)
    motion = motions()[_choice(where, "motion", content.get("motion", "increment"), motions())]()
    sensors = _sensors(where, content["sensors"], log) if "sensors" in content else usual.sensors
    start = _start(where, content.get("start", "log"))
    effects = _effects(where, content.get("effects", []), log)
    try:
        owners = (start, motion, *sensors, *named_apart(effects))
    except ModelError as error:
        _fail(where, "effects", str(error))
    known = {parameter.name: parameter for owner in owners for parameter in owner.parameters}
    priors_given, fixed_given = _table(where, "priors", content), _table(where, "fixed", content)
    _known_keys(where, "priors", priors_given, known)
    _known_keys(where, "fixed", fixed_given, known)
    both = sorted(set(priors_given) & set(fixed_given))
    if both:
        _fail(
            where, f"fixed.{both[0]}", f"expected either a fixed value or a prior, but {both[0]} has both; remove one"
        )
    priors = {name: prior_from_table(where, known[name], table) for name, table in priors_given.items()}
    fixed = {name: checked_number(where, f"fixed.{name}", value) for name, value in fixed_given.items()}
    try:
        return RobotModel(motion, sensors, start, priors, fixed, effects)
    except ModelError as error:
        raise ModelError(f"{where}: {error}") from None


def _load(where: str) -> dict[str, Any]:
    try:
        with open(where, "rb") as stream:
            text = stream.read(_LONGEST_FILE + 1)
    except OSError as error:
        raise ModelError(f"{where}: expected a model file, but got '{error.strerror}'; check the path") from None
    if len(text) > _LONGEST_FILE:
        raise ModelError(
            f"{where}: expected a model file, but got one of more than {_LONGEST_FILE} bytes; check that it is one"
        )
    return _parsed(where, text)


def _parsed(where: str, text: str | bytes) -> dict[str, Any]:
    try:
        return tomllib.loads(text if isinstance(text, str) else text.decode())
    # Texts nested without end exceed the parser's recursion; numbers of thousands of digits, Python's limit for them.
    except (ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())[:200]
        raise ModelError(
            f"{where}: expected a model file in TOML, but got one that cannot be read ({reason}); correct it"
        ) from None


def _fail(where: str, key: str, message: str) -> NoReturn:
    raise ModelError(f"{where}, key '{key}': {message}")


def _known_keys(where: str, table: str, given: Mapping[str, Any], known: Iterable[str]) -> None:
    names = list(known)
    for key in given:
        if key not in names:
            full = f"{table}.{key}" if table else key
            advice = did_you_mean(key, names, "remove it")
            _fail(where, full, f"expected one of {', '.join(names)}, but got '{key}'; {advice}")


def _choice(where: str, key: str, value: Any, choices: Iterable[str]) -> str:
    names = list(choices)
    if isinstance(value, str) and value in names:
        return value
    advice = did_you_mean(str(value), names, "choose one of these")
    _fail(where, key, f"expected {' or '.join(repr(name) for name in names)}, but got {value!r}; {advice}")


def _table(where: str, key: str, content: Mapping[str, Any]) -> dict[str, Any]:
    value = content.get(key, {})
    if not isinstance(value, dict):
        _fail(where, key, f"expected a table, but got {value!r}; write [{key}] and its keys below")
    return value


def _flag(where: str, key: str, value: Any) -> bool:
    if not isinstance(value, bool):
        _fail(where, key, f"expected true or false, but got {value!r}; correct it")
    return value


def _start(where: str, given: Any) -> StartBelief:
    if not isinstance(given, dict):
        return _ANYWHERE if _choice(where, "start", given, ("log", "anywhere")) == "anywhere" else StartBelief()
    _known_keys(where, "start", given, ("mean", "std"))
    beliefs: dict[str, tuple[float, float, float]] = {}
    for key, value in given.items():
        if not isinstance(value, list) or len(value) != 3:
            _fail(
                where,
                f"start.{key}",
                f"expected three numbers (x [m], y [m], heading [rad]), but got {value!r}; correct it",
            )
        # inf is a number here: it stands for a component of which nothing is known.
        x, y, heading = (
            np.inf if key == "std" and part == np.inf else checked_number(where, f"start.{key}", part) for part in value
        )
        if key == "std" and min(x, y, heading) <= 0.0:
            _fail(
                where,
                "start.std",
                f"expected three positive standard deviations, but got {value!r}; a robot placed exactly still has, "
                "say, 0.001",
            )
        beliefs[key] = (x, y, heading)
    return StartBelief(beliefs.get("mean"), beliefs.get("std"))


def _sensors(where: str, given: Any, log: RobotLog) -> tuple[Part, ...]:
    known = registered_sensors()
    tables = " or ".join(f"[sensors.{name}]" for name in known)
    if not isinstance(given, dict):
        _fail(where, "sensors", f"expected a table, but got {given!r}; write {tables}")
    _known_keys(where, "sensors", given, known)
    if not given:
        _fail(
            where,
            "sensors",
            f"expected a table {tables}, but got none; add one, or leave [sensors] out",
        )
    return tuple(_sensor(where, name, kind, given, log) for name, kind in known.items() if name in given)


def _sensor(where: str, name: str, kind: type[Sensor], given: dict[str, Any], log: RobotLog) -> Sensor:
    """Read the settings of a sensor: booleans, choices, and numbers above zero, for the fields of its class."""
    settings, key = _table(where, name, given), f"sensors.{name}"
    declared: tuple[dataclasses.Field[Any], ...] = dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ()
    fields = {field.name: field for field in declared}
    _known_keys(where, key, settings, fields)
    usual = kind.default(log)
    values: dict[str, Any] = {}
    for setting, field in fields.items():
        value = settings.get(setting, getattr(usual, setting) if usual is not None else field.default)
        if isinstance(field.default, bool):
            values[setting] = _flag(where, f"{key}.{setting}", value)
        elif isinstance(field.default, str):
            values[setting] = _choice(where, f"{key}.{setting}", value, field.metadata["choices"])
        elif value is None:
            values[setting] = None
        else:
            values[setting] = checked_number(where, f"{key}.{setting}", value)
            if values[setting] <= 0.0:
                unit = field.metadata.get("comment", "a number")
                _fail(where, f"{key}.{setting}", f"expected {unit} > 0, but got {values[setting]:g}; correct it")
            if isinstance(field.default, int) and values[setting].is_integer():
                values[setting] = int(values[setting])
    try:
        return kind(**values)
    except ModelError as error:
        _fail(where, key, str(error))


def _effects(where: str, given: Any, log: RobotLog) -> tuple[Effect, ...]:
    if not isinstance(given, list) or not all(isinstance(table, dict) for table in given):
        _fail(where, "effects", f"expected tables [[effects]], but got {given!r}; write [[effects]] and name = below")
    effects = []
    for table in given:
        if not isinstance(table.get("name"), str):
            _fail(where, "effects", f"expected the name of an effect, but got {table!r}; write for example "
                  'name = "range-bias"')  # fmt: skip
        if table["name"] == _FORMULA or table["name"].startswith(PREFIX) or "terms" in table:
            effects.append(_formula(where, table, log))
            continue
        place = {key: value for key, value in table.items() if key != "name"}
        for key, value in place.items():
            if not isinstance(value, list) or not value:
                _fail(where, f"effects.{key}", f"expected a list of numbers, but got {value!r}; write for example [2]")
            for number in value:
                checked_number(where, f"effects.{key}", number)
        try:
            effects.append(effect_named(table["name"], log, place))
        except ModelError as error:
            _fail(where, "effects", str(error))
    return tuple(effects)


def _formula(where: str, given: Mapping[str, Any], log: RobotLog) -> Effect:
    """Read a formula; a name of ``formula`` alone is completed by the formula itself."""
    _known_keys(where, "effects", given, ("name", "carrier", "terms", "coefficients", "constants", "window"))
    carrier = _choice(where, "effects.carrier", given.get("carrier"), FORMULA_CARRIERS)
    terms = _texts(where, "effects.terms", given.get("terms"), "cos(heading)")
    coefficients = given.get("coefficients")
    if coefficients is not None:
        coefficients = _texts(where, "effects.coefficients", coefficients, "formula_turn")
    constants = {
        name: checked_number(where, f"effects.constants.{name}", value)
        for name, value in _table(where, "constants", given).items()
    }
    window = given.get("window")
    if window is not None and (not isinstance(window, list) or len(window) != 2):
        _fail(where, "effects.window", f"expected [begin, end] in seconds, but got {window!r}; correct it")
    name = None if given["name"] == _FORMULA else given["name"]
    try:
        window = None if window is None else tuple(checked_number(where, "effects.window", time) for time in window)
        change = Formula(carrier, terms, constants, window)
        # How large a coefficient can be depends on how large its term is: where the log tells, it decides the prior.
        values = [] if change.needs_path else change.values(log)
        spread = [float(np.sqrt(np.mean(value[1:] ** 2))) or 1.0 for value in values] or None
        return formula_effect(
            carrier, terms, constants, window, name=name, coefficients=coefficients, spread=spread
        )
    except ModelError as error:
        _fail(where, "effects", str(error))


def _texts(where: str, key: str, value: Any, example: str) -> tuple[str, ...]:
    if not isinstance(value, list) or not value or not all(isinstance(text, str) for text in value):
        _fail(where, key, f'expected a list of texts, but got {value!r}; write for example ["{example}"]')
    return tuple(value)
