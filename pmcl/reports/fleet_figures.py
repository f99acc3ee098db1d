"""Figures of a fleet: every robot's parameters beside the others' and beside the population."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pmcl.fleet.comparison import Comparison, Member
from pmcl.reports.style import POSTERIOR, PRIOR, legend_above, new_figure, tidy

__all__ = ["plot_fleet"]

_ODD = "#D55E00"
# Panels in a row, and inches for a panel's frame and for each robot in it.
_COLUMNS, _FRAME, _PER_ROBOT = 3, 1.0, 0.17
# Half width of an interval that holds 90 % of a Gaussian [standard deviations].
_NINETY = 1.645


def plot_fleet(comparison: Comparison) -> Figure:
    """Draw a panel for each parameter, with a line for each robot.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    matplotlib.figure.Figure
    """
    names = list(comparison.populations)
    robots = list(dict.fromkeys(member.robot for member in comparison.members))
    rows = -(-len(names) // _COLUMNS)
    figure = new_figure(rows * (_FRAME + _PER_ROBOT * len(robots)) + 0.4)
    grid = figure.subplots(rows, min(_COLUMNS, len(names)), squeeze=False, sharey=True)
    for axes in grid.flat[len(names) :]:
        axes.remove()
    for name, axes in zip(names, grid.flat, strict=False):
        _panel(axes, comparison, name, robots)
    for axes in grid[:, 0]:
        axes.set_yticks(range(len(robots)), robots)
        axes.set_ylim(len(robots) - 0.4, -0.6)
    handles = [
        Line2D([], [], marker="o", color=POSTERIOR, label="robot by itself, 90 %"),
        Line2D([], [], marker="o", color=_ODD, label="stands out"),
        Line2D([], [], color="black", linewidth=1.3, label="typical robot"),
        Patch(color=PRIOR, alpha=0.25, label="90 % of such robots"),
    ]
    legend_above(figure, handles)
    return figure


def _panel(axes: Axes, comparison: Comparison, name: str, robots: list[str]) -> None:
    population = comparison.populations[name]
    low, high = population.new_robot_quantiles((0.05, 0.95))
    axes.axvspan(float(low), float(high), color=PRIOR, alpha=0.25, linewidth=0)
    axes.axvline(float(population.mean_quantiles((0.5,))[0]), color="black", linewidth=1.3)
    members: list[Member] = [member for member in comparison.members if member.parameter == name]
    for member in members:
        row, color = robots.index(member.robot), _ODD if member.stands_out else POSTERIOR
        reach = _NINETY * member.sd
        axes.plot([member.mean - reach, member.mean + reach], [row, row], color=color, linewidth=1.5)
        axes.plot([member.mean], [row], "o", color=color, markersize=4)
    unit = population.line.parameter.unit
    axes.set_xlabel(name if unit == "1" else f"{name} [{unit}]")
    axes.locator_params(axis="x", nbins=4)
    tidy(axes)
