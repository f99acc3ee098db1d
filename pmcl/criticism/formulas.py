"""Effects outside the catalogue, written as a formula: a coefficient times a feature, on some carrier.

When something is unusual and no known effect explains it, small features of motion, place, time and beam geometry are
offered as effects like any other: scored, refitted, and accepted only by held-out data. What is accepted reads
``formula: turn += 0.03*cos(heading)``; what is not stays unknown.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.criticism.covariates import row_covariates
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.models.effects.formula import FORMULA_CARRIERS, PREFIX, formula_effect
from pmcl.models.sensor import sensor_of
from pmcl.models.sensors.range_beams.table import RangeBeams
from pmcl.models.tables import Tables

__all__ = ["Steady", "filled_in", "formulas", "steady_changes", "wave"]

Float = NDArray[np.float64]

# Cells along the longer side of what the robot has visited, and the share of rows below which a cell is not offered.
_CELLS, _VISITED = 4, 0.03

_OF_MOTION = ("translation", "turn")
_OF_MOTION_NOISE = ("log sigma_forward", "log sigma_turn")
_RANGE, _RANGE_NOISE = "range", "log sigma_range"
# Beams at a steeper incidence [rad] than this count as being at this one: the tangent has no bound.
_STEEPEST = 1.3


class _Feature(NamedTuple):
    """What a formula may depend on: what people call it, the term that tells it, its constants, and its values.

    Values, (T,) or (T, B), are those of one log along the path that its fit has found.
    """

    called: str
    term: str
    constants: Mapping[str, float]
    values: Float


def formulas(log: RobotLog, tables: Tables, path: Float, *, of_noise: bool = True) -> tuple[Effect, ...]:
    """Return the feature library for a log, as effects.

    Parameters
    ----------
    log : RobotLog
        The log.
    tables : Tables
        Of the fitted model; its motion must be by increments.
    path : ndarray, shape (T, D)
        The path that the log tells of: features of place and heading are taken from it.
    of_noise : bool
        Whether formulas of standard deviations are among them, or of what is expected only.
    """
    if not hasattr(tables.motion, "mean") or path.shape[1] < 3:
        return ()
    rows = _row_features(log, path)
    carriers = _OF_MOTION + _OF_MOTION_NOISE if of_noise else _OF_MOTION
    made = [_formula(carrier, feature) for carrier in carriers for feature in rows]
    made += [_formula(carrier, feature) for carrier in _OF_MOTION for feature in _cell_features(path)]
    for sensor in tables.sensors:
        if isinstance(sensor, RangeBeams):
            made += [_formula(_RANGE, feature) for feature in _beam_features(sensor, path, rows)]
    if of_noise and any(isinstance(sensor, RangeBeams) for sensor in tables.sensors):
        made += [_formula(_RANGE_NOISE, feature) for feature in rows]
    return tuple(effect for effect in made if effect is not None)


class Steady(NamedTuple):
    """A change of what is expected that is the same in all rows: its effect, and what carries it."""

    effect: Effect
    carrier: str


def steady_changes(tables: Tables, n_rows: int) -> tuple[Steady, ...]:
    """Return the steady changes that a model can have; waves are made of them."""
    carriers = list(_OF_MOTION) if hasattr(tables.motion, "mean") else []
    if any(isinstance(sensor, RangeBeams) for sensor in tables.sensors):
        carriers.append(_RANGE)
    made = ((_formula(carrier, _Feature("1", "1", {}, np.ones(n_rows))), carrier) for carrier in carriers)
    return tuple(Steady(effect, carrier) for effect, carrier in made if effect is not None)


def wave(change: Steady, log: RobotLog, period: float, begins: float) -> Effect:
    """Return a formula that swings about a steady change.

    Parameters
    ----------
    change : Steady
        What swings.
    log : RobotLog
        The log.
    period, begins : float
        Of the wave, and a time at which it rises through zero [s]; rounded to what the formula's name tells.
    """
    period, begins = float(f"{period:.4g}"), round(begins, 2)
    constants = {"begins": begins, "period": period}
    called = f"sin(2*pi*(time - {begins:.12g})/{period:g})"
    values = np.sin(2.0 * np.pi * (np.asarray(log.times) - begins) / period)
    made = _formula(change.carrier, _Feature(called, "sin(2*pi*(time - begins)/period)", constants, values))
    assert made is not None
    return made


def filled_in(name: str, value: float) -> str:
    """Return the name of a formula with its coefficient, e.g. ``formula: turn += 0.03*cos(heading)``."""
    return name.replace("c*", f"{value:.3g}*", 1).replace("+ -", "- ")


def _formula(carrier: str, feature: _Feature) -> Effect | None:
    """Return one formula, or None for a feature that does not vary."""
    spread = float(np.sqrt(np.mean(feature.values**2)))
    if not spread > 1e-9 * (1.0 + float(np.abs(feature.values).max())):
        return None
    name = f"{PREFIX}{FORMULA_CARRIERS[carrier].text}c*{feature.called}"
    return formula_effect(
        carrier, [feature.term], feature.constants, name=name, spread=[spread], features=[feature.values]
    )


def _row_features(log: RobotLog, path: Float) -> list[_Feature]:
    rows = row_covariates(log, path)
    middle = {name: float(np.round(np.median(getattr(rows, name)), 2)) for name in ("time", "x", "y")}
    return [
        _Feature("speed", "speed", {}, rows.speed),
        _Feature("turn_rate", "turn_rate", {}, rows.turn),
        _Feature("abs(turn_rate)", "abs(turn_rate)", {}, np.abs(rows.turn)),
        _Feature("cos(heading)", "cos(heading)", {}, np.cos(rows.heading)),
        _Feature("sin(heading)", "sin(heading)", {}, np.sin(rows.heading)),
        *(
            _Feature(f"({name} - {value:g})", f"{name} - middle", {"middle": value}, getattr(rows, name) - value)
            for name, value in middle.items()
        ),
    ]


def _cell_features(path: Float) -> list[_Feature]:
    low, high = path[:, :2].min(axis=0), path[:, :2].max(axis=0)
    side = max(float((high - low).max()), 1e-6) / _CELLS
    index = np.minimum(((path[:, :2] - low) / side).astype(int), _CELLS - 1)
    found = []
    for i, j in np.unique(index, axis=0):
        inside = (index == (i, j)).all(axis=1)
        if _VISITED < inside.mean() < 0.7:
            (x0, y0), (x1, y1) = low + side * np.array([i, j]), low + side * np.array([i + 1, j + 1])
            called = f"[x in {x0:.2f}..{x1:.2f}, y in {y0:.2f}..{y1:.2f}]"
            # A step belongs to the place where it begins.
            term = "inside(x_before, x_low, x_high)*inside(y_before, y_low, y_high)"
            # The farthest point visited belongs to the last cell, whose end is that point.
            x1, y1 = (np.nextafter(max(x1, high[0]), np.inf) if i == _CELLS - 1 else x1,
                      np.nextafter(max(y1, high[1]), np.inf) if j == _CELLS - 1 else y1)  # fmt: skip
            bounds = {"x_low": x0, "x_high": x1, "y_low": y0, "y_high": y1}
            constants = {name: float(value) for name, value in bounds.items()}
            found.append(_Feature(called, term, constants, np.roll(inside, 1).astype(float)))
    return found


def _beam_features(sensor: Any, path: Float, rows: Sequence[_Feature]) -> list[_Feature]:
    """Return features of each beam at each row, (T, B)."""
    along = sensor_of(sensor).along(sensor, path)
    distance, direction = along["distance"], along["world_direction"]
    leaning = np.tan(np.minimum(along["incidence"], _STEEPEST))
    every_beam = (1, distance.shape[1])
    return [
        _Feature("distance^2", "distance**2", {}, distance**2),
        _Feature("tan(incidence)", "tan(min(incidence, steepest))", {"steepest": _STEEPEST}, leaning),
        _Feature("cos(world_direction)", "cos(world_direction)", {}, np.cos(direction)),
        _Feature("sin(world_direction)", "sin(world_direction)", {}, np.sin(direction)),
        *(
            feature._replace(values=np.tile(feature.values[:, None], every_beam))
            for feature in rows
            if feature.called.startswith(("(", "speed"))
        ),
    ]
