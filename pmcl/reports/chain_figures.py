"""Figures about how the chains moved: traces, ranks, autocorrelation, growth of the effective sample size."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from scipy import stats

from pmcl.posterior.access import log_joint, parameter_names, parameter_units, theta_draws, true_theta
from pmcl.posterior.compat import Posterior, bulk_ess, tail_ess
from pmcl.posterior.diagnostics import ESS_LIMIT
from pmcl.reports.style import (
    FAINT,
    POSTERIOR,
    TRUTH,
    chain_color,
    evenly_spaced,
    labelled,
    legend_above,
    new_figure,
    tidy,
)

__all__ = ["plot_autocorrelation", "plot_ess_evolution", "plot_rank", "plot_trace"]

Float = NDArray[np.float64]

# Panels in a row, in the order of preference; none that leaves a single panel in the last row is taken.
_COLUMNS = (4, 3, 5)
# Letters that fit above a panel.
_WIDEST_TITLE = 24
# Blocks of draws whose medians a trace shows.
_BLOCKS = 25


def plot_trace(data: Posterior) -> Figure:
    """Draws of each parameter, and of the log joint density, in the order of sampling, with their histograms.

    Bold lines are the medians of blocks of draws.

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
    truth = true_theta(data)
    rows = [
        (labelled(name, unit, narrow=True), theta_draws(data)[..., index], truth.get(name))
        for index, (name, unit) in enumerate(zip(parameter_names(data), parameter_units(data), strict=True))
    ]
    densities = log_joint(data)
    if densities is not None:
        rows.append((labelled("log joint", "nat", narrow=True), densities, None))
    figure = new_figure(0.6 + 1.45 * len(rows))
    grid = figure.subplots(len(rows), 2, squeeze=False, sharey="row", width_ratios=[5, 1])
    for (left, right), (label, draws, true) in zip(grid, rows, strict=True):
        shown = evenly_spaced(draws.shape[1], 1500)
        bins = _bins(draws)
        for chain, values in enumerate(draws):
            color = chain_color(chain)
            left.plot(shown, values[shown], color=color, linewidth=0.5, alpha=0.3)
            blocks = np.array_split(np.arange(len(values)), min(_BLOCKS, len(values)))
            medians = [np.median(values[block]) for block in blocks]
            left.plot([block.mean() for block in blocks], medians, color=color, linewidth=1.6)
            if bins is not None:
                right.hist(values, bins=bins, orientation="horizontal", histtype="step", color=color)
        for axes in (left, right):
            if true is not None:
                axes.axhline(true, **TRUTH)
            tidy(axes)
        left.set_ylabel(label, fontsize=9)
        left.margins(x=0.01)
        right.tick_params(labelbottom=False)
    for left in grid[:-1, 0]:
        left.tick_params(labelbottom=False)
    grid[-1, 0].set_xlabel("draw")
    grid[-1, 1].set_xlabel("count")
    figure.align_ylabels(list(grid[:, 0]))
    handles = _chain_handles(data, with_truth=bool(set(truth) & set(parameter_names(data))))
    handles += [
        Line2D([], [], color=FAINT, linewidth=0.8, label="draws"),
        Line2D([], [], color=FAINT, linewidth=2.0, label="medians of blocks"),
    ]
    legend_above(figure, handles)
    return figure


def plot_rank(data: Posterior) -> Figure:
    """Histogram of each chain's ranks among the draws of all chains; chains that agree give flat histograms.

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
    theta, names = theta_draws(data), parameter_names(data)
    n_chains, n_draws, _ = theta.shape
    n_bins = int(np.clip(n_draws // 20, 2, 20))
    edges = np.linspace(0.0, n_chains * n_draws, n_bins + 1)
    figure, panels = _panels(len(names), 0.9 + 0.45 * n_chains)
    ranks = np.apply_along_axis(stats.rankdata, 0, theta.reshape(-1, len(names))).reshape(theta.shape) - 0.5
    # Height 1 is a flat histogram. Each chain has a lane of its own, which the tallest bar of all just fits.
    heights = np.apply_along_axis(lambda r: np.histogram(r, bins=edges)[0] / (n_draws / n_bins), 1, ranks)
    flat = min(0.4, 0.95 / heights.max())
    for index, (axes, name) in enumerate(zip(panels, names, strict=True)):
        for chain in range(n_chains):
            axes.bar(
                edges[:-1],
                flat * heights[chain, :, index],
                width=np.diff(edges),
                bottom=chain,
                align="edge",
                color=chain_color(chain),
                edgecolor="white",
                linewidth=0.4,
            )
            axes.axhline(chain + flat, color="black", linewidth=0.7, alpha=0.6)
        axes.set_ylim(0.0, n_chains)
        axes.set_title(_title(name), fontsize=10)
        axes.set_yticks(np.arange(n_chains) + flat, [str(chain) for chain in range(n_chains)])
        axes.set_ylabel("chain")
        axes.set_xlabel("rank among all draws")
        axes.xaxis.set_major_locator(MaxNLocator(3))
        tidy(axes)
    flat_line = Line2D([], [], color="black", linewidth=0.7, label="all bars are this high when the chains agree")
    legend_above(figure, [*_chain_handles(data, with_truth=False), flat_line])
    return figure


def plot_autocorrelation(data: Posterior) -> Figure:
    """Correlation of a draw with the draws after it, per parameter and chain.

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
    theta, names = theta_draws(data), parameter_names(data)
    correlation = autocorrelation(theta)
    # Up to three times the lag at which the autocorrelation of the slowest parameter has vanished.
    slow = np.abs(correlation.mean(axis=0)).max(axis=-1) > 0.05
    forgotten = int(np.argmin(slow)) if not slow.all() else len(slow)
    n_lags = min(len(slow), max(20, 3 * forgotten))
    figure, panels = _panels(len(names), 2.3)
    for index, (axes, name) in enumerate(zip(panels, names, strict=True)):
        axes.axhline(0.0, color=FAINT, linewidth=0.8)
        lags, of_chains = np.arange(n_lags), correlation[:, :n_lags, index]
        axes.fill_between(lags, of_chains.min(axis=0), of_chains.max(axis=0), alpha=0.3, linewidth=0, color=POSTERIOR)
        axes.plot(lags, of_chains.mean(axis=0), color=POSTERIOR, linewidth=1.4)
        axes.set_title(_title(name), fontsize=10)
        axes.set_xlabel("lag [draws]")
        axes.set_ylabel("autocorrelation")
        axes.set_ylim(-0.3, 1.02)
        tidy(axes)
    handles = [
        Line2D([], [], color=POSTERIOR, label="mean of the chains"),
        Patch(color=POSTERIOR, alpha=0.3, label="least to greatest of the chains"),
    ]
    legend_above(figure, handles)
    return figure


def plot_ess_evolution(data: Posterior) -> Figure:
    """How the effective number of draws grows with the draws; it should grow in proportion.

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
    theta, names = theta_draws(data), parameter_names(data)
    lengths = np.unique(np.linspace(theta.shape[1] / 6, theta.shape[1], 6).astype(int))
    figure = new_figure(3.0)
    for axes, measure, title in zip(figure.subplots(1, 2), (bulk_ess, tail_ess), ("bulk", "tails"), strict=True):
        for index, name in enumerate(names):
            growth = [measure(np.ascontiguousarray(theta[:, :length, index])) for length in lengths]
            axes.plot(lengths, growth, "o-", color=chain_color(index), label=name, markersize=4)
        axes.axhline(ESS_LIMIT, color="black", linestyle=":", label=f"at least {ESS_LIMIT:.0f} are required")
        axes.set_xlim(0, None)
        axes.set_ylim(0, None)
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("draws per chain")
        axes.set_ylabel("effective draws, all chains")
        tidy(axes)
    legend_above(figure, figure.axes[0].get_lines())
    return figure


def autocorrelation(theta: Float) -> Float:
    """Autocorrelation of each chain by the fast Fourier transform.

    Parameters
    ----------
    theta : ndarray, shape (K, N, d)

    Returns
    -------
    ndarray, shape (K, max(N // 2, 1), d)
        At lags 0, 1, ...; 1 at lag 0, and zero elsewhere for a chain that never moved.
    """
    n_draws = theta.shape[1]
    centred = theta - theta.mean(axis=1, keepdims=True)
    # Twice the length, so that the end of a chain does not overlap its beginning.
    spectrum = np.fft.rfft(centred, n=2 * n_draws, axis=1)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2, axis=1)[:, : max(n_draws // 2, 1)]
    variance = covariance[:, :1]
    moved = variance > 0.0
    result = np.where(moved, covariance / np.where(moved, variance, 1.0), 0.0)
    result[:, 0] = 1.0
    return np.asarray(result, dtype=np.float64)


def _panels(count: int, height: float) -> tuple[Figure, list[Axes]]:
    fitting = [columns for columns in _COLUMNS if count % columns != 1]
    columns = min(count, fitting[0] if fitting else _COLUMNS[0])
    rows = -(-count // columns)
    figure = new_figure(0.5 + height * rows)
    panels = list(figure.subplots(rows, columns, squeeze=False).flat)
    for unused in panels[count:]:
        unused.remove()
    return figure, panels[:count]


def _title(name: str) -> str:
    """Return the title of a panel, in several lines when the name is wider than the panel."""
    return name if len(name) <= _WIDEST_TITLE else labelled(name, "", narrow=True)


def _bins(draws: Float) -> Float | None:
    finite = draws[np.isfinite(draws)]
    if finite.size == 0 or finite.min() == finite.max():
        return None
    return np.linspace(finite.min(), finite.max(), 31)


def _chain_handles(data: Posterior, *, with_truth: bool) -> list[Line2D]:
    n_chains = theta_draws(data).shape[0]
    handles = [Line2D([], [], color=chain_color(chain), label=f"chain {chain}") for chain in range(n_chains)]
    return handles + ([Line2D([], [], **TRUTH, label="true value")] if with_truth else [])
