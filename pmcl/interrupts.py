"""Ctrl-C during long work: the first one stops the work at its next step, the second one at once.

Python raises KeyboardInterrupt wherever the main thread happens to be. Inside a callback of compiled code, of a garbage
collector or of a progress bar nobody can pass it on, so it is printed and forgotten, and the run goes on. While
:func:`stopping_on_interrupt` is active the signal therefore only sets a flag, and long work asks for it between its
steps with :func:`check_interrupt`, in whatever thread it runs.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

__all__ = ["check_interrupt", "stopping_on_interrupt"]

_NOTICE = b"pmcl: stopping after this step; press Ctrl-C again to stop at once\n"


class _Watch:
    """Whether a handler is installed, and whether Ctrl-C was pressed since."""

    active = False
    requested = False


def check_interrupt() -> None:
    """Raise KeyboardInterrupt when Ctrl-C was pressed while :func:`stopping_on_interrupt` was active.

    Cheap enough to be called before every sweep, in any thread.
    """
    if _Watch.requested:
        raise KeyboardInterrupt


@contextmanager
def stopping_on_interrupt() -> Iterator[None]:
    """Let Ctrl-C stop the enclosed work at its next call of :func:`check_interrupt`.

    The handler is installed only in the main thread, where Python delivers signals, and only in place of Python's own
    handler: a program that handles Ctrl-C itself, or ignores it, is left alone. The handler before is put back in the
    end. Inside another such block this one does nothing.

    Raises
    ------
    KeyboardInterrupt
        In the end at the latest, so that no Ctrl-C is lost; also in place of an error that the interruption caused,
        such as that of a pool of processes which Ctrl-C has stopped too.
    """
    if (
        _Watch.active
        or threading.current_thread() is not threading.main_thread()
        or signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    ):
        yield
        return
    _Watch.active, _Watch.requested = True, False
    signal.signal(signal.SIGINT, _on_signal)
    try:
        yield
        check_interrupt()
    except Exception as error:
        if _Watch.requested:
            raise KeyboardInterrupt from error
        raise
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _Watch.active = _Watch.requested = False


def _on_signal(number: int, frame: FrameType | None) -> None:
    if _Watch.requested:
        signal.default_int_handler(number, frame)
    _Watch.requested = True
    # Not through sys.stderr: the signal may have come while that was being written to.
    if sys.__stderr__ is not None:
        with contextlib.suppress(OSError, ValueError):
            os.write(sys.__stderr__.fileno(), _NOTICE)
