"""The paper's two details: m Metropolis rounds for each new trajectory, and r rows of data added in each sweep.

    python run.py            # about ten minutes on one core; what is there already is not computed again
    python run.py --small --output FOLDER

The sampler is the paper's: the smoothing kernel, one parameter at a time, no transport moves. Chains start from the
prior with the first r rows; each sweep adds r more until all are in. Steps of the Metropolis proposals adapt for 50
sweeps after that, and are then frozen.

curves.csv holds R-hat of the worst parameter over the second half of all sweeps so far, burn-in included, as someone
who watches the run would compute it. settings.csv has a row for each run: how soon it settled, and what it gave then.
"""

import argparse
import csv
import time
from collections.abc import Callable
from pathlib import Path

import emcee
import numpy as np
from emcee.state import State

from pmcl.models.robot_model import default_model
from pmcl.posterior.compat import bulk_ess, r_hat
from pmcl.sampling.move import ParticleGibbsMove
from pmcl.sampling.state import into_blob
from pmcl.sampling.sweep import SweepSettings, start_chain
from pmcl.simulations.amigobot import simulate_amigobot

TRUTH = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.05, "sigma_range": 0.08}
SEEDS = (11, 12, 13)  # of the logs; the chains' seeds follow from them
FULL = {"rows": 400, "particles": 50, "chains": 6, "sweeps": 700, "m": (1, 2, 5, 10, 30), "r": (2, 8, 40, 400)}
SMALL = {"rows": 30, "particles": 20, "chains": 3, "sweeps": 60, "m": (1, 10), "r": (3, 30)}
USUAL_M, USUAL_R = 5, 8
ADAPTING = 50
GOOD, POINTS = 1.1, 30
GAIN = 0.05


def forbidden(theta: np.ndarray) -> float:
    """Stand in for a density that emcee never asks for: the move has its own."""
    raise AssertionError


def chains(log_seed: int, m: int, r: int, settings: dict) -> dict[str, np.ndarray]:
    """Run chains from the prior on; return every state and the time of each sweep."""
    log = simulate_amigobot(float(settings["rows"]), log_seed, TRUTH)
    bound = default_model(log).bind(log)
    shared = {"kernel": "smoothing", "particles": settings["particles"], "metropolis_steps": m, "transport_moves": 0}
    seeds = np.random.SeedSequence([log_seed, m, r]).generate_state(settings["chains"] + 1)
    starting = SweepSettings(**shared, data_rate=r)
    first = [start_chain(bound, starting, int(seed)) for seed in seeds[:-1]]
    adapting = ParticleGibbsMove(bound, **shared, data_rate=r, gain=GAIN)
    frozen = ParticleGibbsMove(bound, **shared)
    state = State(
        np.array([start.state.theta for start in first]),
        log_prob=np.array([start.state.log_joint for start in first]),
        blobs=np.array([into_blob(start.state, start.info, adapting.dtype) for start in first], dtype=adapting.dtype),
        random_state=np.random.RandomState(int(seeds[-1])).get_state(),
    )
    including = -(-settings["rows"] // r) - 1 + ADAPTING
    theta, rows, spent = [], [], []
    for move, sweeps in ((adapting, including), (frozen, settings["sweeps"])):
        sampler = emcee.EnsembleSampler(len(first), bound.dimension, forbidden, moves=[move])
        before = time.process_time()
        for after in sampler.sample(state, iterations=sweeps, skip_initial_state_check=True, store=False):
            spent.append(time.process_time() - before)
            theta.append(after.coords.copy())
            rows.append(int(after.blobs["rows"].min()))
            state, before = after, time.process_time()
    return {
        "theta": np.swapaxes(np.array(theta), 0, 1),
        "rows": np.array(rows),
        "cpu_seconds": np.array(spent),
        "frozen_from": np.array(including),
    }


def worst(measure: Callable[[np.ndarray], float], theta: np.ndarray) -> float:
    """Return R-hat or the effective sample size of the parameter where it is worst."""
    values = [measure(np.ascontiguousarray(theta[..., k], dtype=float)) for k in range(theta.shape[-1])]
    return max(values) if measure is r_hat else min(values)


def measured(run: dict[str, np.ndarray], key: dict[str, int]) -> tuple[list[dict], dict]:
    """Return the points of a curve, and what the run comes to."""
    theta, seconds = run["theta"], np.cumsum(run["cpu_seconds"])
    sweeps = np.unique(np.geomspace(16, theta.shape[1], POINTS).astype(int))
    hats = np.array([worst(r_hat, theta[:, n // 2 : n]) for n in sweeps])
    curve = [
        key | {"sweeps": int(n), "r_hat": f"{hat:.5g}", "cpu_seconds": f"{seconds[n - 1]:.4g}"}
        for n, hat in zip(sweeps, hats, strict=True)
    ]
    bad = np.flatnonzero(~(hats <= GOOD))
    good = bad[-1] + 1 if bad.size else 0
    begin = int(run["frozen_from"])
    settled = theta[:, begin + (theta.shape[1] - begin) // 4 :]
    spent = run["cpu_seconds"][-settled.shape[1] :].sum()
    ess = worst(bulk_ess, settled)
    complete = int(np.argmax(run["rows"] == run["rows"].max()))
    return curve, key | {
        "chains": theta.shape[0],
        "settled_sweeps": settled.shape[1],
        "ess": f"{ess:.1f}",
        "ess_per_cpu_second": f"{ess / spent:.4g}",
        "cpu_ms_per_sweep": f"{1e3 * spent / settled.shape[1] / theta.shape[0]:.3g}",
        "moved": f"{np.mean(np.diff(settled, axis=1) != 0.0):.4f}",
        "sweeps_until_complete": complete + 1,
        "cpu_seconds_until_complete": f"{seconds[complete]:.4g}",
        "sweeps_until_good": int(sweeps[good]) if good < sweeps.size else "",
        "cpu_seconds_until_good": f"{seconds[sweeps[good] - 1]:.4g}" if good < sweeps.size else "",
    }


def append(path: Path, rows: list[dict]) -> None:
    """Add rows to a CSV file."""
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]), lineterminator="\n")
        if file.tell() == 0:
            writer.writeheader()
        writer.writerows(rows)


def done(path: Path) -> set[tuple[int, int, int]]:
    """Return which runs are stored."""
    if not path.exists():
        return set()
    with path.open(newline="") as file:
        return {(int(row["m"]), int(row["r"]), int(row["log"])) for row in csv.DictReader(file)}


def main() -> None:
    """Compute the settings that are missing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--small", action="store_true", help="seconds instead of minutes, for the tests")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent, help="folder of the results")
    arguments = parser.parse_args()
    settings = SMALL if arguments.small else FULL
    usual = SMALL["r"][0] if arguments.small else USUAL_R
    pairs = dict.fromkeys([(m, usual) for m in settings["m"]] + [(USUAL_M, r) for r in settings["r"]])
    present = done(arguments.output / "settings.csv")
    for log_seed in SEEDS[:1] if arguments.small else SEEDS:
        for m, r in pairs:
            if (m, r, log_seed) in present:
                continue
            curve, summary = measured(chains(log_seed, m, r, settings), {"m": m, "r": r, "log": log_seed})
            append(arguments.output / "curves.csv", curve)
            append(arguments.output / "settings.csv", [summary])
            print(summary, flush=True)


if __name__ == "__main__":
    main()
