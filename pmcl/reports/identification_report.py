"""An HTML page, and lines for the terminal, about what a log can tell: each parameter, and what to drive next."""

from __future__ import annotations

import os

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pmcl.identifiability.result import CANNOT_TELL, Identification, Prediction
from pmcl.reports.html import page, picture, write_page
from pmcl.reports.style import PRIOR, new_figure, tidy
from pmcl.reports.tables import Row, Table, aligned, rounded

__all__ = ["identification_table", "identification_text", "plot_identification", "write_identification_report"]

_TOLD, _UNTOLD = "#009E73", "#D55E00"
# Shares below this are drawn at this place, so that the axis has an end.
_LEAST_SHARE = 0.003


def write_identification_report(found: Identification, path: str | os.PathLike[str]) -> None:
    """Write a self-contained HTML file about what a log can tell.

    Parameters
    ----------
    found : Identification
        The result of :func:`pmcl.identifiability.workflow.identify`.
    path : path-like
        The file; an older file of that name is replaced only when the new one is complete.

    Raises
    ------
    PosteriorError
        If the file cannot be written.
    """
    table = identification_table(found)
    text = page(
        "identification.html.j2",
        title=f"What this log can tell of {found.robot or 'the robot'}",
        subject=f"{found.where}; {found.rows} rows over {found.duration:.0f} s, {found.readings} readings.",
        sentence=found.sentence,
        box="good" if not found.untold else "unsure",
        notes=found.notes,
        advice=[(prediction.name, _remedy(prediction)) for prediction in found.untold if prediction.remedy],
        table=table,
        is_short=lambda row, column: table.rows[row].short and column in table.checked,
        meanings=[(p.name, "" if p.unit == "1" else p.unit, p.description) for p in found.predictions],
        picture=picture(
            plot_identification(found),
            "How much of the prior's uncertainty stays",
            "Points: the posterior standard deviation that is predicted for this log, as a share of the prior's. To "
            f"the right of the dotted line, at {CANNOT_TELL:g}, the posterior is mostly the prior. Bars lead to what a "
            "minute of the best drive would leave besides.",
        ),
        drives=[(name, *(_percent(share) for share in shares)) for name, shares in found.drives.items()],
        names=[prediction.name for prediction in found.predictions],
        correlations=[(f"{first} and {second}", f"{value:+.2f}") for first, second, value in found.correlations],
        limit=f"{CANNOT_TELL:g}",
    )
    write_page(text, path)


def identification_table(found: Identification) -> Table:
    """Put the predictions into rows of text; a parameter that the log cannot tell is marked.

    Parameters
    ----------
    found : Identification

    Returns
    -------
    Table
    """
    columns = ("parameter", "unit", "mean", "sd", "prior mean", "prior sd", "sd left", "this log tells it")
    rows = tuple(_row(prediction) for prediction in found.predictions)
    return Table(columns, rows, (columns.index("sd left"), columns.index("this log tells it")))


def identification_text(found: Identification) -> str:
    """Return the result as lines for the terminal; a star marks what the log cannot tell.

    Parameters
    ----------
    found : Identification
    """
    table = identification_table(found)
    remedies = [f"{prediction.name}: {_remedy(prediction)}." for prediction in found.untold if prediction.remedy]
    lines = [
        aligned(table, left=2),
        "",
        "mean, sd: predicted for the posterior. sd left: the sd as a share of the prior's.",
        "",
        f"{found.sentence}.",
        *remedies,
        *(f"Note: {note}." for note in found.notes),
    ]
    return "\n".join(lines)


def _row(prediction: Prediction) -> Row:
    mean_digits = prediction.std if prediction.can_tell else prediction.prior_std
    precision = prediction.precision if prediction.can_tell else "not"
    cells = (
        prediction.name,
        "" if prediction.unit == "1" else prediction.unit,
        rounded(prediction.mean, mean_digits),
        f"{prediction.std:.2g}",
        f"{prediction.prior_mean:.3g}",
        f"{prediction.prior_std:.2g}",
        _percent(prediction.share),
        precision,
    )
    return Row(cells, not prediction.can_tell)


def _remedy(prediction: Prediction) -> str:
    return prediction.remedy.removeprefix("; ")


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 0.995 else f"{100.0 * share:.0f} %"


def plot_identification(found: Identification) -> Figure:
    """Draw the share of the prior's standard deviation that stays, for each parameter.

    Parameters
    ----------
    found : Identification

    Returns
    -------
    matplotlib.figure.Figure
    """
    n = len(found.predictions)
    figure = new_figure(1.2 + 0.36 * n, 8.0)
    axes = figure.subplots()
    for row, prediction in enumerate(found.predictions):
        share = max(prediction.share, _LEAST_SHARE)
        color = _TOLD if prediction.can_tell else _UNTOLD
        if found.drives:
            after = max(min(shares[row] for shares in found.drives.values()), _LEAST_SHARE)
            axes.plot([after, share], [row, row], color=PRIOR, linewidth=4.0, alpha=0.45, solid_capstyle="butt")
        axes.plot([share], [row], "o", color=color, markersize=8)
    axes.axvline(CANNOT_TELL, color=PRIOR, linestyle=":", linewidth=1.3)
    axes.set_xscale("log")
    low = min([0.05, *(prediction.share for prediction in found.predictions)])
    axes.set_xlim(max(0.5 * low, 0.5 * _LEAST_SHARE), 1.3)
    axes.set_ylim(n - 0.5, -0.5)
    axes.set_yticks(range(n), [prediction.name for prediction in found.predictions])
    axes.set_xlabel("posterior standard deviation / prior standard deviation")
    tidy(axes)
    handles = [
        Line2D([], [], marker="o", linestyle="", color=_TOLD, label="this log can tell it"),
        Line2D([], [], marker="o", linestyle="", color=_UNTOLD, label="this log cannot"),
    ]
    if found.drives:
        handles.append(Line2D([], [], color=PRIOR, alpha=0.45, linewidth=4.0, label="and a minute of the best drive"))
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False)
    return figure
