"""Figures of a criticism: where, when and in which channel model and log disagree, and which effects explain it."""

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

from pmcl.criticism.findings.parts import Candidate
from pmcl.criticism.findings.result import Criticism
from pmcl.criticism.scoring.scored_log import ScoredLog
from pmcl.logs.joined import first_rows
from pmcl.logs.robot_log import RobotLog
from pmcl.reports.map_drawing import draw_map
from pmcl.reports.style import FAINT, POSTERIOR, legend_above, new_figure, tidy

__all__ = ["plot_candidates", "plot_channels", "plot_gains", "plot_map", "plot_pit"]

Float = NDArray[np.float64]

# Rows over which squared normal scores are averaged.
_WINDOW = 15
# Ticks of the scale of mean squared normal scores.
_SURPRISE_TICKS = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0)
# Columns of the heat map, and most bars of the candidates.
_TIME_BINS = 40
_MOST_CANDIDATES = 14
# Squared normal scores are limited to this, so that single gross errors do not hide all else.
_GREATEST_SQUARE = 40.0
_ACCEPTED, _REJECTED = "#009E73", "#D55E00"
# Greatest difference between the distribution of n PITs and the uniform one in 95 % of samples, times the root of n
# (Kolmogorov).
_KOLMOGOROV = 1.358


def plot_map(criticism: Criticism) -> Figure:
    """Draw the path, coloured by how badly the readings there were predicted, for the base model and the final one.

    The colour is the mean square of the normal scores of the readings' PITs over 15 rows; it is 1 when the model is
    right.
    """
    models = _models(criticism)
    figure = new_figure(4.4)
    grid = figure.subplots(1, len(models), squeeze=False)[0]
    shades = [_surprise(scored) for _, scored in models]
    top = max(2.0, float(np.nanquantile(shades[0], 0.98)))
    for axes, (title, scored), shade in zip(grid, models, shades, strict=True):
        of_map = _draw_map(axes, criticism.log)
        points = scored.path[:, :2]
        # Nobody drives from the end of one log to the start of the next.
        driven = np.setdiff1d(np.arange(1, len(points)), first_rows(criticism.log))
        lines = LineCollection(
            list(np.stack([points[driven - 1], points[driven]], axis=1)),
            cmap="viridis_r", norm=LogNorm(0.5, top), linewidths=2.5,
        )  # fmt: skip
        lines.set_array(shade[driven])
        axes.add_collection(lines)
        axes.autoscale_view()
        axes.set_title(title, fontsize=10)
        tidy(axes)
    bar = figure.colorbar(lines, ax=list(grid), label="mean squared surprise (1: as predicted)", shrink=0.85)
    ticks = [tick for tick in _SURPRISE_TICKS if tick <= top]
    bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
    bar.minorticks_off()
    legend_above(figure, of_map)
    return figure


def plot_channels(criticism: Criticism) -> Figure:
    """Draw a heat map of every channel against time: readings longer than predicted are red, shorter ones blue."""
    models = _models(criticism)
    blocks = [_heat(scored) for _, scored in models]
    labels = blocks[0][0]
    figure = new_figure(1.2 + len(models) * max(1.4, 0.2 * len(labels)))
    grid = figure.subplots(len(models), 1, squeeze=False, sharex=True)[:, 0]
    for axes, (title, _), (_, heat, edges) in zip(grid, models, blocks, strict=True):
        times = criticism.log.times[np.minimum(edges.astype(int), criticism.log.n_steps - 1)]
        mesh = axes.pcolormesh(times, np.arange(len(labels) + 1), heat, cmap="RdBu_r", vmin=-4.0, vmax=4.0)
        for row in first_rows(criticism.log):  # between two logs nothing was read
            axes.axvspan(*criticism.log.times[row - 1 : row + 1], color="white")
        shown = np.arange(0, len(labels), max(1, len(labels) // 16))
        axes.set_yticks(shown + 0.5, [labels[k] for k in shown], fontsize=8)
        axes.set_title(title, fontsize=10)
        tidy(axes)
    grid[-1].set_xlabel("time [s]")
    figure.colorbar(mesh, ax=list(grid), label="mean deviation [its standard errors]", shrink=0.9)
    return figure


def plot_pit(criticism: Criticism) -> Figure:
    """Draw the difference between the PITs' distribution and the uniform one, with a 95 % band."""
    models = _models(criticism)
    kinds = [kind for kind in _kinds(models[0][1]) if kind[1].any()]
    figure = new_figure(3.2)
    for axes, (name, _) in zip(figure.subplots(1, len(kinds), squeeze=False)[0], kinds, strict=True):
        for (title, scored), color in zip(models, (_REJECTED, _ACCEPTED), strict=False):
            selected = dict(_kinds(scored))[name]
            u = np.sort(scored.pit[selected])
            axes.plot(u, np.arange(1, u.size + 1) / u.size - u, color=color, linewidth=1.3, label=title)
        band = _KOLMOGOROV / np.sqrt(u.size)
        axes.axhspan(-band, band, color=FAINT, alpha=0.35, label="95 % of samples without an effect")
        axes.set_title(name, fontsize=10)
        axes.set_xlabel("PIT")
        axes.set_ylabel("difference")
        tidy(axes)
    legend_above(figure, [handle for axes in figure.axes for handle in axes.get_legend_handles_labels()[0]])
    return figure


def plot_candidates(criticism: Criticism, number: int = 0) -> Figure:
    """Draw bars of the greatest scores of one step, and the critical value.

    Parameters
    ----------
    criticism : Criticism
        The result.
    number : int
        The step, from 0.

    Returns
    -------
    Figure
        In 5 % of logs without a missing effect some bar exceeds the critical value.
    """
    step = criticism.steps[number]
    by_score = sorted(step.candidates, key=lambda candidate: -abs(candidate.z))
    # An effect that was added for the gain of its refit may have hardly a score.
    ranked = [
        candidate for k, candidate in enumerate(by_score) if k < _MOST_CANDIDATES or candidate.accepted
    ][::-1]
    figure = new_figure(0.9 + 0.28 * max(3, len(ranked)))
    axes = figure.subplots()
    colors = [_ACCEPTED if candidate.accepted else POSTERIOR for candidate in ranked]
    handles: list[Any] = [Patch(color=POSTERIOR, label="candidate")]
    if any(candidate.accepted for candidate in ranked):
        handles.append(Patch(color=_ACCEPTED, label="added to the model"))
    axes.barh(np.arange(len(ranked)), [abs(candidate.z) for candidate in ranked], color=colors)
    axes.set_yticks(np.arange(len(ranked)), [label_of(candidate) for candidate in ranked], fontsize=9)
    if np.isfinite(step.critical_z):
        handles.append(axes.axvline(step.critical_z, color="black", linestyle=":", label="critical value (5 %)"))
    legend_above(figure, handles)
    axes.set_xlabel("deviation of the score [standard normal]")
    tidy(axes)
    return figure


def plot_gains(criticism: Criticism, number: int = 0) -> Figure:
    """Draw what the refitted candidates of one step gain: log score with two standard errors, and evidence.

    Parameters
    ----------
    criticism : Criticism
        The result.
    number : int
        The step, from 0.
    """
    candidates = criticism.steps[number].candidates
    tried = [candidate for candidate in candidates if np.isfinite(candidate.log_score_gain)][::-1]
    figure = new_figure(0.9 + 0.34 * max(3, len(tried)))
    axes = figure.subplots()
    rows = np.arange(len(tried))
    gain, se = np.array([(c.log_score_gain, c.log_score_gain_se) for c in tried]).reshape(-1, 2).T
    axes.errorbar(gain, rows, xerr=2.0 * se, fmt="o", color=FAINT, label="log score", capsize=2, markersize=4)
    axes.plot([c.evidence for c in tried], rows, "D", color=POSTERIOR, label="evidence", markersize=5)
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.set_yticks(rows, [label_of(candidate) for candidate in tried], fontsize=9)
    axes.set_xlabel("gain [nat]")
    tidy(axes)
    legend_above(figure, axes.get_legend_handles_labels()[0])
    return figure


def label_of(candidate: Candidate) -> str:
    """Return a candidate's name with its place."""
    place = ", ".join(f"{', '.join(f'{value:g}' for value in values)}" for values in candidate.where.values())
    return f"{candidate.name} {place}".strip()


def _models(criticism: Criticism) -> list[tuple[str, ScoredLog]]:
    """Return the log scored under the base model, and under the final one if it differs, with titles."""
    if criticism.first is None or criticism.last is None:
        return []
    before = ("before", criticism.first.scored)
    if criticism.last is criticism.first:
        return [before]
    return [before, ("after", criticism.last.scored)]


def _kinds(scored: ScoredLog) -> list[tuple[str, NDArray[np.bool_]]]:
    """Return the name of each kind of readings, and which readings of it have a PIT, (N,)."""
    predictions = scored.predictions
    return [(name, (predictions.kind == k) & ~np.isnan(scored.pit)) for k, name in enumerate(predictions.kinds)]


def _surprise(scored: ScoredLog) -> Float:
    """Return the mean square of the normal scores around each row, (T,)."""
    time, n_steps = scored.predictions.time, len(scored.path)
    known = ~np.isnan(scored.pit)
    square = np.minimum(special.ndtri(scored.pit[known]) ** 2, _GREATEST_SQUARE)
    window = np.ones(_WINDOW)
    sums = np.convolve(np.bincount(time[known], square, minlength=n_steps), window, mode="same")
    count = np.convolve(np.bincount(time[known], minlength=n_steps).astype(float), window, mode="same")
    return np.where(count > 0, sums / np.maximum(count, 1.0), np.nan)


def _heat(scored: ScoredLog) -> tuple[list[str], Float, Float]:
    """Return labels of the channels, mean normal scores in units of their standard errors, and the bins' edges."""
    predictions, known = scored.predictions, ~np.isnan(scored.pit)
    xi = np.clip(special.ndtri(np.where(known, scored.pit, 0.5)), -6.0, 6.0)
    edges = np.linspace(0.0, len(scored.path), min(_TIME_BINS, len(scored.path)) + 1)
    labels, rows = [], []
    for kind, name in enumerate(predictions.kinds):
        for channel in np.unique(predictions.channel[(predictions.kind == kind) & known]):
            selected = (predictions.kind == kind) & (predictions.channel == channel) & known
            sums = np.histogram(predictions.time[selected], edges, weights=xi[selected])[0]
            count = np.histogram(predictions.time[selected], edges)[0]
            labels.append(f"{name} {channel}")
            rows.append(np.where(count > 0, sums / np.sqrt(np.maximum(count, 1)), np.nan))
    return labels, np.array(rows), edges


def _draw_map(axes: Axes, log: RobotLog) -> list[Any]:
    """Draw the log's map; return its entries for the legend."""
    walls, landmarks = log.walls, log.landmarks
    return draw_map(
        axes,
        walls=None if walls is None else walls.segments,
        landmarks=None if landmarks is None else landmarks.positions,
        grid=log.grid_map,
    )


