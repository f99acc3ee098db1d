"""Simulation-based calibration: does the posterior contain the truth as often as it says?

Draw theta from its prior, a path and readings from the model, and the posterior from the readings. The rank of the
true theta among independent posterior draws is then uniform, whatever the prior (Talts et al., arXiv:1804.06788). A
replicate is one row of results.csv, and a function of its seed alone. What is already in the file is not computed
again:

    python run.py --kernel conditional --replicates 200
    python run.py --kernel smoothing --replicates 200

Odometry and landmarks are the same in all replicates and know nothing of the true path: a robot that is steered from
where it really is would tell, by its odometry, about the noise of its motion.
"""

import argparse
import csv
import logging
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from pmcl.calibration import ParticleGibbs, RunOptions
from pmcl.logs.robot_log import RobotLog
from pmcl.models.parameters import gamma_prior
from pmcl.models.robot_model import default_model
from pmcl.models.sensor import sensor_of
from pmcl.posterior.compat import bulk_ess
from pmcl.simulations.simulate import make_rng, simulate_path

ROWS = 40
# Far outside what the robot can reach in 40 steps of 0.3 m, so that no noise makes a distance negative.
LANDMARKS = 30.0 * np.array([[1.0, 0.0], [-0.5, 0.9], [-0.5, -0.9]])
# Sensors that are sharp against the motion: the path is nearly known, so that the plain sampler mixes too, and a filter
# of few particles is poor, so that its error shows.
MEANS = {
    "sigma_forward": 0.1, "sigma_left": 0.1, "sigma_turn": 0.1, "sigma_landmark_range": 0.1, "sigma_bearing": 0.03,
}  # fmt: skip
# The 15 draws that are ranked are so many sweeps apart that they are nearly independent; 2 more come before them.
RANKED, SKIPPED = 15, 2
SWEEPS_PER_DRAW = {"conditional": 12, "smoothing": 40}
# Transport moves aim at the exact posterior: next to `smoothing` they would hide what that kernel targets.
TRANSPORT_MOVES = {"conditional": 2, "smoothing": 0}
BASE_SEED = 20060716
RESULTS = Path(__file__).with_name("results.csv")


def log_with(readings: dict[str, np.ndarray]) -> RobotLog:
    """Return the log of an open-loop drive along an eight, with these readings of every landmark at every row."""
    row = np.arange(ROWS)
    odometry = np.column_stack([np.full(ROWS, 0.3), np.zeros(ROWS), 0.3 * np.sin(2.0 * np.pi * row / ROWS)])
    return RobotLog.build(
        time=row.astype(float),
        odometry=odometry,
        landmarks=LANDMARKS,
        landmark_range=readings["range"],
        landmark_bearing=readings["bearing"],
        start_mean=np.zeros(3),
        start_std=np.array([0.1, 0.1, 0.05]),
    )


def replicate(number: int, kernel: str, particles: int) -> dict[str, float | int | str]:
    """Simulate, calibrate, rank; both kernels see the same theta and readings of a replicate."""
    simulation, sampling = np.random.SeedSequence([BASE_SEED, number]).generate_state(2)
    rng = make_rng(int(simulation))
    shape = (ROWS, len(LANDMARKS))
    everywhere = log_with({"range": np.ones(shape), "bearing": np.ones(shape)})
    model = replace(default_model(everywhere), priors={name: gamma_prior(mean) for name, mean in MEANS.items()})
    blank = model.bind(everywhere)
    theta = blank.draw_prior(rng)
    (tables,) = blank.tables(theta)
    path = simulate_path(tables.motion, tables.start, rng)
    table = sensor_of(tables.sensors[0]).simulate(tables.sensors[0], path, rng)
    bound = model.bind(log_with({"range": table.range.reshape(shape), "bearing": table.bearing.reshape(shape)}))
    method = ParticleGibbs(
        kernel=kernel,
        particles=particles,
        transport_moves=TRANSPORT_MOVES[kernel],
        burn_in_particles=200,
        data_rate=8,
        tuning_sweeps=(20, 30, 40),
        sweeps_per_draw=SWEEPS_PER_DRAW[kernel],
    )
    options = RunOptions(draws=SKIPPED + RANKED, chains=1, seed=int(sampling), trajectories=1)
    begin = time.perf_counter()
    draws = method.run(bound, options).theta[0, SKIPPED:]
    row: dict[str, float | int | str] = {
        "kernel": kernel,
        "particles": particles,
        "replicate": number,
        "simulation_seed": int(simulation),
        "sampling_seed": int(sampling),
        "seconds": round(time.perf_counter() - begin, 3),
    }
    for k, name in enumerate(bound.names):
        row |= {
            f"{name}_true": f"{theta[k]:.6g}",
            f"{name}_mean": f"{draws[:, k].mean():.6g}",
            f"{name}_sd": f"{draws[:, k].std(ddof=1):.6g}",
            f"{name}_ess": f"{bulk_ess(draws[None, :, k]):.1f}",
            f"{name}_rank": int((draws[:, k] < theta[k]).sum()),
        }
    return row


def done() -> set[tuple[str, int, int]]:
    """Return what the file already holds."""
    if not RESULTS.exists():
        return set()
    with RESULTS.open(newline="") as file:
        return {(row["kernel"], int(row["particles"]), int(row["replicate"])) for row in csv.DictReader(file)}


def main() -> None:
    """Compute the replicates that are missing, and write each as soon as it is there."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kernel", choices=["conditional", "smoothing"], default="conditional")
    parser.add_argument("--particles", type=int, default=20)
    parser.add_argument("--replicates", type=int, default=200)
    arguments = parser.parse_args()
    logging.disable(logging.WARNING)
    present = done()
    for number in range(arguments.replicates):
        if (arguments.kernel, arguments.particles, number) in present:
            continue
        row = replicate(number, arguments.kernel, arguments.particles)
        new = not RESULTS.exists()
        with RESULTS.open("a", newline="") as file:
            writer = csv.DictWriter(file, fieldnames=list(row), lineterminator="\n")
            if new:
                writer.writeheader()
            writer.writerow(row)
        print(f"{row['kernel']}, replicate {number}: {row['seconds']} s", flush=True)


if __name__ == "__main__":
    main()
