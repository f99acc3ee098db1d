"""The figure of a robot's path, its uncertainty, and its distance from the reference."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from pmcl.geometry import wrap
from pmcl.posterior.access import log_suffixes, trajectory_draws
from pmcl.posterior.compat import Posterior, find_group
from pmcl.posterior.estimates import PathSummary, path_summary
from pmcl.posterior.log_groups import stored_grid
from pmcl.reports.bands import band_over_time
from pmcl.reports.map_drawing import draw_map
from pmcl.reports.style import POSTERIOR, evenly_spaced, legend_above, new_figure, tidy

__all__ = ["plot_trajectory"]

Float = NDArray[np.float64]

# More ellipses than this along a path only merge into one band.
_MOST_ELLIPSES = 80
# Bins of time in which errors are drawn as a median and a band.
_TIME_BINS = 60
# Half axis of the ellipse that holds 90 % of a Gaussian in two dimensions, in standard deviations.
_ELLIPSE_90 = 2.146
_ERROR = "#D55E00"


def plot_trajectory(data: Posterior, log: int = 0) -> Figure:
    """Draw the robot's path on the map, how well it is known over time, and how far the mean is from the true path.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
    log : int
        Position of the log, from 0.

    Returns
    -------
    matplotlib.figure.Figure
        Map above, standard deviations and errors of position and heading below.

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
    figure = new_figure(7.6, 6.4)
    panels = figure.subplot_mosaic([["map", "map"], ["position", "heading"]], height_ratios=[3, 1])
    of_map = _draw_map(panels["map"], data, suffix)
    stored = np.asarray(trajectory_draws(data, log).values, dtype=np.float64)
    handles = _draw_path(panels["map"], stored.reshape(-1, *stored.shape[2:]), path, truth)
    handles += _draw_spread(panels["position"], panels["heading"], path, truth)
    of_path = [line for line in panels["map"].get_lines() if line not in of_map]
    legend_above(figure, [*of_map, *of_path, *handles])
    return figure


def _draw_map(axes: Axes, data: Posterior, suffix: str) -> list[Any]:
    """Draw the map that the posterior holds; return its entries for the legend."""
    constants = find_group(data, "constant_data")
    walls, landmarks = (
        constants[f"{name}{suffix}"].values if f"{name}{suffix}" in constants else None
        for name in ("wall", "landmark_position")
    )
    entries = draw_map(axes, walls=walls, landmarks=landmarks, grid=stored_grid(constants, suffix))
    tidy(axes)
    return entries


def _draw_path(axes: Axes, paths: Float, path: PathSummary, truth: Float | None) -> list[Any]:
    """Draw the mean path in its 90 % ellipses; return the ellipses' entry for the legend."""
    rows = evenly_spaced(len(path.times), _MOST_ELLIPSES)
    axes.add_collection(_ellipses(axes, paths[:, rows, :2], path.mean[rows, :2]))
    if truth is not None:
        # The reference is drawn below the mean path, so that it is visible only where the two differ.
        axes.plot(truth[:, 0], truth[:, 1], color="black", linewidth=1.0, label="true path")
    axes.plot(path.mean[:, 0], path.mean[:, 1], color=POSTERIOR, linewidth=1.1, label="mean path")
    marks: dict[str, Any] = {"color": POSTERIOR, "markersize": 8, "linestyle": "", "zorder": 4}
    axes.plot(*path.mean[0, :2], marker="o", markerfacecolor="white", label="start", **marks)
    axes.plot(*path.mean[-1, :2], marker="s", label="end", **marks)
    axes.autoscale_view()
    return [Patch(color=POSTERIOR, alpha=0.3, label="90 % ellipses of the position")]


def _ellipses(axes: Axes, positions: Float, centres: Float) -> EllipseCollection:
    """Return the ellipses that hold 90 % of Gaussians with the covariances of `positions` (paths, rows, 2)."""
    offset = positions - positions.mean(axis=0)
    covariance = np.einsum("kri,krj->rij", offset, offset) / len(positions)
    variances, directions = np.linalg.eigh(covariance)
    axis_lengths = 2.0 * _ELLIPSE_90 * np.sqrt(np.maximum(variances, 0.0))
    angles = np.degrees(np.arctan2(directions[:, 1, 1], directions[:, 0, 1]))
    return EllipseCollection(
        axis_lengths[:, 1], axis_lengths[:, 0], angles, units="xy", offsets=centres, transOffset=axes.transData,
        facecolors=POSTERIOR, alpha=0.25, linewidths=0.0,
    )  # fmt: skip


def _draw_spread(position: Axes, heading: Axes, path: PathSummary, truth: Float | None) -> list[Any]:
    """Draw standard deviations and errors over time; return their entries for the legend."""
    handles: list[Any] = [Line2D([], [], color=POSTERIOR, label="posterior standard deviation")]
    position.plot(path.times, np.hypot(path.sd[:, 0], path.sd[:, 1]), color=POSTERIOR, linewidth=1.0, zorder=3)
    heading.plot(path.times, path.sd[:, 2], color=POSTERIOR, linewidth=1.0, zorder=3)
    if truth is not None:
        offset = path.mean - truth
        for axes, error in ((position, np.hypot(offset[:, 0], offset[:, 1])), (heading, np.abs(wrap(offset[:, 2])))):
            band = band_over_time(path.times, error, _TIME_BINS)
            axes.fill_between(band.time, band.low, band.high, color=_ERROR, alpha=0.2, linewidth=0)
            axes.plot(band.time, band.median, color=_ERROR, linewidth=1.2)
        handles.append(Line2D([], [], color=_ERROR, label="error of the mean path (median and 90 % band)"))
    position.set_ylabel("position [m]")
    heading.set_ylabel("heading [rad]")
    for axes in (position, heading):
        axes.set_xlabel("time [s]")
        axes.set_ylim(0, None)
        tidy(axes)
    return handles
