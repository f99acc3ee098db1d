"""Effects hidden in simulated logs: are they found, is the name right, and is it quiet where nothing is hidden?

    python run.py make FOLDER --block 1 --effects all --magnitudes clear,large --seeds 2 --nulls 30 --outside --pairs 10
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
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from outside import OUTSIDE

import pmcl
from pmcl.criticism.workflow import criticize
from pmcl.errors import PmclError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.catalogue import CATALOGUE
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


def simulate(place: str, effects: Sequence[str], seed: int, rows: int = ROWS, hide: bool = True) -> RobotLog:
    """Simulate one log with hidden effects: NAME=MAGNITUDE, or a name from outside the catalogue."""
    given = tuple((OUTSIDE[text], (1.0,)) if text in OUTSIDE else text for text in effects)
    rng = np.random.default_rng(seed)
    theta = {name: std * float(np.exp(0.3 * rng.standard_normal())) for name, std in NOISE[place].items()}
    if place == "room":
        return pmcl.simulate_amigobot(float(rows), seed, theta, effects=given, hide_effects=hide)
    return simulate_landmark_field(rows, seed, theta, bearings=True, reach=12.0, effects=given, hide_effects=hide)


def make(folder: Path, given: argparse.Namespace) -> None:
    """Write logs in an order that tells nothing, and what they hide into a file of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    places, magnitudes = given.places.split(","), given.magnitudes.split(",")
    names = [effect.name for effect in CATALOGUE] if given.effects == "all" else given.effects.split(",")
    wanted = []
    for place in places:
        plain = simulate(place, (), 0, 60)
        shown = [effect for effect in CATALOGUE if effect.name in names and effect.instances(plain)]
        for effect in shown:
            sizes = [size.replace(" ", "-") for size in magnitudes if size in effect.typical]
            wanted += [(place, [f"{effect.name}={size}"], k) for size in sizes for k in range(given.seeds)]
        wanted += [(place, [], k) for k in range(given.nulls)]
        if given.outside and place == "room":
            wanted += [(place, [name], k) for name in OUTSIDE for k in range(given.seeds)]
        rng = np.random.default_rng(given.block)
        for k in range(given.pairs):
            chosen = rng.choice(len(shown), 2, replace=False)
            wanted.append((place, [f"{shown[i].name}=clear" for i in chosen], k))
    sealed_file = folder / "sealed.json"
    sealed = json.loads(sealed_file.read_text()) if sealed_file.exists() else {}
    known = [(one["place"], one["effects"], one["seed"]) for one in sealed.values()]
    order = np.random.default_rng(len(sealed)).permutation(len(wanted))
    for place, effects, k in [wanted[i] for i in order]:
        seed = 1_000_000 * given.block + 1000 * k + zlib.crc32(" ".join([place, *effects]).encode()) % 1000
        if (place, effects, seed) in known:
            continue
        number = f"{len(sealed):04d}"
        try:
            told = simulate(place, effects, seed, hide=False)
        except PmclError as error:
            print(f"cannot simulate {effects}: {error}")
            continue
        hidden = json.loads(told.dataset.attrs.get("effects", "[]"))
        told.dataset.attrs.pop("effects", None)
        RobotLog(told.without_truth().dataset).write(folder / f"log-{number}.nc")
        sealed[number] = {
            "place": place, "effects": effects, "seed": seed,
            "where": [one["where"] for one in hidden], "values": [one["parameters"] for one in hidden],
        }  # fmt: skip
        sealed_file.write_text(json.dumps(sealed, indent=0))


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
    tally: dict[str, list[tuple[bool, bool, bool]]] = {}
    for number, truth in sorted(sealed.items(), key=lambda item: (item[1]["place"], item[1]["effects"])):
        path = folder / f"log-{number}.json"
        if not path.exists():
            continue
        result = json.loads(path.read_text())
        hidden = [text.partition("=")[0] for text in truth["effects"]]
        names = [one["name"] for one in result["effects"]]
        sets = [
            {one["name"], *(twin.split(" (")[0] for twin in one["not_distinguishable_from"])}
            for one in result["effects"]
        ]
        found = result["verdict"] != "no missing effect"
        named = bool(names) and all(name in names for name in hidden) and bool(hidden)
        in_set = bool(sets) and bool(hidden) and all(any(name in one for one in sets) for name in hidden)
        kind = "none" if not hidden else "pair" if len(hidden) > 1 else "outside" if hidden[0] in OUTSIDE else "one"
        size = truth["effects"][0].partition("=")[2] if kind == "one" else ""
        tally.setdefault(f"{kind} {size}".strip(), []).append((found, named, in_set))
        steps = result["steps"]
        z = max((abs(a["z"]) for a in steps[0]["alarms"]), default=0.0) if steps else 0.0
        gain = steps[-1]["gap"]["log_score_per_reading"] - steps[0]["gap"]["log_score_per_reading"] if steps else 0.0
        print(
            f"{number} {truth['place']:5} {' + '.join(truth['effects']) or '-':44} {result['verdict']:18} "
            f"{'NAME' if named else 'set' if in_set else '':4} {z:5.1f} {gain:7.3f} {result['seconds']:4.0f} s  "
            f"{', '.join(names)} {[e['where'] for e in result['effects'] if e['where']]} {truth['where']}"
        )
    for title, rows in sorted(tally.items()):
        found, named, in_set = (sum(column) for column in zip(*rows, strict=True))
        print(f"{title}: {len(rows)} logs, found {found}, named {named}, named or in the set {in_set}")


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
    parser.add_argument("--outside", action="store_true", help="also effects that the catalogue does not hold")
    parser.add_argument("--pairs", type=int, default=0, help="also logs with two effects at once")
    parser.add_argument("--joint", action="store_true", help="calibrate each final model with full chains")
    parser.add_argument("--most", type=int, help="stop after so many logs")
    given = parser.parse_args()
    if given.what == "make":
        make(given.folder, given)
    elif given.what == "run":
        run(given.folder, given.joint, given.most)
    else:
        score(given.folder)
