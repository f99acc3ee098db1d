"""Pages that are one file: templates filled with escaped text, pictures inside, nothing loaded from elsewhere."""

from __future__ import annotations

import base64
import io
import os
from typing import Any

import jinja2
from matplotlib.figure import Figure

from pmcl.posterior.files import replacing

__all__ = ["embedded", "page", "write_page"]

# At ten inches of width: 1300 pixels, which stay sharp when the page shows them 1000 wide.
_DOTS_PER_INCH = 130


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
    # Neither version nor date, so that the same posterior gives the same file.
    figure.savefig(buffer, format="png", dpi=_DOTS_PER_INCH, metadata={"Software": None})
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"


def page(template: str, **content: Any) -> str:
    """Fill a template of this package; all content is escaped.

    Parameters
    ----------
    template : str
        Name of a file in ``pmcl/reports/templates``.
    **content
        What the template asks for; a name that is missing is an error.

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
    return environment.get_template(template).render(**content)


def write_page(text: str, path: str | os.PathLike[str]) -> None:
    """Write a page; an older file of that name stays whole until the new one is complete.

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
        temporary.write_text(text, encoding="utf-8")
