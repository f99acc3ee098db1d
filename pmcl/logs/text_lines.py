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

__all__ = ["Line", "lines_of", "numbers_in", "require_short_text"]

# A scan of 10 000 rays takes 100 kB. A longer line is no line of a recording, and is not read into memory.
_LONGEST_LINE = 1_000_000
# The longest recordings are some 100 MB of text. Compressed, a few kilobytes may stand for more than this [byte].
_LONGEST_TEXT = 1_000_000_000
# Empty lines take longest to read for their length.
_MOST_LINES = 5_000_000


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
        When it is missing, empty, damaged, too long or no text.
    """
    where = os.fspath(path)
    if not os.path.isfile(path):
        fail(where, "expected a text with a recording, got no such file: check the path")
    number, length = 0, 0
    try:
        with _opened(where) as stream:
            while raw := stream.readline(_LONGEST_LINE):
                number += 1
                length += len(raw)
                require_short_text(number, length, where)
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


def require_short_text(n_lines: int, n_characters: int, where: str) -> None:
    """Check that a text that is being read does not go on for ever.

    Parameters
    ----------
    n_lines, n_characters : int
        What was read so far.
    where : str
        File, for messages.

    Raises
    ------
    LogError
        When it is longer than any recording.
    """
    if n_characters > _LONGEST_TEXT or n_lines > _MOST_LINES:
        fail(
            where,
            f"expected a text of at most {_LONGEST_TEXT // 10**6} MB and {_MOST_LINES} lines, got more: cut it into "
            "parts",
        )


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
