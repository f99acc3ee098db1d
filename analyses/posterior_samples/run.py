"""Figures 1 and 3 of the paper: posterior samples of both robots' noise parameters from a short and a longer drive.

    python run.py            # about ten minutes on one core; what is there already is not computed again
    python run.py --small --output FOLDER

Each run is one file: <robot>_<seconds>_<kernel>.npz with the draws (chain, draw, parameter), the true values and seeds.
The short drive is the beginning of the long one. The paper's kernel, with 500 particles, is run on one short drive
only: it takes long, and mixes slowly.
"""

import argparse
import time
from pathlib import Path

import numpy as np

import pmcl
from pmcl.posterior.access import theta_draws
from pmcl.simulations.aibo import simulate_aibo
from pmcl.simulations.amigobot import simulate_amigobot

SEED = 20060716
SIMULATORS = {"amigobot": simulate_amigobot, "aibo": simulate_aibo}
# Robots unlike the prior means (0.05 m, 0.03 m, 0.05 rad; 0.1 m; 0.1 rad, 0.2): firm on their feet, poor at turning.
TRUTH = {
    "amigobot": {"sigma_forward": 0.02, "sigma_left": 0.01, "sigma_turn": 0.1, "sigma_range": 0.04},
    "aibo": {
        "sigma_forward": 0.02, "sigma_left": 0.015, "sigma_turn": 0.1, "sigma_bearing": 0.03, "sigma_size": 0.3,
    },
}  # fmt: skip
LONGEST = {"amigobot": 2000, "aibo": 1000}
RUNS = [
    {"robot": "amigobot", "seconds": 400, "kernel": "conditional", "particles": 25, "draws": 1000},
    {"robot": "amigobot", "seconds": 2000, "kernel": "conditional", "particles": 25, "draws": 1000},
    {"robot": "amigobot", "seconds": 400, "kernel": "smoothing", "particles": 500, "draws": 400},
    {"robot": "aibo", "seconds": 400, "kernel": "conditional", "particles": 25, "draws": 1000},
    {"robot": "aibo", "seconds": 1000, "kernel": "conditional", "particles": 25, "draws": 1000},
]
SMALL = [
    {"robot": "amigobot", "seconds": 40, "kernel": "conditional", "particles": 10, "draws": 60},
    {"robot": "amigobot", "seconds": 200, "kernel": "conditional", "particles": 10, "draws": 60},
]


def calibrate(robot: str, seconds: int, kernel: str, particles: int, draws: int) -> dict[str, np.ndarray]:
    """Calibrate on the first `seconds` of a robot's long drive."""
    truth = TRUTH[robot]
    drive = SIMULATORS[robot](float(LONGEST[robot]), SEED, truth)
    log = drive.select(0, seconds)
    begin = time.process_time()
    # The start is known, so that few particles are enough for burn-in.
    data = pmcl.calibrate(
        log,
        method=pmcl.ParticleGibbs(
            kernel=kernel,
            particles=particles,
            sweeps_per_draw=1 if kernel == "smoothing" else 2,
            burn_in_particles=200,
        ),
        draws=draws,
        seed=SEED + 1,
        check=False,
    )
    return {
        "theta": theta_draws(data).astype(np.float32),
        "truth": np.array(list(truth.values())),
        "names": np.array(list(truth)),
        "particles": np.array(particles),
        "cpu_seconds": np.array(time.process_time() - begin),
        "seeds": np.array([SEED, SEED + 1]),
    }


def main() -> None:
    """Compute the runs that are missing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--small", action="store_true", help="seconds instead of minutes, for the tests")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent, help="folder of the results")
    arguments = parser.parse_args()
    runs = SMALL if arguments.small else RUNS
    for run in runs:
        path = arguments.output / f"{run['robot']}_{run['seconds']}_{run['kernel']}.npz"
        if path.exists():
            continue
        result = calibrate(**run)
        np.savez_compressed(path, **result)
        print(f"{path.name}: {float(result['cpu_seconds']):.0f} CPU seconds", flush=True)


if __name__ == "__main__":
    main()
