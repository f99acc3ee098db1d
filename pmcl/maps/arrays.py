"""Coordinates as maps store them: finite, read-only float64 arrays of a known shape."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmcl.errors import MapError

__all__ = ["FARTHEST", "as_numbers", "coordinates"]

FARTHEST = 2.0e7
"""Half the circumference of the earth [m]: no length that a robot measures is greater, also not a coordinate in UTM."""


def as_numbers(value: ArrayLike | None) -> NDArray[np.float64]:
    """Copy real numbers into a float64 array; text that looks like a number is still text.

    Parameters
    ----------
    value : array_like, shape (...)
        Integers or floating-point numbers; None is not a number.

    Returns
    -------
    ndarray, shape (...)
        A copy of its own.

    Raises
    ------
    TypeError
        When there is anything else; the message says in a few words what came. Callers add what was expected and where.
    """
    try:
        array = np.asarray(value)
    except ValueError:
        raise TypeError("rows of unequal length") from None
    if array.size and array.dtype.kind not in "iuf":
        kind = {"U": "text", "S": "text", "T": "text", "M": "dates", "m": "durations", "b": "truth values"}
        first = f"{array.ravel()[:1].tolist()[0]!r:.40}"
        raise TypeError(f"{kind.get(array.dtype.kind, f'values of type {array.dtype}')} such as {first}")
    return np.array(array, dtype=np.float64)


def coordinates(value: ArrayLike, what: str, shape: str, tail: tuple[int, ...]) -> NDArray[np.float64]:
    """Copy coordinates into a read-only array, or say what is wrong with them.

    Parameters
    ----------
    value : array_like, shape (N, *tail)
        Coordinates [m].
    what, shape : str
        What they describe and their shape in words, for the message.
    tail : tuple of int
        Sizes of all axes but the first.

    Returns
    -------
    ndarray, shape (N, *tail)
        Finite, N >= 1, not writeable.

    Raises
    ------
    MapError
        When these are not numbers, the shape differs, nothing is there, or a coordinate is not finite or beyond
        :data:`FARTHEST`.
    """
    try:
        array = as_numbers(value)
    except TypeError as problem:
        raise MapError(f"expected numbers {shape} for the {what}, got {problem}: give coordinates in metres") from None
    if array.size == 0:
        raise MapError(f"expected at least one row {shape} for the {what}, got none: give the map its coordinates")
    if array.ndim == 0 or array.shape[1:] != tail:
        raise MapError(f"expected shape {shape} for the {what}, got shape {array.shape}: rearrange the coordinates")
    bad = np.argwhere(~(np.abs(array) <= FARTHEST))
    if len(bad):
        at = tuple(int(i) for i in bad[0])
        expected = f"finite {what}" if not np.isfinite(array[at]) else f"{what} within {FARTHEST:g} m"
        raise MapError(f"expected {expected}, got {array[at]} at index {at}: correct or remove that row")
    array.flags.writeable = False
    return array
