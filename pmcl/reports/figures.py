"""Figures of a posterior's parameters: each with its prior, and against each other.

The figures about the chains are in :mod:`pmcl.reports.chain_figures`, the robot's path is in
:mod:`pmcl.reports.path_figure`; both can be imported from here as well. Figures about the readings are in
:mod:`pmcl.reports.residual_figures`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from scipy import ndimage

from pmcl.posterior.access import parameter_names, parameter_units, theta_draws, true_theta
from pmcl.posterior.compat import Posterior, find_group
from pmcl.reports.bands import mass_levels
from pmcl.reports.chain_figures import plot_autocorrelation, plot_ess_evolution, plot_rank, plot_trace
from pmcl.reports.path_figure import plot_trajectory
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

__all__ = [
    "plot_autocorrelation",
    "plot_ess_evolution",
    "plot_marginals",
    "plot_pair",
    "plot_rank",
    "plot_trace",
    "plot_trajectory",
]

Float = NDArray[np.float64]

# More dots than this make the file larger without showing more.
_MOST_DOTS = 2000
# Cells of the grid on which densities of two parameters are smoothed, and the width of the smoothing in cells.
_GRID, _SMOOTHING = 40, 2.0
_REGIONS = (0.9, 0.5)
_REGION_COLORS = ("#A9CCE3", "#4A92C3")
# Share of the prior's draws that the picture of the prior's whole range shows: a long tail would hide the rest.
_PRIOR_SHARE = 0.98


def plot_marginals(data: Posterior) -> Figure:
    """Draw the prior of each parameter with the range of the posterior, and the posterior enlarged.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree

    Returns
    -------
    matplotlib.figure.Figure
        One row for each parameter; without the column of priors if the posterior holds none.

    Raises
    ------
    PosteriorError
        If the posterior holds no draws.
    """
    theta, names, truth = theta_draws(data), parameter_names(data), true_theta(data)
    priors = find_group(data, "prior")
    with_prior = all(name in priors for name in names)
    figure = new_figure(0.7 + 1.25 * len(names), 6.4)
    grid = figure.subplots(len(names), 1 + with_prior, squeeze=False)
    for row, (name, unit) in enumerate(zip(names, parameter_units(data), strict=True)):
        draws = theta[..., row].ravel()
        if with_prior:
            _whole_range(grid[row, 0], np.asarray(priors[name].values, dtype=np.float64).ravel(), draws)
        axes = grid[row, -1]
        _histogram(axes, draws)
        low, high = np.quantile(draws, [0.05, 0.95])
        axes.plot([low, high], [0.0, 0.0], color=POSTERIOR, linewidth=5, solid_capstyle="butt", clip_on=False)
        _true_lines(axes, truth.get(name), None)
        grid[row, 0].set_ylabel("density", fontsize=9)
        for panel in grid[row]:
            panel.set_yticks([])
            panel.spines["left"].set_visible(False)
            panel.xaxis.set_major_locator(MaxNLocator(5))
            tidy(panel)
            panel.set_xlabel(labelled(name, unit))
    if with_prior:
        grid[0, 0].set_title("prior, its whole range", fontsize=10)
        grid[0, 1].set_title("posterior, enlarged", fontsize=10)
    handles: list[Any] = [Patch(color=POSTERIOR, alpha=0.35, label="posterior")]
    handles.append(Line2D([], [], color=POSTERIOR, linewidth=5, label="its 90 % interval"))
    handles += [Patch(color=FAINT, label="prior")] if with_prior else []
    handles += [Line2D([], [], **TRUTH, label="true value")] if set(names) & set(truth) else []
    legend_above(figure, handles)
    return figure


def _histogram(axes: Axes, draws: Float) -> None:
    axes.hist(draws, bins=40, density=True, color=POSTERIOR, alpha=0.35)
    low, high = float(draws.min()), float(draws.max())
    if high > low:
        axes.set_xlim(low - 0.1 * (high - low), high + 0.1 * (high - low))


def _whole_range(axes: Axes, prior: Float, draws: Float) -> None:
    outside = 0.5 * (1.0 - _PRIOR_SHARE)
    low, high = np.quantile(prior, [outside, 1.0 - outside])
    low, high = min(float(low), float(draws.min())), max(float(high), float(draws.max()))
    if high > low:
        axes.hist(prior, bins=30, range=(low, high), density=True, color=FAINT)
        axes.set_xlim(low, high)
    interval = np.quantile(draws, [0.05, 0.95])
    axes.axvspan(*interval, color=POSTERIOR, alpha=0.9, linewidth=1.5)


def plot_pair(data: Posterior) -> Figure:
    """Draw parameters against each other, as in the paper's Figure 1.

    Below the diagonal draws, coloured by chain; above it the smallest regions that hold 50 % and 90 % of the draws,
    and the correlation; on it histograms, with the prior density on a scale of its own. Dashed lines are true values.

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
    figure = new_figure(max(3.2, min(10.0, 2.2 * size) + 0.4), 10.0 if size > 1 else 6.0)
    grid = figure.subplots(size, size, squeeze=False, sharex="col")
    for row in range(size):
        for column in range(size):
            axes = grid[row, column]
            if row == column:
                _marginal(axes, data, names[row], theta[..., row])
            elif row > column:
                _scatter(axes, theta[..., column], theta[..., row])
            else:
                _regions(axes, theta[..., column], theta[..., row])
            if row != column:
                # The same limits left and right of the diagonal.
                axes.set_ylim(*_span(theta[..., row]))
            _true_lines(axes, truth.get(names[column]), truth.get(names[row]) if row != column else None)
            _label_pair(axes, row, column, labels)
    figure.align_ylabels(list(grid[:, 0]))
    legend_above(figure, _pair_handles(data))
    return figure


def _span(values: Float) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    margin = 0.05 * (high - low) if high > low else max(0.05 * abs(low), 1e-6)
    return low - margin, high + margin


def _marginal(axes: Axes, data: Posterior, name: str, draws: Float) -> None:
    constants = find_group(data, "constant_data")
    _histogram(axes, draws.ravel())
    if "prior_density" in constants and name in constants["parameter"].values:
        prior = constants.sel(parameter=name)
        density = np.asarray(prior["prior_density"].values, dtype=np.float64)
        top = np.nanmax(density, initial=0.0)
        if top > 0.0:
            # On the scale of the posterior most priors would be a line at zero.
            axes.plot(prior["prior_grid"], density * (0.6 * axes.get_ylim()[1] / top), color=PRIOR, linewidth=1.6)


def _scatter(axes: Axes, horizontal: Float, vertical: Float) -> None:
    n_chains, n_draws = horizontal.shape
    shown = evenly_spaced(n_draws, max(_MOST_DOTS // n_chains, 1))
    for chain in range(n_chains):
        axes.plot(
            horizontal[chain, shown], vertical[chain, shown], ".", color=chain_color(chain), markersize=2.5, alpha=0.5
        )


def _regions(axes: Axes, horizontal: Float, vertical: Float) -> None:
    across, up = horizontal.ravel(), vertical.ravel()
    if np.ptp(across) == 0.0 or np.ptp(up) == 0.0:
        axes.set_axis_off()
        return
    margin = [0.15 * float(np.ptp(values)) for values in (across, up)]
    box = [(values.min() - edge, values.max() + edge) for values, edge in zip((across, up), margin, strict=True)]
    counts, x_edges, y_edges = np.histogram2d(across, up, bins=_GRID, range=box)
    density = ndimage.gaussian_filter(counts, _SMOOTHING)
    levels = mass_levels(density, _REGIONS)
    x, y = 0.5 * (x_edges[1:] + x_edges[:-1]), 0.5 * (y_edges[1:] + y_edges[:-1])
    axes.contourf(x, y, density.T, levels=[*levels, density.max() * 1.001], colors=_REGION_COLORS[-len(levels) :])
    correlation = float(np.corrcoef(across, up)[0, 1])
    place: dict[str, Any] = {"ha": "right", "va": "top", "transform": axes.transAxes}
    # The text has a background of its own, because the line of a true value may cross it.
    ground = {"facecolor": "white", "edgecolor": "none", "pad": 1.0, "alpha": 0.85}
    axes.text(0.97, 0.97, f"r = {correlation:+.2f}", fontsize=9, bbox=ground, **place)


def _true_lines(axes: Axes, horizontal: float | None, vertical: float | None) -> None:
    # A true value far outside would shrink the posterior to a dot; then the limits stay and no line is drawn.
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
    axes.xaxis.set_major_locator(MaxNLocator(3))
    axes.yaxis.set_major_locator(MaxNLocator(4))
    size = len(labels)
    if row == size - 1:
        axes.set_xlabel(labels[column], fontsize=9)
        axes.tick_params(axis="x", rotation=30 if size > 4 else 0)
    if row == column:
        axes.set_yticks([])
        axes.spines["left"].set_visible(False)
        if column == 0:
            unit = labels[0].partition("[")[2].rstrip("]")
            axes.set_ylabel(labelled("density", f"1/{unit}" if unit not in ("", "1") else unit), fontsize=9)
    elif column == 0:
        axes.set_ylabel(labels[row], fontsize=9)
    elif column == size - 1 and axes.axison:
        axes.yaxis.tick_right()
        axes.yaxis.set_label_position("right")
        axes.spines["right"].set_visible(True)
        axes.spines["left"].set_visible(False)
        axes.set_ylabel(labels[row], fontsize=9)
    else:
        axes.tick_params(labelleft=False)


def _pair_handles(data: Posterior) -> list[Any]:
    n_chains, names = theta_draws(data).shape[0], parameter_names(data)
    handles: list[Any] = [
        Line2D([], [], marker="o", linestyle="", markersize=4, color=chain_color(chain), label=f"chain {chain}")
        for chain in range(n_chains if len(names) > 1 else 0)
    ]
    if len(names) > 1:
        handles += [
            Patch(color=color, label=f"{share:.0%} of the draws".replace("%", " %"))
            for share, color in zip(_REGIONS, _REGION_COLORS, strict=True)
        ]
    if "prior_density" in find_group(data, "constant_data"):
        handles.append(Line2D([], [], color=PRIOR, linewidth=1.6, label="prior density (scale of its own)"))
    if set(names) & set(true_theta(data)):
        handles.append(Line2D([], [], **TRUTH, label="true value"))
    return handles
