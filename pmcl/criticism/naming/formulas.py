"""Effects outside the catalogue, written as a formula: a coefficient times a feature, on some carrier.

When something is unusual and no known effect explains it, small features of motion, place, time and beam geometry are
offered as effects: they are scored, refitted, and compete with the effects of the catalogue. An accepted formula
reads ``formula: turn += 0.03*cos(heading)``. If none is accepted, the effect stays unknown.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.criticism.scoring.covariates import row_covariates
from pmcl.errors import ModelError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.models.effects.formula import FORMULA_CARRIERS, PREFIX, formula_effect
from pmcl.models.sensor import sensor_of
from pmcl.models.tables import Tables

__all__ = ["SteadyChange", "formulas", "steady_changes", "wave"]

Float = NDArray[np.float64]

# Cells along the longer side of the area that the robot has visited, and the share of rows between which a cell is
# offered: a cell visited less shows little, and one visited more is the whole area. Chosen by hand.
_CELLS, _LEAST_VISITED, _MOST_VISITED = 4, 0.03, 0.7

_OF_MOTION = ("translation", "turn")
_OF_MOTION_NOISE = ("log sigma_forward", "log sigma_turn")
_RANGE, _RANGE_NOISE = "range", "log sigma_range"
# The incidence of a beam is limited to this angle [rad] before its tangent, which has no bound, is taken (chosen by
# hand).
_GREATEST_INCIDENCE = 1.3
# A feature whose root mean square is smaller than this, relative to its largest value, does not vary.
_VARIES = 1e-9


class _Feature(NamedTuple):
    """A quantity on which a formula may depend.

    Attributes
    ----------
    text : str
        Its name in the name of the formula.
    term : str
        The term that computes it, see :mod:`pmcl.models.effects.terms`.
    constants : mapping of str to float
        Fixed numbers in the term.
    values : ndarray, shape (T,) or (T, B)
        Its values along the fitted path of one log.
    """

    text: str
    term: str
    constants: Mapping[str, float]
    values: Float


def formulas(log: RobotLog, tables: Tables, path: Float, *, of_noise: bool = True) -> tuple[Effect, ...]:
    """Return all formulas with one feature that apply to a log, as effects.

    Parameters
    ----------
    log : RobotLog
        The log.
    tables : Tables
        Coefficient tables of the fitted model; there are no formulas unless its motion has the increments of a pose.
    path : ndarray, shape (T, D)
        The fitted path, from which features of place and heading are computed.
    of_noise : bool
        Whether formulas of standard deviations are included, besides those of means.
    """
    if not _can_change("translation", tables) or path.shape[1] < 3:
        return ()
    rows = _row_features(log, path)
    # Motion by odometry has means like any other, but no noise of its own: that follows from its alphas.
    noise = [carrier for carrier in _OF_MOTION_NOISE if of_noise and _can_change(carrier, tables)]
    carriers = (*_OF_MOTION, *noise)
    effects = [_formula(carrier, feature) for carrier in carriers for feature in rows]
    effects += [_formula(carrier, feature) for carrier in _OF_MOTION for feature in _cell_features(path)]
    if _can_change(_RANGE, tables):
        for table in tables.sensors:
            effects += [_formula(_RANGE, feature) for feature in _beam_features(table, path, rows)]
    if of_noise and _can_change(_RANGE_NOISE, tables):
        effects += [_formula(_RANGE_NOISE, feature) for feature in rows]
    return tuple(effect for effect in effects if effect is not None)


def _can_change(carrier: str, tables: Tables) -> bool:
    """Return whether a model's tables hold what formulas of a carrier change."""
    try:
        FORMULA_CARRIERS[carrier].edit(tables, np.zeros(1))
    except ModelError:
        return False
    return True


class SteadyChange(NamedTuple):
    """A change of a mean by the same amount in all rows.

    Attributes
    ----------
    effect : Effect
        The change as a formula.
    carrier : str
        One of :data:`pmcl.models.effects.formula.FORMULA_CARRIERS`.
    """

    effect: Effect
    carrier: str


def steady_changes(tables: Tables, n_rows: int) -> tuple[SteadyChange, ...]:
    """Return the steady changes of a model's means, from which waves are built.

    Parameters
    ----------
    tables : Tables
        Coefficient tables of the model.
    n_rows : int
        Rows T of the log.
    """
    carriers = [carrier for carrier in (*_OF_MOTION, _RANGE) if _can_change(carrier, tables)]
    constant = _Feature("1", "1", {}, np.ones(n_rows))
    changes = ((_formula(carrier, constant), carrier) for carrier in carriers)
    return tuple(SteadyChange(effect, carrier) for effect, carrier in changes if effect is not None)


def wave(change: SteadyChange, log: RobotLog, period: float, begins: float) -> Effect:
    """Return a formula by which a mean oscillates in time.

    Parameters
    ----------
    change : SteadyChange
        The change that oscillates.
    log : RobotLog
        The log.
    period : float
        Period [s], rounded to the four digits that the formula's name shows.
    begins : float
        A time at which the wave rises through zero [s], rounded to 0.01 s.
    """
    period, begins = float(f"{period:.4g}"), round(begins, 2)
    constants = {"begins": begins, "period": period}
    text = f"sin(2*pi*(time - {begins:.12g})/{period:g})"
    values = np.sin(2.0 * np.pi * (np.asarray(log.times) - begins) / period)
    formula = _formula(change.carrier, _Feature(text, "sin(2*pi*(time - begins)/period)", constants, values))
    assert formula is not None
    return formula


def _formula(carrier: str, feature: _Feature) -> Effect | None:
    """Return one formula, or None for a feature that does not vary."""
    spread = float(np.sqrt(np.mean(feature.values**2)))
    if not spread > _VARIES * (1.0 + float(np.abs(feature.values).max())):
        return None
    name = f"{PREFIX}{FORMULA_CARRIERS[carrier].text}c*{feature.text}"
    return formula_effect(
        carrier, [feature.term], feature.constants, name=name, spread=[spread], features=[feature.values]
    )


def _row_features(log: RobotLog, path: Float) -> list[_Feature]:
    """Return features of each row, (T,)."""
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
    """Return features that are 1 in one cell of the visited area and 0 elsewhere, (T,)."""
    low, high = path[:, :2].min(axis=0), path[:, :2].max(axis=0)
    side = max(float((high - low).max()), 1e-6) / _CELLS
    index = np.minimum(((path[:, :2] - low) / side).astype(int), _CELLS - 1)
    features = []
    for i, j in np.unique(index, axis=0):
        inside = (index == (i, j)).all(axis=1)
        if _LEAST_VISITED < inside.mean() < _MOST_VISITED:
            (x0, y0), (x1, y1) = low + side * np.array([i, j]), low + side * np.array([i + 1, j + 1])
            text = f"[x in {x0:.2f}..{x1:.2f}, y in {y0:.2f}..{y1:.2f}]"
            # A step belongs to the cell in which it begins.
            term = "inside(x_before, x_low, x_high)*inside(y_before, y_low, y_high)"
            # The farthest visited point ends the last cell and belongs to it.
            x1, y1 = (np.nextafter(max(x1, high[0]), np.inf) if i == _CELLS - 1 else x1,
                      np.nextafter(max(y1, high[1]), np.inf) if j == _CELLS - 1 else y1)  # fmt: skip
            bounds = {"x_low": x0, "x_high": x1, "y_low": y0, "y_high": y1}
            constants = {name: float(value) for name, value in bounds.items()}
            features.append(_Feature(text, term, constants, np.roll(inside, 1).astype(float)))
    return features


def _beam_features(table: Any, path: Float, rows: Sequence[_Feature]) -> list[_Feature]:
    """Return features of each beam at each row, (T, B); none for a sensor without beams."""
    along = sensor_of(table).along(table, path)
    if not along:
        return []
    distance, direction = along["distance"], along["world_direction"]
    slope = np.tan(np.minimum(along["incidence"], _GREATEST_INCIDENCE))
    every_beam = (1, distance.shape[1])
    return [
        _Feature("distance^2", "distance**2", {}, distance**2),
        _Feature("tan(incidence)", "tan(min(incidence, steepest))", {"steepest": _GREATEST_INCIDENCE}, slope),
        _Feature("cos(world_direction)", "cos(world_direction)", {}, np.cos(direction)),
        _Feature("sin(world_direction)", "sin(world_direction)", {}, np.sin(direction)),
        *(
            feature._replace(values=np.tile(feature.values[:, None], every_beam))
            for feature in rows
            if feature.text.startswith(("(", "speed"))
        ),
    ]
