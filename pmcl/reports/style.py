"""The common style of all figures: colours, labels, sizes."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, ScalarFormatter
from numpy.typing import NDArray

__all__ = [
    "FAINT",
    "POSTERIOR",
    "PRIOR",
    "TRUTH",
    "chain_color",
    "evenly_spaced",
    "labelled",
    "legend_above",
    "new_figure",
    "tidy",
]

# A palette that stays apart for colour-blind readers (Okabe and Ito).
_CHAINS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#8C7A00", "#5B4FA0")

POSTERIOR = "#0072B2"
PRIOR = "#777777"
FAINT = "#B8B8B8"
TRUTH: dict[str, Any] = {"color": "black", "linestyle": (0, (4, 2)), "linewidth": 1.3}

# Powers of ten between which numbers at ticks are written in full, such as 0.002.
_PLAIN_POWERS = (-4, 5)

# On a logarithmic axis with less than this between its ends, powers of ten alone would be too few ticks.
_FEW_DECADES = 50.0

# Letters in a line of a narrow label, and in an inch of a legend.
_NARROW = 14
_LETTERS_PER_INCH = 11.0


def chain_color(chain: int) -> str:
    """Return the colour of a chain, which is the same in all figures.

    Parameters
    ----------
    chain : int
        From 0.

    Returns
    -------
    str
    """
    return _CHAINS[chain % len(_CHAINS)]


def new_figure(height: float, width: float = 10.0) -> Figure:
    """Empty figure of `width` by `height` inches, without pyplot, which would keep every figure alive.

    Ten inches at 100 dots per inch fill a page of 1000 pixels with letters of 10 points.

    Parameters
    ----------
    height, width : float
        In inches.

    Returns
    -------
    matplotlib.figure.Figure
    """
    return Figure(figsize=(width, height), layout="constrained")


def labelled(name: str, unit: str, *, narrow: bool = False) -> str:
    """Axis label, such as ``sigma_range [m]``.

    Parameters
    ----------
    name, unit : str
        An empty unit is left out.
    narrow : bool
        Break the label into short lines: long names at their underscores, the unit below.

    Returns
    -------
    str
    """
    if not narrow:
        return f"{name} [{unit}]" if unit else name
    lines = [""]
    for part in re.findall(r"[^_ ]*[_ ]|[^_ ]+", name):
        if len(lines[-1]) + len(part) > _NARROW and lines[-1]:
            lines.append("")
        lines[-1] += part
    return "\n".join([*lines, f"[{unit}]"] if unit else lines)


def tidy(axes: Axes) -> None:
    """Remove the upper and right frame, and write the numbers at the ticks in full.

    Call it after the scales are set.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    """
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "log":
            low, high = axis.get_view_interval()
            steps = (1.0, 2.0, 5.0) if high < _FEW_DECADES * low else (1.0,)
            axis.set_major_locator(LogLocator(subs=steps))
            axis.set_major_formatter(FuncFormatter(_plain))
            axis.set_minor_formatter(NullFormatter())
        elif isinstance(axis.get_major_formatter(), ScalarFormatter):
            formatter = ScalarFormatter(useOffset=False)
            formatter.set_powerlimits(_PLAIN_POWERS)
            axis.set_major_formatter(formatter)


def _plain(value: float, position: int | None = None) -> str:
    return f"{value:g}"


def legend_above(figure: Figure, handles: Iterable[Any]) -> None:
    """Legend above all panels.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    handles : iterable of matplotlib artists
        Artists whose label starts with an underscore, or that repeat a label, are left out.
    """
    unique = {str(handle.get_label()): handle for handle in handles if not str(handle.get_label()).startswith("_")}
    if unique:
        figure.legend(
            list(unique.values()),
            list(unique),
            loc="outside upper center",
            ncols=_legend_columns(list(unique), _LETTERS_PER_INCH * float(figure.get_size_inches()[0])),
            frameon=False,
        )


def _legend_columns(labels: list[str], row: float) -> int:
    """Return the greatest number of columns that fits into a row of so many letters; columns are filled one by one."""
    for columns in range(len(labels), 1, -1):
        height = -(-len(labels) // columns)
        widths = [max(map(len, labels[first : first + height])) for first in range(0, len(labels), height)]
        # Line and gap of an entry are as wide as some eight letters.
        if sum(8 + width for width in widths) <= row:
            # As few columns as give the same rows, so that no entry is alone in the last one.
            return -(-len(labels) // height)
    return 1


def evenly_spaced(length: int, at_most: int) -> NDArray[np.int64]:
    """Choose indices that thin a sequence to what a picture can show.

    Parameters
    ----------
    length : int
    at_most : int

    Returns
    -------
    ndarray of int, at most `at_most` long
        From 0 to ``length - 1``.
    """
    return np.unique(np.linspace(0, length - 1, min(length, at_most)).astype(np.int64))
