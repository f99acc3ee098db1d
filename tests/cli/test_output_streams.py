"""Commands whose output goes nowhere: a full disk, a closed stream, a reader that has gone."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

COMMAND = f"{sys.executable} -c 'from pmcl.cli import main; main()' example"


def _run(redirection):
    return subprocess.run(["bash", "-c", f"{COMMAND} {redirection}"], capture_output=True, text=True, check=False)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a system without /dev/full")
def test_a_full_disk_behind_the_output_is_told_in_one_line():
    done = _run("> /dev/full")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("pmcl: error: expected that the output can be written, but got 'No space left on device'")


@pytest.mark.parametrize("redirection", [">&-", "2>&-", "| true"])
def test_output_that_nobody_takes_makes_no_noise(redirection):
    assert "Traceback" not in _run(redirection).stderr
