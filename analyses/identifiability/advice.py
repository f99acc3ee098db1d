"""Does the drive that 'pmcl identify' advises teach what it promises?

    python advice.py         # some minutes of CPU; what is there already is not computed again

A robot among landmarks only drives straight, or only turns in place, so that its log cannot tell some of its noises. It
then drives what it was advised to, for as long as advised, and both logs together are calibrated. Each row of
advice.csv is one parameter that got an advice.
"""

import csv
import time
from pathlib import Path

import numpy as np
from run import SEED

import pmcl
from pmcl.identifiability import identify
from pmcl.models.motions.increments.motion import GrowingIncrementNoise
from pmcl.models.robot_model import RobotModel
from pmcl.models.sensor import sensor_of
from pmcl.models.sensors.landmarks.sensor import LandmarkNoise
from pmcl.models.starts.belief import StartBelief
from pmcl.posterior.access import theta_draws
from pmcl.posterior.diagnostics import summarize
from pmcl.simulations.drives import drives_for
from pmcl.simulations.simulate import make_rng, simulate_path

COLUMNS = ("kind", "number", "parameter", "truth", "prior_sd", "before_sd", "drive", "minutes", "promised_sd", "sd",
           "mean", "ess")  # fmt: skip
MODEL = RobotModel(GrowingIncrementNoise(), (LandmarkNoise(),))
TRUTH = {"sigma_forward": 0.02, "sigma_left": 0.01, "sigma_turn": 0.01, "sigma_forward_per_metre": 0.1,
         "sigma_turn_per_radian": 0.1, "sigma_turn_per_metre": 0.05, "sigma_landmark_range": 0.05,
         "sigma_bearing": 0.02}  # fmt: skip
LANDMARKS = np.array([(-3.0, 4.0), (8.0, 4.0), (2.0, -5.0), (9.0, -3.0)])
ROWS, REPLICATES = 90, 4
THERE_AND_BACK = np.where(np.arange(ROWS) // 15 % 2 == 0, 1.0, -1.0)[:, None]
KINDS = {"straight": THERE_AND_BACK * (0.3, 0.0, 0.0), "turning": THERE_AND_BACK * (0.0, 0.0, 0.3)}


def driven(command: np.ndarray, truth: dict[str, float], seed: int) -> pmcl.RobotLog:
    """Simulate a robot that drives these increments (T, 3), once a second."""
    n_steps, seen = len(command), np.ones((len(command), len(LANDMARKS)))
    log = pmcl.RobotLog.build(
        time=np.arange(n_steps, dtype=float), odometry=command, landmarks=LANDMARKS, landmark_range=seen,
        landmark_bearing=0.1 * seen, start_mean=np.zeros(3), start_std=np.full(3, 0.05), true_theta=truth, warn=False,
    )  # fmt: skip
    rng = make_rng(seed)
    values = [np.array([truth[p.name] for p in part.parameters]) for part in (MODEL.motion, MODEL.sensors[0])]
    path = simulate_path(MODEL.motion.bind(log).table(values[0]), StartBelief().bind(log).table(np.empty(0)), rng)
    table, dataset = MODEL.sensors[0].bind(log).table(values[1]), log.dataset.copy(deep=True)
    sensor_of(table).store(sensor_of(table).simulate(table, path, rng), dataset)
    dataset["true_pose"] = (("time", "pose"), path)
    return pmcl.RobotLog.from_dataset(dataset, f"simulated, seed {seed}")


def advised(kind: str, number: int) -> list[dict[str, object]]:
    """Drive, ask for advice, drive so, and calibrate."""
    seed = SEED + 50000 + 1000 * sorted(KINDS).index(kind) + number
    factors = 2.0 ** np.random.default_rng(seed).uniform(-0.5, 0.5, len(TRUTH))
    truth = {name: value * factor for (name, value), factor in zip(TRUTH.items(), factors, strict=True)}
    log = driven(KINDS[kind], truth, seed)
    predictions = {p.name: p for p in identify(log, MODEL).predictions}
    asked = {name: p for name, p in predictions.items() if p.advice is not None}
    drives = {drive.name: drive for drive in drives_for(log, log.true_poses, sideways=False)}
    rows = []
    for drive, minutes in sorted({(p.advice.drive, p.advice.minutes) for p in asked.values()}):
        command = drives[drive].commands[:, 1:].reshape(-1, 3)
        command = np.resize(command, (round(60 * minutes) + 1, 3))
        more = driven(command, truth, seed + 500)
        data = pmcl.calibrate([log, more], MODEL, draws=1000, seed=seed, check=False)
        draws, ess = theta_draws(data), summarize(data)["ess_bulk"].values
        for k, name in enumerate(predictions):
            if name in asked and (asked[name].advice.drive, asked[name].advice.minutes) == (drive, minutes):
                p = asked[name]
                values = (kind, number, name, truth[name], p.prior_std, p.std, drive, minutes, p.advice.std,
                          draws[..., k].std(), draws[..., k].mean(), float(ess[k]))  # fmt: skip
                rows.append({column: f"{value:.4g}" if isinstance(value, float) else value
                             for column, value in zip(COLUMNS, values, strict=True)})  # fmt: skip
    return rows


def main() -> None:
    """Compute what is missing."""
    path = Path(__file__).parent / "advice.csv"
    there = set()
    if path.exists():
        with path.open(newline="") as file:
            there = {(row["kind"], int(row["number"])) for row in csv.DictReader(file)}
    for number in range(REPLICATES):
        for kind in KINDS:
            if (kind, number) in there:
                continue
            begin = time.process_time()
            rows = advised(kind, number)
            new = not path.exists()
            with path.open("a", newline="") as file:
                writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
                if new:
                    writer.writeheader()
                writer.writerows(rows)
            told = "; ".join(f"{row['parameter']}: {row['drive']} for {row['minutes']} min, promised "
                             f"{row['promised_sd']}, got {row['sd']}" for row in rows)  # fmt: skip
            print(f"{kind} {number} ({time.process_time() - begin:.0f} CPU seconds): {told}", flush=True)


if __name__ == "__main__":
    main()
