"""Self-contained HTML pages: templates filled with escaped text, with the pictures inside the file."""

from __future__ import annotations

import base64
import io
import os
from typing import Any, NamedTuple

import jinja2
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.text import Text

from pmcl.reports.terms import explain_terms
from pmcl.whole_file import replacing

__all__ = ["Picture", "embedded", "page", "picture", "write_page"]

# A page shows an inch of a figure as 96 pixels; more dots keep it sharp on fine screens and in print.
_DOTS_PER_INCH = 140
_PIXELS_PER_INCH = 96
# A figure may shrink to this share of its size before its letters of 10 points are hard to read. On a screen that is
# narrower still the reader scrolls sideways.
_LEAST_SHARE = 0.6


class Picture(NamedTuple):
    """A figure ready for a page.

    Attributes
    ----------
    title, caption : str
        The title may be empty.
    source : str
        The image itself, as a ``data:`` address.
    width, height, least_width : int
        Size at which the page shows it, and the width below which it is not shrunk [pixel].
    """

    title: str
    caption: str
    source: str
    width: int
    height: int
    least_width: int


def picture(figure: Figure, title: str, caption: str) -> Picture:
    """Make a figure ready for a page.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    title, caption : str

    Returns
    -------
    Picture
    """
    width, height = (round(_PIXELS_PER_INCH * float(inches)) for inches in figure.get_size_inches())
    return Picture(title, caption, embedded(figure), width, height, round(_LEAST_SHARE * width))


def embedded(figure: Figure) -> str:
    """Turn a figure into the address of an image that carries its own content.

    Parameters
    ----------
    figure : matplotlib.figure.Figure

    Returns
    -------
    str
        A ``data:`` address of a PNG image.
    """
    buffer = io.BytesIO()
    # Names come from files: a "$" in one begins no formula. Figures of this package have none.
    for text in figure.findobj(Text):
        text.set_parse_math(False)
    # The file holds neither version nor date, so that the same posterior gives the same file.
    with rc_context({"text.parse_math": False}):  # texts at ticks are made while the figure is drawn
        figure.savefig(buffer, format="png", dpi=_DOTS_PER_INCH, metadata={"Software": None})
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"


def page(template: str, **content: Any) -> str:
    """Fill a template of this package; all content is escaped, and terms are explained where they first appear.

    Parameters
    ----------
    template : str
        Name of a file in ``pmcl/reports/templates``.
    **content
        Variables of the template; a missing one is an error.

    Returns
    -------
    str
        The page.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("pmcl.reports"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return explain_terms(environment.get_template(template).render(**content))


def write_page(text: str, path: str | os.PathLike[str]) -> None:
    """Write a page; an older file of that name is replaced only when the new one is complete.

    Parameters
    ----------
    text : str
    path : path-like

    Raises
    ------
    PosteriorError
        If the file cannot be written.
    """
    with replacing(path) as temporary:
        # Bytes of a file's name that are no UTF-8 become question marks.
        temporary.write_text(text, encoding="utf-8", errors="replace")
