"""What 'pmcl identify' predicts of a posterior, against the posterior that calibration then draws.

    python run.py            # about forty minutes of CPU; what is there already is not computed again
    python run.py --small --output FOLDER

Each row of results.csv is one parameter of one simulated log. Robots, lengths, drives and true parameters differ; most
true parameters are drawn from their priors.
"""

import argparse
import csv
import time
from pathlib import Path

import numpy as np

import pmcl
from pmcl.engine import contract
from pmcl.identifiability import identify
from pmcl.logs import LidarScans
from pmcl.maps import OccupancyGrid
from pmcl.models.motions.increments.motion import GrowingIncrementNoise
from pmcl.models.motions.odometry.motion import Differential, Omni
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.models.sensor import sensor_of
from pmcl.models.sensors.landmarks.sensor import LandmarkNoise
from pmcl.models.sensors.lidar.sensor import Lidar
from pmcl.posterior.access import parameter_names, theta_draws
from pmcl.posterior.diagnostics import summarize
from pmcl.simulations import simulate_aibo, simulate_amigobot, simulate_landmark_field
from pmcl.simulations.driving import WaypointDriver
from pmcl.simulations.simulate import make_rng

SEED = 20261124
COLUMNS = ("kind", "number", "rows", "readings", "parameter", "truth", "predicted_mean", "predicted_sd", "mean", "sd",
           "prior_sd", "share", "ess", "r_hat", "effective_draws", "identify_cpu", "calibrate_cpu")  # fmt: skip
DRAWS, CHAINS = 400, 4
# A calibration whose slowest parameter has fewer effective draws, or a greater R-hat, says little about a standard
# deviation; it is repeated with four times as many draws, up to the last of these.
LEAST_ESS, MOST_R_HAT, MOST_DRAWS = 200.0, 1.02, 6400

# A hall of 8 m x 6 m with a pillar and a niche, cells of 5 cm, and routes through it.
CELLS = np.zeros((120, 160), dtype=np.uint8)
CELLS[[0, -1]] = CELLS[:, [0, -1]] = OccupancyGrid.OCCUPIED
CELLS[50:62, 70:82] = CELLS[0:24, 120:124] = CELLS[90:, 40:44] = OccupancyGrid.OCCUPIED
HALL = OccupancyGrid(CELLS, 0.05)
LOOP = np.array([(5.2, 1.2), (5.2, 3.0), (6.8, 4.6), (3.4, 4.6), (1.2, 3.4), (1.2, 1.2)])
CORRIDOR = np.array([(5.0, 1.2), (1.2, 1.2)])
# nav2's alphas, as a robot of average wheels has them; each log multiplies them by factors between 1/2 and 2.
ALPHAS = {"alpha1": 0.1, "alpha2": 0.05, "alpha3": 0.05, "alpha4": 0.02, "alpha5": 0.1}
LASER = {"sigma_hit": 0.08, "z_rand": 0.05, "z_short": 0.03, "z_max": 0.03, "lambda_short": 0.5}


def driven(motion, theta, logged, steer, start, rng, n_steps):
    """Steer a robot from its true pose; each increment is drawn by the motion model from the command."""
    command, path = np.full((n_steps, 3), 0.01), np.empty((n_steps, 3))
    table = motion.bind(logged(command, np.ones((n_steps, 24)))).table(np.array(theta))
    command[0], path[0] = 0.0, start + 0.05 * rng.standard_normal(3)
    scratch, current = np.empty((int(contract.scratch_rows(table)), 1)), np.empty((3, 1))
    for t in range(1, n_steps):
        command[t] = table.mean[t] = steer(path[t - 1])
        contract.propagate(table, t, rng, path[t - 1][:, None].copy(), current, scratch)
        path[t] = current[:, 0]
    return path, command


Made = tuple[pmcl.RobotLog, RobotModel]


def lidar_log(n_steps: int, seed: int, *, omni: bool, beam: bool, route: np.ndarray) -> Made:
    """Simulate a robot with a lidar of 24 rays in the hall, whose noise is that of its motion model."""
    rng = np.random.default_rng(seed)
    motion = Omni() if omni else Differential()
    sensor = Lidar(model="beam" if beam else "likelihood-field", exponent=1.0)
    truth = {p.name: {**ALPHAS, **LASER}[p.name] * 2.0 ** rng.uniform(-1.0, 1.0)
             for p in (*motion.parameters, *sensor.parameters)}  # fmt: skip
    driver, start = WaypointDriver(route, step=0.3, turn=0.6, reached=0.4), np.array([*route[-1], 0.0])

    def steer(pose: np.ndarray) -> np.ndarray:
        command = driver(pose)
        # An omnidirectional robot also makes good what it is off to the side.
        return command + np.array([0.0, 0.3 * np.sin(command[2]) if omni else 0.0, 0.0])

    def logged(command: np.ndarray, ranges: np.ndarray, path: np.ndarray | None = None) -> pmcl.RobotLog:
        angles = np.linspace(-np.pi, np.pi, 24, endpoint=False)
        return pmcl.RobotLog.build(
            time=np.arange(n_steps, dtype=float), odometry=command, grid_map=HALL, start_mean=start,
            lidars={"": LidarScans(ranges, angles, 0.05, 12.0, np.array([0.1, 0.0, 0.0]))}, true_poses=path,
            start_std=np.full(3, 0.05), true_theta=truth, robot="robot with a lidar", warn=False,
        )  # fmt: skip

    path, command = driven(motion, [truth[p.name] for p in motion.parameters], logged, steer, start, rng, n_steps)
    full = logged(command, np.ones((n_steps, 24)), path)
    dataset = full.dataset.copy(deep=True)
    table = sensor.bind(full).table(np.array([truth[p.name] for p in sensor.parameters]))
    sensor_of(table).store(sensor_of(table).simulate(table, path, make_rng(seed + 1)), dataset)
    log = pmcl.RobotLog.from_dataset(dataset, f"hall, seed {seed}").with_map(HALL)
    return log, RobotModel(motion, (sensor,))


def made(kind: str, number: int) -> Made:
    """Return the log of a kind and number, and its model; lengths alternate."""
    seed = SEED + 1000 * sorted(KINDS).index(kind) + number
    rows = KINDS[kind][number % len(KINDS[kind])]
    if kind.startswith("amigobot"):
        # A sharp sonar, or one as the prior has it.
        log = simulate_amigobot(rows, seed, {"sigma_range": 0.03} if kind.endswith("sharp") else None)
        return log, default_model(log)
    if kind == "aibo":
        log = simulate_aibo(rows, seed)
        return log, default_model(log)
    if kind.startswith("landmarks"):
        bearings = kind.endswith("bearings")
        few = 3 if bearings else 8
        log = simulate_landmark_field(rows, seed, n_landmarks=few, bearings=bearings, ranges=not bearings)
        return log, default_model(log)
    if kind == "growing":
        log = simulate_landmark_field(rows, seed)
        return log, RobotModel(GrowingIncrementNoise(), (LandmarkNoise(bearing=False),))
    route = CORRIDOR if kind.endswith("corridor") else LOOP
    return lidar_log(rows, seed, omni=kind.startswith("omni"), beam="beam" in kind, route=route)


# Rows of the logs of each kind, in turn.
KINDS = {
    "aibo": (60, 120, 240, 400),
    "amigobot": (30, 100, 200, 400),
    "amigobot sharp": (60, 200),
    "growing": (60, 120, 300),
    "landmarks bearings": (40, 120),
    "landmarks ranges": (20, 80, 200),
    "differential field": (60, 150),
    "differential field corridor": (60, 150),
    "differential beam": (60, 150),
    "omni field": (60, 150),
}
REPLICATES = {
    "aibo": 10, "amigobot": 10, "amigobot sharp": 4, "growing": 6, "landmarks bearings": 4, "landmarks ranges": 8,
    "differential field": 2, "differential field corridor": 2, "differential beam": 2, "omni field": 2,
}  # fmt: skip
SMALL = {"aibo": 1, "landmarks ranges": 1, "differential field": 1}


def compare(kind: str, number: int, draws: int, chains: int) -> list[dict[str, object]]:
    """Predict and calibrate one log."""
    log, model = made(kind, number)
    begin = time.process_time()
    found = identify(log, model, drives=False)
    predicted = time.process_time()
    most = draws if draws < DRAWS else MOST_DRAWS
    while True:
        data = pmcl.calibrate(log, model, draws=draws, chains=chains, seed=SEED + number, check=False)
        summary, theta = summarize(data), theta_draws(data)
        if draws >= most or (summary["ess_bulk"].min() >= LEAST_ESS and summary["r_hat"].max() <= MOST_R_HAT):
            break
        draws *= 4
    done = time.process_time()
    rows = []
    for k, prediction in enumerate(found.predictions):
        assert parameter_names(data)[k] == prediction.name
        values = (
            kind, number, log.n_steps, log.n_readings, prediction.name, log.true_theta.get(prediction.name, np.nan),
            prediction.mean, prediction.std, theta[..., k].mean(), theta[..., k].std(), prediction.prior_std,
            prediction.share, float(summary["ess_bulk"].values[k]), float(summary["r_hat"][k]), found.effective_draws,
            predicted - begin, done - predicted,
        )  # fmt: skip
        rows.append({name: f"{value:.4g}" if isinstance(value, float) else value
                     for name, value in zip(COLUMNS, values, strict=True)})  # fmt: skip
    return rows


def main() -> None:
    """Compute the logs that are missing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--small", action="store_true", help="a minute instead of twenty, for the tests")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent, help="folder of the results")
    arguments = parser.parse_args()
    path = arguments.output / "results.csv"
    there = set()
    if path.exists():
        with path.open(newline="") as file:
            there = {(row["kind"], int(row["number"])) for row in csv.DictReader(file)}
    replicates = SMALL if arguments.small else REPLICATES
    for number in range(max(replicates.values())):
        for kind in (kind for kind, count in replicates.items() if number < count):
            if (kind, number) in there:
                continue
            rows = compare(kind, number, 200 if arguments.small else DRAWS, 2 if arguments.small else CHAINS)
            new = not path.exists()
            with path.open("a", newline="") as file:
                writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
                if new:
                    writer.writeheader()
                writer.writerows(rows)
            ratios = " ".join(f"{float(row['predicted_sd']) / float(row['sd']):.2f}" for row in rows)
            print(f"{kind} {number}: {ratios}; {float(rows[0]['calibrate_cpu']):.0f} CPU seconds", flush=True)


if __name__ == "__main__":
    main()
