"""Progress messages of a long run: the current step, the number of candidates left, and the elapsed time.

On a terminal one line at the bottom is kept up to date. Elsewhere, as in a log file of a build server, a line is
written whenever a step begins, and from time to time while a step goes on.
"""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import Any

from tqdm import tqdm

from pmcl.interrupts import check_interrupt

__all__ = ["Progress", "Watch"]

_logger = logging.getLogger("pmcl.criticism")

# Seconds between two updates of the line on a terminal, and between two lines elsewhere (chosen by hand).
_REFRESH, _PAUSE = 0.5, 15.0


class Progress:
    """Reports the progress of a run; a context manager, which removes its line at the end.

    Parameters
    ----------
    shown : bool
        Whether anything is reported.
    live : bool, optional
        Whether to keep one line up to date; by default, on a terminal.
    pause : float
        Seconds after which a line is repeated when there is no terminal.
    """

    def __init__(
        self,
        shown: bool = False,
        *,
        live: bool | None = None,
        pause: float = _PAUSE,
    ) -> None:
        self.shown, self.pause = shown, pause
        self.live = shown and (sys.stderr.isatty() if live is None else live)
        self._began = self._last_message = time.monotonic()
        self._stage = ""
        self._watch: Watch | None = None
        self._line: Any = None
        self._hidden = False
        self._over = threading.Event()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Progress:
        if self.shown:
            self._thread = threading.Thread(target=self._keep_reporting, name="pmcl progress", daemon=True)
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        self._hide()

    def tell(self, message: str, doing: str = "") -> None:
        """Report that a step begins, or the result of a step.

        Parameters
        ----------
        message : str
            The step that begins, or the result of the step that ends.
        doing : str
            The step that goes on from here, if it differs from the message.
        """
        self.check()
        self._stage = doing or message
        if self.shown:
            self._log(message)

    def check(self) -> None:
        """Raise KeyboardInterrupt if the user has interrupted the run."""
        check_interrupt()

    @contextmanager
    def watched(self, activity: str, names: Sequence[str]) -> Iterator[Watch]:
        """Count pieces of work.

        Parameters
        ----------
        activity : str
            The work, e.g. "quick fits of candidates".
        names : sequence of str
            The name of each piece; empty names for pieces that are alike.
        """
        outer, self._watch = self._watch, Watch(self, activity, tuple(names))
        try:
            yield self._watch
        finally:
            self._watch = outer

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Leave the terminal to another progress bar."""
        self._hidden = True
        self._hide()
        try:
            yield
        finally:
            self._hidden = False

    def status(self) -> str:
        """Return the text of the current step."""
        watch = self._watch
        return str(watch) if watch is not None else self._stage

    def _keep_reporting(self) -> None:
        while not self._over.wait(_REFRESH if self.live else min(_REFRESH, self.pause)):
            if self.live:
                self._show()
            elif time.monotonic() - self._last_message >= self.pause:
                self._log(self.status() if self._watch is not None else f"still {self._stage}")

    def _elapsed(self) -> str:
        minutes, seconds = divmod(int(time.monotonic() - self._began), 60)
        return f"[{minutes:d}:{seconds:02d}]"

    def _log(self, message: str) -> None:
        self._last_message = time.monotonic()
        _logger.info("%s %s", self._elapsed(), message)

    def _show(self) -> None:
        with self._lock:
            if self._hidden or self._over.is_set():
                return
            if self._line is None:
                self._line = tqdm(total=0, bar_format="{desc}", leave=False, file=sys.stderr, dynamic_ncols=True)
            width = int(self._line.ncols or 80) - 1
            self._line.set_description_str(f"{self._elapsed()} {self.status()}"[:width])

    def _hide(self) -> None:
        with self._lock:
            if self._line is not None:
                self._line.close()
                self._line = None


class Watch:
    """Counts pieces of work; threads may share it."""

    def __init__(self, progress: Progress, activity: str, names: tuple[str, ...]) -> None:
        self._progress, self._activity, self._names = progress, activity, names
        self._done, self._now = 0, ""
        self._lock = threading.Lock()

    def begin(self, k: int) -> None:
        """Report that piece k begins; raise KeyboardInterrupt if the user has interrupted the run."""
        self._progress.check()
        self._now = self._names[k]

    def end(self) -> None:
        """Report that a piece is done."""
        with self._lock:
            self._done += 1

    def __str__(self) -> str:
        total = len(self._names)
        now = f", now {self._now}" if self._now else ""
        return f"{self._activity}: {self._done} of {total} done, {total - self._done} left{now}"
