"""Draw a recorded robot's path by a filter before and after the critic, and its error over the whole drive.

    PMCL_DATA=/folder/with/recordings python picture.py        # a minute on two cores

The models are those that the critic left in create_2.json: the base model, and the base model with the effects that it
added, each with its posterior means. The filters are those of run.py, so their errors are those of errors.csv. Motion
capture gives the true path; neither the critic nor the filters read it.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from run import HERE, PARTICLES, REPETITIONS, recordings

from pmcl.localization.many import Runs, localize_many
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.selection import effect_named
from pmcl.models.robot_model import RobotModel, default_model

ROBOT = "Create 2"
PICTURE = HERE.parent / "pictures" / "before_and_after.png"
# Seconds of the drive that the maps show; the whole path would cross itself too often to be read.
SHOWN = 150.0
# Room around the true path, along x and y [m].
MARGIN = np.array([1.4, 0.9])
BEFORE, AFTER, TRUE = "#D55E00", "#0072B2", "black"


def stored() -> Path:
    """Return the file with what the critic said."""
    return HERE / f"{ROBOT.replace(' ', '_').lower()}.json"


def models(log: RobotLog) -> tuple[tuple[RobotModel, dict[str, float]], ...]:
    """Return base model and final model of the stored criticism, each with its posterior means."""
    found = json.loads(stored().read_text())
    base = default_model(log)
    effects = tuple(effect_named(one["name"], log, one["where"]) for one in found["effects"])
    return tuple(
        (model, {name: found["parameters"][when][name]["mean"] for name in model.bind(log).names})
        for model, when in ((base, "before"), (replace(base, effects=effects), "after"))
    )


def typical_run(runs: Runs) -> int:
    """Return the run whose error is the median one."""
    return int(np.argsort(runs.position_rmse)[len(runs.seeds) // 2])


def typical_window(times: np.ndarray, errors: list[np.ndarray], rmse: list[float]) -> slice:
    """Return the rows of the window in which both errors are most like those of the whole drive."""
    starts = np.flatnonzero(times <= times[-1] - SHOWN)[::10]
    windows = [slice(start, int(np.searchsorted(times, times[start] + SHOWN))) for start in starts]

    def unlike(window: slice) -> float:
        own = [float(np.sqrt(np.nanmean(error[window] ** 2))) for error in errors]
        return sum(abs(np.log(one / whole)) for one, whole in zip(own, rmse, strict=True))

    return min(windows, key=unlike)


def draw_map(axes, log: RobotLog, path: np.ndarray, window: slice, color: str) -> None:
    true = log.true_poses[window, :2]
    axes.plot(*log.landmarks.positions.T, "^", color="#666666", markersize=6, label="landmarks")
    ties = np.stack([true, path[window, :2]], axis=1)[::4]
    axes.add_collection(LineCollection(list(ties), colors=color, linewidths=0.6, alpha=0.6))
    axes.plot(*path[window, :2].T, color=color, linewidth=1.8)
    axes.plot(*true.T, color=TRUE, linewidth=1.2, label="true path")
    axes.plot(*true[0], "o", color=TRUE, markersize=6, markerfacecolor="white", label="start")
    axes.set_aspect("equal", adjustable="box")
    low, high = true.min(axis=0) - MARGIN, true.max(axis=0) + MARGIN
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]")
    axes.spines[["top", "right"]].set_visible(False)


def draw_errors(axes, times: np.ndarray, errors: list[np.ndarray], window: slice) -> None:
    for error, color, name in zip(errors, (BEFORE, AFTER), ("before", "after"), strict=True):
        axes.plot(times, error, color=color, linewidth=1.0, label=name)
    axes.axvspan(times[window][0], times[window][-1], color="#DDDDDD", linewidth=0)
    place = {"transform": axes.get_xaxis_transform(), "ha": "right", "va": "top"}
    axes.text(times[window][-1], 0.99, "shown above ", fontsize=9, **place)
    axes.set(xlabel="time [s]", ylabel="position error [m]", ylim=(0.0, None), xlim=(0.0, times[-1]))
    axes.spines[["top", "right"]].set_visible(False)


def draw_posteriors(axes) -> None:
    """Draw mean and 90 % interval of each noise parameter before and after, on one scale of powers of ten."""
    parameters = json.loads(stored().read_text())["parameters"]
    names = [name for name in parameters["before"] if name.startswith("sigma_")]
    for when, color, offset in (("before", BEFORE, -0.15), ("after", AFTER, 0.15)):
        mean, sd = np.array([[parameters[when][name][key] for key in ("mean", "sd")] for name in names]).T
        axes.errorbar(mean, np.arange(len(names)) + offset, xerr=1.645 * sd, fmt="o", color=color, markersize=4)
    axes.set_xscale("log")
    axes.set_xlim(0.008, 0.15)
    axes.set_xticks([0.01, 0.03, 0.1], ["0.01", "0.03", "0.1"])
    axes.minorticks_off()
    axes.set_yticks(range(len(names)), [f"{name} [{parameters['before'][name]['unit']}]" for name in names], fontsize=9)
    axes.invert_yaxis()
    axes.set_xlabel("posterior of the noise")
    axes.spines[["top", "right"]].set_visible(False)


def draw(log: RobotLog, runs: list[Runs], path: Path) -> None:
    rmse = [float(np.nanmean(one.position_rmse)) for one in runs]
    chosen = [typical_run(one) for one in runs]
    errors = [one.position_error[k] for one, k in zip(runs, chosen, strict=True)]
    window = typical_window(log.times, errors, rmse)
    figure = Figure(figsize=(9.2, 7.4), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=[2.5, 1.0])
    maps = above.subplots(1, 2, sharex=True, sharey=True)
    titles = ("before: noise alone", "after: with what the critic found")
    for axes, title, one, k, value, color in zip(maps, titles, runs, chosen, rmse, (BEFORE, AFTER), strict=True):
        draw_map(axes, log, one.pose_mean[k], window, color)
        axes.set_title(f"{title}\nerror {value:.2f} m", fontsize=13, color=color, weight="bold")
    maps[0].set_ylabel("y [m]")
    handles = [
        Line2D([], [], color=BEFORE, linewidth=1.8, label="filter before"),
        Line2D([], [], color=AFTER, linewidth=1.8, label="filter after"),
        *maps[0].get_legend_handles_labels()[0],
    ]
    above.legend(handles=handles, loc="outside lower center", ncols=5, frameon=False)
    left, right = below.subplots(1, 2, width_ratios=[1.7, 1.0])
    draw_errors(left, log.times, errors, window)
    draw_posteriors(right)
    figure.savefig(path, dpi=120, metadata={"Software": None})


def main() -> None:
    """Localize with both models and draw."""
    log = recordings()[ROBOT]
    runs = [
        localize_many(log, model, theta=theta, repetitions=REPETITIONS, particles=PARTICLES)
        for model, theta in models(log)
    ]
    draw(log, runs, PICTURE)
    before, after = (float(np.nanmean(one.position_rmse)) for one in runs)
    print(f"before {before:.4f} m, after {after:.4f} m; {PICTURE}: {PICTURE.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
