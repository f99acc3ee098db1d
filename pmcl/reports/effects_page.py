"""The catalogue of effects as text and as an HTML page."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Sequence
from typing import NamedTuple

from pmcl.models.effects.catalogue import CATALOGUE
from pmcl.models.effects.effect import CARRIERS, MAGNITUDES, Effect
from pmcl.reports.effect_pictures import plot_effect
from pmcl.reports.html import Picture, page, picture, write_page

__all__ = ["effect_text", "effects_text", "write_effects_page"]

_HEADINGS = {
    "motion": "How the robot moves",
    "range": "Range beams",
    "landmark": "Landmark sightings",
    "sensor": "Every sensor",
    "map": "The map",
}
_WIDTH = 100


class _Row(NamedTuple):
    """One parameter of an effect: name, unit, meaning, and its typical sizes."""

    name: str
    unit: str
    description: str
    sizes: str


def _rows(effect: Effect) -> list[_Row]:
    rows = []
    for k, parameter in enumerate(effect.parameters):
        sizes = [effect.typical[magnitude][k] for magnitude in MAGNITUDES if magnitude in effect.typical]
        # The places are those of a log, and there is none here.
        placed = parameter.name in effect.shape and effect.places is not None
        typical_sizes = "" if placed else ", ".join(f"{size:g}" for size in sizes)
        rows.append(_Row(parameter.name, parameter.unit, parameter.description, typical_sizes))
    return rows


def _groups(effects: Sequence[Effect]) -> list[tuple[str, list[Effect]]]:
    # Sensors of installed packages have no heading here: their names serve.
    carriers = dict.fromkeys((*CARRIERS, *(effect.carrier for effect in effects)))
    groups = [
        (_HEADINGS.get(carrier, carrier.capitalize()), [effect for effect in effects if effect.carrier == carrier])
        for carrier in carriers
    ]
    return [(heading, members) for heading, members in groups if members]


def effects_text(effects: Sequence[Effect] = CATALOGUE) -> str:
    """Return the catalogue as lines of text: name, sentence, and parameters with units.

    Parameters
    ----------
    effects : sequence of Effect
        The effects.

    Returns
    -------
    str
    """
    lines = []
    for heading, members in _groups(effects):
        lines += [heading, ""]
        for effect in members:
            lines += _wrapped(effect.summary, first=f"  {effect.name}: ", rest=" " * 6)
            parameters = ", ".join(f"{row.name} [{row.unit}]" for row in _rows(effect))
            lines += _wrapped(parameters, first=" " * 6, rest=" " * 6)
        lines.append("")
    return "\n".join(lines[:-1])


def effect_text(effect: Effect) -> str:
    """Return the full description of one effect as lines of text."""
    lines = [effect.name, "", *_wrapped(effect.summary), "", *_wrapped(effect.symptom, first="In the data: "), ""]
    lines.append(f"Parameters ({', '.join(MAGNITUDES)}):")
    for row in _rows(effect):
        sizes = f" ({row.sizes})" if row.sizes else ""
        lines += _wrapped(f"{row.description}{sizes}", first=f"  {row.name} [{row.unit}]: ", rest=" " * 6)
    if effect.near_twins:
        lines += ["", "Looks like:"]
        for twin, motion in effect.near_twins.items():
            lines += _wrapped(motion, first=f"  {twin}; to tell them apart: ", rest=" " * 6)
    lines += ["", *_wrapped("; ".join(effect.references), first="See ")]
    return "\n".join(lines)


def _wrapped(text: str, first: str = "", rest: str = "") -> list[str]:
    return textwrap.wrap(text, _WIDTH, initial_indent=first, subsequent_indent=rest, break_on_hyphens=False)


def write_effects_page(path: str | os.PathLike[str], effects: Sequence[Effect] = CATALOGUE) -> None:
    """Write the catalogue as one self-contained HTML file, with a picture of what each effect does to the data.

    Parameters
    ----------
    path : path-like
        An older file of that name is replaced only when the new one is complete.
    effects : sequence of Effect
        The effects.

    Raises
    ------
    PosteriorError
        If the file cannot be written.
    """
    groups = [
        (heading, [(effect, _rows(effect), _picture(effect)) for effect in members])
        for heading, members in _groups(effects)
    ]
    known = {effect.name for effect in effects}
    title = "Effects that pmcl knows"
    write_page(page("effects.html.j2", title=title, groups=groups, known=known, magnitudes=MAGNITUDES), path)


def _picture(effect: Effect) -> Picture | None:
    drawn = plot_effect(effect)
    return None if drawn is None else picture(drawn.figure, "", drawn.caption)
