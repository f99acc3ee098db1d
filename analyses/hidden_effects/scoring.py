"""What the critic said of a log against what was hidden in it: one row of by_probability.csv for each log."""

import csv
from pathlib import Path

import numpy as np
from logs import Hidden, simulate
from outside import OUTSIDE

from pmcl.criticism.fitting.held_out import gap_of
from pmcl.engine.contract import state_size
from pmcl.errors import PmclError
from pmcl.filtering.one_step_ahead import predict_readings
from pmcl.filtering.particle_filter import log_joint, make_rng
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.models.effects.selection import effect_named
from pmcl.models.robot_model import BoundModel, RobotModel, default_model

__all__ = ["FORMULA", "IN_THE_DATA", "append", "nats_on_true_path", "read_results", "scored"]

FORMULA = "formula:"
PARTICLES = 2000
IN_THE_DATA = 3.0
"""An effect that explains a log better by less than this [nat], with the path known, has not acted in it."""


def read_results(path: Path) -> list[dict[str, str]]:
    """Return the rows that are stored already."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def append(path: Path, row: dict[str, object]) -> None:
    """Add a row."""
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(row), lineterminator="\n")
        if new:
            writer.writeheader()
        writer.writerow(row)


def scored(hidden: Hidden, result: dict) -> dict[str, object]:
    """Compare one result with the truth."""
    names = [text.partition("=")[0] for text in hidden.effects]
    found = [one["name"] for one in result["effects"]]
    twins = [[twin.split(" (")[0] for twin in one["not_distinguishable_from"]] for one in result["effects"]]
    sets = [{name, *others} for name, others in zip(found, twins, strict=True)]
    steps = result["steps"]
    gaps = [steps[k]["gap"] if steps else {} for k in (0, -1)]
    alarms = steps[0]["alarms"] if steps else []
    return {
        "block": hidden.block,
        "place": hidden.place,
        "kind": _kind(hidden, names),
        "hidden": " + ".join(names),
        "magnitude": hidden.effects[0].partition("=")[2] if len(names) == 1 else "",
        "seed": hidden.seed,
        "version": result["version"],
        "seconds": f"{result['seconds']:.1f}",
        "seconds_to_name": f"{result['seconds_to_name']:.1f}" if result.get("seconds_to_name", -1.0) > 0.0 else "",
        "verdict": result["verdict"],
        "found": " + ".join(found),
        "twins": " + ".join("/".join(others) for others in twins),
        "right_name": int(bool(names) and all(name in found for name in names)),
        "in_the_set": int(bool(names) and all(any(name in one for one in sets) for name in names)),
        "right_place": _right_place(hidden, names, result["effects"]),
        "too_many": max(0, len(found) - len(names)),
        "p_value": min((min(1.0, len(alarms) * alarm["p_value"]) for alarm in alarms), default=""),
        "score_before": gaps[0].get("log_score_per_reading", ""),
        "score_after": gaps[1].get("log_score_per_reading", ""),
        "score_of_truth": _score_of_truth(hidden, names, result),
        "nats_on_true_path": nats_on_true_path(hidden),
        "coverage_before": gaps[0].get("coverage_90", ""),
        "coverage_after": gaps[1].get("coverage_90", ""),
        **_sizes(hidden, names, result["effects"]),
        "probabilities": _probabilities(result["effects"]),
        "nothing_probability": result.get("nothing_probability", ""),
    }


def _probabilities(effects: list[dict]) -> str:
    """Return how probable each name of the first effect is said to be, as ``name=0.93 / name=0.05``."""
    if not effects or effects[0]["probability"] is None:
        return ""
    told = [(effects[0]["name"], effects[0]["probability"])]
    told += [(other["name"], other["probability"]) for other in effects[0]["alternatives"]]
    return " / ".join(f"{name.replace('=', '')}={probability:.4f}" for name, probability in told)


def _kind(hidden: Hidden, names: list[str]) -> str:
    if not names:
        return "none"
    if len(names) > 1:
        return "pair"
    if names[0] in OUTSIDE:
        return "outside"
    return "poor motion" if hidden.place == "circle" else "one"


def _right_place(hidden: Hidden, names: list[str], effects: list[dict]) -> object:
    """Tell whether an effect that has a place was found there; empty when it was not found by its name."""
    for name, where in zip(names, hidden.where, strict=False):
        for one in effects:
            if one["name"] == name and where:
                return int({k: list(v) for k, v in where.items()} == one["where"])
    return ""


def nats_on_true_path(hidden: Hidden) -> object:
    """Return by how much a single hidden effect explains a log better [nat], were the path known.

    Near zero, the log does not hold the effect (the robot never came to the slippery patch), and there is nothing to
    find. Empty where it cannot be told: outside the catalogue, for pairs, and for states that no log stores.
    """
    names = [text.partition("=")[0] for text in hidden.effects]
    if len(names) != 1 or names[0] in OUTSIDE:
        return ""
    log = simulate(hidden.place, hidden.effects, hidden.seed, hide=False)
    path = log.dataset["true_pose"].values.copy()
    path[:, 2] = np.unwrap(path[:, 2])
    values = []
    for effects in (True, False):
        bound = _true_model(hidden, log, effects)
        tables = bound.tables(np.array([hidden.values[name] for name in bound.names]))[0]
        if int(state_size(tables.motion)) != path.shape[1]:
            return ""
        values.append(log_joint(tables, path))
    return f"{values[0] - values[1]:.1f}"


def _true_model(hidden: Hidden, log: RobotLog, effects: bool = True) -> BoundModel:
    """Return the model that a log was simulated with, or the same without its effects."""
    names = [text.partition("=")[0] for text in hidden.effects]
    bare = log.without_truth()
    base = default_model(bare)
    placed = [_placed(name, where, log) for name, where in zip(names, hidden.where, strict=True)] if effects else []
    return RobotModel(base.motion, base.sensors, base.start, effects=tuple(placed)).bind(bare)


def _score_of_truth(hidden: Hidden, names: list[str], result: dict) -> object:
    """Return the held-out log score of a reading [nat] under the true model; empty outside the catalogue."""
    if not names or any(name in OUTSIDE for name in names) or not result["steps"]:
        return ""
    log = simulate(hidden.place, hidden.effects, hidden.seed, hide=False)
    try:
        bound = _true_model(hidden, log)
        theta = np.array([hidden.values[name] for name in bound.names])
        rng = make_rng(np.random.SeedSequence((hidden.seed, 9)))
        seen = predict_readings(bound.tables(theta)[0], log.n_steps, PARTICLES, rng)
    except (PmclError, KeyError) as error:
        print(f"no score of the truth for {hidden.effects}: {error}")
        return ""
    return gap_of(seen, seen.pit(rng), slice(result["settings"]["split"], None)).log_score_per_reading


def _placed(name: str, where: dict, log: RobotLog) -> Effect:
    place = {key: tuple(values) for key, values in where.items()}
    return effect_named(name, log, place) if place else effect_named(name, log)


def _sizes(hidden: Hidden, names: list[str], effects: list[dict]) -> dict[str, object]:
    """Return the hidden effect's first parameter, and what was found of it, when it was found by its name."""
    row: dict[str, object] = {"parameter": "", "truth": "", "mean": "", "sd": ""}
    if len(names) != 1:
        return row
    for one in effects:
        if one["name"] == names[0]:
            parameter, estimate = next(iter(one["parameters"].items()))
            if parameter in hidden.values:
                row |= {"parameter": parameter, "truth": hidden.values[parameter]}
                row |= {"mean": estimate["mean"], "sd": estimate["sd"]}
    return row
