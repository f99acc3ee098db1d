"""Runs command lines one after the other, each in a forked process with limits on CPU time and memory.

Reads one JSON object a line from stdin (``arguments``, ``cpu_seconds``, ``memory``, ``warm``) and answers with one on
stdout. Everything is imported before the first command, so that a fork is all that a command costs; the process has one
thread, so that a fork is safe. :mod:`corpus.runner` starts it.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
import tempfile

os.environ.setdefault("PMCL_COMPILE_AHEAD", "0")
# A thread of another library would make forking unsafe, and its memory would count for each command.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"

# The longest time that passes while a command runs, relative to its CPU time.
_WAITS = 10

_IMPORTED = (
    "pmcl.calibration.workflow", "pmcl.exports.export", "pmcl.identifiability.workflow", "pmcl.localization.offline",
    "pmcl.logs.bags.read", "pmcl.logs.barfoot", "pmcl.logs.carmen", "pmcl.logs.csv_log", "pmcl.logs.mrclam",
    "pmcl.logs.wean", "pmcl.maps.map_server", "pmcl.maps.wean", "pmcl.models.model_file", "pmcl.posterior.files",
    "pmcl.preflight.check", "pmcl.reports.posterior_report", "arviz", "h5netcdf", "matplotlib.pyplot",
    "rosbags.rosbag1", "rosbags.rosbag2", "ruamel.yaml", "scipy.io", "PIL.PngImagePlugin", "PIL.PpmImagePlugin",
)  # fmt: skip


def _sizes():
    """Return how many memory addresses this process has, and how many of them are in memory [byte]."""
    with open("/proc/self/statm", encoding="ascii") as stream:
        return [int(word) * resource.getpagesize() for word in stream.read().split()[:2]]


def _run(request, answer):
    """Run one command in this process, which ends with it."""
    from click.testing import CliRunner

    from pmcl.cli.commands import pmcl as application

    seconds = int(request["cpu_seconds"])
    # At the soft limit SIGXCPU ends the process; Python installs no handler for it.
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    # A process that waits takes no CPU time; on a busy machine one that computes waits as well.
    signal.alarm(_WAITS * seconds)
    addresses, resident = _sizes()
    most = addresses + int(request["memory"])
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    result = CliRunner().invoke(application, request["arguments"])
    crash = ""
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        import traceback

        crash = "".join(traceback.format_exception(result.exception))[-3000:]
    found = {"status": result.exit_code, "stdout": result.stdout, "stderr": result.stderr, "crash": crash}
    found["resident"] = resident
    with os.fdopen(answer, "w", encoding="utf-8") as stream:
        json.dump(found, stream)


def _warm(request):
    """Run a command in this process: what it imports and compiles is then there in every fork."""
    from click.testing import CliRunner

    from pmcl.cli.commands import pmcl as application

    result = CliRunner().invoke(application, request["arguments"])
    found = {"status": result.exit_code, "stdout": result.stdout, "stderr": result.stderr}
    return {**found, "crash": repr(result.exception), "signal": 0, "noise": "", "cpu": 0.0, "peak": 0}


def _serve(request):
    here, there = os.pipe()
    with tempfile.TemporaryFile() as noise:
        child = os.fork()
        if child == 0:
            try:
                os.close(here)
                os.dup2(noise.fileno(), 1)
                os.dup2(noise.fileno(), 2)
                _run(request, there)
            except BaseException as problem:
                os.write(2, f"the checker failed: {problem!r}"[:1000].encode())
            finally:
                os._exit(0)
        os.close(there)
        with os.fdopen(here, "r", encoding="utf-8") as stream:
            text = stream.read()
        _, status, usage = os.wait4(child, 0)
        noise.seek(0)
        said = noise.read(2000).decode("utf-8", errors="replace")
    found = json.loads(text) if text else {"status": None, "stdout": "", "stderr": "", "crash": ""}
    found["signal"] = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
    found["noise"] = said
    found["cpu"] = usage.ru_utime + usage.ru_stime
    # Before it begins, the process has the libraries in memory that its parent has imported.
    found["peak"] = max(usage.ru_maxrss * 1024 - found.pop("resident", 0), 0)
    return found


def main():
    """Serve until stdin ends."""
    import importlib

    for name in _IMPORTED:
        importlib.import_module(name)
    # The channel is ours alone: what a command prints goes elsewhere.
    channel = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    for line in sys.stdin:
        request = json.loads(line)
        channel.write(json.dumps((_warm if request["warm"] else _serve)(request)) + "\n")
        channel.flush()


if __name__ == "__main__":
    main()
