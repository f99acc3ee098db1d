"""What a case of the corpus is: files made from sound ones, a command that reads them, and what must become of it."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, Phase, given, settings

__all__ = ["EITHER", "REFUSED", "Case", "cut", "drawn", "flipped"]

REFUSED, EITHER = "refused", "either"
"""What must become of a case: one line and exit status 2; or that, or a sound result."""

Command = Sequence[object]


@dataclass(frozen=True)
class Case:
    """One bad input.

    Attributes
    ----------
    family, name : str
        What kind of file is bad, and in what way.
    make : callable
        Writes the files into an empty folder, and returns the arguments of the command that reads them. What the
        command writes has to be called ``out`` and something.
    expected : str
        :data:`REFUSED` or :data:`EITHER`.
    says : str
        A part of the message of a case that is refused.
    follow : callable or None
        Takes the folder of a case that was accepted, and returns the arguments of a command that uses the result.
    quick : bool
        Whether the case may belong to the part that always runs, see :func:`corpus.families.quick_cases`.
    of_option : bool
        Whether an option is wrong and not a file, so that the message names no file.
    """

    family: str
    name: str
    make: Callable[[Path], Command]
    expected: str = REFUSED
    says: str = ""
    follow: Callable[[Path], Command] | None = None
    quick: bool = True
    of_option: bool = False

    @property
    def title(self) -> str:
        """Family and name."""
        return f"{self.family}: {self.name}"


def drawn(strategy, count):
    """Draw examples from a strategy of hypothesis, the same ones in every run."""
    found = []

    @settings(max_examples=count, derandomize=True, database=None, phases=[Phase.generate], deadline=None,
              suppress_health_check=list(HealthCheck))  # fmt: skip
    @given(strategy)
    def collect(example):
        found.append(example)

    collect()
    return found[:count]


def _numbers(*words):
    return np.random.default_rng(zlib.crc32(repr(words).encode()))


def flipped(content: bytes, count: int, number: int, *, within: Iterable[float] = (0.0, 1.0)) -> bytes:
    """Flip some bits, in a part of the content; `number` chooses which ones."""
    low, high = (int(share * len(content)) for share in within)
    rng, changed = _numbers("flips", count, number), bytearray(content)
    for place in rng.integers(low, max(high, low + 1), count):
        changed[place] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def cut(content: bytes, number: int) -> bytes:
    """Keep the first part of the content; the numbers from 0 on give other parts, from nothing to all but a byte."""
    lengths = (0, 1, 7, 8, 100, len(content) // 3, len(content) // 2, len(content) - 100, len(content) - 1)
    return content[: max(lengths[number % len(lengths)], 0)]
