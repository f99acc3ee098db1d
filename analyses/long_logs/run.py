"""What do long logs cost, and what do many short logs of one drive tell instead?

A robot is simulated for up to 100 000 rows and calibrated with the defaults, one chain after the other on one thread.
Each log is a process of its own, whose greatest memory is noted: Python and its libraries take 0.25 GB of it. A drive
is also cut into pieces, each with a start belief of its own, as if the robot had been switched off in between. Then the
number of chains, of particles and of landmarks is changed, one at a time. Logs of an hour, one row each second, are
calibrated with all defaults, for what many logs would cost. Rows go to results.csv; those that are there are not
computed again. From the repository's root:

    python analyses/long_logs/run.py                  # an hour and a half
    python analyses/long_logs/run.py --only sweeps    # only how a sweep's time grows with rows, particles and readings
"""

from __future__ import annotations

import argparse
import csv
import itertools
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import pmcl
from pmcl.calibration import ParticleGibbs
from pmcl.filtering.particle_filter import make_rng, run_filter, update_path
from pmcl.models.robot_model import default_model
from pmcl.posterior.access import theta_draws
from pmcl.posterior.diagnostics import summarize
from pmcl.posterior.settings import settings as settings_of
from pmcl.simulations.landmark_field import simulate_landmark_field

CASE = ("robot", "rows", "pieces", "chains", "particles", "channels", "draws")
FIELDS = (
    *CASE, "burn_in_cpu_s", "cpu_s_per_draw", "sweeps_per_draw", "worst_ess", "r_hat", "peak_memory_gb", "log_mb",
    "posterior_mb", "parameters", "means", "sds", "truth",
)  # fmt: skip
SWEEPS = ("robot", "rows", "particles", "channels", "ms_per_sweep", "ns_per_particle_row")
# As in CASE; draws are those of each chain.
FULL = (
    ("landmarks", 400, 1, 2, 25, 8, 400), ("landmarks", 2000, 1, 2, 25, 8, 400),
    ("landmarks", 10_000, 1, 2, 25, 8, 200), ("landmarks", 10_000, 10, 2, 25, 8, 200),
    ("sonars", 400, 1, 2, 25, 8, 400), ("sonars", 2000, 1, 2, 25, 8, 400), ("sonars", 10_000, 1, 2, 25, 8, 200),
    *(("landmarks", 2000, 1, chains, 25, 8, 40) for chains in (1, 4, 8)),
    *(("landmarks", 2000, 1, 2, particles, 8, 40) for particles in (100, 400)),
    *(("landmarks", 2000, 1, 2, 25, channels, 40) for channels in (2, 32, 128)),
    ("landmarks", 3600, 1, 4, 25, 8, 1000), ("sonars", 3600, 1, 4, 25, 8, 1000),
    ("landmarks", 50_000, 1, 2, 25, 8, 100), ("landmarks", 100_000, 1, 2, 25, 8, 100),
)  # fmt: skip
SMALL = (("landmarks", 60, 1, 2, 25, 8, 20), ("landmarks", 120, 2, 1, 10, 4, 20))
SEED = 1
START_STD = (0.1, 0.1, 0.05)


class OneAfterTheOther:
    """A pool of one thread."""

    map = staticmethod(map)


def drive(robot, rows, channels):
    """Return a simulated log; the Amigobot always has its eight sonars."""
    if robot == "landmarks":
        return simulate_landmark_field(rows, SEED, n_landmarks=channels)
    return pmcl.simulate_amigobot(float(rows), SEED)


def cut(log, pieces):
    """Cut a log into pieces, each with a belief about its first pose that is as sure as that of a whole log."""
    if pieces == 1:
        return [log]
    rng, logs = np.random.default_rng(SEED), []
    edges = np.linspace(0, log.n_steps, pieces + 1).astype(int)
    for begin, end in itertools.pairwise(edges):
        near = log.dataset["true_pose"].values[begin] + np.array(START_STD) * rng.standard_normal(3)
        logs.append(log.select(begin, end, start_mean=near, start_std=START_STD))
    return logs


def measure(robot, rows, pieces, chains, particles, channels, draws):
    """Calibrate one drive; return a row of results."""
    method = ParticleGibbs(particles=particles)
    settings = {"chains": chains, "method": method, "seed": SEED, "pool": OneAfterTheOther()}
    pmcl.calibrate(cut(drive(robot, 60 * pieces, channels), pieces), draws=10, **settings)  # compiles
    moments = {}

    def note(stage, done, total):
        if stage == "draws":
            moments.setdefault("first", time.process_time())
            moments["last"], moments["steps"] = time.process_time(), total - 1

    log = drive(robot, rows, channels)
    began = time.process_time()
    posterior = pmcl.calibrate(cut(log, pieces), draws=draws, progress=note, **settings)
    summary, theta = summarize(posterior), theta_draws(posterior)
    names = [str(name) for name in summary["parameter"].values]
    case = (robot, rows, pieces, chains, particles, channels, draws)
    return dict(zip(CASE, case, strict=True)) | {
        "burn_in_cpu_s": moments["first"] - began,
        "cpu_s_per_draw": (moments["last"] - moments["first"]) / (chains * moments["steps"]),
        "sweeps_per_draw": settings_of(posterior)["sweeps_per_draw"],
        "worst_ess": float(summary["ess_bulk"].min()), "r_hat": float(summary["r_hat"].max()),
        "peak_memory_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9,
        **_sizes(log, posterior),
        "parameters": " ".join(names), "means": _text(theta.mean(axis=(0, 1))), "sds": _text(theta.std(axis=(0, 1))),
        "truth": _text([log.true_theta[name] for name in names]),
    }  # fmt: skip


def _sizes(log, posterior):
    """Return how large the files of a log and of its posterior are."""
    with tempfile.TemporaryDirectory() as folder:
        log.write(Path(folder) / "log.nc")
        pmcl.write_posterior(posterior, Path(folder) / "posterior.nc")
        return {f"{name}_mb": (Path(folder) / f"{name}.nc").stat().st_size / 1e6 for name in ("log", "posterior")}


def _text(values):
    return " ".join(f"{value:.6g}" for value in values)


def sweeps(small):
    """Yield how long a sweep of conditional SMC takes, by rows, particles, and channels of readings."""
    cases = [("landmarks", 1000, 25, 8)] if small else [
        *(("landmarks", rows, 25, 8) for rows in (400, 2000, 10_000, 50_000, 100_000)),
        *(("landmarks", 2000, particles, 8) for particles in (100, 400, 1600)),
        *(("landmarks", 2000, 25, channels) for channels in (2, 4, 16, 32, 64)),
        *(("sonars", rows, 25, 8) for rows in (400, 2000, 10_000)),
        *(("sonars", 2000, particles, 8) for particles in (100, 400, 1600)),
    ]  # fmt: skip
    for robot, rows, particles, channels in cases:
        log = drive(robot, rows, channels)
        bound = default_model(log).bind(log)
        tables, rng = bound.tables(bound.prior_mean())[0], make_rng(SEED)
        path = run_filter(tables, rows, 100, rng).mean()
        update_path(tables, path, rows, particles, rng, "conditional")
        seconds = []
        for _ in range(max(5, 200_000 // (rows * particles))):
            began = time.process_time()
            update_path(tables, path, rows, particles, rng, "conditional")
            seconds.append(time.process_time() - began)
        median = float(np.median(seconds))
        numbers = (robot, rows, particles, channels, 1e3 * median, 1e9 * median / (rows * particles))
        yield dict(zip(SWEEPS, numbers, strict=True))


def append(path, fields, row):
    """Add a row to a table."""
    begun = path.exists()
    with path.open("a", newline="") as stream:
        writer = csv.DictWriter(stream, fields)
        if not begun:
            writer.writeheader()
        writer.writerow({name: f"{value:.5g}" if isinstance(value, float) else value for name, value in row.items()})
    print(", ".join(f"{name} {value}" for name, value in row.items()), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--small", action="store_true", help="seconds instead of an hour")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent, help="folder of the tables")
    parser.add_argument("--only", choices=["logs", "sweeps"])
    parser.add_argument("--measure", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.measure:
        print(json.dumps(measure(*json.loads(given.measure))))
        return
    results, of_sweeps = given.output / "results.csv", given.output / "sweeps.csv"
    if given.only != "sweeps":
        known = set()
        if results.exists():
            with results.open(newline="") as stream:
                known = {tuple(row[name] for name in CASE) for row in csv.DictReader(stream)}
        for case in SMALL if given.small else FULL:
            if tuple(map(str, case)) in known:
                continue
            command = [sys.executable, __file__, "--measure", json.dumps(case)]
            text = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
            append(results, FIELDS, json.loads(text.splitlines()[-1]))
    if given.only != "logs" and not of_sweeps.exists():
        for row in sweeps(given.small):
            append(of_sweeps, SWEEPS, row)


if __name__ == "__main__":
    main()
