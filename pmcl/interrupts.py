"""Ctrl-C, or a cluster's SIGTERM, during long work: the first stops it at its next step, the second at once.

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
from typing import Any

__all__ = ["check_interrupt", "stopping_on_interrupt"]

_NOTICES = {
    signal.SIGINT: b"pmcl: stopping after this step; press Ctrl-C again to stop at once\n",
    # What a cluster sends some seconds before it kills a job.
    signal.SIGTERM: b"pmcl: told to end; stopping after this step\n",
}
# Only in place of these handlers: a program that handles a signal itself, or ignores it, is left alone.
_PYTHONS_OWN: dict[signal.Signals, Any] = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}


class _Watch:
    """Whether a handler is installed, and whether a signal came since."""

    active = False
    requested = False


class _Mask(threading.local):
    """The signals that this thread had blocked before it forked; None while it does not fork."""

    before: set[int] | None = None


_mask = _Mask()


def check_interrupt() -> None:
    """Raise KeyboardInterrupt when Ctrl-C was pressed while :func:`stopping_on_interrupt` was active.

    Cheap enough to be called before every sweep, in any thread.
    """
    if _Watch.requested:
        raise KeyboardInterrupt


@contextmanager
def stopping_on_interrupt() -> Iterator[None]:
    """Let Ctrl-C or SIGTERM stop the enclosed work at its next call of :func:`check_interrupt`.

    The handler is installed only in the main thread, where Python delivers signals, and only in place of Python's own
    handler: a program that handles a signal itself, or ignores it, is left alone. The handler before is put back in the
    end. Inside another such block this one does nothing.

    Raises
    ------
    KeyboardInterrupt
        In the end at the latest, so that no Ctrl-C is lost; also in place of an error that the interruption caused,
        such as that of a pool of processes which Ctrl-C has stopped too.
    """
    in_main_thread = threading.current_thread() is threading.main_thread()
    replaced = [number for number, own in _PYTHONS_OWN.items() if in_main_thread and signal.getsignal(number) is own]
    if _Watch.active or not replaced:
        yield
        return
    _Watch.active, _Watch.requested = True, False
    for number in replaced:
        signal.signal(number, _on_signal)
    try:
        yield
        check_interrupt()
    except Exception as error:
        if _Watch.requested:
            raise KeyboardInterrupt from error
        raise
    finally:
        for number in replaced:
            signal.signal(number, _PYTHONS_OWN[number])
        _Watch.active = _Watch.requested = False


def _on_signal(number: int, frame: FrameType | None) -> None:
    if _Watch.requested:
        signal.signal(number, _PYTHONS_OWN[signal.Signals(number)])
        signal.raise_signal(number)
        return
    _Watch.requested = True
    # Not through sys.stderr: the signal may have come while that was being written to.
    if sys.__stderr__ is not None:
        with contextlib.suppress(OSError, ValueError):
            os.write(sys.__stderr__.fileno(), _NOTICES[signal.Signals(number)])


def _before_fork() -> None:
    if _Watch.active:
        _mask.before = {int(number) for number in signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})}


def _after_fork_in_parent() -> None:
    if _mask.before is not None:
        signal.pthread_sigmask(signal.SIG_SETMASK, _mask.before)
        _mask.before = None


def _after_fork_in_child() -> None:
    if signal.getsignal(signal.SIGTERM) is _on_signal:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
    _after_fork_in_parent()


# A pool ends its processes by SIGTERM and waits for their end, so that those forked from here must not go on until
# their next step. The signal stays blocked until they have Python's own handler again: a new process forgets the
# signals that came before Python has noticed the fork.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=_before_fork, after_in_parent=_after_fork_in_parent, after_in_child=_after_fork_in_child
    )
