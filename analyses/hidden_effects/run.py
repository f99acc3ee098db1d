"""Effects hidden in simulated logs: are they found, is the name right, and is it quiet where nothing is hidden?

    python run.py make FOLDER --block 1 --effects all --magnitudes clear,large --seeds 2 --nulls 30
    python run.py run FOLDER
    python run.py score FOLDER

`make` writes logs that tell nothing about what they hide, and one file, sealed.json, that does; only `score` opens it.
`run` criticises the logs that have no result yet, so it can be stopped and continued, and several may run at once.
Thresholds were chosen on block 0; other blocks have other seeds.
"""

import argparse
import json
import logging
import os
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import pmcl
from pmcl.criticism.workflow import criticize
from pmcl.errors import PmclError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.catalogue import CATALOGUE
from pmcl.models.effects.selection import effect_named
from pmcl.robots.landmark_field import simulate_landmark_field

# Middling noise, varied by a third from log to log.
NOISE = {
    "room": {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.05},
    "field": {
        "sigma_forward": 0.05, "sigma_left": 0.03, "sigma_turn": 0.03, "sigma_landmark_range": 0.2,
        "sigma_bearing": 0.04,
    },
}  # fmt: skip
ROWS = 600


def simulate(place: str, effects: Sequence[str], seed: int, rows: int = ROWS) -> RobotLog:
    """Simulate one log with hidden effects."""
    rng = np.random.default_rng(seed)
    theta = {name: std * float(np.exp(0.3 * rng.standard_normal())) for name, std in NOISE[place].items()}
    if place == "room":
        return pmcl.simulate_amigobot(float(rows), seed, theta, effects=tuple(effects), hide_effects=True)
    return simulate_landmark_field(
        rows, seed, theta, bearings=True, reach=12.0, effects=tuple(effects), hide_effects=True
    )


def make(folder: Path, places: list[str], names: list[str], magnitudes: list[str], seeds: int, nulls: int, block: int):
    """Write logs in an order that tells nothing, and what they hide into a file of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    plain = {place: simulate(place, (), 0, 60) for place in places}
    wanted = []
    for place in places:
        for effect in CATALOGUE:
            if effect.name not in names or not effect.instances(plain[place]):
                continue
            sizes = [size for size in magnitudes if size in effect.typical]
            wanted += [(place, effect.name, size, k) for size in sizes for k in range(seeds)]
        wanted += [(place, "", "", k) for k in range(nulls)]
    sealed_file = folder / "sealed.json"
    sealed = json.loads(sealed_file.read_text()) if sealed_file.exists() else {}
    known = {(one["place"], one["effect"], one["magnitude"], one["seed"]) for one in sealed.values()}
    rng = np.random.default_rng(len(sealed))
    for place, name, size, k in [wanted[i] for i in rng.permutation(len(wanted))]:
        seed = 1_000_000 * block + 1000 * k + (CATALOGUE.index(effect_named(name)) if name else 900)
        if (place, name, size, seed) in known:
            continue
        number = f"{len(sealed):04d}"
        try:
            log = simulate(place, (f"{name}={size.replace(' ', '-')}",) if name else (), seed)
            where = _place(place, name, size, seed) if name else {}
        except PmclError as error:
            print(f"cannot simulate {name}: {error}")
            continue
        log.without_truth().write(folder / f"log-{number}.nc")
        sealed[number] = {"place": place, "effect": name, "magnitude": size, "seed": seed, **where}
        sealed_file.write_text(json.dumps(sealed, indent=0))


def _place(place: str, name: str, size: str, seed: int) -> dict:
    """What the simulator says that it hid."""
    rng = np.random.default_rng(seed)
    theta = {key: std * float(np.exp(0.3 * rng.standard_normal())) for key, std in NOISE[place].items()}
    text = (f"{name}={size.replace(' ', '-')}",)
    told = (
        pmcl.simulate_amigobot(float(ROWS), seed, theta, effects=text)
        if place == "room"
        else simulate_landmark_field(ROWS, seed, theta, bearings=True, reach=12.0, effects=text)
    )
    (hidden,) = json.loads(told.dataset.attrs["effects"])
    return {"where": hidden["where"], "values": hidden["parameters"]}


def run(folder: Path, joint: bool, most: int | None) -> None:
    """Criticise every log that has no result yet."""
    done = 0
    for path in sorted(folder.glob("log-*.nc")):
        result = path.with_suffix(".json")
        claim = path.with_suffix(".running")
        if result.exists() or claim.exists() or (most is not None and done >= most):
            continue
        claim.write_text(str(os.getpid()))
        started = time.perf_counter()
        try:
            found = criticize(RobotLog.read(path), joint=joint, workers=1)
            content = json.loads(found.to_json())
        except PmclError as error:
            content = {"verdict": "error", "sentence": str(error), "effects": [], "steps": [], "unexplained": []}
        content["seconds"] = time.perf_counter() - started
        content["version"] = pmcl.__version__
        result.write_text(json.dumps(content))
        claim.unlink()
        done += 1
        print(f"{path.name} {content['seconds']:.0f} s: {content['sentence']}", flush=True)


def score(folder: Path) -> None:
    """Compare results with what was hidden."""
    sealed = json.loads((folder / "sealed.json").read_text())
    rows = []
    for number, truth in sorted(sealed.items(), key=lambda item: (item[1]["effect"], item[1]["magnitude"])):
        path = folder / f"log-{number}.json"
        if not path.exists():
            continue
        result = json.loads(path.read_text())
        names = [one["name"] for one in result["effects"]]
        sets = [
            {one["name"], *(twin.split(" (")[0] for twin in one["not_distinguishable_from"])}
            for one in result["effects"]
        ]
        first = bool(names) and names[0] == truth["effect"]
        in_set = bool(sets) and truth["effect"] in sets[0]
        rows.append((truth, result, first, in_set))
        steps = result["steps"]
        z = max((abs(a["z"]) for a in steps[0]["alarms"]), default=0.0) if steps else 0.0
        print(
            f"{number} {truth['place']:5} {truth['effect'] or '-':34} {truth['magnitude']:12} {result['verdict']:18} "
            f"{'NAME' if first else 'set' if in_set else '   '} {z:5.1f} {result['seconds']:4.0f} s  "
            f"{', '.join(names)} {truth.get('where') or ''} {[e['where'] for e in result['effects'] if e['where']]}"
        )
    for title, hidden in (("hidden", True), ("none", False)):
        chosen = [row for row in rows if bool(row[0]["effect"]) == hidden]
        alarms = sum(result["verdict"] != "no missing effect" for _, result, _, _ in chosen)
        named, in_set = sum(row[2] for row in chosen), sum(row[3] for row in chosen)
        print(f"{title}: {len(chosen)} logs, alarm {alarms}, name {named}, in set {in_set}")


if __name__ == "__main__":
    logging.basicConfig(level=logging.WARNING)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["make", "run", "score"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--places", default="room,field")
    parser.add_argument("--effects", default="all")
    parser.add_argument("--magnitudes", default="clear,large")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--nulls", type=int, default=0)
    parser.add_argument("--block", type=int, default=0)
    parser.add_argument("--joint", action="store_true", help="calibrate each final model with full chains")
    parser.add_argument("--most", type=int, help="stop after so many logs")
    given = parser.parse_args()
    every = [effect.name for effect in CATALOGUE] if given.effects == "all" else given.effects.split(",")
    if given.what == "make":
        make(
            given.folder, given.places.split(","), every, given.magnitudes.split(","), given.seeds, given.nulls,
            given.block,
        )  # fmt: skip
    elif given.what == "run":
        run(given.folder, given.joint, given.most)
    else:
        score(given.folder)
