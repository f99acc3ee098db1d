"""An HTML page about a posterior: verdict, path, parameters, readings, chains and settings, in this order."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from pmcl.posterior.access import log_suffixes, parameter_names
from pmcl.posterior.compat import Posterior, find_group
from pmcl.posterior.diagnostics import summarize, verdict
from pmcl.posterior.settings import settings
from pmcl.reports.figures import (
    plot_autocorrelation,
    plot_ess_evolution,
    plot_marginals,
    plot_pair,
    plot_rank,
    plot_trace,
    plot_trajectory,
)
from pmcl.reports.html import Picture, page, picture, write_page
from pmcl.reports.log_summary import LogSummary, log_summaries
from pmcl.reports.residual_figures import plot_residuals, residual_channels
from pmcl.reports.settings_table import settings_table
from pmcl.reports.tables import parameter_table, summary_text

__all__ = ["Half", "summary_text", "write_report"]

# Pictures of more logs than this make the page large and show little more.
_MOST_LOGS = 6

_PARAMETER_FIGURES: tuple[tuple[str, Callable[[Posterior], Figure], str], ...] = (
    (
        "Prior and posterior",
        plot_marginals,
        "Left: the prior in grey, and in blue the 90 % interval of the posterior on the same scale. A narrow blue "
        "stripe on a wide prior means that the log determines the parameter; if both are as wide, it shows little. "
        "Right: the posterior enlarged.",
    ),
    (
        "Parameters against each other",
        plot_pair,
        "Below the diagonal: draws, coloured by chain. Above it: the regions where most draws lie, and the correlation "
        "r. A long slanting region means that the log determines a combination of two parameters better than each.",
    ),
)
_CHAIN_FIGURES: tuple[tuple[str, Callable[[Posterior], Figure], str], ...] = (
    (
        "Traces",
        plot_trace,
        "Draws in the order of sampling; bold lines are medians of blocks of draws. Chains that have "
        "converged look alike, without drift; one whose log joint stays below the others is lost.",
    ),
    (
        "Ranks",
        plot_rank,
        "The ranks of each chain's draws among the draws of all chains. Chains whose bars follow the line agree.",
    ),
    (
        "Autocorrelation",
        plot_autocorrelation,
        "Correlation of a draw with the draws after it. The sooner the lines reach zero, the more each draw is worth.",
    ),
    (
        "Growth of the effective sample size",
        plot_ess_evolution,
        "It should grow in proportion to the draws. A line that bends down means that the chains have not yet visited "
        "the whole posterior.",
    ),
)


# Meanings of the sampler's statistics of each draw.
_STATISTICS = {
    "lp": "log joint density of parameters, path and readings [nat]",
    "acceptance_rate": "share of proposals that were accepted",
    "transport_walk_acceptance_rate": "the same for small moves of parameters and path together",
    "transport_jump_rate": "the same for jumps of parameters and path together",
    "path_block_redraw_rate": "share of blocks of the path that were drawn anew",
    "log_evidence": "log density of the readings given the parameters, estimated by the particles [nat]",
    "particle_ess": "effective share of the particles",
    "path_update_rate": "share of the poses that a sweep renews",
}


class Half(NamedTuple):
    """One half of the verdict.

    Attributes
    ----------
    text : str
        The answer in a few words.
    state : str
        ``"yes"``, ``"no"`` or ``"unknown"``.
    """

    text: str
    state: str


def write_report(data: Posterior, path: str | os.PathLike[str]) -> None:
    """Write one self-contained HTML file about a posterior.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
    path : path-like
        An older file of that name is replaced only when the new one is complete.

    Raises
    ------
    PosteriorError
        If the posterior holds no draws, or the file cannot be written.
    """
    summary = summarize(data)
    judged = verdict(data, summary)
    halves = _halves(judged.converged, getattr(judged, "adequate", None))
    logs = log_summaries(data)
    table = parameter_table(data, summary, complete=True)
    text = page(
        "posterior.html.j2",
        title=_title(logs),
        logs=logs,
        size=f"{summary.attrs['chains']} chains of {summary.attrs['draws']} draws.",
        verdict=judged,
        halves=halves,
        box=_box(halves),
        paths=_path_pictures(data, logs),
        table=table,
        is_short=lambda row, column: table.rows[row].short and column in table.checked,
        meanings=_meanings(data),
        parameter_pictures=_drawn(data, _PARAMETER_FIGURES),
        residuals=_residual_pictures(data, logs),
        chain_pictures=_drawn(data, _CHAIN_FIGURES),
        statistics=("statistic", *(f"chain {chain}" for chain in range(summary.attrs["chains"])), "meaning"),
        moves=_moves(data),
        settings=settings_table(settings(data)),
    )
    write_page(text, path)


def _title(logs: tuple[LogSummary, ...]) -> str:
    robots = list(dict.fromkeys(log.robot for log in logs if log.robot))
    return f"Noise model of {' and '.join(robots)}" if robots else "Posterior of the noise model"


def _halves(converged: bool, adequate: bool | None) -> tuple[Half, Half]:
    chains = Half("The chains have converged", "yes") if converged else Half("The chains have not converged", "no")
    if adequate is None:
        return chains, Half("Not checked whether the model fits", "unknown")
    return chains, Half("The model fits the readings", "yes") if adequate else Half("The model does not fit", "no")


def _box(halves: tuple[Half, Half]) -> str:
    """Return the colour of the verdict's box: that of its worse half."""
    states = {half.state for half in halves}
    return "bad" if "no" in states else "unsure" if "unknown" in states else "good"


def _drawn(data: Posterior, figures: tuple[tuple[str, Callable[[Posterior], Figure], str], ...]) -> list[Picture]:
    return [picture(draw(data), title, caption) for title, draw, caption in figures]


def _of_log(logs: tuple[LogSummary, ...], number: int) -> str:
    return "" if len(logs) <= max(number, 1) else f"Log {number} of {len(logs)}: {logs[number].described}"


def _path_pictures(data: Posterior, logs: tuple[LogSummary, ...]) -> list[Picture]:
    n_logs = len(log_suffixes(data))
    pictures = []
    for number in range(min(n_logs, _MOST_LOGS)):
        known = number < len(logs) and logs[number].has_truth
        caption = (
            "The path of the robot in the frame of the map, given the whole log. Below: the standard deviation of its "
            "position and heading"
        )
        caption += ", and the distance from the reference path, which calibration did not read." if known else "."
        if number == _MOST_LOGS - 1 and n_logs > _MOST_LOGS:
            caption += f" The other {n_logs - _MOST_LOGS} logs are not shown."
        pictures.append(picture(plot_trajectory(data, number), _of_log(logs, number), caption))
    return pictures


def _residual_pictures(data: Posterior, logs: tuple[LogSummary, ...]) -> list[Picture]:
    caption = (
        "Normal scores of the readings: each reading minus what the calibrated model predicts one step ahead, in "
        "standard deviations of the prediction. When the model fits, nine out of ten lie between the dotted lines at "
        "all times, and the correlation with the reading before is about zero."
    )
    return [
        picture(plot_residuals(data, number, len(logs)), _of_log(logs, number), caption)
        for number in range(min(len(logs), _MOST_LOGS))
        if residual_channels(data, number, len(logs))
    ]


def _moves(data: Posterior) -> list[tuple[str, ...]]:
    """Return name, mean in each chain, and meaning of each statistic."""
    rows: list[tuple[str, ...]] = []
    for name, values in find_group(data, "sample_stats").data_vars.items():
        if "draw" not in values.dims or values.dtype.kind not in "fiub":
            continue
        means = values.astype(np.float64).mean(dim="draw")
        meaning = _STATISTICS.get(str(name), str(values.attrs.get("long_name", "")))
        if means.dims == ("chain",):
            rows.append((str(name), *_numbers(means), meaning))
        elif set(means.dims) == {"chain", "parameter"}:
            rows += [
                (f"{name}, {parameter}", *_numbers(means.sel(parameter=parameter)), "" if number else meaning)
                for number, parameter in enumerate(means["parameter"].values)
            ]
    return rows


def _numbers(values: xr.DataArray) -> list[str]:
    # Log densities of long logs are whole numbers of nats, never powers of ten.
    return [
        "-" if not np.isfinite(value) else f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.4g}"
        for value in values.values
    ]


def _meanings(data: Posterior) -> list[tuple[str, str, str]]:
    """Return name, meaning and prior of each parameter that has a meaning or a prior."""
    posterior = find_group(data, "posterior")
    rows = [
        (name, str(posterior[name].attrs.get("long_name", "")), str(posterior[name].attrs.get("prior", "")))
        for name in parameter_names(data)
    ]
    return [row for row in rows if row[1] or row[2]]
