"""Text recordings, line by line, with errors that name the line."""

from __future__ import annotations

import gzip
import math
import os
import zlib
from collections.abc import Iterator, Sequence
from typing import IO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.logs.validation import fail

__all__ = ["Line", "lines_of", "numbers_in"]

# A scan of 10 000 rays takes 100 kB. A longer line is no line of a recording, and is not read into memory.
_LONGEST_LINE = 1_000_000


class Line(NamedTuple):
    """One line of a text.

    Attributes
    ----------
    number : int
        Which one, from 1 on.
    words : list of str
        What stands between blanks; never empty.
    is_whole : bool
        Whether it ends with a line break. The last line of a recording that was interrupted does not.
    """

    number: int
    words: list[str]
    is_whole: bool


def lines_of(path: str | os.PathLike[str]) -> Iterator[Line]:
    """Read a text that may be compressed by gzip; empty lines are skipped.

    Parameters
    ----------
    path : path
        The file.

    Yields
    ------
    Line

    Raises
    ------
    LogError
        When it is missing, empty, damaged or no text.
    """
    where = os.fspath(path)
    if not os.path.isfile(path):
        fail(where, "expected a text with a recording, got no such file: check the path")
    number = 0
    try:
        with _opened(where) as stream:
            while raw := stream.readline(_LONGEST_LINE):
                number += 1
                if len(raw) == _LONGEST_LINE or b"\0" in raw:
                    fail(f"{where}, line {number}", "expected a line of text, got something else: check the file")
                words = raw.decode("utf-8", errors="replace").split()
                if words:
                    yield Line(number, words, raw.endswith(b"\n"))
    except (OSError, EOFError, zlib.error) as problem:
        said = getattr(problem, "strerror", None) or str(problem)
        fail(where, f"expected a readable text, got '{said}' after line {number}: copy it again")
    if not number:
        fail(where, "expected a text with a recording, got an empty file: copy it again")


def numbers_in(words: Sequence[str]) -> NDArray[np.float64] | None:
    """Return words as an array of finite numbers, shape (N,); None when one of them is something else."""
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        return None
    return np.array(numbers) if all(map(math.isfinite, numbers)) else None


def _opened(where: str) -> IO[bytes]:
    with open(where, "rb") as stream:
        packed = stream.read(2) == b"\x1f\x8b"
    return gzip.open(where, "rb") if packed else open(where, "rb")  # type: ignore[return-value]
