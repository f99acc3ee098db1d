"""A second process compiles what will be needed; nothing depends on it, and nothing is said when all is on disk."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pmcl
from pmcl.calibration import ParticleGibbs, calibrate
from pmcl.engine import compile_ahead as helper
from pmcl.engine.progress import _expected, announce_compilation, expect_compilations
from pmcl.filtering import ahead
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.registry import candidates
from pmcl.models.robot_model import default_model
from pmcl.models.tables import uniform
from pmcl.simulations.aibo import simulate_aibo
from pmcl.simulations.amigobot import simulate_amigobot

SMALL = """
from typing import NamedTuple
from pmcl.engine.compile import entry
from pmcl.engine.contract import scratch_rows

class Marked(NamedTuple):
    number: float

@scratch_rows.register(Marked)
def rows(table):
    return 3

@entry
def first(table):
    return scratch_rows(table)

@entry
def second(table):
    return scratch_rows(table) + 1
"""
# Prints the two answers, which of them were read from disk, how many helpers were started, and what was said.
PROGRAM = """
import logging, sys
from pmcl.engine import compile_ahead as ahead
import small

said = []
handler = logging.Handler()
handler.emit = lambda record: said.append(record.getMessage().replace(" ", "_"))
logging.getLogger("pmcl").addHandler(handler)
logging.getLogger("pmcl").setLevel(logging.INFO)
table = small.Marked(1.0)
BEFORE
ahead.compile_ahead([(small.first, (table,)), (small.second, (table,))])
AFTER
answers = [small.first(table), small.second(table)]
read = [sum(function.stats.cache_hits.values()) for function in (small.first, small.second)]
print(*answers, *read, len(ahead._helpers), *said)
"""


def _run(folder, *, before="", after="", **variables):
    (folder / "small.py").write_text(SMALL)
    (folder / "program.py").write_text(PROGRAM.replace("BEFORE", before).replace("AFTER", after))
    package = str(Path(pmcl.__file__).resolve().parents[1])
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(folder / "cache"),
        "PYTHONPATH": os.pathsep.join((package, str(folder))),
        "PMCL_COMPILE_AHEAD": "1",
        **variables,
    }
    command = [sys.executable, str(folder / "program.py")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    return done.stdout.split()


@pytest.fixture
def two_processors(monkeypatch):
    """Whatever this machine has: the programs ask for themselves, so they are told."""
    return "ahead._processors = lambda: 2"


@pytest.mark.slow
def test_the_helper_compiles_all_and_a_second_run_says_nothing(tmp_path, two_processors):
    waiting = "assert ahead._helpers[0].wait(200) == 0"
    assert _run(tmp_path, before=two_processors, after=waiting) == ["3", "4", "1", "1", "1"]
    # Now all is on disk: no helper, and nothing is said.
    assert _run(tmp_path, before=two_processors) == ["3", "4", "1", "1", "0"]


@pytest.mark.parametrize(
    ("before", "after", "helpers"),
    [
        pytest.param("import sys; sys.executable = '/nonexistent/python'", "", "0", marks=pytest.mark.slow,
                     id="cannot start"),
        pytest.param("ahead._BEGIN = 'import os; os._exit(1)'", "ahead._helpers and ahead._helpers[0].wait(60)", None,
                     marks=pytest.mark.slow, id="dies at once"),
        # It dies while it compiles: its lock is free again.
        pytest.param("", "import time; time.sleep(2.0); ahead._helpers[0].kill()", "1", id="dies later"),
    ],
)  # fmt: skip
def test_a_helper_that_fails_does_no_harm(tmp_path, two_processors, before, after, helpers):
    first, second, _, _, count, *_ = _run(tmp_path, before=f"{two_processors}; {before}", after=after)
    assert (first, second) == ("3", "4")
    assert helpers in (count, None)


def test_without_a_second_processor_this_process_compiles_and_counts(tmp_path):
    said = ["compiling_1_of_2_(first)_...", "compiling_2_of_2_(second)_..."]
    assert _run(tmp_path, before="ahead._processors = lambda: 1") == ["3", "4", "0", "0", "0", *said]


def test_the_helper_can_be_switched_off(tmp_path, two_processors):
    assert _run(tmp_path, before=two_processors, PMCL_COMPILE_AHEAD="0")[4] == "0"


def test_the_total_grows_with_what_was_not_expected_and_begins_anew_when_all_is_done(tmp_path, caplog):
    _expected.clear()
    one, two, three = (tmp_path / name for name in "abc")
    with caplog.at_level("INFO", "pmcl.compile"):
        expect_compilations([one, two])
        announce_compilation("one", one)
        one.touch()
        announce_compilation("three", three)
        two.touch()
        three.touch()
        announce_compilation("four", tmp_path / "d")
    _expected.clear()
    lines = ["compiling 1 of 2 (one) ...", "compiling 2 of 3 (three) ...", "compiling 1 of 1 (four) ..."]
    assert [record.getMessage() for record in caplog.records] == lines


@pytest.fixture(scope="module")
def short_log() -> RobotLog:
    return simulate_amigobot(duration=30.0, seed=1)


def _signatures(calls):
    import numba

    return {(function, tuple(numba.typeof(value) for value in arguments)) for function, arguments in calls}


def test_a_calibration_compiles_what_was_foreseen_and_little_else(short_log, monkeypatch):
    """A signature that is foreseen wrongly is compiled for nothing, and the right one is compiled late."""
    foreseen = []
    monkeypatch.setattr(ahead, "compile_ahead", foreseen.extend)
    calibrate(short_log, draws=4, chains=1, method=ParticleGibbs(burn_in_particles=50), seed=1)
    sampling = [(function, kinds) for function, kinds in _signatures(foreseen) if "pass" not in function.__name__]
    used = [function.__name__ for function, kinds in sampling if kinds in function.overloads]
    assert sorted(used) == ["joint_terms", "redraw_path", "refresh_blocks", "standardised", "transport_trial"]


def test_what_is_compiled_ahead_stays_within_its_budget(short_log, monkeypatch):
    """Each of these costs one to three seconds on a new machine; see what a new one buys before this is raised."""
    foreseen = []
    monkeypatch.setattr(ahead, "compile_ahead", foreseen.extend)
    tables = default_model(short_log).bind(short_log).tables(np.array([0.1, 0.1, 0.1, 0.1]))[0]
    ahead.compile_for_calibration(tables)
    assert len(_signatures(foreseen)) <= 7
    foreseen.clear()
    ahead.compile_for_criticism(tables)
    assert len(_signatures(foreseen)) <= 26
    assert helper._helpers == []


@pytest.mark.parametrize("simulate", [simulate_amigobot, simulate_aibo])
def test_all_effects_together_need_few_combinations_of_table_types(simulate, monkeypatch):
    """Kernels are compiled for each combination; those of whole families are compiled ahead."""
    import numba

    log = simulate(duration=60.0, seed=1)
    bound = default_model(log).bind(log)
    tables = bound.tables(bound.prior_mean())[0]
    foreseen = []
    monkeypatch.setattr(ahead, "compile_ahead", foreseen.extend)
    ahead.compile_for_criticism(tables)
    known = {numba.typeof(arguments[0]) for function, arguments in foreseen if function.__name__ == "guided_rows"}
    met = {numba.typeof(tables): ["no effect"]}
    for effect in candidates(log):
        values = np.array(next(iter(effect.typical.values())), dtype=float)
        met.setdefault(numba.typeof(uniform(effect.edit(tables, values, log))), []).append(effect.name)
    assert known <= set(met)
    # One effect has a state of its own, and is compiled for when it is tried.
    assert [names for kind, names in met.items() if kind not in known] == [["turn-noise-correlated"]]
    assert len(met) == 4
