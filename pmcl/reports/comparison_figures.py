"""Figures of a comparison of methods: convergence against time, and where the means ended."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

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
    curves = [
        ("r_hat", "R-hat - 1 (worst parameter)"),
        ("ess", "effective draws (worst parameter)"),
        ("error", "distance from reference [posterior sd]"),
    ]
    if comparison.truth is not None:
        curves.append(("error_of_truth", "distance from truth [posterior sd]"))
    grid = list(figure.subplots(2, 2, sharex=True).flat)
    for axes in grid[len(curves) :]:
        axes.remove()
    grid = grid[: len(curves)]
    for axes, (name, label) in zip(grid, curves, strict=True):
        for number, result in enumerate(comparison.results):
            values = getattr(result.curve, name) - (1.0 if name == "r_hat" else 0.0)
            # An R-hat below 1, which occurs by chance, cannot be drawn on a logarithmic scale.
            shown = np.maximum(values, 1e-4)
            axes.plot(result.curve.wall, shown, ".-", color=chain_color(number), markersize=4, linewidth=1.3)
        axes.set_yscale("log")
        axes.set_ylabel(label)
        tidy(axes)
    grid[0].axhline(R_HAT_LIMIT - 1.0, **TRUTH)
    handles: list[Any] = [*_handles(comparison), Line2D([], [], label="limit of R-hat", **TRUTH)]
    if np.isfinite(comparison.reference.error):
        _reference_error(grid[2], comparison)
        handles.append(Patch(color=FAINT, alpha=0.35, label="error of the reference itself"))
    for axes in grid[-2:]:
        axes.set_xlabel("time since the start of the run [s]")
        axes.tick_params(labelbottom=True)
    legend_above(figure, handles)
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
    handles: list[Any] = [*_handles(comparison), Patch(color=FAINT, alpha=0.35, label="sd of the reference")]
    if comparison.truth is not None:
        handles.append(Line2D([], [], label="truth", **TRUTH))
    legend_above(figure, handles)
    return figure


def _reference_error(axes: Axes, comparison: Comparison) -> None:
    """Mark the Monte Carlo error of the reference, below which it cannot distinguish methods."""
    axes.axhspan(axes.get_ylim()[0], comparison.reference.error, color=FAINT, alpha=0.35, linewidth=0)


def _handles(comparison: Comparison) -> list[Line2D]:
    return [
        Line2D([], [], color=chain_color(number), marker="o", markersize=4, label=str(result.method))
        for number, result in enumerate(comparison.results)
    ]
