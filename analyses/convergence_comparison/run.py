"""Convergence against time: particle Gibbs with both kernels at several n, and emcee's ensemble, on one Amigobot log.

    python run.py            # about a quarter of an hour; a finished comparison is not computed again
    python run.py --small --output FOLDER

It is what `pmcl compare` does, stored as numbers: curves.csv (each method at growing numbers of draws), methods.csv
(what each had reached in the end) and means.csv (where its means ended, and the reference's).
"""

import argparse
import csv
import sys
from pathlib import Path

from pmcl.comparison.compare import Comparison, compare
from pmcl.reports.comparison_report import expected_error
from pmcl.simulations.amigobot import simulate_amigobot

LOG_SEED, SEED = 20060716, 4
TRUTH = {"sigma_forward": 0.02, "sigma_left": 0.01, "sigma_turn": 0.1, "sigma_range": 0.04}
METHODS = (
    "conditional:10,conditional:25,conditional:100,plain:25,"
    "smoothing:25,smoothing:100,smoothing:500,ensemble:100,ensemble-de:100,bootstrap-ensemble:200"
)


def write(path: Path, rows: list[dict]) -> None:
    """Write rows as CSV."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def store(comparison: Comparison, folder: Path) -> None:
    """Write what the notebook shows."""
    reference = comparison.reference
    curves, methods, means = [], [], []
    for result in comparison.results:
        for point in zip(*result.curve, strict=True):
            values = dict(zip(result.curve._fields, point, strict=True))
            curves.append({"method": str(result.method)} | {name: f"{value:.6g}" for name, value in values.items()})
        methods.append(
            {
                "method": str(result.method),
                "chains": result.chains,
                "draws": result.draws,
                "burn_in_seconds": f"{result.burn_in:.2f}",
                "burn_in_cpu_seconds": f"{result.burn_in_cpu:.2f}",
                "wall_seconds": f"{result.curve.wall[-1]:.2f}",
                "cpu_seconds": f"{result.curve.cpu[-1]:.2f}",
                "r_hat": f"{result.curve.r_hat[-1]:.4f}",
                "ess": f"{result.curve.ess[-1]:.1f}",
                "ess_per_cpu_second": f"{result.ess_per_cpu_second:.3g}",
                "error": f"{result.curve.error[-1]:.4f}",
                "expected_error": f"{expected_error(comparison, result):.4f}",
                "error_of_truth": f"{result.curve.error_of_truth[-1]:.4f}",
            }
        )
        for name, mean, sd in zip(comparison.names, result.mean, result.sd, strict=True):
            means.append({"method": str(result.method), "parameter": name, "mean": f"{mean:.6g}", "sd": f"{sd:.6g}"})
    for name, mean, sd in zip(comparison.names, reference.mean, reference.sd, strict=True):
        means.append({"method": "reference", "parameter": name, "mean": f"{mean:.6g}", "sd": f"{sd:.6g}"})
    methods.append(
        {"method": "reference", "chains": comparison.chains, "wall_seconds": f"{comparison.reference_seconds:.2f}"}
        | {"r_hat": f"{reference.r_hat:.4f}", "ess": f"{reference.ess:.1f}", "error": f"{reference.error:.4f}"}
    )
    write(folder / "curves.csv", curves)
    write(folder / "means.csv", means)
    write(folder / "methods.csv", methods)


def main() -> None:
    """Compare, unless that was done before."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--small", action="store_true", help="seconds instead of minutes, for the tests")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent, help="folder of the results")
    arguments = parser.parse_args()
    if (arguments.output / "methods.csv").exists():
        return
    if arguments.small:
        log, methods, seconds = simulate_amigobot(20.0, LOG_SEED, TRUTH), "conditional:10,smoothing:10,ensemble:50", 2.0
    else:
        log, methods, seconds = simulate_amigobot(400.0, LOG_SEED, TRUTH), METHODS, 60.0
    store(compare(log, methods, seconds=seconds, seed=SEED, progress=sys.stderr.isatty()), arguments.output)


if __name__ == "__main__":
    main()
