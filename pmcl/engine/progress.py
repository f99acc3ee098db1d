"""Says that kernels are being compiled, so that a silent first minute does not look like a hang."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterable
from pathlib import Path

__all__ = ["announce_compilation", "expect_compilations"]

_logger = logging.getLogger("pmcl.compile")
_lock = threading.Lock()
# Files that hold, or will hold, the code of what was or is to be compiled.
_expected: set[Path] = set()


def expect_compilations(files: Iterable[Path]) -> None:
    """Count compilations that are still to come in the total that is told."""
    with _lock:
        _forget_if_done()
        _expected.update(files)


def announce_compilation(name: str, file: Path | None) -> None:
    """Log which compilation begins, and of how many.

    Parameters
    ----------
    name : str
        What is compiled.
    file : Path or None
        The file that will hold its code, if any.
    """
    with _lock:
        if file is None:
            _logger.info("compiling %s ...", name)
            return
        _forget_if_done()
        _expected.add(file)
        _logger.info("compiling %d of %d (%s) ...", 1 + _count_done(), len(_expected), name)


def _count_done() -> int:
    return sum(file.exists() for file in _expected)


def _forget_if_done() -> None:
    if _count_done() == len(_expected):
        _expected.clear()
