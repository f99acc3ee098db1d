"""Lines of an exported file: a key, a value, and a comment that says how sure it is."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import NamedTuple

from pmcl.exports.spread import Spread

__all__ = ["CANNOT_TELL", "Line", "described", "yaml_text"]

CANNOT_TELL = "this log cannot tell: the posterior is the prior"
"""Comment on a parameter that the log says nothing about."""

# So many digits that weights computed from the file agree with the posterior's to 1e-9 over hundreds of beams.
_DIGITS = 12


class Line(NamedTuple):
    """One line of a file: ``key: value  # comment``; with an empty key a comment alone."""

    key: str
    value: float | int | bool | str | None
    comment: str = ""


def described(spread: Spread, unit: str = "1") -> str:
    """Say how well a quantity is known.

    Parameters
    ----------
    spread : Spread
        Its spread.
    unit : str
        SI unit; "1" for none.

    Returns
    -------
    str
        E.g. ``"0.031 +- 0.002 m, 90 %: 0.028 to 0.034"``.
    """
    units = "" if unit in ("", "1") else f" {unit}"
    if spread.sd == 0.0:
        return f"{spread.mean:.3g}{units}"
    text = f"{spread.mean:.3g} +- {spread.sd:.2g}{units}, 90 %: {spread.low:.3g} to {spread.high:.3g}"
    return text if spread.told else f"{CANNOT_TELL} ({text})"


def yaml_text(path: Sequence[str], lines: Sequence[Line], heading: Sequence[str] = ()) -> str:
    """Write lines as YAML.

    Parameters
    ----------
    path : sequence of str
        Keys of the tables that hold the lines, outermost first.
    lines : sequence of Line
        What they hold.
    heading : sequence of str
        Comments above everything.

    Returns
    -------
    str
    """
    text = [f"# {line}".rstrip() for line in heading]
    text += [f"{'  ' * depth}{key}:" for depth, key in enumerate(path)]
    indent = "  " * len(path)
    pairs = [f"{line.key}: {_value(line.value)}" if line.key else "" for line in lines]
    width = max((len(pair) for pair, line in zip(pairs, lines, strict=True) if line.comment), default=0)
    for pair, line in zip(pairs, lines, strict=True):
        if not line.key:
            text.append(f"{indent}# {line.comment}")
        elif line.comment:
            text.append(f"{indent}{pair:<{width}}  # {line.comment}")
        else:
            text.append(f"{indent}{pair}")
    return "\n".join(text) + "\n"


def _value(value: float | int | bool | str | None) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        # ROS parameters are typed: a whole number without a point would be an integer, which is refused. YAML 1.1 reads
        # "1e-05" as text, so the mantissa has a point.
        text = f"{value:.{_DIGITS}g}"
        mantissa, _, exponent = text.partition("e")
        mantissa = mantissa if "." in mantissa else f"{mantissa}.0"
        return f"{mantissa}e{exponent}" if exponent else mantissa
    return json.dumps(value)
