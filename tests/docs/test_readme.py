"""Everything that the README shows is true: its code runs, its commands run, and it names what exists."""

from __future__ import annotations

import ast
import contextlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import click
import pytest
from docs.documents import METHODS, README, commands, fences, mentioned_commands, shortened

from pmcl.cli.commands import pmcl as application
from pmcl.examples import own_robot


def test_blocks_are_python_or_commands():
    """A block in a language that no test here runs would go unnoticed."""
    assert len(fences("python")) >= 4
    assert len(commands()) >= 8
    assert README.read_text(encoding="utf-8").count("\n```") == 2 * (len(fences("python")) + len(fences("")))


@pytest.mark.parametrize("block", fences("python"), ids=lambda block: block.partition("\n")[0])
def test_every_name_that_the_readme_imports_exists(block):
    for node in ast.parse(block).body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            exec(ast.unparse(node), {})


@pytest.mark.parametrize("arguments", mentioned_commands(), ids=" ".join)
def test_every_command_of_the_readme_has_these_options(arguments, tmp_path, monkeypatch):
    """The command line is parsed as for a run; nothing is read or written."""
    monkeypatch.chdir(tmp_path)
    command, info = application, "pmcl"
    with click.Context(application, info_name=info) as context:
        while isinstance(command, click.Group) and arguments:
            info, command, rest = command.resolve_command(context, arguments)
            arguments = rest
        if "--effects" in arguments:  # a file that the command before it writes
            arguments = [a for a in arguments if a != "--effects" and not a.endswith(".py")]
        # What the text leaves out is what it is not about, such as -o.
        with contextlib.suppress(click.MissingParameter):
            command.make_context(info, list(arguments), parent=context)


@pytest.mark.parametrize("document", [README, METHODS], ids=["README", "methods"])
def test_links_lead_to_files(document):
    text = document.read_text(encoding="utf-8")
    headings = {
        re.sub(r"[^\w\- ]", "", line.lstrip("# ").lower()).strip().replace(" ", "-")
        for line in text.splitlines()
        if line.startswith("#")
    }
    for target in re.findall(r"\]\(([^)]+)\)", text):
        if target.startswith("#"):
            assert target[1:] in headings, target
        elif not target.startswith("http"):
            assert (document.parent / target.partition("#")[0]).exists(), target


@pytest.mark.slow
def test_python_of_the_readme_runs_in_order(tmp_path, monkeypatch, capsys):
    """One reader, one session: names of a block are known in the next. The robot of the example made the files."""
    monkeypatch.chdir(tmp_path)
    own_robot.record(duration=100.0)
    scope: dict[str, object] = {}
    for block in fences("python"):
        exec(compile(shortened(block), str(README), "exec"), scope)
    assert (tmp_path / "robot.nc").is_file()
    assert (tmp_path / "posterior.nc").is_file()
    assert "[" in capsys.readouterr().out.splitlines()[-1]  # the last pose


def _run(line: str, folder: Path) -> None:
    """Run one line in a shell; statuses 3 and 4 (not converged, does not fit) are results too, of a run so short."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-c", shortened(line)], cwd=folder, env={**os.environ, "PATH": path}, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    samples = "pmcl calibrate" in line or "pmcl fleet" in line or ("pmcl criticize" in line and "--posterior" in line)
    usable = (0, 3, 4) if samples else (0,)
    assert done.returncode in usable, f"{line}\n{done.stdout}\n{done.stderr}"


def _written(line: str) -> set[str]:
    options = "-o|--json|--tum|--started-log|--save-model|>"
    if "pmcl criticize" in line:  # which writes what other commands read
        options += "|--posterior"
    return set(re.findall(rf"(?:{options}) (\S+)", line))


# What the README's commands read: names of files and folders, and where they are among the recorded data.
RECORDINGS = {
    "MRCLAM_Dataset6": "mrclam6",
    "jarvis_complex_path_fast.bag": "jarvis/jarvis_complex_path_fast.bag",
    "i-108_10mm.yaml": "jarvis/i-108_10mm.yaml",
    "i-108_10mm.pgm": "jarvis/i-108_10mm.pgm",
    "robotdata1.log": "wean/robotdata1.log",
    "wean.dat.gz": "wean/wean.dat.gz",
}


def _possible_without(names: Iterable[str], lines: list[str]) -> list[str]:
    """Leave out the commands that read some files or folders, or what such commands write."""
    absent, possible = set(names), []
    for line in lines:
        if absent & set(line.split()):
            absent |= _written(line)
        else:
            possible.append(line)
    return possible


def _without_criticism_of_recordings(lines: list[str]) -> list[str]:
    """Leave out the commands that criticise a recorded drive for minutes, and those that read what these write."""
    long = [line for line in lines if "pmcl criticize" in line and "steered.nc" not in line]
    assert len(long) >= 2
    return _possible_without(set().union(*map(_written, long)), [line for line in lines if line not in long])


# One of the README's criticisms, of a simulated robot, always runs.
@pytest.mark.parametrize("recordings_are_criticised", [
    pytest.param(False, marks=pytest.mark.slow), pytest.param(True, marks=pytest.mark.long),
])  # fmt: skip
def test_commands_of_the_readme_run_in_order(tmp_path, request, recordings_are_criticised):
    lines = commands() if recordings_are_criticised else _without_criticism_of_recordings(commands())
    try:
        data = request.getfixturevalue("shared_data")
        for name, place in RECORDINGS.items():
            if (data / place).is_dir():
                (tmp_path / name).symlink_to(data / place)
            else:  # a log names its map only where the map itself is in its folder
                shutil.copy(data / place, tmp_path / name)
    except pytest.skip.Exception:
        lines = _possible_without(RECORDINGS, lines)
    assert shutil.which("bash")
    for line in lines:
        _run(line, tmp_path)
    written = set().union(*map(_written, lines))
    assert len(written) >= 2
    for name in written:
        assert (tmp_path / name).stat().st_size > 0, name
