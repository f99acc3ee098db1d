"""Says that kernels are being compiled, so that a silent first minute does not look like a hang."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["announce_compilation"]

_logger = logging.getLogger("pmcl.compile")
_said = False


@contextmanager
def announce_compilation(name: str, compiled: Any) -> Iterator[None]:
    """Log one line before the first compilation of this process and the time each one took."""
    global _said
    started = time.perf_counter()
    misses = sum(compiled.stats.cache_misses.values())
    if not _said:
        _said = True
        _logger.info(
            "loading the compiled kernels (the first run on a machine compiles them: half a minute; some minutes for "
            "criticism, which needs those of all effects) ..."
        )
    yield
    if sum(compiled.stats.cache_misses.values()) > misses:
        _logger.info("compiled %s in %.1f s", name, time.perf_counter() - started)
