"""The posterior as rows of text, for the page and for the terminal."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from pmcl.posterior.compat import Posterior
from pmcl.posterior.diagnostics import ESS_LIMIT, R_HAT_LIMIT, summarize

__all__ = ["Row", "Table", "aligned", "parameter_table", "rounded", "summary_text"]

_UNKNOWN = "-"


class Row(NamedTuple):
    """One parameter.

    Attributes
    ----------
    cells : tuple of str
    short : bool
        Whether R-hat or an effective sample size misses its limit.
    """

    cells: tuple[str, ...]
    short: bool


class Table(NamedTuple):
    """Rows under columns.

    Attributes
    ----------
    columns : tuple of str
    rows : tuple of Row
    checked : tuple of int
        Columns that hold what is checked against a limit.
    """

    columns: tuple[str, ...]
    rows: tuple[Row, ...]
    checked: tuple[int, ...]


def rounded(value: float, sd: float) -> str:
    """Write a number with as many digits as its uncertainty leaves meaning: two digits of the standard deviation.

    Parameters
    ----------
    value, sd : float
        In the same unit.

    Returns
    -------
    str
        A dash for NaN.
    """
    if not np.isfinite(value):
        return _UNKNOWN if np.isnan(value) else str(value)
    if not (np.isfinite(sd) and sd > 0.0):
        return f"{value:.4g}"
    decimals = 1 - int(np.floor(np.log10(sd)))
    # Far from 1, leading or trailing zeros would hide the digits.
    if decimals > 6 or decimals < -4:
        digits = max(int(np.floor(np.log10(max(abs(value), sd)))) + decimals, 1)
        return f"{value:.{digits}e}"
    return f"{value:.{max(decimals, 0)}f}"


def parameter_table(data: Posterior, summary: xr.Dataset, *, complete: bool) -> Table:
    """Summary of each parameter in text.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
    summary : xarray.Dataset
        Result of :func:`pmcl.posterior.diagnostics.summarize` for `data`.
    complete : bool
        With MCSE and both effective sample sizes; otherwise the smaller of the two only.

    Returns
    -------
    Table
        The column of true values is there only when one of them is known.
    """
    with_truth = bool(np.isfinite(summary["truth"]).any())
    rows: list[Row] = []
    columns: tuple[str, ...] = ()
    for name in map(str, summary["parameter"].values):
        entry = summary.sel(parameter=name)
        number = {str(key): float(values) for key, values in entry.data_vars.items() if key != "unit"}
        sd = number["sd"]
        cells = {"name": name, "unit": str(entry["unit"].item()), "mean": rounded(number["mean"], sd)}
        cells["sd"] = rounded(sd, sd)
        cells["90 % interval"] = f"{rounded(number['q5'], sd)} to {rounded(number['q95'], sd)}"
        if with_truth:
            cells["truth"] = rounded(number["truth"], sd)
        if complete:
            cells["MCSE"] = f"{number['mcse']:.1g}" if np.isfinite(number["mcse"]) else _UNKNOWN
        cells["R-hat"] = f"{number['r_hat']:.3f}" if np.isfinite(number["r_hat"]) else _UNKNOWN
        if complete:
            cells["ESS bulk"], cells["ESS tail"] = _count(number["ess_bulk"]), _count(number["ess_tail"])
        else:
            cells["ESS"] = _count(min(number["ess_bulk"], number["ess_tail"]))
        enough = min(number["ess_bulk"], number["ess_tail"]) >= ESS_LIMIT and number["r_hat"] <= R_HAT_LIMIT
        rows.append(Row(tuple(cells.values()), not enough))
        columns = tuple(cells)
    checked = tuple(index for index, column in enumerate(columns) if column.startswith(("R-hat", "ESS")))
    return Table(columns, tuple(rows), checked)


def summary_text(data: Posterior, summary: xr.Dataset | None = None) -> str:
    """Plain table for the terminal: name, unit, mean, sd, 90 % interval, truth when known, R-hat, ESS.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
    summary : xarray.Dataset, optional
        Result of :func:`pmcl.posterior.diagnostics.summarize` for `data`, if it was computed already.

    Returns
    -------
    str
        Lines without a final line break. A star marks rows that miss a limit of convergence.

    Raises
    ------
    PosteriorError
        If the posterior holds no draws.
    """
    table = parameter_table(data, summarize(data) if summary is None else summary, complete=False)
    # Names and units to the left, numbers to the right.
    return aligned(table, left=2)


def aligned(table: Table, left: int) -> str:
    """Write a table for the terminal.

    Parameters
    ----------
    table : Table
    left : int
        How many columns, from the first, stand at the left of their width; the others stand at the right.

    Returns
    -------
    str
        Lines without a final line break. A star marks rows that miss a limit.
    """
    lines = [table.columns, *(row.cells for row in table.rows)]
    widths = [max(len(line[index]) for line in lines) for index in range(len(table.columns))]
    marks = ["", *(" *" if row.short else "" for row in table.rows)]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if index < left else cell.rjust(width)
            for index, (cell, width) in enumerate(zip(line, widths, strict=True))
        )
        + mark
        for line, mark in zip(lines, marks, strict=True)
    )


def _count(value: float) -> str:
    return f"{value:.0f}" if np.isfinite(value) else _UNKNOWN
