"""Effects that begin or end: does the critic say when, and is an effect that lasts left whole?

    python windows.py run --block 3         # some three seconds for each of 80 logs, after kernels are compiled
    python windows.py sum

Only the estimator is measured: the right effect, at its clear size, is fitted to each log, and no search is run. Half
of the logs have the effect throughout, the others from some row on, until some row, or in between. `run` adds a row to
windows.csv for each log that is not in it yet.
"""

import argparse
import csv
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from scoring import append

from pmcl.criticism.fitting.quick_fit import BRIEF, quick_fit
from pmcl.criticism.fitting.when import acting
from pmcl.filtering.particle_filter import make_rng
from pmcl.models.effects.selection import parse_effect
from pmcl.models.robot_model import default_model

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "criticism"))
from windowed_logs import SIGHTS, SONAR, unwrapped, windowed

RESULTS = Path(__file__).parent / "windows.csv"
ROWS = 300
ROOM = (
    "beam-bias@2", "range-bias", "range-scale", "short-readings", "odometry-turn-scale", "odometry-turn-bias",
    "wheel-slip", "sensor-yaw", "heavy-tailed-range-noise", "odometry-forward-scale", "beam-yaw@5", "dead-beam@1",
    "turn-noise-grows-with-turn", "range-noise-grows-with-range",
)  # fmt: skip
FIELD = (
    "bearing-bias", "landmark-range-scale", "landmark-misread", "odometry-turn-scale", "odometry-arc",
    "landmark-range-bias",
)  # fmt: skip
CLOSE = 0.05
"""An onset or end within this share of the log counts as right."""


def logs_of(block: int) -> list[tuple[str, str, int, int, int]]:
    """Return place, effect, first row, row after the last one, and seed of each log, in an order that mixes them."""
    rng, made = np.random.default_rng(block), []
    for i, (place, name) in enumerate([("room", name) for name in ROOM] + [("field", name) for name in FIELD]):
        made += [(place, f"{name}=clear", 0, ROWS, 1000 * block + 2 * i + k) for k in range(2)]
        for k in range(2):
            kind = ("from", "until", "between")[(2 * i + k) % 3]
            first, last = int(ROWS * rng.uniform(0.2, 0.7)), ROWS
            if kind == "until":
                first, last = 0, int(ROWS * rng.uniform(0.3, 0.8))
            elif kind == "between":
                first = int(ROWS * rng.uniform(0.15, 0.5))
                last = first + int(ROWS * rng.uniform(0.25, 0.4))
            made.append((place, f"{name}=clear", first, last, 1000 * block + 500 + 2 * i + k))
    return [made[k] for k in np.random.default_rng(0).permutation(len(made))]


def measured(place: str, text: str, first: int, last: int, seed: int) -> dict[str, object]:
    """Fit the effect to one log, and ask when it acts."""
    log = windowed(place, text, first, last, ROWS, seed)
    effect, values = parse_effect(text, log, make_rng(seed))
    bound = replace(default_model(log), effects=(effect,)).bind(log.without_truth())
    noise, start = SONAR if place == "room" else SIGHTS, np.array(values, dtype=float)
    # The chain starts near where it ends, on the true path.
    for k in effect.strengths:
        start[k] = effect.null[k] + max((last - first) / ROWS, 0.2) * (start[k] - effect.null[k])
    theta = np.array([*(noise[name] for name in bound.names[: bound.dimension - start.size]), *start])
    fit = quick_fit(bound, seed + 1, theta=theta, path=unwrapped(log.true_poses), effort=BRIEF)
    return row_of(place, text, first, last, seed, values, acting(fit, bound.effects[0], seed=7))


def row_of(place, text, first, last, seed, values, acts) -> dict[str, object]:
    """Return a row of the table; the times of these logs are their rows."""
    told = {}
    for name in ("begin", "end"):
        moment = getattr(acts, name, None)
        ends = ("", "", "") if moment is None else tuple(moment)
        told |= dict(zip((name, f"{name}_low", f"{name}_high"), ends, strict=True))
    size = json.dumps({name: list(value) for name, value in acts.values.items()}) if acts else ""
    return {
        "place": place, "effect": text, "first": first, "last": last, "seed": seed,
        "windowed": acts is not None, **told,
        "true_values": json.dumps([float(value) for value in values]), "while_acting": size,
    }  # fmt: skip


def summed(rows: list[dict[str, str]]) -> None:
    """Print how many constant effects are left whole, and how many windows are right."""
    constant = [row for row in rows if int(row["last"]) - int(row["first"]) == ROWS]
    cut = [row for row in constant if row["windowed"] == "True"]
    print(f"constant: {len(constant) - len(cut)} of {len(constant)} told as constant")
    windows = [row for row in rows if int(row["last"]) - int(row["first"]) < ROWS]
    found = [row for row in windows if row["windowed"] == "True"]
    right, covered, ends = 0, 0, 0
    for row in found:
        first, last = int(row["first"]), int(row["last"])
        wanted = {"begin": first if first > 0 else None, "end": last - 1 if last < ROWS else None}
        close = []
        for name, truth in wanted.items():
            if truth is None or not row[name]:
                close.append(truth is None and not row[name])
                continue
            close.append(abs(float(row[name]) - truth) <= CLOSE * ROWS)
            ends += 1
            covered += float(row[f"{name}_low"]) <= truth <= float(row[f"{name}_high"])
        right += all(close)
    print(f"windows: {len(found)} of {len(windows)} told; all ends within {CLOSE:.0%} of the log in {right}")
    print(f"ends inside their 90 % interval: {covered} of {ends}")


def main() -> None:
    """Run or sum up."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("what", choices=("run", "sum"))
    parser.add_argument("--block", type=int, default=3)
    given = parser.parse_args()
    rows = list(csv.DictReader(RESULTS.open())) if RESULTS.exists() else []
    if given.what == "run":
        done = {int(row["seed"]) for row in rows}
        for one in logs_of(given.block):
            if one[-1] not in done:
                append(RESULTS, measured(*one))
    else:
        summed(rows)


if __name__ == "__main__":
    main()
