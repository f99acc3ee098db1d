"""Checks on the arrays of a stream: shapes, finite numbers, clocks that run forward."""

from __future__ import annotations

from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmcl.logs.validation import fail
from pmcl.maps.arrays import as_numbers

__all__ = ["clock_of", "fail_for_pause", "numbers", "require_finite", "require_same_length", "table_of", "vector"]

Float = NDArray[np.float64]


def fail_for_pause(where: str, what: str, time: float, max_pause: float) -> NoReturn:
    """Raise the error that a stream pauses for too long.

    Parameters
    ----------
    where : str
        File or call, for messages.
    what : str
        The stream, for messages.
    time : float
        When the pause begins [s].
    max_pause : float
        The longest pause that is allowed [s].

    Raises
    ------
    LogError
        Always.
    """
    fail(
        where,
        f"expected {what} without a pause of more than {max_pause:g} s, got one at {time:.9g} s: make two logs of it "
        "(pmcl.calibrate takes several), or allow it with max_pause",
    )


def numbers(where: str, name: str, value: ArrayLike) -> Float:
    """Return what was given as an array of numbers.

    Parameters
    ----------
    where : str
        File or call, for messages.
    name : str
        The argument, for messages.
    value : array_like
        What was given.

    Returns
    -------
    ndarray

    Raises
    ------
    LogError
        When it holds something else.
    """
    try:
        return as_numbers(value)
    except TypeError as problem:
        fail(where, f"expected numbers in '{name}', got {problem}: convert them")


def vector(where: str, name: str, value: ArrayLike) -> Float:
    """Return what was given as one axis of finite numbers.

    Parameters
    ----------
    where : str
        File or call, for messages.
    name : str
        The argument, for messages.
    value : array_like
        What was given.

    Returns
    -------
    ndarray, shape (N,)

    Raises
    ------
    LogError
        When the shape is another, or a number is not finite.
    """
    array = numbers(where, name, value)
    if array.ndim != 1:
        fail(where, f"expected '{name}' of shape (N,), got {array.shape}: reshape it")
    require_finite(where, name, array)
    return array


def table_of(where: str, name: str, value: ArrayLike, columns: int) -> Float:
    """Return what was given as a table of finite numbers.

    Parameters
    ----------
    where : str
        File or call, for messages.
    name : str
        The argument, for messages.
    value : array_like
        What was given.
    columns : int
        Number of columns.

    Returns
    -------
    ndarray, shape (N, columns)
        N >= 1.

    Raises
    ------
    LogError
        When the shape is another, or a number is not finite.
    """
    array = numbers(where, name, value)
    if array.ndim != 2 or array.shape[1] != columns or not len(array):
        fail(where, f"expected '{name}' of shape (N, {columns}) with N >= 1, got {array.shape}: reshape it")
    require_finite(where, name, array)
    return array


def clock_of(where: str, name: str, value: ArrayLike) -> Float:
    """Return what was given as strictly increasing times.

    Parameters
    ----------
    where : str
        File or call, for messages.
    name : str
        The argument, for messages.
    value : array_like
        What was given.

    Returns
    -------
    ndarray, shape (N,)
        Times [s], N >= 1.

    Raises
    ------
    LogError
        When there is none, one is not finite, or they do not increase.
    """
    times = vector(where, name, value)
    if not times.size:
        fail(where, f"expected times [s] in '{name}', got none: check the recording")
    back = np.flatnonzero(np.diff(times) <= 0.0)
    if back.size:
        k = int(back[0]) + 1
        fail(
            where,
            f"expected strictly increasing '{name}', got {times[k]:.9g} s after {times[k - 1]:.9g} s at index {k}: "
            "sort them and remove duplicates",
        )
    return times


def require_finite(where: str, name: str, array: Float) -> None:
    """Check that every number is finite.

    Parameters
    ----------
    where : str
        File or call, for messages.
    name : str
        The argument, for messages.
    array : ndarray
        The numbers.

    Raises
    ------
    LogError
        With the first number that is not, and its place.
    """
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        at = tuple(int(i) for i in bad[0])
        fail(where, f"expected finite numbers in '{name}', got {array[at]} at {list(at)}: remove what was not measured")


def require_same_length(where: str, first: str, a: Any, second: str, b: Any) -> None:
    """Check that two columns of one stream have the same length.

    Parameters
    ----------
    where : str
        File or call, for messages.
    first, second : str
        The arguments, for messages.
    a, b : sequence
        What was given.

    Raises
    ------
    LogError
        When their lengths differ.
    """
    if len(a) != len(b):
        fail(where, f"expected '{first}' and '{second}' of the same length, got {len(a)} and {len(b)}: give both whole")
