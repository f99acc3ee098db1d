"""Every calibration method on simulated and recorded logs, and how often each holds the truth.

    python run.py                                  # adds what results.csv lacks: hours for all logs
    python run.py --logs "landmarks 400" --methods conditional,ekf --seconds 20
    python run.py --coverage 50                    # adds logs to coverage.csv until there are so many
    python run.py --judge 3000                     # NUTS against conditional SMC with transport moves, into judge.csv
    python run.py --small --output FOLDER

Rows are written as they are made, so that a run can be stopped and gone on with. Each log's last quarter is held out.
A reference, a long run of conditional SMC with transport moves, is made once for each log and kept in references.json.
Results: results.csv has a row for each log and method; means.csv its means, for each parameter; coverage.csv a row for
each simulated log, method and parameter, whose truth was drawn from the prior; judge.csv the means of both judges.
"""

import argparse
import contextlib
import csv
import json
import math
import os
from pathlib import Path

import arviz
import numpy as np

from pmcl.comparison.curves import Reference, learning_curve, reference_of
from pmcl.comparison.held_out import held_out_worth, peak_memory
from pmcl.comparison.methods import draw, parse_methods
from pmcl.errors import PmclError
from pmcl.logs.mrclam import read_mrclam
from pmcl.models.robot_model import default_model
from pmcl.sampling.chains import PointEstimate
from pmcl.sampling.options import RunOptions
from pmcl.sampling.stopwatch import Stopwatch
from pmcl.simulations import simulate_aibo, simulate_amigobot, simulate_landmark_field

DATA = Path(os.environ.get("PMCL_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
AMIGOBOT = {"sigma_forward": 0.02, "sigma_left": 0.01, "sigma_turn": 0.1, "sigma_range": 0.04}
LOGS = {
    "landmarks 400": lambda: simulate_landmark_field(400, seed=0),
    "Amigobot 400": lambda: simulate_amigobot(400.0, seed=20060716, theta=AMIGOBOT),
    "AIBO 400": lambda: simulate_aibo(400.0, seed=20060716),
    "Create 1": lambda: read_mrclam(DATA / "mrclam6", 1, 0.5),
    "Create 2": lambda: read_mrclam(DATA / "mrclam6", 2, 0.5),
    "landmarks 2000": lambda: simulate_landmark_field(2000, seed=0),
    "Amigobot 2000": lambda: simulate_amigobot(2000.0, seed=20060716, theta=AMIGOBOT),
}
METHODS = (
    "conditional,plain,smoothing,ekf,ukf,least-squares,em,optimiser,liu-west,storvik,ensemble,ensemble-de,pmmh,"
    "correlated-pmmh,bootstrap-ensemble,bootstrap-pmmh,marginal-gibbs,andrews,nuts,prior,truth"
)
COVERED = "conditional,ekf,least-squares,storvik,liu-west,em"
CHAINS, SEED, HELD_OUT, LEVEL = 4, 4, 0.25, 0.9


def run(bound, method, seconds, seed):
    """Return what a method found, its clock and its memory, or the reason why it found nothing."""
    with contextlib.suppress(PmclError):  # the run that counts says it
        method.method.shortest().run(bound, RunOptions(draws=4, chains=2, trajectories=1))  # compiles
    stopwatch = Stopwatch(seconds)
    try:
        with peak_memory() as peak:
            found = draw(method, bound, CHAINS, seed, stopwatch)
    except PmclError as error:
        return None, stopwatch, math.nan, str(error).replace(f"{DATA}{os.sep}", "")  # of this machine
    stopwatch.stop()
    return found, stopwatch, peak.value, ""


def add(path, rows):
    """Append rows to a CSV file."""
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]), lineterminator="\n")
        if new:
            writer.writeheader()
        writer.writerows(rows)


def read(path):
    """Return the rows of a CSV file, none where there is no file."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def reference(folder, name, bound, seconds):
    """Return the reference of a log, made at the first time."""
    path = folder / "references.json"
    known = json.loads(path.read_text()) if path.exists() else {}
    if name not in known:
        method = parse_methods("conditional:50")[0]
        found, stopwatch, _, why = run(bound, method, 2.0 * seconds, SEED + 1000)
        if found is None:
            raise SystemExit(f"{name}: {why}")
        made = reference_of(found.theta)
        known[name] = {"names": bound.names, "mean": made.mean.tolist(), "sd": made.sd.tolist(), "error": made.error,
                       "r_hat": made.r_hat, "ess": made.ess, "seconds": stopwatch.seconds}  # fmt: skip
        path.write_text(json.dumps(known, indent=1) + "\n")
    found = known[name]
    return Reference(np.array(found["mean"]), np.array(found["sd"]), found["error"], found["r_hat"], found["ess"])


def compare(folder, name, log, methods, seconds):
    """Add what is missing of one log."""
    done = {(row["log"], row["method"]) for row in read(folder / "results.csv")}
    missing = [method for method in parse_methods(methods) if (name, method.name) not in done]
    if not missing:
        return
    model, split = default_model(log), log.n_steps - round(HELD_OUT * log.n_steps)
    bound = model.bind(log.select(0, split))
    truth = None
    if log.true_theta and set(bound.names) <= set(log.true_theta):
        truth = np.array([log.true_theta[each] for each in bound.names])
    against = reference(folder, name, bound, seconds)
    for method in missing:
        found, stopwatch, memory, why = run(bound, method, seconds, SEED)
        row = dict.fromkeys(
            ("log", "method", "chains", "draws", "seconds", "burn_in_cpu", "cpu", "r_hat", "ess", "ess_per_cpu_second",
             "error", "error_of_truth", "memory", "log_score", "log_score_error", "position_error", "failure"), ""
        )  # fmt: skip
        row |= {"log": name, "method": method.name, "failure": why}
        if found is not None:
            chains = found.as_chains() if isinstance(found, PointEstimate) else found
            times = stopwatch.draw_times(chains.n_draws)
            curve = learning_curve(chains.theta, np.array(times.wall), np.array(times.cpu), against, truth)
            mean = chains.theta.mean(axis=(0, 1))
            worth = held_out_worth(log, model, dict(zip(bound.names, mean.tolist(), strict=True)), split, SEED)
            rate = curve.ess[-1] / max(curve.cpu[-1] - times.burn_in_cpu, 1e-9)
            numbers = {"chains": chains.n_chains, "draws": chains.n_draws, "seconds": stopwatch.seconds,
                       "burn_in_cpu": times.burn_in_cpu, "cpu": stopwatch.cpu_seconds, "r_hat": curve.r_hat[-1],
                       "ess": curve.ess[-1], "ess_per_cpu_second": rate, "error": curve.error[-1],
                       "error_of_truth": curve.error_of_truth[-1], "memory": memory, **worth._asdict()}  # fmt: skip
            row |= {key: f"{value:.5g}" for key, value in numbers.items()}
            spread = found.standard_error if isinstance(found, PointEstimate) else chains.theta.std(axis=(0, 1))
            spread = np.full(mean.size, np.nan) if spread is None else spread
            add(folder / "means.csv", [
                {"log": name, "method": method.name, "parameter": each, "mean": f"{m:.6g}", "sd": f"{s:.6g}",
                 "truth": "" if truth is None else f"{truth[k]:.6g}"}
                for k, (each, m, s) in enumerate(zip(bound.names, mean, spread, strict=True))
            ])  # fmt: skip
        add(folder / "results.csv", [row])
        print(name, method.name, row["r_hat"], row["ess_per_cpu_second"], row["error"], why, flush=True)


def cover(folder, count, methods, seconds, rows):
    """Add simulated logs with truths drawn from the prior, and whether each method's 90 % interval holds them."""
    done = {(row["seed"], row["method"]) for row in read(folder / "coverage.csv")}
    for seed in range(count):
        plain = default_model(simulate_landmark_field(rows, seed=0)).parameters
        rng = np.random.default_rng((seed, 5))
        truth = {parameter.name: float(parameter.prior.rvs(random_state=rng)) for parameter in plain}
        log = simulate_landmark_field(rows, seed=seed, theta=truth)
        bound = default_model(log).bind(log)
        for method in parse_methods(methods):
            if (str(seed), method.name) in done:
                continue
            found, _, _, why = run(bound, method, seconds, seed)
            made = []
            for k, name in enumerate(bound.names):
                place = ""
                if isinstance(found, PointEstimate) and found.standard_error is not None:
                    # A Gaussian of the logarithm, as a noise is positive.
                    z = (math.log(truth[name]) - math.log(found.theta[k])) * found.theta[k] / found.standard_error[k]
                    place = f"{0.5 * math.erfc(-z / math.sqrt(2.0)):.5f}"
                elif found is not None and not isinstance(found, PointEstimate):
                    place = f"{float(np.mean(found.theta[..., k] < truth[name])):.5f}"
                holds = "" if not place else int(abs(float(place) - 0.5) <= 0.5 * LEVEL)
                made.append({"seed": seed, "method": method.name, "parameter": name, "truth": f"{truth[name]:.5g}",
                             "share_below": place, "holds": holds, "failure": why})  # fmt: skip
            add(folder / "coverage.csv", made)


def judge(folder, log, methods):
    """Add the means of exact methods that share no code, with their Monte Carlo errors."""
    bound = default_model(log).bind(log)
    for method, budget in methods.items():
        found, stopwatch, _, why = run(bound, parse_methods(method)[0], budget, SEED)
        if found is None:
            raise SystemExit(f"{method}: {why}")
        made = []
        for k, name in enumerate(bound.names):
            draws = found.theta[..., k]
            error, ess, r_hat = (
                float(np.squeeze(number))
                for number in (arviz.mcse(draws, method="mean"), arviz.ess(draws), arviz.rhat(draws))
            )
            made.append({
                "method": method, "parameter": name, "mean": f"{draws.mean():.6g}", "sd": f"{draws.std():.6g}",
                "error": f"{error:.3g}", "ess": f"{ess:.5g}", "r_hat": f"{r_hat:.5f}",
                "cpu": f"{stopwatch.cpu_seconds:.5g}",
            })  # fmt: skip
        add(folder / "judge.csv", made)


def main():
    """Add what is missing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", default=",".join(LOGS), help="names of logs, separated by commas")
    parser.add_argument("--methods", default="", help="methods as for 'pmcl compare'")
    parser.add_argument("--seconds", type=float, default=60.0, help="of each method")
    parser.add_argument("--coverage", type=int, default=0, help="number of simulated logs; no other comparison then")
    parser.add_argument("--judge", type=float, default=0.0, help="seconds of NUTS; no other comparison then")
    parser.add_argument("--rows", type=int, default=60, help="rows of each log of --coverage")
    parser.add_argument("--small", action="store_true", help="seconds instead of hours, for the tests")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent, help="folder of the results")
    given = parser.parse_args()
    if given.small:
        log = simulate_landmark_field(60, seed=0)
        compare(given.output, "landmarks 60", log, "conditional,least-squares,prior", 1.0)
        cover(given.output, 2, "conditional,least-squares", 0.5, 30)
        judge(given.output, log, {"conditional": 0.5, "ekf": 0.5})
    elif given.judge:
        judge(given.output, LOGS["landmarks 400"](), {"conditional": 60.0, "nuts": given.judge})
    elif given.coverage:
        cover(given.output, given.coverage, given.methods or COVERED, given.seconds, given.rows)
    else:
        for name in given.logs.split(","):
            compare(given.output, name, LOGS[name](), given.methods or METHODS, given.seconds)


if __name__ == "__main__":
    main()
