"""One page about a posterior: verdict first, then numbers, pictures and the settings that made them."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from pmcl.posterior.access import log_suffixes, parameter_names
from pmcl.posterior.compat import Posterior, find_group
from pmcl.posterior.diagnostics import summarize, verdict
from pmcl.posterior.settings import settings
from pmcl.reports.figures import (
    plot_autocorrelation,
    plot_ess_evolution,
    plot_pair,
    plot_rank,
    plot_trace,
    plot_trajectory,
)
from pmcl.reports.html import embedded, page, write_page
from pmcl.reports.tables import parameter_table, summary_text

__all__ = ["Picture", "summary_text", "write_report"]

# Pictures of more logs than this make the page heavy and say little new.
_MOST_LOGS = 6


class Picture(NamedTuple):
    """A figure ready for the page.

    Attributes
    ----------
    title, caption : str
    source : str
        The image itself, as a ``data:`` address.
    """

    title: str
    caption: str
    source: str


def write_report(data: Posterior, path: str | os.PathLike[str]) -> None:
    """Write one self-contained HTML file about a posterior.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
    path : path-like
        An older file of that name stays whole until the new one is complete.

    Raises
    ------
    PosteriorError
        If the posterior holds no draws, or the file cannot be written.
    """
    summary = summarize(data)
    n_chains, n_draws = summary.attrs["chains"], summary.attrs["draws"]
    text = page(
        "posterior.html.j2",
        title="Posterior of the noise model",
        verdict=verdict(data, summary),
        size=f"{n_chains} chains of {n_draws} draws",
        table=parameter_table(data, summary, complete=True),
        figures=_pictures(data),
        chains=range(n_chains),
        moves=_moves(data),
        priors=_priors(data),
        settings=sorted(settings(data).items()),
    )
    write_page(text, path)


_CHAPTERS: tuple[tuple[str, Callable[[Posterior], Figure], str], ...] = (
    (
        "Parameters against each other",
        plot_pair,
        "Dots are draws, coloured by chain; histograms show each parameter alone, with its prior density in grey. "
        "A narrow posterior on a flat prior was learnt from the log. Numbers are correlations.",
    ),
    (
        "Traces",
        plot_trace,
        "Draws in the order they were made. Chains that have converged look alike, without drift; "
        "one whose log joint density stays below the others is lost.",
    ),
    (
        "Ranks",
        plot_rank,
        "Where the draws of each chain rank among the draws of all. Chains whose bars follow the line agree.",
    ),
    (
        "Autocorrelation",
        plot_autocorrelation,
        "How long a draw is remembered. The sooner the lines reach zero, the more each draw is worth.",
    ),
    (
        "Growth of the effective sample size",
        plot_ess_evolution,
        "It should grow in proportion to the draws; a line that bends down tells of places not yet visited.",
    ),
)


def _pictures(data: Posterior) -> list[Picture]:
    pictures = [Picture(title, caption, embedded(draw(data))) for title, draw, caption in _CHAPTERS]
    n_logs = len(log_suffixes(data))
    for log in range(min(n_logs, _MOST_LOGS)):
        title = "Trajectory" if n_logs == 1 else f"Trajectory of log {log} of {n_logs}"
        caption = (
            "Where the robot was, given the log. Right: posterior standard deviation of position and heading over "
            "time, with the error of the mean path where a reference is known."
        )
        if log == _MOST_LOGS - 1 and n_logs > _MOST_LOGS:
            caption += f" The other {n_logs - _MOST_LOGS} logs are not shown."
        pictures.append(Picture(title, caption, embedded(plot_trajectory(data, log))))
    return pictures


def _moves(data: Posterior) -> list[tuple[str, list[str]]]:
    """Mean of each statistic in each chain."""
    rows = []
    for name, values in find_group(data, "sample_stats").data_vars.items():
        if "draw" not in values.dims or values.dtype.kind not in "fiub":
            continue
        means = values.astype(np.float64).mean(dim="draw")
        if means.dims == ("chain",):
            rows.append((str(name), [_number(value) for value in means.values]))
        elif set(means.dims) == {"chain", "parameter"}:
            rows += [
                (f"{name}, {parameter}", [_number(value) for value in means.sel(parameter=parameter).values])
                for parameter in means["parameter"].values
            ]
    return rows


def _number(value: float) -> str:
    return f"{value:.4g}" if np.isfinite(value) else "-"


def _priors(data: Posterior) -> list[tuple[str, str, str]]:
    posterior = find_group(data, "posterior")
    rows = [
        (name, str(posterior[name].attrs.get("long_name", "")), str(posterior[name].attrs.get("prior", "")))
        for name in parameter_names(data)
    ]
    return [row for row in rows if row[1] or row[2]]
