"""Compilation of what will soon be needed, by a second process while this one goes on.

The helper takes the list from its end and puts what it compiled on disk. This process compiles what it meets first;
when it comes to something that the helper has finished it only reads it, and when the helper is at it, it waits
(:meth:`pmcl.engine.disk_cache.DiskCache.alone`). Nothing depends on the helper: when it cannot start or
dies, this process compiles everything itself.

The helper is a plain new interpreter. So it does not matter how this process was started, and a script needs no
``if __name__ == "__main__"``.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import numba

from pmcl.engine.disk_cache import current_sources, kernel_modules
from pmcl.engine.functions import EntryFunction
from pmcl.engine.progress import expect_compilations

__all__ = ["Call", "compile_ahead", "serve"]

# A compiled function, and arguments of the types that it will be called with.
Call = tuple[EntryFunction, tuple[Any, ...]]

# Set to 0, it keeps the helper from being started.
_SWITCH = "PMCL_COMPILE_AHEAD"
# A new interpreter costs two seconds: for one function alone it does not pay.
_LEAST = 2
_BEGIN = """
import json, sys
sys.path[:] = json.loads(sys.stdin.buffer.readline())
from pmcl.engine.compile_ahead import serve
serve(sys.stdin.buffer)
"""
_helpers: list[subprocess.Popen[bytes]] = []


def compile_ahead(calls: Sequence[Call]) -> None:
    """Let a helper process compile what these calls need, where that is not on disk yet.

    Parameters
    ----------
    calls : sequence of (function, arguments)
        In the order in which they will be made. Nothing is called: only the types of the arguments matter.

    Notes
    -----
    Nothing is started when all is on disk, when there is one processor only, when no folder can be written, or when the
    environment variable ``PMCL_COMPILE_AHEAD`` is 0. At most one helper works at a time.
    """
    missing: dict[Any, tuple[str, str, Any]] = {}
    for function, arguments in calls:
        signature = tuple(numba.typeof(value) for value in arguments)
        file = function.file_to_come(signature)
        if file is not None:
            missing.setdefault(file, (function.py_func.__module__, function.py_func.__name__, signature))
    expect_compilations(missing)
    busy = any(helper.poll() is None for helper in _helpers)
    if len(missing) < _LEAST or busy or os.environ.get(_SWITCH) == "0" or _processors() < 2:
        return
    with contextlib.suppress(OSError, ValueError, pickle.PicklingError, AttributeError):
        _start(list(missing.values()))


def _processors() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # macOS, Windows
        return os.cpu_count() or 1


def _start(jobs: list[tuple[str, str, Any]]) -> None:
    request = pickle.dumps((current_sources(), jobs))
    # Interrupts from the keyboard are for this process; the helper ends when its input does.
    apart: dict[str, Any] = {"start_new_session": True}
    if sys.platform == "win32":
        apart = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    helper = subprocess.Popen(
        [sys.executable, "-c", _BEGIN], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        **apart,
    )  # fmt: skip
    _helpers.append(helper)
    assert helper.stdin is not None
    for line in (sys.path, kernel_modules()):
        helper.stdin.write(json.dumps(line).encode() + b"\n")
    helper.stdin.write(len(request).to_bytes(8, "little") + request)
    helper.stdin.flush()


@atexit.register
def _stop() -> None:
    for helper in _helpers:
        with contextlib.suppress(OSError):
            helper.kill()
        helper.wait()
        with contextlib.suppress(OSError):
            if helper.stdin is not None:
                helper.stdin.close()


def serve(stream: Any) -> None:
    """Be the helper: compile what `stream` asks for, the last first."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in json.loads(stream.readline()):
        import_module(name)
    sources, jobs = pickle.loads(stream.read(int.from_bytes(stream.read(8), "little")))
    if current_sources() != sources:
        # This interpreter sees other files than the one that asks, which could not use what is compiled here.
        return
    threading.Thread(target=_end_with, args=(stream,), daemon=True).start()
    for module, name, signature in reversed(jobs):
        getattr(import_module(module), name).compile_unless_busy(signature)
    # At once: an interpreter that shuts down orderly would wait for the thread that reads.
    os._exit(0)


def _end_with(stream: Any) -> None:
    """End this process as soon as the one that asked is gone."""
    stream.read()
    os._exit(0)
