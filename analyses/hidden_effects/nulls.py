"""Logs in which nothing is hidden: are the critic's p-values right, and does it say that nothing is missing?

    python nulls.py run --seed 1 --each 12          # some ten seconds for each log
    python nulls.py sum                             # counts of small p-values and of verdicts

`run` adds a row to nulls.csv for each log that is not in it yet. Most logs come from the simulator. Those of the kind
"drive" are recorded drives with readings and commands that their fitted models simulate again; the recordings are
looked for in PMCL_DATA, and without them this kind is left out.
"""

import argparse
import csv
import os
import time
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np
from logs import simulate
from run import version
from scoring import append

from pmcl.criticism.fitting.quick_fit import Fit, quick_fit
from pmcl.criticism.scoring.simulated_logs import replicated_log
from pmcl.criticism.workflow import criticize
from pmcl.errors import PmclError
from pmcl.filtering.particle_filter import make_rng
from pmcl.logs.barfoot import read_barfoot
from pmcl.logs.mrclam import read_mrclam
from pmcl.logs.robot_log import RobotLog
from pmcl.models.robot_model import default_model

RESULTS = Path(__file__).parent / "nulls.csv"
KINDS = ("room", "hall", "field", "camera", "drive")
DATA = Path(os.environ.get("PMCL_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
# Logs of this script share no seed with those of run.py, whose seeds begin with the number of a block.
FIRST_SEED = 500_000_000
LEVELS = (0.05, 1e-3, 1e-5)


def null_log(kind: str, seed: int, rows: int) -> RobotLog:
    """Return a log without a hidden effect."""
    if kind == "drive":
        fit = fitted_drive(seed % 2, rows)
        rng = make_rng(np.random.SeedSequence((FIRST_SEED, seed)))
        return replicated_log(fit.bound.logs[0], fit.tables, fit.path, rng).log
    return simulate(kind, (), FIRST_SEED + seed, rows).without_truth()


@cache
def fitted_drive(number: int, rows: int) -> Fit:
    """Return the default model fitted to the first rows of one of two recorded drives."""
    if number:
        log = read_mrclam(DATA / "mrclam6", 1, 0.5)
    else:
        log = read_barfoot(DATA / "lost_in_the_woods" / "dataset2.mat", 1.0)
    log = RobotLog.from_dataset(log.without_truth().dataset.isel(time=slice(0, rows)), log.where)
    return quick_fit(default_model(log).bind(log), FIRST_SEED)


def judged(kind: str, seed: int, rows: int, code: str) -> dict[str, object]:
    """Criticise one log; return its row."""
    begin = time.process_time()
    row = {"kind": kind, "seed": seed, "rows": rows, "version": code}
    try:
        found = criticize(null_log(kind, seed, rows), joint=False, workers=1, seed=seed)
    except PmclError as error:
        return row | {"verdict": "error", "found": str(error), "p_value": "", "p_value_last": "", "seconds": ""}
    return row | {
        "verdict": found.verdict,
        "found": " + ".join(one.name for one in found.effects),
        "p_value": found.first.judgement.p_value if found.first else "",
        "p_value_last": found.last.judgement.p_value if found.last else "",
        "seconds": f"{time.process_time() - begin:.1f}",
    }


def run(given: argparse.Namespace) -> None:
    """Criticise the logs that have no row yet."""
    code = version()
    done = {(row["kind"], row["seed"], row["rows"]) for row in stored(given.results)}
    for number in range(given.each):
        for kind in given.kinds.split(","):
            seed = 1000 * given.seed + number
            if (kind, str(seed), str(given.rows)) in done or (kind == "drive" and not DATA.exists()):
                continue
            row = judged(kind, seed, given.rows, code)
            append(given.results, row)
            print(*(f"{value:.2g}" if isinstance(value, float) else value for value in row.values()), flush=True)


def sum_up(results: Path) -> None:
    """Print how often p-values are small, and the verdicts, for each kind and for all."""
    rows = stored(results)
    for kind in [*KINDS, "all"]:
        of_kind = [row for row in rows if kind in (row["kind"], "all")]
        p = np.array([float(row["p_value"]) for row in of_kind if row["p_value"]])
        counts = ", ".join(f"p < {level:g}: {np.count_nonzero(p < level)}" for level in LEVELS)
        verdicts = ", ".join(f"{name}: {n}" for name, n in Counter(row["verdict"] for row in of_kind).most_common())
        print(f"{kind}: {len(of_kind)} logs; {counts}; {verdicts}")


def stored(path: Path) -> list[dict[str, str]]:
    """Return the rows that are stored already."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def main() -> None:
    """Criticise logs without a hidden effect, or sum up."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["run", "sum"])
    parser.add_argument("--seed", type=int, default=1, help="the logs of another number are others")
    parser.add_argument("--each", type=int, default=12, help="logs of each kind")
    parser.add_argument("--rows", type=int, default=300)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--results", type=Path, default=RESULTS)
    given = parser.parse_args()
    if given.what == "run":
        run(given)
    else:
        sum_up(given.results)


if __name__ == "__main__":
    main()
