"""Runs ``pmcl`` command lines with limits on CPU time and memory, and says what became of each."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

# What a command may take for one input, however bad it is [s of CPU], [byte].
CPU_SECONDS = 10
MEMORY = 2 * 2**30

_SERVER = Path(__file__).with_name("server.py")


@dataclass(frozen=True)
class Outcome:
    """What became of a command line.

    Attributes
    ----------
    status : int or None
        Exit status; None when the process was killed.
    stdout, stderr : str
        What it printed.
    crash : str
        The end of the traceback, where an exception was not caught.
    signal : int
        The signal that killed it, or 0.
    noise : str
        What libraries printed past Python.
    cpu : float
        CPU time [s].
    peak : int
        Memory that it took beyond that of the imported libraries, at most [byte].
    """

    status: int | None
    stdout: str
    stderr: str
    crash: str
    signal: int
    noise: str
    cpu: float
    peak: int


class Runner:
    """A process that runs command lines; a context manager."""

    def __enter__(self) -> Runner:
        self._process = subprocess.Popen(
            [sys.executable, str(_SERVER)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env={**os.environ, "PYTHONWARNINGS": ""},
        )  # fmt: skip
        return self

    def __exit__(self, *unused: object) -> None:
        self._process.stdin.close()
        self._process.wait(60)
        self._process.stdout.close()

    def warm(self, *arguments: object) -> Outcome:
        """Run a command line without limits, so that those that follow find imported and compiled what it needs."""
        return self._asked(arguments, warm=True)

    def run(self, *arguments: object) -> Outcome:
        """Run one command line."""
        return self._asked(arguments, warm=False)

    def _asked(self, arguments: tuple[object, ...], *, warm: bool) -> Outcome:
        request = {"arguments": [str(each) for each in arguments], "cpu_seconds": CPU_SECONDS, "memory": MEMORY,
                   "warm": warm}  # fmt: skip
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        return Outcome(**json.loads(self._process.stdout.readline()))
