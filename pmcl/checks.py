"""Checks on the arguments of public functions, made once at the border: everything behind trusts what passes here.

One rule holds everywhere. An argument that cannot be used, because of its value or because of its type, raises the
:class:`~pmcl.errors.PmclError` of its package with one line that says what was expected, what came and what to do; it
does so before any work is done. A whole number must be one by type: neither ``2.0`` nor ``True`` is, but numpy's
integers are. Only a call with a missing or unknown argument is Python's own TypeError.
"""

from __future__ import annotations

import math
import numbers
import os
from collections.abc import Collection
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from pmcl.errors import PmclError, did_you_mean, one_line

__all__ = [
    "MOST_COUNT",
    "MOST_SEED",
    "check_choice",
    "check_flag",
    "check_memory",
    "check_number",
    "check_path",
    "check_seed",
    "check_type",
    "check_whole",
    "file_name",
]

Checked = TypeVar("Checked")

MOST_SEED = 2**64 - 1
"""The greatest seed: what seeds of further runs that numpy makes from one seed may be."""

MOST_COUNT = 10**9
"""The greatest number of draws, particles, rows or threads: beyond all use, and small enough for every index."""

# What Python and numpy register as numbers, but nobody means as one.
_NO_NUMBERS = (bool, np.bool_, np.timedelta64)
# Without a system that tells its memory: a terabyte, more than any computer that a robot's log is calibrated on.
_UNKNOWN_MEMORY = 2**40


def check_whole(
    name: str,
    value: Any,
    least: int = 0,
    most: int = MOST_COUNT,
    *,
    error: type[PmclError],
    advice: str = "choose another",
    where: str = "",
) -> int:
    """Return a whole number as an int.

    Parameters
    ----------
    name : str
        What the argument is called, for the message.
    value : int or numpy integer
        What came.
    least, most : int
        Limits, both allowed.
    error : type
        The PmclError to raise.
    advice : str
        What to do, for the message.
    where : str
        The caller, where the message begins with it.

    Raises
    ------
    PmclError
        When the value is no whole number, or beyond its limits.
    """
    place = f"{where}: " if where else ""
    bounds = f"of at least {least}" if most == MOST_COUNT else f"between {least} and {most}"
    if isinstance(value, _NO_NUMBERS) or not isinstance(value, numbers.Integral):
        raise error(f"{place}expected {name} as a whole number {bounds}, but got {_shown(value)}; {advice}")
    number = int(value)
    if not least <= number <= most:
        bounds = f"of at most {most}" if number > most else f"of at least {least}"
        raise error(f"{place}expected {name} {bounds}, but got {_shown(number)}; {advice}")
    return number


def check_number(
    name: str,
    value: Any,
    low: float = -math.inf,
    high: float = math.inf,
    *,
    unit: str = "",
    open_low: bool = False,
    open_high: bool = False,
    error: type[PmclError],
    advice: str = "choose another",
    where: str = "",
) -> float:
    """Return a finite real number as a float.

    Parameters
    ----------
    name, value, error, advice, where
        As for :func:`check_whole`; integers and numpy's numbers are numbers too.
    low, high : float
        Limits; allowed themselves unless `open_low` or `open_high`.
    unit : str
        Unit of the number, for the message.

    Raises
    ------
    PmclError
        When the value is no finite number, or beyond its limits.
    """
    is_number = isinstance(value, numbers.Real) and not isinstance(value, _NO_NUMBERS)
    try:
        number = float(value) if is_number else math.nan
    except OverflowError:  # an int beyond all floats
        number = math.inf
    too_low = number <= low if open_low else number < low
    too_high = number >= high if open_high else number > high
    if not math.isfinite(number) or too_low or too_high:
        unit = f" {unit}" if unit else ""
        limits = []
        if low > -math.inf:
            limits.append(f"{'more than' if open_low else 'at least'} {low:g}{unit}")
        if high < math.inf:
            limits.append(f"{'less than' if open_high else 'at most'} {high:g}{unit}")
        expected = f"a number of {' and '.join(limits)}" if limits else f"a finite number{unit and f' in{unit}'}"
        came = f"{number:g}{unit}" if is_number else _shown(value)
        place = f"{where}: " if where else ""
        raise error(f"{place}expected {name} as {expected}, but got {came}; {advice}")
    return number


def check_seed(value: Any, *, error: type[PmclError], where: str = "") -> int:
    """Return a seed as an int; raises `error` unless it is a whole number from 0 to 2^64 - 1.

    Parameters
    ----------
    value : object
        The seed as it was given.
    error : type
        Class of the error.
    where : str
        File or function that the message begins with; empty for none.

    Returns
    -------
    int
    """
    return check_whole("seed", value, 0, MOST_SEED, error=error, advice="choose for example 0", where=where)


def check_choice(name: str, value: Any, choices: Collection[str], *, error: type[PmclError]) -> str:
    """Return a value that is one of some texts; raises `error` otherwise, with the nearest one if there is one.

    Parameters
    ----------
    name : str
        What the value is, for the message.
    value : object
        The value as it was given.
    choices : collection of str
        The texts.
    error : type
        Class of the error.

    Returns
    -------
    str
    """
    if isinstance(value, str) and value in choices:
        return value
    listed = ", ".join(f"'{choice}'" for choice in choices)
    advice = did_you_mean(value if isinstance(value, str) else "", choices, "choose one of them")
    raise error(f"expected {name} as one of {listed}, but got {_shown(value)}; {advice}")


def check_flag(name: str, value: Any, *, error: type[PmclError]) -> bool:
    """Return a truth value; raises `error` for everything else, also for 0, 1 and texts.

    Parameters
    ----------
    name : str
        What the value is, for the message.
    value : object
        The value as it was given.
    error : type
        Class of the error.

    Returns
    -------
    bool
    """
    if isinstance(value, bool | np.bool_):
        return bool(value)
    raise error(f"expected {name} as True or False, but got {_shown(value)}; write one of them")


def check_type(
    name: str, value: Any, kind: type[Checked] | tuple[type[Checked], ...], *, error: type[PmclError], advice: str
) -> Checked:
    """Return a value of some type; raises `error` for others.

    Parameters
    ----------
    name : str
        What the value is, for the message.
    value : object
        The value as it was given.
    kind : type or tuple of type
        The types that are accepted.
    error : type
        Class of the error.
    advice : str
        What to do, the end of the message.

    Returns
    -------
    object
        The value itself.
    """
    if isinstance(value, kind):
        return value
    kinds = kind if isinstance(kind, tuple) else (kind,)
    expected = " or ".join(each.__name__ for each in kinds)
    raise error(f"expected {name} as {expected}, but got {_shown(value)}; {advice}")


def check_path(name: str, value: Any, *, error: type[PmclError]) -> str:
    """Return a path as text; raises `error` when it is empty, no path, or has a null character.

    Parameters
    ----------
    name : str
        What the path is, for the message.
    value : object
        The path as it was given.
    error : type
        Class of the error.

    Returns
    -------
    str
    """
    text = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    if not isinstance(text, str) or not text or "\0" in text:
        raise error(f"expected {name} as the path of a file, but got {_shown(value)}; give a text or a pathlib.Path")
    return text


def check_memory(what: str, n_bytes: float, *, error: type[PmclError], advice: str) -> None:
    """Raise `error` when something would take more memory than the machine has.

    Parameters
    ----------
    what : str
        What would take the memory, for the message.
    n_bytes : float
        How much it would take [byte].
    error : type
        Class of the error.
    advice : str
        What to do, the end of the message.
    """
    try:
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        memory = _UNKNOWN_MEMORY
    if n_bytes > memory:
        raise error(
            f"expected {what} to fit into the {memory / 2**30:.0f} GB of memory, but got sizes that need "
            f"{n_bytes / 2**30:.3g} GB; {advice}"
        )


def _shown(value: Any) -> str:
    """Write a value in one short line, with its type where that is not plain."""
    if isinstance(value, int) and not isinstance(value, bool):
        return str(value) if abs(value) < 10**20 else f"an integer of {value.bit_length()} bits"
    try:
        text = " ".join(repr(value).split())
    except Exception:
        text = ""
    text = text if len(text) <= 40 else f"{text[:37]}..."
    return text if value is None or isinstance(value, str | bool | float) else f"{text} ({type(value).__name__})"


def file_name(where: str) -> str:
    """Return the name of a file as a result may hold it: without its folder, which is private to the user.

    Parameters
    ----------
    where : str
        Path of the file.

    Returns
    -------
    str
        In one line and in characters that a file can hold: on Linux a name may be any bytes, and Python gives those
        that are no UTF-8 as lone surrogates.
    """
    return one_line(Path(where).name.encode("utf-8", "replace").decode())
