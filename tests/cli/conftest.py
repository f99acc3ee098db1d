from __future__ import annotations

import pytest
from click.testing import CliRunner

from pmcl.cli.commands import pmcl as application
from pmcl.simulations.amigobot import simulate_amigobot


@pytest.fixture
def run():
    """A function that runs a command line and returns its result: exit_code, stdout, stderr."""

    def run_command(*arguments):
        return CliRunner().invoke(application, [str(argument) for argument in arguments])

    return run_command


@pytest.fixture
def refused(run):
    """A function that runs a command line and checks that it is refused in one line; returns the line."""

    def run_command(*arguments):
        result = run(*arguments)
        assert result.exit_code == 2, result.output
        lines = result.stderr.splitlines()
        assert len(lines) == 1, result.stderr
        assert lines[0].startswith("pmcl: error: ")
        assert result.stdout == ""
        return lines[0]

    return run_command


@pytest.fixture(scope="session")
def log():
    return simulate_amigobot(30.0)


@pytest.fixture
def log_file(log, tmp_path):
    path = tmp_path / "log.nc"
    log.write(path)
    return path
