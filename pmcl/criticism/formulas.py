"""Effects outside the catalogue, written as a formula: a coefficient times a feature, on some carrier.

When something is unusual and no known effect explains it, small features of motion, place, time and beam geometry are
offered as effects like any other: scored, refitted, and accepted only by held-out data. What is accepted reads
``formula: turn += 0.03*cos(heading)``; what is not stays unknown.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from pmcl.criticism.covariates import incidence, row_covariates
from pmcl.filtering.predict import beam_lengths
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect, Where
from pmcl.models.parameters import Parameter
from pmcl.models.rich_tables import RichRangeBeams, rich_beams
from pmcl.models.tables import RangeBeams, Tables

__all__ = ["PREFIX", "Steady", "filled_in", "formulas", "steady_changes", "wave"]

Float = NDArray[np.float64]

PREFIX = "formula: "
# Cells along the longer side of what the robot has visited, and the share of rows below which a cell is not offered.
_CELLS, _VISITED = 4, 0.03
_PRIOR_WIDTH = 3.0


class _Carrier(NamedTuple):
    """What a formula changes: its text, the unit of the change, a clear change, and the edit."""

    text: str
    unit: str
    clear: float
    edit: Callable[[Tables, Float], Tables]
    carrier: str


def _translation(tables: Tables, change: Float) -> Tables:
    motion: Any = tables.motion
    mean = motion.mean.copy()
    mean[:, :2] *= 1.0 + change[:, None]
    return tables._replace(motion=motion._replace(mean=mean))


def _turn(tables: Tables, change: Float) -> Tables:
    motion: Any = tables.motion
    mean = motion.mean.copy()
    mean[:, 2] += change
    return tables._replace(motion=motion._replace(mean=mean))


def _noise(component: int) -> Callable[[Tables, Float], Tables]:
    def edit(tables: Tables, change: Float) -> Tables:
        motion: Any = tables.motion
        std = motion.std.copy()
        std[:, component] *= np.exp(np.clip(change, -5.0, 5.0))
        return tables._replace(motion=motion._replace(std=std))

    return edit


_ON_ROWS = (
    _Carrier("translation *= 1 + ", "1", 0.1, _translation, "motion"),
    _Carrier("turn += ", "rad", 0.04, _turn, "motion"),
    _Carrier("log sigma_forward += ", "1", 0.5, _noise(0), "motion"),
    _Carrier("log sigma_turn += ", "1", 0.5, _noise(2), "motion"),
)


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
    carriers = _ON_ROWS if of_noise else _ON_ROWS[:2]
    made = [_formula(carrier, name, feature) for carrier in carriers for name, feature in rows.items()]
    cells = _cell_features(path)
    made += [_formula(carrier, name, feature) for carrier in _ON_ROWS[:2] for name, feature in cells.items()]
    for sensor in tables.sensors:
        if isinstance(sensor, RangeBeams | RichRangeBeams):
            made += [_formula(_RANGE, name, feature) for name, feature in _beam_features(sensor, path, rows).items()]
    if of_noise and any(isinstance(sensor, RangeBeams | RichRangeBeams) for sensor in tables.sensors):
        made += [_formula(_RANGE_NOISE, name, feature) for name, feature in rows.items()]
    return tuple(effect for effect in made if effect is not None)


class Steady(NamedTuple):
    """A change of what is expected that is the same in all rows: its effect, and what carries it."""

    effect: Effect
    carrier: _Carrier


def steady_changes(tables: Tables, n_rows: int) -> tuple[Steady, ...]:
    """Return the steady changes that a model can have; waves are made of them."""
    carriers = list(_ON_ROWS[:2]) if hasattr(tables.motion, "mean") else []
    if any(isinstance(sensor, RangeBeams | RichRangeBeams) for sensor in tables.sensors):
        carriers.append(_RANGE)
    made = ((_formula(carrier, "1", _spread_out(carrier, np.ones(n_rows))), carrier) for carrier in carriers)
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
    name = f"sin(2*pi*(time - {begins:.12g})/{period:g})"
    feature = np.sin(2.0 * np.pi * (np.asarray(log.times) - begins) / period)
    made = _formula(change.carrier, name, _spread_out(change.carrier, feature))
    assert made is not None
    return made


def _spread_out(carrier: _Carrier, rows: Float) -> Float:
    return rows[:, None] if carrier is _RANGE else rows


def filled_in(name: str, value: float) -> str:
    """Return the name of a formula with its coefficient, e.g. ``formula: turn += 0.03*cos(heading)``."""
    return name.replace("c*", f"{value:.3g}*", 1).replace("+ -", "- ")


def _formula(carrier: _Carrier, name: str, feature: Float) -> Effect | None:
    """Return one formula, or None for a feature that does not vary."""
    spread = float(np.sqrt(np.mean(feature**2)))
    if not spread > 1e-9 * (1.0 + float(np.abs(feature).max())):
        return None
    clear = carrier.clear / spread

    def change(tables: Tables, values: Any, log: RobotLog, where: Where) -> Tables:
        return carrier.edit(tables, float(values[0]) * feature[: log.n_steps])

    plain = "".join(letter if letter.isalnum() else "_" for letter in f"{carrier.text}{name}").strip("_")
    parameter = "formula_" + "_".join(part for part in plain.split("_") if part)
    return Effect(
        name=f"{PREFIX}{carrier.text}c*{name}",
        summary=f"{carrier.text.removeprefix('log ').split()[0]} depends on {name}",
        parameters=(Parameter(parameter, carrier.unit, stats.norm(scale=_PRIOR_WIDTH * clear), "coefficient"),),
        null=(0.0,),
        change=change,
        carrier=carrier.carrier,
        look=f"Residuals depend on {name}.",
        typical={"clear": (clear,)},
        absorber=True,  # noise that depends on something takes up much of what any effect causes
    )


def _row_features(log: RobotLog, path: Float) -> dict[str, Float]:
    rows = row_covariates(log, path)
    middle = {name: float(np.round(np.median(getattr(rows, name)), 2)) for name in ("time", "x", "y")}
    return {
        "speed": rows.speed,
        "turn_rate": rows.turn,
        "abs(turn_rate)": np.abs(rows.turn),
        "cos(heading)": np.cos(rows.heading),
        "sin(heading)": np.sin(rows.heading),
        **{f"({name} - {value:g})": getattr(rows, name) - value for name, value in middle.items()},
    }


def _cell_features(path: Float) -> dict[str, Float]:
    low, high = path[:, :2].min(axis=0), path[:, :2].max(axis=0)
    side = max(float((high - low).max()), 1e-6) / _CELLS
    index = np.minimum(((path[:, :2] - low) / side).astype(int), _CELLS - 1)
    found = {}
    for i, j in np.unique(index, axis=0):
        inside = (index == (i, j)).all(axis=1)
        if _VISITED < inside.mean() < 0.7:
            (x0, y0), (x1, y1) = low + side * np.array([i, j]), low + side * np.array([i + 1, j + 1])
            # A step belongs to the place where it begins.
            found[f"[x in {x0:.2f}..{x1:.2f}, y in {y0:.2f}..{y1:.2f}]"] = np.roll(inside, 1).astype(float)
    return found


def _beams(change: Callable[[RichRangeBeams, Float], RichRangeBeams]) -> Callable[[Tables, Float], Tables]:
    def edit(tables: Tables, values: Float) -> Tables:
        beams = RangeBeams | RichRangeBeams
        changed = (change(rich_beams(s), values) if isinstance(s, beams) else s for s in tables.sensors)
        return tables._replace(sensors=tuple(changed))

    return edit


def _longer(beams: RichRangeBeams, change: Float) -> RichRangeBeams:
    return beams._replace(bias_at=beams.bias_at + change)


def _noisier(beams: RichRangeBeams, change: Float) -> RichRangeBeams:
    return beams._replace(std_factor=beams.std_factor * np.exp(np.clip(change, -5.0, 5.0)))


_RANGE = _Carrier("range += ", "m", 0.04, _beams(_longer), "range")
_RANGE_NOISE = _Carrier("log sigma_range += ", "1", 0.5, _beams(_noisier), "range")


def _beam_features(sensor: Any, path: Float, rows: dict[str, Float]) -> dict[str, Float]:
    """Return features of each beam at each row, (T, B)."""
    distance = np.minimum(beam_lengths(sensor, path), sensor.max_range)
    direction = path[:, 2, None] + sensor.beam_pose[:, 2]
    of_rows = {name: np.repeat(column[:, None], distance.shape[1], axis=1) for name, column in rows.items()}
    return {
        "distance^2": distance**2,
        "tan(incidence)": np.tan(np.minimum(incidence(sensor, path), 1.3)),
        "cos(world_direction)": np.cos(direction),
        "sin(world_direction)": np.sin(direction),
        **{name: column for name, column in of_rows.items() if name.startswith(("(", "speed"))},
    }
