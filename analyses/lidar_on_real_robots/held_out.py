"""From a bag to nav2: what the exported parameters are worth on the part of the drive that they have not seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from judge import (
    JUDGED_PARTICLES,
    REFERENCE,
    ellipse_radius,
    errors,
    fit_judge,
    log_density_of_truth,
    share_near_walls,
)
from nav2_filter import CUBES, PRODUCT, Settings, grid_of_nav2, run_filter
from recordings import jarvis, jarvis_map
from results import Table
from ruamel.yaml import YAML

import pmcl
from pmcl.exports.export import export_text
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.models.sensors.lidar.sensor import Lidar
from pmcl.posterior.access import parameter_names, theta_draws
from pmcl.posterior.diagnostics import summarize

CALIBRATION = ("log", "kind", "parameter", "exponent", "mean", "sd", "low", "median", "high", "r_hat")
RESULT = ("laser", "judged", "map", "settings", "seed", "position_rmse", "position_worst", "heading_rmse",
          "coverage_95", "lost", "readings", "scan", "truth", "radius", "particles", "ignored")  # fmt: skip
ROWS = ("laser", "judged", "map", "settings", "time", "error", "sd")
DEFAULTS = Settings(alphas=(0.2,) * 4, sigma_hit=0.2, z_hit=0.5, z_rand=0.5, rule=CUBES)
HAND = Settings(alphas=(0.1,) * 4, sigma_hit=0.1, z_hit=0.5, z_rand=0.4, rule=CUBES, beam=True)
MARGIN = 2.0


SENSORS = {"tempered": Lidar(), "untempered": Lidar(exponent=1.0), "beam": Lidar(model="beam")}
"""The default model, the same with beams taken as independent, and the beam model (tempered)."""


def calibrated(name: str, log, kind: str, folder: Path, draws: int, chains: int) -> str:
    """Return the exported file of a calibration, which is made if it is not there; all in `folder`."""
    path = folder / "exported" / f"{name}_{kind}.yaml"
    path.parent.mkdir(exist_ok=True)
    if path.exists():
        return path.read_text()
    sensor = SENSORS[kind]
    model = RobotModel(default_model(log).motion, (sensor,))
    data = pmcl.calibrate(log, model, draws=draws, chains=chains)
    table = Table(folder / "calibrations.csv", CALIBRATION, 3)
    summary = summarize(data)
    values = theta_draws(data).reshape(-1, len(parameter_names(data)))
    usual = sensor.usual_settings(log)
    exponent = sensor.exponent or float(usual["exponent"])
    for k, parameter in enumerate(parameter_names(data)):
        low, median, high = np.quantile(values[:, k], (0.05, 0.5, 0.95))
        numbers = (values[:, k].mean(), values[:, k].std(ddof=1), low, median, high)
        r_hat = float(summary["r_hat"].sel(parameter=parameter))
        table.add(name, kind, parameter, exponent, *numbers, r_hat)
    text = export_text(data, "nav2")
    path.write_text(text)
    print(text, flush=True)
    return text


def settings_of(text: str) -> Settings:
    """Read an exported file as nav2 would."""
    found = YAML(typ="safe", pure=True).load(text)["amcl"]["ros__parameters"]
    beam = found["laser_model_type"] == "beam"
    assert beam or found["laser_model_type"] == "likelihood_field_prob"
    names = ("sigma_hit", "z_hit", "z_rand", "laser_max_range", "max_beams")
    names += ("z_short", "z_max", "lambda_short") if beam else ()
    return Settings(
        alphas=tuple(found[f"alpha{k}"] for k in (1, 2, 3, 4)), rule=CUBES if beam else PRODUCT, beam=beam,
        **{name: found[name] for name in names},
    )  # fmt: skip


def contestants(found: dict[str, Settings]) -> dict[str, Settings]:
    """Return all settings that are compared, by their names in the results; those after the export tell why."""
    tempered = found["tempered"]
    settings = {
        "defaults": DEFAULTS,
        "hand": HAND,
        "export": tempered,
        "defaults, product": DEFAULTS._replace(rule=PRODUCT),
        "defaults, exported alphas": DEFAULTS._replace(alphas=tempered.alphas),
        "defaults, exported laser": tempered._replace(alphas=DEFAULTS.alphas),
    }
    return settings | {f"{kind} export": found[kind] for kind in found if kind != "tempered"}


def run(folder: Path, kinds, directions, seeds: int, draws: int, chains: int) -> None:
    """Calibrate what is not calibrated and localize what is not localized; `kinds` for each laser.

    Both lasers together are localized with what was calibrated with the navigation laser alone.
    """
    table = Table(folder / "held_out.csv", RESULT, 5)
    rows = Table(folder / "held_out_rows.csv", ROWS, 5)
    seen = Table(folder / "near_walls.csv", ("laser", "part", "share"), 2)
    maps = {"as it is": jarvis_map(), "with margin": jarvis_map().with_margin(MARGIN)}
    maps = {name: grid_of_nav2(grid) for name, grid in maps.items()}
    for laser, of_laser in kinds.items():
        for train, judged in directions:
            source = "navigation" if laser == "both" else laser
            name = f"jarvis_{source}_{train}"
            log = jarvis(source, train)
            found = {}
            for kind in of_laser:
                # The README's commands have the usual number of chains; two are enough for the rest.
                number = chains if (source, kind) == ("navigation", "tempered") else 2
                found[kind] = settings_of(calibrated(name, log, kind, folder, draws, number))
            if not seen.knows(laser, judged):
                seen.add(laser, judged, share_near_walls(jarvis(laser, judged)))
            judge = fit_judge(jarvis(laser, train), jarvis(laser, judged))
            compare(laser, judged, contestants(found), maps, seeds, (table, rows), judge)


def compare(laser, judged, settings, maps, seeds, tables, judge) -> None:
    table, rows = tables
    log = jarvis(laser, judged, None)
    truth = log.true_poses
    for which, grid in maps.items():
        for name, chosen in settings.items():
            if rows.knows(laser, judged, which, name, float(log.times[-1])):
                continue
            off = []
            for seed in range(seeds):
                rng = np.random.default_rng([seed, 1])
                start = log.start_mean + log.start_std * rng.standard_normal(3)
                run = run_filter(log, grid, chosen, [seed, 2], start_mean=start, start_std=log.start_std)
                scores = np.array([judge.scores(t, run.predicted[t, : run.n[t]][:JUDGED_PARTICLES])
                                   for t in range(log.n_steps)])  # fmt: skip
                together = run.covariance + REFERENCE
                found = errors(run.mean, together, truth)
                off.append(np.hypot(*(run.mean - truth)[:, :2].T))
                if not table.knows(laser, judged, which, name, seed):
                    table.add(
                        laser, judged, which, name, seed, *found.values(), *scores.mean(axis=0),
                        log_density_of_truth(run.mean, together, truth).mean(), ellipse_radius(run.covariance),
                        run.n.mean(), run.ignored.mean(),
                    )  # fmt: skip
            off = np.array(off)
            for t in range(log.n_steps):
                rows.add(laser, judged, which, name, log.times[t], off[:, t].mean(), off[:, t].std())
            print(laser, judged, which, name, f"{np.sqrt((off**2).mean()):.4f} m", flush=True)
