"""Figures of a criticism: where, when and in which channel model and log disagree, and what explains it."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray
from scipy import special

from pmcl.criticism.scoring.scored_log import Evidence
from pmcl.criticism.findings.result import Candidate, Criticism
from pmcl.reports.style import FAINT, POSTERIOR, legend_above, new_figure, tidy

__all__ = ["plot_candidates", "plot_channels", "plot_gains", "plot_map", "plot_pit"]

Float = NDArray[np.float64]

_WINDOW = 15
# Where the scale of surprise has ticks.
_SURPRISE_TICKS = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0)
_TIME_BINS = 40
_MOST_CANDIDATES = 14
_ACCEPTED, _REJECTED = "#009E73", "#D55E00"
# Of what a PIT's distribution may differ from the uniform one in 95 % of samples of size n, times the root of n.
_KOLMOGOROV = 1.358


def plot_map(found: Criticism) -> Figure:
    """Draw the path, coloured by how badly the readings there were foreseen, before and after.

    The colour is the mean square of the normal scores of the readings' PITs over some rows: 1 is as it should be.
    """
    passes = _passes(found)
    figure = new_figure(4.4)
    grid = figure.subplots(1, len(passes), squeeze=False)[0]
    shades = [_surprise(evidence) for _, evidence in passes]
    top = max(2.0, float(np.nanquantile(shades[0], 0.98)))
    for axes, (title, evidence), shade in zip(grid, passes, shades, strict=True):
        _draw_map(axes, found)
        points = evidence.path[:, :2]
        lines = LineCollection(
            list(np.stack([points[:-1], points[1:]], axis=1)), cmap="viridis_r", norm=LogNorm(0.5, top), linewidths=2.5
        )
        lines.set_array(shade[1:])
        axes.add_collection(lines)
        axes.autoscale_view()
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("x [m]")
        axes.set_ylabel("y [m]")
        tidy(axes)
    bar = figure.colorbar(lines, ax=list(grid), label="mean squared surprise (1: as foreseen)", shrink=0.85)
    ticks = [tick for tick in _SURPRISE_TICKS if tick <= top]
    bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
    bar.minorticks_off()
    legend_above(figure, [*grid[0].collections, *grid[0].get_lines()])
    return figure


def plot_channels(found: Criticism) -> Figure:
    """Heat map of every channel against time: readings longer than foreseen are red, shorter ones blue."""
    passes = _passes(found)
    blocks = [_heat(evidence) for _, evidence in passes]
    labels = blocks[0][0]
    figure = new_figure(1.2 + len(passes) * max(1.4, 0.2 * len(labels)))
    grid = figure.subplots(len(passes), 1, squeeze=False, sharex=True)[:, 0]
    for axes, (title, _), (_, heat, edges) in zip(grid, passes, blocks, strict=True):
        times = found.log.times[np.minimum(edges.astype(int), found.log.n_steps - 1)]
        mesh = axes.pcolormesh(times, np.arange(len(labels) + 1), heat, cmap="RdBu_r", vmin=-4.0, vmax=4.0)
        shown = np.arange(0, len(labels), max(1, len(labels) // 16))
        axes.set_yticks(shown + 0.5, [labels[k] for k in shown], fontsize=8)
        axes.set_title(title, fontsize=10)
        tidy(axes)
    grid[-1].set_xlabel("time [s]")
    figure.colorbar(mesh, ax=list(grid), label="mean deviation [its standard errors]", shrink=0.9)
    return figure


def plot_pit(found: Criticism) -> Figure:
    """Difference of the PITs' distribution from the uniform one, before and after, with a 95 % band."""
    passes = _passes(found)
    kinds = [kind for kind in _kinds(passes[0][1]) if kind[1].any()]
    figure = new_figure(3.2)
    for axes, (name, _) in zip(figure.subplots(1, len(kinds), squeeze=False)[0], kinds, strict=True):
        for (title, evidence), color in zip(passes, (_REJECTED, _ACCEPTED), strict=False):
            mine = dict(_kinds(evidence))[name]
            u = np.sort(evidence.pit[mine])
            axes.plot(u, np.arange(1, u.size + 1) / u.size - u, color=color, linewidth=1.3, label=title)
        band = _KOLMOGOROV / np.sqrt(u.size)
        axes.axhspan(-band, band, color=FAINT, alpha=0.35, label="95 % of samples without an effect")
        axes.set_title(name, fontsize=10)
        axes.set_xlabel("PIT")
        axes.set_ylabel("difference")
        tidy(axes)
    legend_above(figure, [handle for axes in figure.axes for handle in axes.get_legend_handles_labels()[0]])
    return figure


def plot_candidates(found: Criticism, number: int = 0) -> Figure:
    """Bars of the greatest scores of one step, with the line that 5 % of logs without an effect cross."""
    step = found.steps[number]
    by_score = sorted(step.candidates, key=lambda one: -abs(one.z))
    # One that was added for what its refit showed may have hardly a score.
    ranked = [one for k, one in enumerate(by_score) if k < _MOST_CANDIDATES or one.accepted][::-1]
    figure = new_figure(0.9 + 0.28 * max(3, len(ranked)))
    axes = figure.subplots()
    colors = [_ACCEPTED if one.accepted else POSTERIOR for one in ranked]
    handles: list[Any] = [Patch(color=POSTERIOR, label="candidate")]
    if any(one.accepted for one in ranked):
        handles.append(Patch(color=_ACCEPTED, label="added to the model"))
    axes.barh(np.arange(len(ranked)), [abs(one.z) for one in ranked], color=colors)
    axes.set_yticks(np.arange(len(ranked)), [label_of(one) for one in ranked], fontsize=9)
    if np.isfinite(step.critical_z):
        handles.append(axes.axvline(step.critical_z, color="black", linestyle=":", label="critical value (5 %)"))
    legend_above(figure, handles)
    axes.set_xlabel("deviation of the score [standard normal]")
    tidy(axes)
    return figure


def plot_gains(found: Criticism, number: int = 0) -> Figure:
    """Gains of the refitted candidates of one step on both parts of the log, with two standard errors."""
    tried = [one for one in found.steps[number].candidates if np.isfinite(one.log_score_gain)][::-1]
    figure = new_figure(0.9 + 0.34 * max(3, len(tried)))
    axes = figure.subplots()
    rows = np.arange(len(tried))
    for offset, color, label, values in (
        (0.13, FAINT, "fit part", [(one.fit_gain, one.fit_gain_se) for one in tried]),
        (-0.13, POSTERIOR, "held-out part", [(one.log_score_gain, one.log_score_gain_se) for one in tried]),
    ):
        gain, se = np.array(values).reshape(-1, 2).T
        axes.errorbar(gain, rows + offset, xerr=2.0 * se, fmt="o", color=color, label=label, capsize=2, markersize=4)
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.set_yticks(rows, [label_of(one) for one in tried], fontsize=9)
    axes.set_xlabel("gain in log score [nat]")
    tidy(axes)
    legend_above(figure, axes.get_legend_handles_labels()[0])
    return figure


def label_of(one: Candidate) -> str:
    """Return a candidate's name with its place."""
    place = ", ".join(f"{', '.join(f'{value:g}' for value in values)}" for values in one.where.values())
    return f"{one.name} {place}".strip()


def _passes(found: Criticism) -> list[tuple[str, Evidence]]:
    before = ("before", found.first.evidence)
    if found.last is found.first:
        return [before]
    return [before, ("after", found.last.evidence)]


def _kinds(evidence: Evidence) -> list[tuple[str, NDArray[np.bool_]]]:
    made = evidence.predictions
    return [(name, (made.kind == k) & ~np.isnan(evidence.pit)) for k, name in enumerate(made.kinds)]


def _surprise(evidence: Evidence) -> Float:
    """Return the mean square of the normal scores around each row, (T,)."""
    time, n_steps = evidence.predictions.time, len(evidence.path)
    known = ~np.isnan(evidence.pit)
    square = np.minimum(special.ndtri(evidence.pit[known]) ** 2, 40.0)
    window = np.ones(_WINDOW)
    sums = np.convolve(np.bincount(time[known], square, minlength=n_steps), window, mode="same")
    count = np.convolve(np.bincount(time[known], minlength=n_steps).astype(float), window, mode="same")
    return np.where(count > 0, sums / np.maximum(count, 1.0), np.nan)


def _heat(evidence: Evidence) -> tuple[list[str], Float, Float]:
    """Return labels of the channels, mean normal scores in units of their standard errors, and the bins' edges."""
    made, known = evidence.predictions, ~np.isnan(evidence.pit)
    xi = np.clip(special.ndtri(np.where(known, evidence.pit, 0.5)), -6.0, 6.0)
    edges = np.linspace(0.0, len(evidence.path), min(_TIME_BINS, len(evidence.path)) + 1)
    labels, rows = [], []
    for kind, name in enumerate(made.kinds):
        for channel in np.unique(made.channel[(made.kind == kind) & known]):
            mine = (made.kind == kind) & (made.channel == channel) & known
            sums = np.histogram(made.time[mine], edges, weights=xi[mine])[0]
            count = np.histogram(made.time[mine], edges)[0]
            labels.append(f"{name} {channel}")
            rows.append(np.where(count > 0, sums / np.sqrt(np.maximum(count, 1)), np.nan))
    return labels, np.array(rows), edges


def _draw_map(axes: Axes, found: Criticism) -> None:
    if found.log.walls is not None:
        walls = list(found.log.walls.segments)
        axes.add_collection(LineCollection(walls, colors="black", linewidths=1.0, label="walls"))
    if found.log.landmarks is not None:
        axes.plot(*found.log.landmarks.positions.T, "^", color="black", markersize=5, label="landmarks")


