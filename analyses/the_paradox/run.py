"""The paper's paradox: with what the smoothing kernel finds, a filter localizes better than with the true parameters.

    python run.py calibrate      # theta by both kernels, for each n, level of range noise and training log
    python run.py localize       # error of a filter with n particles and each of these thetas
    python run.py landscape      # error and evidence of a filter with n particles against the noise it assumes
    python run.py all --small --output FOLDER

Two robots, one steady on its wheels and one that slips, and two levels of range noise. The calibrations take twenty
minutes on one core, the other two parts five minutes each. What is in calibrations.csv, errors.csv and landscape.csv
already is not computed again, so a run can be stopped and continued.
"""

import argparse
import csv
import itertools
import logging
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pmcl.calibration import ParticleGibbs, RunOptions
from pmcl.localization.many import localize_many
from pmcl.logs.robot_log import RobotLog
from pmcl.models.robot_model import default_model
from pmcl.posterior.compat import bulk_ess, r_hat
from pmcl.simulations.amigobot import simulate_amigobot

MOTION = {
    "steady": {"sigma_forward": 0.04, "sigma_left": 0.02, "sigma_turn": 0.08},
    "slippery": {"sigma_forward": 0.10, "sigma_left": 0.05, "sigma_turn": 0.10},
}
FULL = {
    "robots": ("steady", "slippery"), "levels": (0.02, 0.10), "particles": (25, 50, 100, 200, 500, 1000),
    "training": 3, "rows": 400, "trajectories": 12, "repetitions": 6, "draws": 200,
    "range": (0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0), "motion": (0.6, 0.8, 1.0, 1.25, 1.6),
}  # fmt: skip
SMALL = {
    "robots": ("steady",), "levels": (0.02,), "particles": (25, 400), "training": 1, "rows": 60, "trajectories": 10,
    "repetitions": 20, "draws": 60, "range": (1.0, 2.0, 4.0), "motion": (0.6, 1.0),
}  # fmt: skip
TRAINING_SEED, TEST_SEED, SAMPLING_SEED, FILTER_SEED = 1000, 2000, 3000, 4000
EXACT = 25  # particles of the conditional kernel, whose target does not depend on them


def truth_of(robot: str, level: float, range_factor: float = 1.0, motion_factor: float = 1.0) -> dict[str, float]:
    """Return the true parameters of a robot at a level of range noise [m], or multiples of them."""
    motion = {name: motion_factor * value for name, value in MOTION[robot].items()}
    return motion | {"sigma_range": range_factor * level}


def cases(settings: dict) -> Iterator[tuple[str, float]]:
    """Yield robots and levels of range noise."""
    yield from itertools.product(settings["robots"], settings["levels"])


def stored(path: Path, keys: tuple[str, ...]) -> set[tuple[str, ...]]:
    """Return what a file holds already."""
    if not path.exists():
        return set()
    with path.open(newline="") as file:
        return {tuple(row[key] for key in keys) for row in csv.DictReader(file)}


def append(path: Path, row: dict[str, object]) -> None:
    """Write a row as soon as it is there."""
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(row), lineterminator="\n")
        if new:
            writer.writeheader()
        writer.writerow(row)


def method_for(kernel: str, particles: int, settings: dict) -> ParticleGibbs:
    """Return the paper's sampler, or the exact one with transport moves."""
    exact = kernel == "conditional"
    return ParticleGibbs(
        kernel=kernel,
        particles=particles,
        metropolis_steps=10,
        burn_in_particles=300 if exact else particles,
        data_rate=max(settings["rows"] // 25, 1),
        settling_sweeps=10,
        tuning_sweeps=(40, 60, 80) if exact else (30, 30),
        sweeps_per_draw=2 if exact else 1,
    )


def calibrate(folder: Path, settings: dict) -> None:
    """Calibrate on every training log with the exact kernel, and with the paper's at each n."""
    path, keys = folder / "calibrations.csv", ("robot", "level", "log", "kernel", "particles")
    done = stored(path, keys)
    for log_number in range(settings["training"]):
        for robot, level in cases(settings):
            log = simulate_amigobot(float(settings["rows"]), TRAINING_SEED + log_number, truth_of(robot, level))
            bound = default_model(log).bind(log)
            for kernel, n in [("conditional", EXACT), *(("smoothing", n) for n in settings["particles"])]:
                key = (robot, str(level), str(log_number), kernel, str(n))
                if key in done:
                    continue
                begin = time.process_time()
                options = RunOptions(
                    draws=settings["draws"],
                    chains=4 if kernel == "conditional" else 2,
                    seed=SAMPLING_SEED + log_number,
                    trajectories=1,
                )
                chains = method_for(kernel, n, settings).run(bound, options)
                row: dict[str, object] = dict(zip(keys, key, strict=True))
                row["cpu_seconds"] = f"{time.process_time() - begin:.1f}"
                for k, name in enumerate(bound.names):
                    draws = np.ascontiguousarray(chains.theta[..., k])
                    row |= {f"{name}_mean": f"{draws.mean():.6g}", f"{name}_sd": f"{draws.std():.6g}"}
                    row |= {f"{name}_r_hat": f"{r_hat(draws):.3f}", f"{name}_ess": f"{bulk_ess(draws):.0f}"}
                append(path, row)
                print(" ".join(key), row["cpu_seconds"], "CPU seconds", flush=True)


def test_logs(robot: str, level: float, settings: dict) -> list[RobotLog]:
    """Return the test trajectories of a robot at a level of range noise."""
    truth, seconds = truth_of(robot, level), float(settings["rows"])
    return [simulate_amigobot(seconds, TEST_SEED + number, truth) for number in range(settings["trajectories"])]


def candidates(folder: Path, robot: str, level: float, n: int) -> Iterator[tuple[str, str, dict[str, float] | None]]:
    """Yield source, training log and theta (None: prior mean) of everything that a filter with n particles may use."""
    yield "true", "-", truth_of(robot, level)
    yield "prior", "-", None
    with (folder / "calibrations.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            right = row["kernel"] == "conditional" or row["particles"] == str(n)
            if (row["robot"], row["level"]) == (robot, str(level)) and right:
                theta = {name: float(row[f"{name}_mean"]) for name in truth_of(robot, level)}
                yield row["kernel"], row["log"], theta


def localize(folder: Path, settings: dict) -> None:
    """Localize on every test trajectory with every theta, with the number of particles that it was made for."""
    path, keys = folder / "errors.csv", ("robot", "level", "particles", "source", "log", "trajectory")
    done = stored(path, keys)
    for robot, level in cases(settings):
        logs = test_logs(robot, level, settings)
        for n in settings["particles"]:
            begin = time.process_time()
            for source, training, theta in candidates(folder, robot, level, n):
                for number, log in enumerate(logs):
                    key = (robot, str(level), str(n), source, training, str(number))
                    if key in done:
                        continue
                    runs = localize_many(
                        log,
                        method="prior" if theta is None else "mean",
                        theta=theta,
                        repetitions=settings["repetitions"],
                        particles=n,
                        seed=FILTER_SEED + number,
                    )
                    error = runs.position_error.mean(axis=1)  # NaN for a run that lost the robot
                    kept = error[runs.lost_at < 0]
                    row: dict[str, object] = dict(zip(keys, key, strict=True))
                    row |= {"runs": len(error), "lost": len(error) - len(kept)}
                    row |= {"error": f"{kept.mean():.6g}", "error_sd_of_runs": f"{kept.std(ddof=1):.4g}"}
                    row["log_evidence"] = f"{runs.log_evidence[runs.lost_at < 0].mean():.2f}"
                    append(path, row)
            print(f"{robot}, level {level}, n = {n}: {time.process_time() - begin:.0f} CPU seconds", flush=True)


def landscape(folder: Path, settings: dict) -> None:
    """Let the filter assume more or less noise of the ranges, or of the motion, than there is; the rest is true."""
    path, keys = folder / "landscape.csv", ("robot", "level", "particles", "scanned", "factor", "trajectory")
    done = stored(path, keys)
    for robot, level in cases(settings):
        scans = [("range", factor) for factor in settings["range"]] + [("motion", f) for f in settings["motion"]]
        for number, log in enumerate(test_logs(robot, level, settings)):
            for n, (scanned, factor) in itertools.product(settings["particles"], scans):
                key = (robot, str(level), str(n), scanned, str(factor), str(number))
                if key in done:
                    continue
                runs = localize_many(
                    log,
                    theta=truth_of(robot, level, **{f"{scanned}_factor": factor}),
                    repetitions=max(settings["repetitions"] // 2, 2),
                    particles=n,
                    seed=FILTER_SEED + number,
                )
                kept = runs.lost_at < 0
                row: dict[str, object] = dict(zip(keys, key, strict=True))
                row["error"] = f"{runs.position_error[kept].mean():.6g}"
                row["log_evidence"] = f"{runs.log_evidence[kept].mean():.2f}"
                row["log_evidence_sd"] = f"{runs.log_evidence[kept].std(ddof=1):.2f}"
                append(path, row)
        print(f"{robot}, level {level}: landscape", flush=True)


def main() -> None:
    """Compute what is missing of one part, or of all."""
    parts = {"calibrate": calibrate, "localize": localize, "landscape": landscape}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="?", choices=[*parts, "all"], default="all")
    parser.add_argument("--small", action="store_true", help="seconds instead of minutes, for the tests")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent, help="folder of the results")
    arguments = parser.parse_args()
    logging.disable(logging.WARNING)
    for name, run in parts.items():
        if arguments.part in (name, "all"):
            run(arguments.output, SMALL if arguments.small else FULL)


if __name__ == "__main__":
    main()
