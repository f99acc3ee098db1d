"""Sum of cubes, product, tempered product: how should the beams of a scan be combined?

The same filter with the same numbers, and only the way in which beams are combined differs. Two sets of numbers: nav2's
defaults, and those calibrated on another log of the same robot. The start is stated with an error, which is as large as
the filter is told: as by a person who clicks on a map, where a robot may be lost, or within 0.1 m. The first rows, in
which the filter finds itself, do not count.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np
from held_out import CALIBRATION, DEFAULTS, MARGIN, calibrated
from judge import LOST, REFERENCE, ellipse_radius, errors, log_density_of_truth
from nav2_filter import CUBES, PRODUCT, Settings, grid_of_nav2, run_filter
from recordings import jarvis, rooms_log, wean, wean_reference, with_scans
from results import Table

from pmcl.models.sensors.lidar.table import cell_noise

BEAMS = 60
COLUMNS = ("log", "start", "numbers", "rule", "worth", "seed", "position_rmse", "position_worst", "heading_rmse",
           "coverage_95", "lost", "truth", "radius", "particles", "ignored")  # fmt: skip
REFERENCE_COLUMNS = ("log", "row", "x", "y", "heading", "xx", "xy", "yy", "aa")
STARTS = {"clicked": np.array([0.5, 0.5, 0.26]), "known": np.array([0.1, 0.1, 0.1])}
"""Standard deviations of the stated start [m, m, rad]: what RViz states of a pose that was clicked, and where a person
can put a robot down."""
MANY = "product, 20 000 particles"
FOUND_AFTER = 5
"""Rows that do not count."""


class Case(NamedTuple):
    """A log that filters are judged on.

    `calibration` names the log that its numbers come from. `known` (T, 3, 3) is the covariance of `truth` (T, 3), and
    `lost` the distance [m] from it at the end that means a lost robot.
    """

    name: str
    log: object
    truth: np.ndarray
    known: np.ndarray
    lost: float
    calibration: str


def references(folder: Path, particles: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return the reference of each Wean recording, computed where it is not stored."""
    path = folder / "wean_reference.csv"
    table = Table(path, REFERENCE_COLUMNS, 2)
    for number in "1", "2":
        if not table.knows(number, 0):
            mean, covariance = wean_reference(number, particles)
            for t, (pose, c) in enumerate(zip(mean, covariance, strict=True)):
                table.add(number, t, *(float(v) for v in pose), c[0, 0], c[0, 1], c[1, 1], c[2, 2])
    found = {}
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    for number in "1", "2":
        mine = [row for row in rows if row["log"] == number]
        mean = np.array([[float(row[k]) for k in ("x", "y", "heading")] for row in mine])
        covariance = np.zeros((len(mine), 3, 3))
        for t, row in enumerate(mine):
            covariance[t, :2, :2] = [[float(row["xx"]), float(row["xy"])], [float(row["xy"]), float(row["yy"])]]
            covariance[t, 2, 2] = float(row["aa"])
        found[number] = mean, covariance
    return found


def numbers_of(folder: Path, name: str, kind: str, resolution: float) -> dict[str, float]:
    """Return the posterior means of a calibration; `hit` is sigma_hit with what the cells of the map hide."""
    with (folder / "calibrations.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["log"] == name and row["kind"] == kind]
    found = {row["parameter"]: float(row["mean"]) for row in rows}
    return found | {"hit": float(np.hypot(found["sigma_hit"], cell_noise(resolution)))} if found else {}


def with_numbers(numbers: dict[str, float], reach: float, **changes) -> Settings:
    """Return settings with calibrated numbers, in their own meaning: a normalised hit."""
    return Settings(
        alphas=tuple(numbers[f"alpha{k}"] for k in (1, 2, 3, 4)), sigma_hit=numbers["hit"],
        z_hit=1.0 - numbers["z_rand"], z_rand=numbers["z_rand"], laser_max_range=reach, max_beams=BEAMS,
        **{"rule": PRODUCT, "beluga": True, **changes},
    )  # fmt: skip


def contestants(tempered: dict[str, float], untempered: dict[str, float], reach: float, worths):
    """Yield (numbers, rule, worth) and settings."""
    usual = DEFAULTS._replace(rule=PRODUCT)
    yield ("defaults", "cubes", BEAMS), DEFAULTS
    yield ("defaults", "cubes, normalised hit", BEAMS), DEFAULTS._replace(beluga=True)
    yield ("defaults", "product", 2.0), usual._replace(exponent=2.0 / BEAMS)
    yield ("defaults", "product", BEAMS), usual
    yield ("calibrated", "cubes", BEAMS), with_numbers(tempered, reach, rule=CUBES, beluga=False)
    yield ("calibrated", "cubes, normalised hit", BEAMS), with_numbers(tempered, reach, rule=CUBES)
    for worth in (*worths, BEAMS):
        yield ("calibrated", "product", worth), with_numbers(tempered, reach, exponent=worth / BEAMS)
    # Is a product bad because 2000 particles are too few for so narrow a weight?
    yield ("calibrated", MANY, BEAMS), with_numbers(tempered, reach)
    if untempered:
        yield ("calibrated untempered", "product", BEAMS), with_numbers(untempered, reach)


def cases(folder: Path, which, settings):
    """Yield the cases of a group of logs, after calibrating what they need."""
    kind, *rest = which
    draws, chains, untempered, particles = settings
    if kind == "jarvis":
        laser, train, judged = rest
        # As in held_out, both lasers are localized with what was calibrated with one.
        source = "navigation" if laser == "both" else laser
        name = f"jarvis_{source}_{train}"
        calibrated(name, jarvis(source, train), "tempered", folder, draws, chains)
        log = jarvis(laser, judged, None)
        known = np.broadcast_to(REFERENCE, (log.n_steps, 3, 3))
        yield Case(f"Jarvis, {laser}, {judged} part", log, log.true_poses, known, LOST, name)
    elif kind == "wean":
        found = references(folder, particles)
        for train in "1", "2":
            log = wean(train)
            log = with_scans(log, log.lidars, start_mean=found[train][0][0], start_std=(0.3, 0.3, 0.1))
            calibrated(f"wean_{train}", log, "tempered", folder, draws, chains)
        for train, judged in ("1", "2"), ("2", "1"):
            yield Case(f"Wean, {judged}", wean(judged, None), *found[judged], 2.0 * LOST, f"wean_{train}")
    else:
        (logs,) = rest
        name = f"room_{kind.replace(' ', '_')}"
        train = rooms_log(kind, 100)
        calibrated(name, train, "tempered", folder, draws, chains)
        if untempered:
            calibrated(name, train, "untempered", folder, draws, chains)
        for seed in range(logs):
            log = rooms_log(kind, seed, None)
            yield Case(f"room, {kind}, {seed}", log, log.true_poses, np.zeros((log.n_steps, 3, 3)), LOST, name)


def run(folder: Path, groups, worths, seeds: int, draws: int, chains: int, untempered: bool, particles: int) -> None:
    """Calibrate what is not calibrated and localize what is not localized."""
    table = Table(folder / "combining.csv", COLUMNS, 6)
    Table(folder / "calibrations.csv", CALIBRATION, 3)
    for group in groups:
        for case in cases(folder, group, (draws, chains, untempered, particles)):
            # Not half a cell off, as nav2 is: that would count as an error of every rule, on Wean's map one of 0.07 m.
            grid = grid_of_nav2(case.log.grid_map.with_margin(MARGIN), centred=True)
            reach = max(laser.max_range for laser in case.log.lidars.values())
            tempered = numbers_of(folder, case.calibration, "tempered", grid.resolution)
            plain = numbers_of(folder, case.calibration, "untempered", grid.resolution)
            few = seeds if case.name[0] != "r" else max(seeds // 3, 2)
            for key, settings in contestants(tempered, plain, reach, worths):
                judge(case, grid, ("clicked", *key), settings, few, table)
                # What a scan is worth is better seen where the number of particles plays no part.
                if key[:2] in (("calibrated", "product"), ("defaults", "cubes")):
                    judge(case, grid, ("known", *key), settings, few, table)
            print(case.name, flush=True)


def judge(case: Case, grid, key, settings: Settings, seeds: int, table: Table) -> None:
    """Localize a log with settings, from starts that are stated with an error."""
    counted = slice(FOUND_AFTER, None)
    truth, known = case.truth[counted], case.known[counted]
    std = STARTS[key[0]]
    many = key[2] == MANY
    particles = {"particles": (20_000, 20_000)} if many else {}
    for seed in range(-(-seeds // 3) if many else seeds):
        if table.knows(case.name, *key, seed):
            continue
        off = np.random.default_rng([seed, 3]).standard_normal(3)
        start = case.truth[0] + std * off
        found = run_filter(case.log, grid, settings, [seed, 4], start_mean=start, start_std=std, **particles)
        mean, covariance = found.mean[counted], found.covariance[counted] + known
        # A belief of one particle is no ellipse: a tenth of a millimetre keeps it invertible.
        covariance = covariance + 1e-8 * np.eye(3)
        table.add(
            case.name, *key, seed, *errors(mean, covariance, truth, case.lost).values(),
            log_density_of_truth(mean, covariance, truth).mean(), ellipse_radius(found.covariance[counted]),
            found.n.mean(), found.ignored.mean(),
        )  # fmt: skip
