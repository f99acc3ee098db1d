"""How many posterior draws should a reading be averaged over (the k of eq. 24)?

Logs of one minute are calibrated, so that their posteriors are wide and it matters how they are used; each posterior
localizes another log of the same robot, many times, with different k. Two ways to choose the k draws are compared: anew
at each row out of 200 (what pmcl does), and once for the whole run. Rows go to results.csv; those that are there are
not computed again. From the repository's root:

    python analyses/draws_per_reading/run.py
"""

from __future__ import annotations

import argparse
import csv
import time
from pathlib import Path

import numpy as np

import pmcl
from pmcl.localization.options import FilterOptions

FIELDS = ("log", "draws", "k", "position_rmse", "standard_error", "log_score_per_row", "seconds_per_row")
FULL = {"logs": 4, "duration": 300.0, "repetitions": 100, "particles": 500, "draws": 1000, "ks": (1, 2, 5, 10, 20, 50)}
SMALL = {"logs": 1, "duration": 30.0, "repetitions": 5, "particles": 50, "draws": 100, "ks": (1, 5)}
CALIBRATION = 60.0


def ways(ks):
    """Name, k, method and options of each way to use a posterior; k = 0 stands for its mean."""
    yield "mean", 0, "mean", None
    for k in ks:
        yield "anew", k, "posterior", FilterOptions(draws=200, draws_per_reading=k)
        yield "fixed", k, "posterior", FilterOptions(draws=k, draws_per_reading=k)


def experiment(known, *, logs, duration, repetitions, particles, draws, ks):
    """Yield the rows that are not `known` yet."""
    for index in range(logs):
        open_ways = [way for way in ways(ks) if (str(index), way[0], str(way[1])) not in known]
        if not open_ways:
            continue
        train = pmcl.simulate_amigobot(CALIBRATION, 2 * index)
        test = pmcl.simulate_amigobot(duration, 2 * index + 1, train.true_theta)
        posterior = pmcl.calibrate(train, draws=draws, chains=2, seed=index, check=False)
        for name, k, method, options in open_ways:
            settings = {"particles": particles, "options": options}
            pmcl.localize_many(test, None, posterior, method, repetitions=1, **settings)  # compile
            began = time.process_time()
            runs = pmcl.localize_many(test, None, posterior, method, repetitions=repetitions, **settings)
            seconds = (time.process_time() - began) / repetitions / test.n_steps
            error = runs.position_rmse
            scatter = error.std(ddof=1) / np.sqrt(repetitions)
            score = runs.log_evidence.mean() / test.n_steps
            yield dict(zip(FIELDS, (index, name, k, error.mean(), scatter, score, seconds), strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--small", action="store_true", help="seconds instead of minutes")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent, help="folder of results.csv")
    arguments = parser.parse_args()
    path = arguments.output / "results.csv"
    known = set()
    if path.exists():
        with path.open(newline="") as stream:
            known = {(row["log"], row["draws"], row["k"]) for row in csv.DictReader(stream)}
    for row in experiment(known, **(SMALL if arguments.small else FULL)):
        begun = path.exists()
        with path.open("a", newline="") as stream:
            writer = csv.DictWriter(stream, FIELDS)
            if not begun:
                writer.writeheader()
            writer.writerow({name: f"{value:.6g}" if name not in FIELDS[:3] else value for name, value in row.items()})
        print(", ".join(f"{name} {value}" for name, value in row.items()), flush=True)


if __name__ == "__main__":
    main()
