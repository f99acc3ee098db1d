"""Figure 1 of the paper: posterior samples of the Amigobot's noise parameters from 400 s and from 2000 s of one drive.

    python run.py            # about five minutes on one core; what is there already is not computed again
    python run.py --small --output FOLDER

Each run is one file: draws_<seconds>_<kernel>.npz with the draws (chain, draw, parameter), the true values and seeds.
The 400 s are the beginning of the 2000 s. The longer drive is calibrated with the exact kernel only: the paper's, with
500 particles, takes five times as long for it as for the shorter one, and mixes more slowly.
"""

import argparse
import time
from pathlib import Path

import numpy as np

import pmcl
from pmcl.posterior.access import theta_draws
from pmcl.robots.amigobot import simulate_amigobot

SEED = 20060716
# A robot unlike the prior means of 0.05 m, 0.03 m, 0.05 rad, 0.1 m: firm on its wheels, poor at turning, sharp-sighted.
TRUTH = {"sigma_forward": 0.02, "sigma_left": 0.01, "sigma_turn": 0.1, "sigma_range": 0.04}
RUNS = [
    {"seconds": 400, "kernel": "conditional", "particles": 25, "draws": 1000},
    {"seconds": 2000, "kernel": "conditional", "particles": 25, "draws": 1000},
    {"seconds": 400, "kernel": "smoothing", "particles": 500, "draws": 400},
]
SMALL = [
    {"seconds": 40, "kernel": "conditional", "particles": 10, "draws": 60},
    {"seconds": 200, "kernel": "conditional", "particles": 10, "draws": 60},
]


def calibrate(longest: int, seconds: int, kernel: str, particles: int, draws: int) -> dict[str, np.ndarray]:
    """Calibrate on the first `seconds` of a drive of `longest` seconds."""
    drive = simulate_amigobot(float(longest), SEED, TRUTH)
    log = drive.select(0, seconds)
    begin = time.process_time()
    # The drive is the Amigobot's own: the start is known, so that few particles are enough for burn-in.
    data = pmcl.calibrate(
        log,
        kernel=kernel,
        particles=particles,
        draws=draws,
        sweeps_per_draw=1 if kernel == "smoothing" else 2,
        burn_in_particles=200,
        seed=SEED + 1,
    )
    return {
        "theta": theta_draws(data).astype(np.float32),
        "truth": np.array(list(TRUTH.values())),
        "names": np.array(list(TRUTH)),
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
    longest = max(run["seconds"] for run in runs)
    for run in runs:
        path = arguments.output / f"draws_{run['seconds']}_{run['kernel']}.npz"
        if path.exists():
            continue
        result = calibrate(longest, **run)
        np.savez_compressed(path, **result)
        print(f"{path.name}: {float(result['cpu_seconds']):.0f} CPU seconds", flush=True)


if __name__ == "__main__":
    main()
