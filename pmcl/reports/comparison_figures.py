"""Figures of a comparison of methods: convergence against time, and where the means ended."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pmcl.comparison.compare import Comparison
from pmcl.posterior.diagnostics import R_HAT_LIMIT
from pmcl.reports.style import FAINT, TRUTH, chain_color, labelled, legend_above, new_figure, tidy

__all__ = ["plot_comparison", "plot_means"]


def plot_comparison(comparison: Comparison) -> Figure:
    """R-hat, effective sample size and errors of each method against the time by the clock.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = new_figure(7.2)
    grid = figure.subplots(2, 2, sharex=True)
    panels = (
        (grid[0, 0], "r_hat", "R-hat - 1 (worst parameter)"),
        (grid[0, 1], "ess", "effective draws (worst parameter)"),
        (grid[1, 0], "error", "distance from reference [posterior sd]"),
        (grid[1, 1], "error_of_truth", "distance from truth [posterior sd]"),
    )
    for axes, name, label in panels:
        for number, result in enumerate(comparison.results):
            values = getattr(result.curve, name) - (1.0 if name == "r_hat" else 0.0)
            # On a logarithmic scale an R-hat below 1, which chance allows, has no place.
            shown = np.maximum(values, 1e-4)
            axes.plot(result.curve.wall, shown, ".-", color=chain_color(number), markersize=4, linewidth=1.3)
        axes.set_yscale("log")
        axes.set_ylabel(label)
        tidy(axes)
    grid[0, 0].axhline(R_HAT_LIMIT - 1.0, **TRUTH)
    _reference_error(grid[1, 0], comparison)
    if comparison.truth is None:
        grid[1, 1].clear()
        grid[1, 1].set_axis_off()
        grid[1, 1].text(0.5, 0.5, "true parameters not known", ha="center", transform=grid[1, 1].transAxes)
    for axes in grid[1]:
        axes.set_xlabel("time since the start of the run [s]")
    legend_above(figure, _handles(comparison))
    return figure


def plot_means(comparison: Comparison) -> Figure:
    """Posterior mean and standard deviation of each parameter by each method, relative to the reference.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    matplotlib.figure.Figure
    """
    reference, n_methods = comparison.reference, len(comparison.results)
    figure = new_figure(1.2 + 0.4 * len(comparison.names) * max(1.0, 0.3 * n_methods))
    axes = figure.subplots()
    axes.axvspan(-1.0, 1.0, color=FAINT, alpha=0.35, linewidth=0)
    axes.axvline(0.0, color=FAINT)
    rows = np.arange(len(comparison.names))
    for number, result in enumerate(comparison.results):
        offset = 0.7 * ((number + 0.5) / n_methods - 0.5)
        axes.errorbar(
            (result.mean - reference.mean) / reference.sd,
            rows + offset,
            xerr=result.sd / reference.sd,
            fmt="o",
            color=chain_color(number),
            markersize=4,
            linewidth=1.4,
        )
    if comparison.truth is not None:
        for row, place in zip(rows, (comparison.truth - reference.mean) / reference.sd, strict=True):
            axes.plot([place, place], [row - 0.42, row + 0.42], **TRUTH)
    labels = [labelled(name, unit) for name, unit in zip(comparison.names, comparison.units, strict=True)]
    axes.set_yticks(rows, labels)
    axes.invert_yaxis()
    axes.set_xlabel("mean and standard deviation [sd of the reference, from its mean]")
    tidy(axes)
    handles = _handles(comparison)
    if comparison.truth is not None:
        handles.append(Line2D([], [], label="truth", **TRUTH))
    legend_above(figure, handles)
    return figure


def _reference_error(axes: Axes, comparison: Comparison) -> None:
    """Below its own Monte Carlo error the reference can tell nothing apart."""
    error = comparison.reference.error
    if np.isfinite(error):
        axes.axhspan(axes.get_ylim()[0], error, color=FAINT, alpha=0.35, linewidth=0, label="error of the reference")


def _handles(comparison: Comparison) -> list[Line2D]:
    return [
        Line2D([], [], color=chain_color(number), marker="o", markersize=4, label=str(result.method))
        for number, result in enumerate(comparison.results)
    ]
