"""Global localization and calibration on two recordings of Wean Hall, of which nobody knows where the robot was.

Recording 1 is localized from anywhere on the map, which tells where it began; from there it is calibrated. Recording 2
is then localized with what recording 1 told, and with three other choices of the parameters. From the repository's
root, twenty minutes on one core:

    python analyses/wean_hall/run.py

starts.csv holds a row for each filter that began anywhere, posterior.csv draws from the posterior, paths.csv the
tracks, and scores.csv a row for each filter that began where the robot did; files that are there are not computed
again. The recordings are looked for in PMCL_DATA, by default shared/data beside the repository.
"""

from __future__ import annotations

import argparse
import csv
import math
import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

import pmcl
from pmcl.localization import localize_many, with_found_start
from pmcl.localization.options import FilterOptions
from pmcl.logs.wean import read_wean
from pmcl.maps.wean import read_wean_map

DATA = Path(os.environ.get("PMCL_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
FREE_AREA = 483.3  # where a robot can be on the map [m^2]
TRIES = 5  # from anywhere, to find where a recording begins
NEAR = 1.0  # a filter has found the robot when its mean is this near to where the robot was [m]
# What people give to AMCL without calibration, in pmcl's terms: nav2's defaults, whose z_hit and z_rand of 0.5 weigh a
# hit that is not normalised, and values tuned by hand.
GUESSES = {
    "nav2": {**{f"alpha{k}": 0.2 for k in range(1, 5)}, "sigma_hit": 0.2,
             "z_rand": 1.0 / (1.0 + 0.2 * math.sqrt(2.0 * math.pi))},
    "hand": {**{f"alpha{k}": 0.1 for k in range(1, 5)}, "sigma_hit": 0.1, "z_rand": 0.4},
    "prior": {},
}  # fmt: skip


class Sizes(NamedTuple):
    duration: float | None = None  # of each recording [s]
    starts: int = 100
    densities: tuple[int, ...] = (1, 2, 5, 10, 20, 50)  # particles for each square metre
    draws: int = 2500
    chains: int = 4
    particles: int = 100
    repetitions: int = 40


SMALL = Sizes(60.0, 4, (2, 50), 20, 2, 10, 3)


def recording(number, sizes):
    """Return a recording on its map, with nothing known about where it begins."""
    grid = read_wean_map(DATA / "wean" / "wean.dat.gz")
    return read_wean(DATA / "wean" / f"robotdata{number}.log", grid_map=grid, duration=sizes.duration)


def started(log):
    """Return the log with the first pose that the whole of it tells: of several tries, the one that fits it best.

    With the prior mean, whose wide noise forgives what the map does not hold.
    """
    tries = []
    for seed in range(TRIES):
        track = pmcl.localize(log, method="prior", seed=seed, options=FilterOptions(recover=True))
        known = with_found_start(log, track, method="prior", seed=seed)
        score = pmcl.localize(known, method="prior", seed=seed).log_score.sum()
        print(f"{log.source}, try {seed}: begins at {known.start_mean.round(2)}, log score {score:.1f} nat")
        tries.append((score, seed, known))
    return max(tries)[2]


def away(poses, path):
    """Distance of poses (..., T, 3) from those of a path (T, 3) [m]."""
    return np.hypot(*np.moveaxis(poses[..., :2] - path[:, :2], -1, 0))


def write(path, fields, rows):
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(fields)
        writer.writerows([f"{value:.6g}" if isinstance(value, float) else value for value in row] for row in rows)


def calibrate(path, log, sizes):
    """Calibrate a recording of which is known where it began; store some draws."""
    data = pmcl.calibrate(
        log, method=pmcl.ParticleGibbs(particles=sizes.particles), draws=sizes.draws, chains=sizes.chains,
        seed=1,
    )  # fmt: skip
    print(pmcl.verdict(data).message)
    names = list(data["posterior"].data_vars)
    draws = np.stack([data["posterior"][name].values.ravel() for name in names], axis=-1)
    write(path, names, draws[:: max(1, len(draws) // 1000)].tolist())


def known_paths(path, logs, known, calibrated):
    """Localize both recordings from where they began, and the first from anywhere; store the tracks."""
    rows = []
    for number, log in logs.items():
        tracks = {"from the start": pmcl.localize(known[number], method="prior", theta=calibrated, seed=1)}
        tracks["from anywhere"] = pmcl.localize(
            log, method="prior", theta=calibrated, seed=1, options=FilterOptions(recover=True)
        )
        for name, track in tracks.items():
            spread = np.sqrt(track.pose_cov[:, 0, 0] + track.pose_cov[:, 1, 1])
            particles = track.dataset["particles"].values
            columns = zip(track.times, track.pose_mean, spread, particles, strict=True)
            rows += [(number, name, float(t), *map(float, pose), float(s), int(n)) for t, pose, s, n in columns]
    write(path, ("recording", "track", "time", "x", "y", "heading", "spread", "particles"), rows)


def starts(path, logs, paths, choices, sizes):
    """Begin anywhere, again and again: with few and with many particles, with and without recovery, each choice."""
    cases = [(1, "prior", density, False) for density in sizes.densities]
    most = sizes.densities[-1]
    cases += [(2, choice, most, recover) for choice in choices for recover in (False, True)]
    rows = []
    for number, choice, density, recover in cases:
        options = FilterOptions(start_particles=max(500, round(density * FREE_AREA)), recover=recover)
        runs = localize_many(
            logs[number], method="prior", theta=choices[choice], repetitions=sizes.starts, seed=2, options=options
        )
        found = away(runs.pose_mean, paths[number]) < NEAR
        print(f"recording {number}, {choice}, {density} per m^2, recover {recover}: {found[:, -1].mean():.2f} found")
        rows += [(number, choice, density, int(recover), int(one[-1]), float(one.mean())) for one in found]
    write(path, ("recording", "choice", "per_square_metre", "recover", "found", "share_of_rows"), rows)


def scores(path, known, choices, sizes):
    """Localize both recordings from where they began, with each choice of the parameters."""
    rows = []
    for number, log in known.items():
        for choice, theta in choices.items():
            runs = localize_many(log, method="prior", theta=theta, repetitions=sizes.repetitions, seed=3)
            rows += [(number, choice, float(score) / log.n_steps) for score in runs.log_evidence]
    write(path, ("recording", "choice", "log_score_per_row"), rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--small", action="store_true", help="a minute instead of twenty")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent, help="folder of the results")
    arguments = parser.parse_args()
    sizes, folder = SMALL if arguments.small else Sizes(), arguments.output
    files = {name: folder / f"{name}.csv" for name in ("posterior", "paths", "starts", "scores")}
    if all(path.exists() for path in files.values()):
        return
    logs = {number: recording(number, sizes) for number in (1, 2)}
    known = {number: started(log) for number, log in logs.items()}
    if not files["posterior"].exists():
        calibrate(files["posterior"], known[1], sizes)
    with files["posterior"].open(newline="") as stream:
        draws = list(csv.DictReader(stream))
    calibrated = {name: float(np.mean([float(draw[name]) for draw in draws])) for name in draws[0]}
    choices = {**GUESSES, "calibrated": calibrated}
    if not files["paths"].exists():
        known_paths(files["paths"], logs, known, calibrated)
    with files["paths"].open(newline="") as stream:
        track = [row for row in csv.DictReader(stream) if row["track"] == "from the start"]
    paths = {
        number: np.array([[float(row["x"]), float(row["y"])] for row in track if int(row["recording"]) == number])
        for number in logs
    }
    if not files["starts"].exists():
        starts(files["starts"], logs, paths, choices, sizes)
    if not files["scores"].exists():
        scores(files["scores"], known, choices, sizes)


if __name__ == "__main__":
    main()
