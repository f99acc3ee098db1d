"""Writing model files, with a comment on everything that a reader may want to change."""

from __future__ import annotations

import dataclasses
from typing import Any, NoReturn

import numpy as np
import tomlkit
from tomlkit.items import Table

from pmcl.checks import file_name
from pmcl.errors import ModelError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.models.effects.formula import FORMULA_CARRIERS, Formula
from pmcl.models.effects.registry import known_effects
from pmcl.models.motion import motions
from pmcl.models.part import Part
from pmcl.models.prior_file import prior_to_table
from pmcl.models.robot_model import RobotModel
from pmcl.models.sensor import sensors
from pmcl.models.starts.belief import StartBelief

__all__ = ["model_text"]


def model_text(model: RobotModel, log: RobotLog) -> str:
    """Write a model as the text of a model file; reading it back gives the same model.

    Parameters
    ----------
    model : RobotModel
        Made of the parts that model files know.
    log : RobotLog
        Named in the heading.

    Returns
    -------
    str
        TOML with comments.

    Raises
    ------
    ModelError
        When a part or a prior is of a kind that a model file cannot hold.
    """
    if not model.sensors:
        raise ModelError("expected a model with at least one sensor, but got none; nothing could be inferred with it")
    document = tomlkit.document()
    document.add(tomlkit.comment(f"pmcl model for {log.robot or 'the robot'} of {file_name(log.where)}"))
    document.add(tomlkit.comment("SI units: metres, radians, seconds. Keys that are left out follow the log."))
    document.add(tomlkit.nl())
    for name, kind in motions().items():
        document.add(tomlkit.comment(f"{name + ':':<10} {getattr(kind, 'summary', '')}".rstrip()))
    document["motion"] = _motion_name(model.motion)
    document.add(tomlkit.nl())
    _add_start(document, model.start)
    tables = tomlkit.table(is_super_table=True)
    for part in model.sensors:
        name, table = _sensor(part, log)
        tables[name] = table
    document["sensors"] = tables
    _add_effects(document, model)
    _add_priors(document, model)
    _add_fixed(document, model)
    return tomlkit.dumps(document)


def _motion_name(motion: Part) -> str:
    for name, kind in motions().items():
        if type(motion) is kind and _settings(motion) == _settings(kind()):
            return name
    _refuse(motion)


def _settings(motion: Part) -> dict[str, object]:
    """Return what a file would have to say of a motion beside its name; priors stand in a table of their own."""
    values = {field.name: getattr(motion, field.name) for field in _fields(motion)}
    return values | {"parameters": [parameter.name for parameter in motion.parameters]}


def _refuse(part: Part) -> NoReturn:
    raise ModelError(
        f"expected parts that a model file can name, but got {type(part).__name__}; register its class "
        "(pmcl.models.register_sensor, pmcl.models.register_motion), or keep this model in Python"
    )


def _add_start(document: tomlkit.TOMLDocument, start: Part) -> None:
    if type(start) is not StartBelief:
        _refuse(start)
    if start.std is not None and np.isinf(start.std).all():
        _add_commented(document, "start", "anywhere", 'or "log", which tells where the robot begins')
    elif start.mean is None and start.std is None:
        _add_commented(document, "start", "log", 'or "anywhere"; or, in its place, a table [start] with mean and std')
    else:
        table = tomlkit.table()
        table.comment("Gaussian belief about the first pose: x [m], y [m], heading [rad]; a std of inf: unknown")
        for key, value in (("mean", start.mean), ("std", start.std)):
            if value is not None:
                table[key] = [float(part) for part in value]
        document["start"] = table


def _add_commented(document: tomlkit.TOMLDocument, key: str, value: str, comment: str) -> None:
    item = tomlkit.item(value)
    item.comment(comment)
    document[key] = item


def _fields(part: Part) -> tuple[dataclasses.Field[Any], ...]:
    return dataclasses.fields(part) if dataclasses.is_dataclass(part) else ()


def _sensor(part: Part, log: RobotLog) -> tuple[str, Table]:
    name, kind = next(((name, kind) for name, kind in sensors().items() if type(part) is kind), ("", None))
    if kind is None or not isinstance(part, kind):
        _refuse(part)
    table = tomlkit.table()
    table.comment(kind.summary)
    usual = part.usual_settings(log)
    for field in _fields(part):
        value: Any = getattr(part, field.name)
        value = usual.get(field.name) if value is None else value
        if value is not None:
            as_it_is = isinstance(value, bool | str) or field.metadata.get("whole", False)
            item = tomlkit.item(value if as_it_is else float(value))
            table[field.name] = item.comment(field.metadata["comment"]) if "comment" in field.metadata else item
    return name, table


def _add_effects(document: tomlkit.TOMLDocument, model: RobotModel) -> None:
    if not model.effects:
        return
    tables = tomlkit.aot()
    for effect in model.effects:
        tables.append(_formula(effect) if isinstance(effect.change, Formula) else _known_effect(effect))
    document["effects"] = tables


def _known_effect(effect: Effect) -> Table:
    known = {candidate.name: candidate for candidate in known_effects()}
    if effect.name not in known or known[effect.name].change is not effect.change:
        raise ModelError(
            "expected formulas and effects that a model file can name ('pmcl effects' lists them), but got "
            f"{effect.name}; keep this model in Python, or give the effect's file with --effects"
        )
    table = tomlkit.table()
    table["name"] = tomlkit.item(effect.name).comment(effect.summary)
    for key, values in effect.where.items():
        table[key] = list(values)
    return table


def _formula(effect: Effect) -> Table:
    formula, table = effect.change, tomlkit.table()
    assert isinstance(formula, Formula)
    table["name"] = effect.name
    table["carrier"] = tomlkit.item(formula.carrier).comment(f"{FORMULA_CARRIERS[formula.carrier].text}the sum of")
    table["terms"] = tomlkit.item(list(formula.terms)).comment("each times its coefficient")
    table["coefficients"] = tomlkit.item([parameter.name for parameter in effect.parameters]).comment("inferred")
    if formula.constants:
        constants = tomlkit.inline_table()
        constants.update({name: float(value) for name, value in formula.constants.items()})
        table["constants"] = constants.comment("of the terms; not inferred")
    if formula.window is not None:
        window = [float(time) for time in formula.window]
        table["window"] = tomlkit.item(window).comment("[s], where the formula holds")
    return table


def _add_priors(document: tomlkit.TOMLDocument, model: RobotModel) -> None:
    if not model.parameters:
        return
    priors = tomlkit.table(is_super_table=True)
    for parameter in model.parameters:
        table = tomlkit.table()
        unit = "" if parameter.unit == "1" else f" [{parameter.unit}]"
        table.comment(f"{parameter.description}{unit}; prior median {float(parameter.prior.median()):.3g}")
        for key, value in prior_to_table(parameter.name, parameter.prior).items():
            table[key] = value
        priors[parameter.name] = table
    document["priors"] = priors


def _add_fixed(document: tomlkit.TOMLDocument, model: RobotModel) -> None:
    if not model.fixed:
        example = model.parameters[0].name if model.parameters else "sigma_left"
        document.add(tomlkit.nl())
        document.add(tomlkit.comment("To hold a parameter at a known value, remove its prior and write:"))
        document.add(tomlkit.comment("[fixed]"))
        document.add(tomlkit.comment(f"{example} = 0.03"))
        return
    fixed = tomlkit.table()
    fixed.comment("known, not inferred")
    for name, value in model.fixed.items():
        fixed[name] = float(value)
    document["fixed"] = fixed
