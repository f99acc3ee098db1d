"""One small picture for each effect: the data of a simulated robot with the effect beside the data without it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from pmcl.models.effects.effect import Effect
from pmcl.reports.effect_demonstrations import Demonstration, Simulated, demonstrate
from pmcl.reports.style import FAINT, POSTERIOR, labelled, new_figure, tidy

__all__ = ["EffectPicture", "plot_effect"]

Float = NDArray[np.float64]

_WIDTH, _HEIGHT = 3.6, 2.5
_WITHOUT, _AFFECTED = "#8A8A8A", POSTERIOR
_UNITS = {
    "time": "s", "step": "m", "turn": "rad", "turn of the robot": "rad", "forward error": "m", "turn error": "rad",
    "true range": "m", "range": "m", "range error": "m", "true distance": "m", "distance error": "m",
    "true bearing": "rad", "bearing error": "rad", "apparent size": "pixel",
}  # fmt: skip
_LINE: dict[str, Any] = {"linewidth": 1.2}
_DOTS: dict[str, Any] = {"linestyle": "", "marker": ".", "markersize": 3.5, "alpha": 0.6}
_COUNTED = ("beam", "landmark")
# Rows of a drive that a picture of its path shows: later the two paths only cross.
_PATH_ROWS = 40


@dataclass(frozen=True)
class _View:
    """What a picture shows.

    Attributes
    ----------
    across, up : str
        Columns of :class:`~pmcl.reports.effect_demonstrations.Simulated`; ``"path"`` for the path on the floor,
        ``"points"`` for the places that readings hit.
    quiet : bool
        Whether nearly all noise is left out.
    one : str
        Column of which only one value is shown, such as ``"beam"``: one beam over time.
    line : bool
        Whether points are joined in their order.
    until : float
        Only what is `across` up to here.
    """

    across: str
    up: str = ""
    quiet: bool = True
    one: str = ""
    line: bool = False
    until: float = np.inf


_PATH, _POINTS = _View("path"), _View("points")
_BY_CARRIER = {
    "motion": _PATH,
    "range": _View("true range", "range error", quiet=False),
    "landmark": _View("true distance", "distance error", quiet=False),
    "sensor": _POINTS,
    "map": _POINTS,
}
# Where another view than the carrier's usual one shows the effect better.
_VIEWS = {
    "odometry-latency": _View("time", "turn of the robot", line=True, until=25.0),
    "forward-noise-grows-with-distance": _View("step", "forward error", quiet=False),
    "turn-noise-grows-with-turn": _View("turn", "turn error", quiet=False),
    "turn-noise-grows-with-distance": _View("step", "turn error", quiet=False),
    "wheel-slip": _View("time", "forward error", quiet=False),
    "heavy-tailed-motion-noise": _View("time", "forward error", quiet=False),
    "turn-noise-correlated": _View("time", "turn error", quiet=False),
    "beam-bias": _View("beam", "range error", quiet=False),
    "beam-yaw": _View("beam", "range error", quiet=False),
    "heavy-tailed-range-noise": _View("time", "range error", quiet=False),
    "range-noise-changes-in-time": _View("time", "range error", quiet=False),
    "range-bias-drifts": _View("time", "range error", quiet=False),
    "range-noise-correlated": _View("time", "range error", quiet=False, one="beam", line=True),
    "quantized-readings": _View("true range", "range"),
    "random-readings": _View("true range", "range", quiet=False),
    "short-readings": _View("true range", "range", quiet=False),
    "max-range-readings": _View("true range", "range", quiet=False),
    "dead-beam": _View("beam", "range", quiet=False),
    "cross-talk": _View("true range", "range", quiet=False),
    "specular-reflection": _View("true range", "range", quiet=False),
    "beam-width": _POINTS,
    "range-is-depth": _View("true bearing", "distance error"),
    "bearing-bias": _View("true bearing", "bearing error", quiet=False),
    "landmark-size-scale": _View("true distance", "apparent size", quiet=False),
    "bearing-noise-falls-with-range": _View("true distance", "bearing error", quiet=False),
    "landmark-noise-correlated": _View("time", "distance error", quiet=False, one="landmark", line=True),
    "landmark-misread": _View("time", "distance error", quiet=False),
}


class EffectPicture(NamedTuple):
    """A picture of an effect.

    Attributes
    ----------
    figure : matplotlib.figure.Figure
    caption : str
        What was simulated, with the size of the effect.
    """

    figure: Figure
    caption: str


def plot_effect(effect: Effect) -> EffectPicture | None:
    """Draw what an effect does to the data of a simulated robot.

    Parameters
    ----------
    effect : Effect
        Of the catalogue or one's own.

    Returns
    -------
    EffectPicture or None
        None when no simulated robot can show the effect (:func:`pmcl.reports.effect_demonstrations.demonstrate`).
    """
    view = _VIEWS.get(effect.name, _BY_CARRIER.get(effect.carrier, _POINTS))
    shown = demonstrate(effect, quiet=view.quiet)
    if shown is None:
        return None
    figure = new_figure(_HEIGHT, _WIDTH)
    axes = figure.subplots()
    if view.across == "path":
        _draw_paths(axes, shown)
    elif view.across == "points":
        _draw_points(axes, shown)
    else:
        _draw_columns(axes, shown, view)
    tidy(axes)
    axes.tick_params(labelsize=8)
    axes.xaxis.label.set_fontsize(9)
    axes.yaxis.label.set_fontsize(9)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.yaxis.set_major_locator(MaxNLocator(5))
    figure.legend(
        loc="outside upper center",
        ncols=3,
        frameon=False,
        fontsize=8,
        handletextpad=0.3,
        columnspacing=1.0,
        markerscale=1.5,
    )
    return EffectPicture(figure, _caption(shown, view))


def _caption(shown: Demonstration, view: _View) -> str:
    sizes = ", ".join(
        f"{parameter.name} = {value:.3g}{'' if parameter.unit == '1' else ' ' + parameter.unit}"
        for parameter, value in zip(shown.effect.parameters, shown.values, strict=True)
    )
    what = {
        "path": "Where odometry says that the robot went, and where it really went",
        "points": "Where readings put what they hit, seen from the robot's true poses",
    }.get(view.across, f"{view.up} against {view.across}".capitalize())
    return f"{what} ({sizes})."


def _draw_paths(axes: Axes, shown: Demonstration) -> None:
    rows = slice(0, _PATH_ROWS)
    for drive, color, label in ((shown.without, _WITHOUT, "odometry"), (shown.affected, _AFFECTED, "real path")):
        axes.plot(drive.path[rows, 0], drive.path[rows, 1], color=color, linewidth=1.6, label=label)
    axes.plot(*shown.without.path[0, :2], "o", color="black", markersize=4, label="start")
    if "place" in shown.effect.where:
        x, y, radius = shown.values[-3:]
        axes.add_patch(Circle((x, y), radius, color=FAINT, alpha=0.4, linewidth=0, label="patch"))
    _metric(axes)


def _draw_points(axes: Axes, shown: Demonstration) -> None:
    walls, landmarks = shown.log.walls, shown.log.landmarks
    if walls is not None:
        axes.add_collection(LineCollection(list(walls.segments), colors="black", linewidths=1.0, label="walls"))
    if landmarks is not None:
        axes.plot(*landmarks.positions.T, "^", color="black", markersize=4, label="landmarks")
    for drive, color, label in ((shown.affected, _AFFECTED, "with the effect"), (shown.without, _WITHOUT, "without")):
        axes.plot(*drive.points.T, ".", color=color, markersize=3.0, alpha=0.7, label=label)
    _metric(axes)


def _metric(axes: Axes) -> None:
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def _draw_columns(axes: Axes, shown: Demonstration, view: _View) -> None:
    # What is the same in both is drawn in grey, on top.
    drives = ((shown.affected, _AFFECTED, "with the effect", 0.15), (shown.without, _WITHOUT, "without", -0.15))
    for drive, color, label, aside in drives:
        across, up = _chosen(drive, view)
        if view.across in _COUNTED:
            across = across + aside
        axes.plot(across, up, color=color, label=label, **(_LINE if view.line else _DOTS))
    axes.set_xlabel(labelled(view.across, _UNITS.get(view.across, "")))
    axes.set_ylabel(labelled(view.up, _UNITS.get(view.up, "")))


def _chosen(drive: Simulated, view: _View) -> tuple[Float, Float]:
    across, up = drive.columns[view.across], drive.columns[view.up]
    if view.one:
        channel = drive.columns[view.one]
        most_read = channel == np.bincount(channel.astype(int)).argmax()
        across, up = across[most_read], up[most_read]
    early = across <= view.until
    across, up = across[early], up[early]
    if view.line:
        # No line over rows at which nothing was read.
        gaps = np.flatnonzero(np.diff(across) > 1.5 * np.diff(across).min()) + 1
        across, up = np.insert(across, gaps, np.nan), np.insert(up, gaps, np.nan)
    return across, up
