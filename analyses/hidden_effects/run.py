"""Effects hidden in simulated logs: are they found, is the name right, and is it quiet where nothing is hidden?

    python run.py make FOLDER --block 1      # the logs of a whole block, some 350
    python run.py run FOLDER                 # half a minute on one core for each; several may run at once
    python run.py score FOLDER               # adds to by_probability.csv, and sums up

`make` writes logs that tell nothing about what they hide, and one file, sealed.json, that does; only `score` opens it.
`run` criticises the logs that have no result yet, so it can be stopped and continued. A log whose block, effects and
seed are in by_probability.csv already is not made again: to enlarge a block, ask for more --seeds.
Blocks differ in their seeds.
"""

import argparse
import json
import logging
import os
import subprocess
import time
from pathlib import Path

# Times are those of one core: threads of the linear algebra library would wait on a second one, and count as well.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from logs import ALIKE, ONLY_THERE, Hidden, make, sealed, wanted
from outside import OUTSIDE
from scoring import FORMULA, IN_THE_DATA, append, read_results, scored

import pmcl
from pmcl.criticism.workflow import criticize
from pmcl.errors import PmclError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.catalogue import CATALOGUE

LOGGER = logging.getLogger("pmcl.criticism")
RESULTS = Path(__file__).parent / "by_probability.csv"
# For the detection curve: effects of every carrier, small.
FAINT = (
    "odometry-turn-scale", "odometry-turn-bias", "turn-noise-grows-with-turn", "range-bias", "beam-bias", "sensor-yaw",
    "short-readings", "range-noise-grows-with-range", "landmark-range-bias", "bearing-bias",
)  # fmt: skip


def whole_block(given: argparse.Namespace) -> list[tuple[str, list[str]]]:
    """Return (place, effects) of every log of a block; an entry that comes twice gets another seed."""
    names = [effect.name for effect in CATALOGUE] if given.effects == "all" else given.effects.split(",")
    magnitudes = given.magnitudes.split(",")
    lists: list[tuple[str, list[str]]] = []
    for place, seeds in (("room", given.seeds), ("hall", given.seeds), ("field", 2 * given.seeds)):
        if place not in given.places.split(","):
            continue
        lists += given.seeds * [(place, one) for one in wanted(place, names, magnitudes)]
        if place == "field":
            lists += given.seeds * [(place, one) for one in wanted(place, names, magnitudes)]
        lists += seeds * [(place, one) for one in wanted(place, set(FAINT) & set(names), ["just-visible"])]
        lists += given.nulls * [(place, [])]
        if place != "field" and given.effects == "all":
            lists += given.seeds * [(place, [name]) for name in OUTSIDE]
        if given.effects == "all":
            lists += pairs(place, given)
    for place in [one for one in ONLY_THERE if one in given.places.split(",")]:
        shown = [name for name in ONLY_THERE[place] if name in names]
        lists += 2 * given.seeds * [(place, one) for one in wanted(place, shown, magnitudes)]
        lists += given.nulls // 4 * [(place, [])]
    if given.effects == "all" and "room" in given.places:
        lists += 2 * given.seeds * [("circle", [f"{name}=clear"]) for name in ALIKE]
    return lists


def pairs(place: str, given: argparse.Namespace) -> list[tuple[str, list[str]]]:
    """Return some pairs of effects that a place can show."""
    shown = [one[0] for one in wanted(place, [effect.name for effect in CATALOGUE], ["clear"])]
    rng = np.random.default_rng([given.block, len(place)])
    return [(place, [shown[i] for i in rng.choice(len(shown), 2, replace=False)]) for _ in range(given.pairs)]


def criticize_all(folder: Path, most: int | None, joint: bool) -> None:
    """Criticise every log that has no result yet."""
    # Of the code that is loaded now; the repository may go on meanwhile.
    done, loaded = 0, version()
    for path in sorted(folder.glob("log-*.nc")):
        result, claim = path.with_suffix(".json"), path.with_suffix(".running")
        if result.exists() or (most is not None and done >= most):
            continue
        try:
            claim.touch(exist_ok=False)
        except FileExistsError:
            continue
        names = FirstName()
        try:
            with names:
                found = criticize(RobotLog.read(path), joint=joint, workers=1, progress=True)
            content = json.loads(found.to_json())
        except PmclError as error:
            content = {"verdict": "error", "sentence": str(error), "effects": [], "steps": [], "unexplained": []}
        # Of the processor: what else the machine does meanwhile does not count.
        content["seconds"], content["seconds_to_name"] = time.process_time() - names.started, names.seconds
        content["version"] = loaded
        result.write_text(json.dumps(content))
        claim.unlink()
        done += 1
        print(f"{path.name} {content['seconds']:.0f} s: {content['sentence']}", flush=True)


class FirstName(logging.Handler):
    """Listens to the progress of a run for the moment at which the first effect has the name that it keeps."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.started, self.seconds, self.added = time.process_time(), float("nan"), False

    def emit(self, record: logging.LogRecord) -> None:
        """Take the time of a step of the run."""
        message = record.getMessage().partition("] ")[2]  # after the elapsed time
        if message.startswith("added "):
            self.added = True
        first = message.startswith(("named ", "added ")) and (np.isnan(self.seconds) or not self.added)
        if first or message.startswith("renamed "):
            self.seconds = time.process_time() - self.started

    def __enter__(self) -> "FirstName":
        LOGGER.setLevel(logging.INFO)
        LOGGER.propagate = False
        LOGGER.addHandler(self)
        return self

    def __exit__(self, *error: object) -> None:
        LOGGER.removeHandler(self)


def version() -> str:
    """Return the version of pmcl, and the commit when this is a repository."""
    command = ["git", "-C", os.fspath(Path(__file__).parent), "rev-parse", "--short", "HEAD"]
    try:
        commit = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    except OSError:
        commit = ""
    return f"{pmcl.__version__} {commit}".strip()


def score(folder: Path, results: Path) -> None:
    """Open the sealed file, compare, store what is new, and sum up."""
    known = {_key(row) for row in read_results(results)}
    for number, hidden in sealed(folder).items():
        path = folder / f"log-{number}.json"
        if not path.exists():
            continue
        if hidden.key not in known:
            append(results, scored(hidden, json.loads(path.read_text())))
    sum_up(results)


def sum_up(results: Path) -> None:
    """Print each result in a line, and the totals of each kind."""
    tally: dict[str, list[tuple[bool, ...]]] = {}
    absent = 0
    rows = sorted(read_results(results), key=lambda row: (row["kind"], row["magnitude"], row["hidden"], row["place"]))
    for row in rows:
        found = row["verdict"] in ("explained", "unknown effect")
        named, in_set = row["right_name"] == "1", row["in_the_set"] == "1"
        named_formula = FORMULA in row["found"]
        wrong = row["verdict"] == "explained" and not in_set and not named_formula
        sure = wrong and not row["twins"].strip(" +/")
        if row["nats_on_true_path"] and float(row["nats_on_true_path"]) < IN_THE_DATA:
            absent += 1
        else:
            title = f"{row['kind']} {row['magnitude']}".strip()
            tally.setdefault(title, []).append((found, named, in_set, wrong, sure))
        print(
            f"{row['place']:6} {row['hidden'] or '-':42} {row['magnitude']:12} {row['verdict']:17} "
            f"{'NAME' if named else 'set' if in_set else '':4} {float(row['seconds']):4.0f} s  {row['found']}"
            f"{' (' + row['twins'] + ')' if row['twins'].strip(' +/') else ''}"
        )
    for title, flags in sorted(tally.items()):
        found, named, in_set, wrong, sure = (sum(column) for column in zip(*flags, strict=True))
        print(
            f"{title}: {len(flags)} logs, found {found}, named {named}, or in the set {in_set}, "
            f"wrong {wrong}, of these without naming alternatives {sure}"
        )
    print(f"left out: {absent} logs whose effect is worth less than {IN_THE_DATA:g} nats where it acts")


def main() -> None:
    """Make logs, criticise them, or score what was said."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["make", "run", "score"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--block", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=1, help="of each effect, magnitude and room; twice in the field")
    parser.add_argument("--places", default="room,hall,field,camera,pitch")
    parser.add_argument("--effects", default="all", help="names with commas between; then nothing but these")
    parser.add_argument("--magnitudes", default="clear,large")
    parser.add_argument("--nulls", type=int, default=22, help="logs without an effect in each place")
    parser.add_argument("--pairs", type=int, default=4, help="logs with two effects in each place")
    parser.add_argument("--joint", action="store_true", help="calibrate each final model with full chains")
    parser.add_argument("--most", type=int, help="stop after so many logs")
    parser.add_argument("--results", type=Path, default=RESULTS)
    given = parser.parse_args()
    logging.basicConfig(level=logging.WARNING)
    if given.what == "make":
        done = {_key(row) for row in read_results(given.results)}
        make(given.folder, given.block, whole_block(given), done)
    elif given.what == "run":
        criticize_all(given.folder, given.most, given.joint)
    else:
        score(given.folder, given.results)


def _key(row: dict[str, str]) -> tuple:
    names = row["hidden"].split(" + ") if row["hidden"] else []
    sizes = [row["magnitude"]] if len(names) == 1 else ["clear"] * len(names)
    effects = [f"{name}={size}" if size else name for name, size in zip(names, sizes, strict=True)]
    return Hidden(int(row["block"]), row["place"], effects, int(row["seed"])).key


if __name__ == "__main__":
    main()
