"""Whitespace separated tables of numbers, with errors that name the line."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Sequence
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from pmcl.logs.validation import fail

__all__ = ["read_table"]


def read_table(path: str | os.PathLike[str], columns: Sequence[str]) -> NDArray[np.float64]:
    """Read a table in which every line holds the same numbers; ``#`` starts a comment, empty lines are skipped.

    Parameters
    ----------
    path : path
        Text file.
    columns : sequence of str
        What each column is called, in order, for messages; there must be exactly as many.

    Returns
    -------
    ndarray, shape (N, len(columns))
        Finite numbers, N >= 1.

    Raises
    ------
    LogError
        When the file is missing or empty, a line has another number of columns, or something is not a finite number.
    """
    where = os.fspath(path)
    if not os.path.isfile(path):
        fail(where, f"expected a table of {', '.join(columns)}, got no such file: check the folder")
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*input contained no data.*", category=UserWarning)
            table = np.loadtxt(path, comments="#", ndmin=2, dtype=np.float64, encoding="utf-8")
    except (ValueError, OSError):
        _explain(where, columns)
    if table.size == 0:
        fail(where, f"expected lines of {', '.join(columns)}, got none: the file is empty")
    if table.shape[1] != len(columns) or not np.isfinite(table).all():
        _explain(where, columns)
    return table


def _explain(path: str, columns: Sequence[str]) -> NoReturn:
    """Find the first bad line; only called once the fast reader has failed, so speed does not matter."""
    try:
        with open(path, encoding="utf-8", errors="replace") as stream:
            for number, line in enumerate(stream, start=1):
                words = line.split("#", 1)[0].split()
                if not words:
                    continue
                where = f"{path}, line {number}"
                if len(words) != len(columns):
                    fail(where, f"expected {len(columns)} columns ({', '.join(columns)}), got {len(words)}: correct it")
                for name, word in zip(columns, words, strict=True):
                    if not _is_finite(word):
                        fail(
                            where, f"expected a finite number for {name}, got {word[:40]!r}: correct or remove the line"
                        )
    except OSError as problem:
        fail(path, f"expected a readable table, got '{problem.strerror}': check its permissions")
    fail(path, f"expected a text table of {', '.join(columns)}, got something else: check the file")


def _is_finite(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False
