"""Figures of the readings against the calibrated model's predictions one step ahead.

They need the group ``predictive_check`` of the posterior: for each channel the normal scores of the readings, which are
independent and standard normal when the model fits.
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray
from scipy import stats

from pmcl.logs.schema import plural_of, readings
from pmcl.posterior.compat import Posterior, find_group
from pmcl.posterior.log_groups import suffixes_for
from pmcl.reports.bands import band_over_time
from pmcl.reports.style import FAINT, POSTERIOR, legend_above, new_figure, tidy

__all__ = ["plot_residuals", "residual_channels"]

Float = NDArray[np.float64]

_TIME_BINS = 60
# Scores beyond this are drawn at the edge.
_LARGEST = 4.0
# What holds 90 % of a standard normal distribution.
_NORMAL_90 = 1.645


def residual_channels(data: Posterior, log: int, n_logs: int) -> dict[str, str]:
    """Give the channels of one log that have been checked.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
    log : int
        Which log, from 0.
    n_logs : int
        How many logs the posterior is of.

    Returns
    -------
    dict of str to str
        Variable in the group ``predictive_check`` to its name in words; empty when the posterior was not checked.
    """
    checked = find_group(data, "predictive_check")
    suffix = suffixes_for(n_logs)[log]
    held = [str(name).removeprefix("residual_").removesuffix(suffix) for name in checked.data_vars]
    named = {f"residual_{kind}{suffix}": plural_of(kind) for kind in readings(held)}
    return {
        variable: words
        for variable, words in named.items()
        if variable in checked and bool(np.isfinite(checked[variable].values).any())
    }


def plot_residuals(data: Posterior, log: int, n_logs: int) -> Figure:
    """Draw the readings' normal scores over time and their distribution, one row for each kind of reading.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
    log : int
        Which log, from 0.
    n_logs : int
        How many logs the posterior is of.

    Returns
    -------
    matplotlib.figure.Figure
    """
    checked = find_group(data, "predictive_check")
    channels = residual_channels(data, log, n_logs)
    figure = new_figure(0.7 + 1.9 * len(channels), 6.4)
    grid = figure.subplots(len(channels), 2, squeeze=False, sharey=True, width_ratios=[4, 1])
    for (left, right), (variable, words) in zip(grid, channels.items(), strict=True):
        values = checked[variable]
        times = np.asarray(values[values.dims[0]].values, dtype=np.float64)
        scores = np.asarray(values.values, dtype=np.float64).reshape(len(times), -1)
        _over_time(left, times, scores)
        _distribution(right, scores)
        left.set_title(f"{words}: correlation with the reading before {_serial_correlation(scores)}", fontsize=9)
        left.set_ylabel("normal score")
        tidy(left)
        tidy(right)
    grid[-1, 0].set_xlabel("time [s]")
    grid[-1, 1].set_xlabel("density")
    handles = [
        Line2D([], [], color=POSTERIOR, label="median of the readings"),
        Patch(color=POSTERIOR, alpha=0.3, label="90 % of the readings"),
        Line2D([], [], color="black", linestyle=":", label="where 90 % of the readings lie when the model fits"),
        Line2D([], [], color="black", linewidth=1.0, label="distribution when the model fits"),
    ]
    legend_above(figure, handles)
    return figure


def _over_time(axes: Axes, times: Float, scores: Float) -> None:
    band = band_over_time(times, np.clip(scores, -_LARGEST, _LARGEST), _TIME_BINS)
    axes.fill_between(band.time, band.low, band.high, color=POSTERIOR, alpha=0.3, linewidth=0, step="mid")
    axes.plot(band.time, band.median, color=POSTERIOR, linewidth=1.3, drawstyle="steps-mid")
    for level in (-_NORMAL_90, _NORMAL_90):
        axes.axhline(level, color="black", linestyle=":", linewidth=1.0)
    axes.axhline(0.0, color=FAINT, linewidth=0.8, zorder=0)
    axes.set_ylim(-_LARGEST, _LARGEST)


def _distribution(axes: Axes, scores: Float) -> None:
    finite = np.clip(scores[np.isfinite(scores)], -_LARGEST, _LARGEST)
    span = (-_LARGEST, _LARGEST)
    axes.hist(finite, bins=32, range=span, density=True, orientation="horizontal", color=POSTERIOR, alpha=0.4)
    height = np.linspace(-_LARGEST, _LARGEST, 161)
    axes.plot(stats.norm.pdf(height), height, color="black", linewidth=1.0)


def _serial_correlation(scores: Float) -> str:
    """Return the correlation of each channel's scores with those of the row before, as text."""
    before, after = scores[:-1], scores[1:]
    both = np.isfinite(before) & np.isfinite(after)
    if both.sum() < 3:
        return "not known"
    return f"{float(np.corrcoef(before[both], after[both])[0, 1]):+.2f}"
