"""Figures of a posterior: the parameters against each other, and the robot's path.

The figures about the chains themselves are in :mod:`pmcl.reports.chain_figures`; they are at hand here as well.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from pmcl.geometry import wrap
from pmcl.posterior.access import (
    log_suffixes,
    parameter_names,
    parameter_units,
    theta_draws,
    trajectory_draws,
    true_theta,
)
from pmcl.posterior.compat import Posterior, find_group
from pmcl.posterior.estimates import PathSummary, path_summary
from pmcl.reports.chain_figures import plot_autocorrelation, plot_ess_evolution, plot_rank, plot_trace
from pmcl.reports.style import (
    FAINT,
    POSTERIOR,
    PRIOR,
    TRUTH,
    chain_color,
    evenly_spaced,
    labelled,
    legend_above,
    new_figure,
    tidy,
)

__all__ = ["plot_autocorrelation", "plot_ess_evolution", "plot_pair", "plot_rank", "plot_trace", "plot_trajectory"]

Float = NDArray[np.float64]

# More dots than this only fill the cloud and the file; more paths hide the map.
_MOST_DOTS = 2000
_MOST_PATHS = 40
_SAMPLED = "#56B4E9"


def plot_pair(data: Posterior) -> Figure:
    """Parameters against each other, as in the paper's Figure 1, with histograms and prior densities on the diagonal.

    Dots are draws, coloured by chain; dashed lines are the true values; the numbers above the diagonal are
    correlations.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    PosteriorError
        If the posterior holds no draws.
    """
    theta, names, truth = theta_draws(data), parameter_names(data), true_theta(data)
    size = len(names)
    labels = [labelled(name, unit, narrow=True) for name, unit in zip(names, parameter_units(data), strict=True)]
    figure = new_figure(max(3.2, min(10.0, 2.3 * size) + 0.4), 10.0 if size > 1 else 6.0)
    grid = figure.subplots(size, size, squeeze=False, sharex="col")
    for row in range(size):
        for column in range(size):
            axes = grid[row, column]
            if row == column:
                _marginal(axes, data, names[row], theta[..., row])
            elif row > column:
                _scatter(axes, theta[..., column], theta[..., row])
            else:
                _correlation(axes, theta[..., row], theta[..., column])
                continue
            _true_lines(axes, truth.get(names[column]), truth.get(names[row]) if row > column else None)
            _label_pair(axes, row, column, labels)
    figure.align_ylabels(list(grid[:, 0]))
    legend_above(figure, _pair_handles(data))
    return figure


def _marginal(axes: Axes, data: Posterior, name: str, draws: Float) -> None:
    constants = find_group(data, "constant_data")
    axes.hist(draws.ravel(), bins=30, density=True, color=POSTERIOR, alpha=0.35)
    if "prior_density" in constants and name in constants["parameter"].values:
        prior = constants.sel(parameter=name)
        axes.plot(prior["prior_grid"], prior["prior_density"], color=PRIOR, linewidth=1.6)
    low, high = float(draws.min()), float(draws.max())
    if high > low:
        # A prior wider than the picture must not stretch it.
        axes.set_xlim(low - 0.1 * (high - low), high + 0.1 * (high - low))


def _scatter(axes: Axes, horizontal: Float, vertical: Float) -> None:
    n_chains, n_draws = horizontal.shape
    shown = evenly_spaced(n_draws, max(_MOST_DOTS // n_chains, 1))
    for chain in range(n_chains):
        axes.plot(
            horizontal[chain, shown], vertical[chain, shown], ".", color=chain_color(chain), markersize=2.5, alpha=0.5
        )


def _correlation(axes: Axes, first: Float, second: Float) -> None:
    axes.set_axis_off()
    if np.ptp(first) > 0.0 and np.ptp(second) > 0.0:
        value = float(np.corrcoef(first.ravel(), second.ravel())[0, 1])
        strength = 0.35 + 0.65 * abs(value)
        axes.text(
            0.5,
            0.5,
            f"r = {value:+.2f}",
            ha="center",
            va="center",
            transform=axes.transAxes,
            alpha=strength,
            fontsize=11,
        )


def _true_lines(axes: Axes, horizontal: float | None, vertical: float | None) -> None:
    # A truth far outside would shrink the posterior to a dot: then keep the limits and show no line.
    x_limits, y_limits = axes.get_xlim(), axes.get_ylim()
    if horizontal is not None:
        axes.axvline(horizontal, **TRUTH)
        x_limits = _stretched(x_limits, horizontal)
    if vertical is not None:
        axes.axhline(vertical, **TRUTH)
        y_limits = _stretched(y_limits, vertical)
    axes.set_xlim(x_limits)
    axes.set_ylim(y_limits)


def _stretched(limits: tuple[float, float], value: float) -> tuple[float, float]:
    low, high = limits
    margin = 0.05 * (high - low)
    if low - 2.0 * (high - low) <= value <= high + 2.0 * (high - low):
        return min(low, value - margin), max(high, value + margin)
    return limits


def _label_pair(axes: Axes, row: int, column: int, labels: list[str]) -> None:
    tidy(axes)
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.yaxis.set_major_locator(MaxNLocator(4))
    size = len(labels)
    if row == size - 1:
        axes.set_xlabel(labels[column], fontsize=9)
        axes.tick_params(axis="x", rotation=45 if size > 3 else 0)
    if row == column:
        axes.set_yticks([])
        axes.spines["left"].set_visible(False)
        if column == 0:
            unit = labels[0].partition("[")[2].rstrip("]")
            axes.set_ylabel(labelled("density", f"1/{unit}" if unit not in ("", "1") else unit), fontsize=9)
    elif column == 0:
        axes.set_ylabel(labels[row], fontsize=9)
    else:
        axes.tick_params(labelleft=False)


def _pair_handles(data: Posterior) -> list[Line2D]:
    n_chains, names = theta_draws(data).shape[0], parameter_names(data)
    handles = [
        Line2D([], [], marker="o", linestyle="", markersize=4, color=chain_color(chain), label=f"chain {chain}")
        for chain in range(n_chains if len(names) > 1 else 0)
    ]
    if "prior_density" in find_group(data, "constant_data"):
        handles.append(Line2D([], [], color=PRIOR, linewidth=1.6, label="prior density"))
    if set(names) & set(true_theta(data)):
        handles.append(Line2D([], [], **TRUTH, label="true value"))
    return handles


def plot_trajectory(data: Posterior, log: int = 0) -> Figure:
    """Draw the robot's path on the map, how well it is known over time, and how far the mean is from the true path.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
    log : int
        Which log, from 0.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    PosteriorError
        If the posterior holds no trajectories for this log.
    """
    path = path_summary(data, log)
    constants = find_group(data, "constant_data")
    suffix = log_suffixes(data)[log]
    name = f"true_pose{suffix}"
    truth = np.asarray(constants[name].values, dtype=np.float64) if name in constants else None
    figure = new_figure(5.2)
    panels = figure.subplot_mosaic([["map", "position"], ["map", "heading"]], width_ratios=[3, 2])
    _draw_map(panels["map"], data, suffix)
    _draw_paths(panels["map"], np.asarray(trajectory_draws(data, log).values, dtype=np.float64), path, truth)
    _draw_spread(panels["position"], panels["heading"], path, truth)
    drawn = [*panels["map"].get_lines(), *panels["map"].collections, *panels["position"].get_lines()]
    # A sample of a transparent hairline would be invisible in the legend.
    samples = Line2D([], [], color=_SAMPLED, linewidth=1.5, label="sampled paths")
    legend_above(figure, [*drawn, samples])
    return figure


def _draw_map(axes: Axes, data: Posterior, suffix: str) -> None:
    constants = find_group(data, "constant_data")
    if f"wall{suffix}" in constants:
        walls = constants[f"wall{suffix}"].values
        axes.add_collection(LineCollection(list(walls), colors="#444444", linewidths=1.6, label="walls"))
    if f"landmark_position{suffix}" in constants:
        spots = constants[f"landmark_position{suffix}"].values
        axes.plot(spots[:, 0], spots[:, 1], "^", color="#D55E00", markersize=6, label="landmarks")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    tidy(axes)


def _draw_paths(axes: Axes, stored: Float, path: PathSummary, truth: Float | None) -> None:
    paths = stored.reshape(-1, *stored.shape[2:])
    shown = paths[evenly_spaced(len(paths), _MOST_PATHS)]
    # All in one artist, each path a segment: forty separate lines would need forty legends.
    axes.add_collection(LineCollection([one[:, :2] for one in shown], colors=_SAMPLED, linewidths=0.6, alpha=0.4))
    axes.plot(path.mean[:, 0], path.mean[:, 1], color=POSTERIOR, linewidth=1.3, label="mean path")
    if truth is not None:
        axes.plot(truth[:, 0], truth[:, 1], **TRUTH, label="true path")
    axes.plot(*path.mean[0, :2], "o", color=POSTERIOR, markersize=7, markerfacecolor="white", label="start")
    axes.autoscale_view()


def _draw_spread(position: Axes, heading: Axes, path: PathSummary, truth: Float | None) -> None:
    position.plot(path.times, np.hypot(path.sd[:, 0], path.sd[:, 1]), color="#009E73", label="posterior sd")
    heading.plot(path.times, path.sd[:, 2], color="#009E73")
    if truth is not None:
        offset = path.mean - truth
        grey: dict[str, Any] = {"color": FAINT, "linewidth": 1.0, "zorder": 1.0}
        position.plot(path.times, np.hypot(offset[:, 0], offset[:, 1]), label="error of the mean", **grey)
        heading.plot(path.times, np.abs(wrap(offset[:, 2])), **grey)
    position.set_ylabel("position [m]")
    heading.set_ylabel("heading [rad]")
    heading.set_xlabel("time [s]")
    position.sharex(heading)
    position.tick_params(labelbottom=False)
    for axes in (position, heading):
        axes.set_ylim(0, None)
        tidy(axes)
