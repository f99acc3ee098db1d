"""What must become of a bad input, and a table of what became of many."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from corpus.cases import REFUSED, Case
from corpus.runner import Outcome, Runner

__all__ = ["Result", "checked", "summary"]

# A message is one line that people can read on a terminal.
_LONGEST_MESSAGE = 1000


class Result(NamedTuple):
    """What became of a case: what is wrong with that, if anything, and what the commands took at most."""

    case: Case
    problem: str
    accepted: bool
    cpu: float
    peak: int


def checked(case: Case, runner: Runner, folder: Path) -> Result:
    """Run a case in an empty folder, and judge what became of it."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    arguments = [str(each) for each in case.make(folder)]
    before = _contents(folder)
    outcome = runner.run(*arguments)
    accepted, problem = outcome.status == 0, _problem(outcome, folder, before)
    if not problem and not accepted and not case.of_option and str(folder) not in outcome.stderr:
        problem = f"a message that does not name the file, {outcome.stderr!r}"
    cpu, peak = outcome.cpu, outcome.peak
    if not problem and accepted and case.expected == REFUSED:
        problem = f"accepted, {outcome.stdout[-300:]!r}"
    if not problem and not accepted and case.says not in outcome.stderr:
        problem = f"expected {case.says!r}, got {outcome.stderr!r}"
    if not problem and accepted and case.follow is not None:
        followed = runner.run(*case.follow(folder))
        cpu, peak = max(cpu, followed.cpu), max(peak, followed.peak)
        problem = _problem(followed, folder, None)
        problem = problem and f"when it is used: {problem}"
    shutil.rmtree(folder, ignore_errors=True)
    return Result(case, problem, accepted, cpu, peak)


def _contents(folder: Path) -> dict[str, int]:
    return {path.name: path.lstat().st_size for path in folder.iterdir()}


def _problem(outcome: Outcome, folder: Path, before: dict[str, int] | None) -> str:
    """Say what is wrong with an outcome: "" when the input was accepted, or refused as it should be."""
    if outcome.signal or outcome.status is None:
        return f"killed by signal {outcome.signal} after {outcome.cpu:.1f} s of CPU, {outcome.noise}"
    if outcome.crash:
        return f"a traceback: {outcome.crash}"
    if outcome.noise:
        return f"a library printed {outcome.noise!r}"
    if outcome.status == 0:
        return "" if "Traceback" not in outcome.stderr else f"printed {outcome.stderr!r}"
    lines = outcome.stderr.splitlines()
    if outcome.status != 2:
        return f"exit status {outcome.status}, {outcome.stderr!r}"
    # pmcl's own warnings may come before the error.
    if sum(line.startswith("pmcl: error: ") for line in lines) != 1 or not lines[-1].startswith("pmcl: error: "):
        return f"expected one line 'pmcl: error: ', got {outcome.stderr!r}"
    if not all(line.startswith(("warning: ", "pmcl: error: ")) for line in lines):
        return f"other lines beside the error, {outcome.stderr!r}"
    if len(lines[-1]) > _LONGEST_MESSAGE:
        return f"a message of {len(lines[-1])} characters, {lines[-1][:300]!r}"
    # What to do stands at the end, after a colon, a semicolon or in brackets.
    if "expected" not in lines[-1] and "; " not in lines[-1]:
        return f"a message that says neither what was expected nor what to do, {lines[-1]!r}"
    if before is not None and _contents(folder) != before:
        return f"files were left behind: {sorted(set(_contents(folder)) - set(before))}"
    return ""


def summary(results: Iterable[Result]) -> str:
    """Write a table: for each family how many cases there were, what became of them, and what they took."""
    results = list(results)
    rows = ["family        cases  refused  accepted  failed   CPU [s], most    memory [MB], most"]
    for family in Counter(result.case.family for result in results):
        mine = [result for result in results if result.case.family == family]
        failed = sum(bool(result.problem) for result in mine)
        accepted = sum(result.accepted for result in mine)
        cpu = sum(result.cpu for result in mine)
        rows.append(
            f"{family:12s} {len(mine):6d} {len(mine) - accepted:8d} {accepted:9d} {failed:7d} {cpu:9.1f}"
            f"{max(r.cpu for r in mine):7.1f} {max(r.peak for r in mine) / 1e6:20.0f}"
        )
    return "\n".join(rows)
