"""The list of planted bugs fits the sources and the tests; ``plant_bugs.py`` itself is for a schedule of its own."""

from __future__ import annotations

import csv
import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
_specification = importlib.util.spec_from_file_location("plant_bugs", HERE / "plant_bugs.py")
plant_bugs = importlib.util.module_from_spec(_specification)
_specification.loader.exec_module(plant_bugs)


def test_every_bug_can_be_planted_and_its_test_exists():
    assert len(plant_bugs.BUGS) >= 40
    assert len({bug.what for bug in plant_bugs.BUGS}) == len(plant_bugs.BUGS)
    for bug in plant_bugs.BUGS:
        compile(plant_bugs.planted(bug), bug.source, "exec")
        assert f"def {bug.test}" in (HERE.parent / bug.file).read_text(), bug.what


def test_all_bugs_were_caught_when_they_were_last_planted():
    with open(HERE / "results.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["bug"] for row in rows] == [bug.what for bug in plant_bugs.BUGS]
    assert {row["outcome"] for row in rows} == {"caught"}


@pytest.mark.long
def test_all_bugs_are_caught():
    kept = (HERE / "results.csv").read_bytes()
    try:
        done = subprocess.run([sys.executable, HERE / "plant_bugs.py"], env=os.environ, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
    finally:
        (HERE / "results.csv").write_bytes(kept)
