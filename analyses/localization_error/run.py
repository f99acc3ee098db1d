"""Localization error with what calibration found, against the truth and the prior: Figures 2 and 4 of the paper.

    python run.py amigobot       # six calibrations on 400 s, ten minutes of test data
    python run.py aibo           # six calibrations on 1000 s, sixteen minutes of test data
    python run.py mrclam         # real robots: train on a third of a drive, localize on the other two
    python run.py mrclam_outliers    # the same with a model that allows for gross errors of the sensor
    python run.py amigobot --small --output FOLDER

Each takes five to twenty minutes on one core. Every calibration has a training log of its own and test trajectories
of its own. draws_<robot>_<calibration>.npz holds the posterior, errors_<robot>.csv a row for each run of the filter;
what is there already is not computed again. The recordings are looked for in PMCL_DATA, by default shared/data beside
the repository.
"""

import argparse
import csv
import itertools
import logging
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr

import pmcl
from pmcl.localization.many import localize_many
from pmcl.logs.mrclam import read_mrclam
from pmcl.logs.robot_log import RobotLog
from pmcl.models.robot_model import default_model
from pmcl.posterior.access import log_joint, theta_draws
from pmcl.posterior.compat import assemble
from pmcl.simulations.aibo import simulate_aibo
from pmcl.simulations.amigobot import simulate_amigobot

TRUTH = {
    "amigobot": {"sigma_forward": 0.02, "sigma_left": 0.01, "sigma_turn": 0.1, "sigma_range": 0.04},
    "aibo": {
        "sigma_forward": 0.02, "sigma_left": 0.015, "sigma_turn": 0.1, "sigma_bearing": 0.03, "sigma_size": 0.3,
    },
}  # fmt: skip
SIMULATORS = {"amigobot": simulate_amigobot, "aibo": simulate_aibo}
METHODS = ("prior", "true", "measured", "mean", "map", "posterior")
TRAINING_SEED, TEST_SEED, SAMPLING_SEED, FILTER_SEED = 100, 200_000, 300, 400_000
# Mean distance [m] and heading error [rad] of a run from the reference, and its mean log score of a row [nat].
COLUMNS = ("calibration", "trajectory", "method", "run", "lost", "position", "heading", "score")
STORED_DRAWS = 250  # of each of four chains
DATA = Path(os.environ.get("PMCL_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))


@dataclass(frozen=True)
class Sizes:
    """How much is computed."""

    calibrations: int
    training: float  # [s]
    test: float  # [s]
    trajectories: int
    repetitions: int
    particles: int
    draws: int
    burn_in_particles: int


FULL = {
    "amigobot": Sizes(6, 400.0, 600.0, 350, 1, 500, 500, 300),
    "aibo": Sizes(6, 1000.0, 960.0, 350, 1, 500, 500, 300),
    "mrclam": Sizes(6, 297.0, 594.0, 1, 60, 500, 500, 1000),
    "mrclam_outliers": Sizes(6, 297.0, 594.0, 1, 60, 500, 500, 1000),
}
SMALL = {
    "amigobot": Sizes(2, 60.0, 60.0, 8, 4, 100, 60, 50),
    "aibo": Sizes(2, 60.0, 60.0, 8, 4, 100, 60, 50),
    "mrclam": Sizes(1, 60.0, 120.0, 1, 4, 100, 60, 500),
    "mrclam_outliers": Sizes(1, 60.0, 120.0, 1, 4, 100, 60, 500),
}


def recorded(calibration: int, sizes: Sizes) -> tuple[RobotLog, list[RobotLog]]:
    """Return a third of a real drive to train on, and what comes before and after it to test on."""
    log = read_mrclam(DATA / "mrclam6", 1 + calibration // 3, 0.5, duration=sizes.training + sizes.test)
    third = log.n_steps // 3
    cuts = [0, third, 2 * third, log.n_steps]
    parts = [part_of(log, begin, end) for begin, end in itertools.pairwise(cuts)]
    return parts[calibration % 3], [part for k, part in enumerate(parts) if k != calibration % 3]


def part_of(log: RobotLog, begin: int, end: int) -> RobotLog:
    """Cut a log; the robot is placed at the beginning, within 0.1 m and 0.1 rad of where motion capture has it."""
    return log.select(begin, end, start_mean=log.true_poses[begin], start_std=np.full(3, 0.1))


def training_log(robot: str, calibration: int, sizes: Sizes) -> RobotLog:
    """Return what a calibration is made from."""
    if robot not in SIMULATORS:
        return recorded(calibration, sizes)[0]
    return SIMULATORS[robot](sizes.training, TRAINING_SEED + calibration, TRUTH[robot])


def test_logs(robot: str, calibration: int, sizes: Sizes) -> Iterator[tuple[int, RobotLog]]:
    """Yield the test trajectories of a calibration: no other calibration sees them."""
    if robot not in SIMULATORS:
        yield from enumerate(recorded(calibration, sizes)[1])
        return
    for number in range(sizes.trajectories):
        yield number, SIMULATORS[robot](sizes.test, TEST_SEED + 1000 * calibration + number, TRUTH[robot])


def errors_about_reference(log: RobotLog) -> dict[str, np.ndarray]:
    """Return the errors of increments, shape (T - 1,), and of sightings, shape (T, J), about motion capture."""
    poses, landmarks = log.true_poses, log.landmarks.positions
    step = np.diff(poses, axis=0)
    cos, sin = np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
    forward, left = cos * step[:, 0] + sin * step[:, 1], cos * step[:, 1] - sin * step[:, 0]
    motion = np.column_stack([forward, left, step[:, 2]]) - log.odometry[1:]
    way = landmarks - poses[:, None, :2]
    bearing = log.landmark_bearing - np.arctan2(way[..., 1], way[..., 0]) + poses[:, 2:]
    return {
        "sigma_forward": motion[:, 0],
        "sigma_left": motion[:, 1],
        "sigma_turn": wrapped(motion[:, 2]),
        "sigma_landmark_range": log.landmark_range - np.hypot(way[..., 0], way[..., 1]),
        "sigma_bearing": wrapped(bearing),
    }


def measured(log: RobotLog) -> dict[str, float]:
    """Return the noise that someone with motion capture would measure: root mean squares about the reference."""
    errors = errors_about_reference(log)
    return {name: float(np.sqrt(np.nanmean(np.square(error)))) for name, error in errors.items()}


def wrapped(angle: np.ndarray) -> np.ndarray:
    """Return angles [rad] between -pi and pi."""
    return np.arctan2(np.sin(angle), np.cos(angle))


def given_theta(robot: str, calibration: int, sizes: Sizes) -> dict[str, dict[str, float]]:
    """Return parameters that do not come from calibration: a simulated robot has true ones, a real one none."""
    if robot in TRUTH:
        return {"true": TRUTH[robot]}
    return {"measured": measured(training_log(robot, calibration, sizes))} if robot == "mrclam" else {}


def model_for(robot: str, log: RobotLog) -> pmcl.RobotModel:
    """Return the usual model of a log, with outliers when asked for."""
    return default_model(log, outliers=robot.endswith("_outliers"))


def calibrate(robot: str, calibration: int, path: Path, sizes: Sizes) -> None:
    """Store the posterior of one calibration."""
    log = training_log(robot, calibration, sizes)
    begin = time.process_time()
    model = model_for(robot, log)
    data = pmcl.calibrate(
        log,
        model,
        method=pmcl.ParticleGibbs(burn_in_particles=sizes.burn_in_particles),
        draws=sizes.draws,
        seed=SAMPLING_SEED + calibration,
        trajectories=1,
        check=False,
    )
    chosen = np.linspace(0, sizes.draws - 1, min(STORED_DRAWS, sizes.draws)).astype(int)
    densities = log_joint(data)
    np.savez_compressed(
        path,
        theta=theta_draws(data)[:, chosen].astype(np.float32),
        log_joint=densities[:, chosen],
        names=np.array([parameter.name for parameter in model.parameters]),
        cpu_seconds=np.array(time.process_time() - begin),
        seed=np.array(SAMPLING_SEED + calibration),
    )
    print(f"{path.name}: {time.process_time() - begin:.0f} CPU seconds", flush=True)


def posterior_from(path: Path) -> object:
    """Return stored draws as an ArviZ posterior."""
    stored = np.load(path)
    draws = {
        str(name): (("chain", "draw"), stored["theta"][..., k].astype(float)) for k, name in enumerate(stored["names"])
    }
    density = {"lp": (("chain", "draw"), stored["log_joint"])}
    return assemble({"posterior": xr.Dataset(draws), "sample_stats": xr.Dataset(density)}, {})


def localize(robot: str, calibration: int, path: Path, draws: Path, sizes: Sizes) -> None:
    """Run the filter over every test trajectory with every method, and store each run."""
    done = set()
    if path.exists():
        with path.open(newline="") as file:
            done = {(row["calibration"], row["trajectory"], row["method"]) for row in csv.DictReader(file)}
    data, given = posterior_from(draws), given_theta(robot, calibration, sizes)
    begin = time.process_time()
    for number, log in test_logs(robot, calibration, sizes):
        for method in METHODS:
            unknown = method in ("true", "measured") and method not in given
            if unknown or (str(calibration), str(number), method) in done:
                continue
            runs = localize_many(
                log,
                model_for(robot, log),
                posterior=data,
                method="mean" if method in given else method,
                theta=given.get(method),
                repetitions=sizes.repetitions,
                particles=sizes.particles,
                # The same for all methods.
                seed=FILTER_SEED + 1000 * calibration + number,
            )
            rows = []
            for run in range(sizes.repetitions):
                errors = [np.nanmean(np.abs(values[run])) for values in (runs.position_error, runs.heading_error)]
                numbers = [f"{value:.5g}" for value in (*errors, np.nansum(runs.log_score[run]) / log.n_steps)]
                rows.append([calibration, number, method, run, int(runs.lost_at[run] >= 0), *numbers])
            append(path, rows)
    print(f"calibration {calibration}: localized, {time.process_time() - begin:.0f} CPU seconds", flush=True)


def append(path: Path, rows: list[list]) -> None:
    """Add rows to the results at once."""
    with path.open("a", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        if file.tell() == 0:
            writer.writerow(COLUMNS)
        writer.writerows(rows)


def main() -> None:
    """Calibrate and localize, but for what was done before."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robot", choices=list(FULL))
    parser.add_argument("--small", action="store_true", help="seconds instead of minutes, for the tests")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent, help="folder of the results")
    arguments = parser.parse_args()
    logging.disable(logging.WARNING)
    robot = arguments.robot
    sizes = (SMALL if arguments.small else FULL)[robot]
    for calibration in range(sizes.calibrations):
        draws = arguments.output / f"draws_{robot}_{calibration}.npz"
        if not draws.exists():
            calibrate(robot, calibration, draws, sizes)
        localize(robot, calibration, arguments.output / f"errors_{robot}.csv", draws, sizes)


if __name__ == "__main__":
    main()
