"""What is tested must be what is installed."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

import pytest

import pmcl


def test_the_package_under_test_is_the_expected_one():
    expected = os.environ.get("PMCL_EXPECTED_HOME")
    if expected is None:
        pytest.skip("PMCL_EXPECTED_HOME not set: any installation will do")
    assert Path(pmcl.__file__).resolve().is_relative_to(Path(expected).resolve())


def test_data_files_and_the_command_are_installed():
    home = Path(pmcl.__file__).parent
    assert (home / "py.typed").is_file()
    assert (home / "reports" / "templates" / "posterior.html.j2").is_file()
    (command,) = [entry for entry in entry_points(group="console_scripts") if entry.name == "pmcl"]
    assert callable(command.load())


def test_the_command_line_is_a_module_too():
    done = subprocess.run([sys.executable, "-m", "pmcl", "--version"], capture_output=True, text=True, check=True)
    assert pmcl.__version__ in done.stdout
