"""Compilation happens once per model, is kept on disk, and never outlives the source it was made from."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
import pytest
from numba import errors, njit
from oracles import hidden_markov
from oracles.random_walk_model import rail_log, rail_model

from pmcl.engine import contract, disk_cache
from pmcl.engine.compile import entry, generic
from pmcl.engine.disk_cache import DiskCache
from pmcl.engine.file_lock import FileLock
from pmcl.engine.vector_math import exp_into
from pmcl.errors import ModelError
from pmcl.filtering.kernels import smc
from pmcl.filtering.particle_filter import make_rng, update_path
from pmcl.models.sensor import sensors
from pmcl.models.starts.table import GaussianStart

TESTS = Path(__file__).resolve().parents[1]
PACKAGE = Path(disk_cache.__file__).resolve().parents[2]

# A kernel of one's own, in a file of its own: its answer is VALUE, so a stale one would be seen.
SMALL = """
from typing import NamedTuple
from pmcl.engine.compile import entry, generic
from pmcl.engine.contract import scratch_rows

class Marked(NamedTuple):
    number: float

@scratch_rows.register(Marked)
def rows(table):
    return VALUE

@entry
def answer(table):
    return scratch_rows(table)
"""
RUN_SMALL = """
import sys
from pmcl.engine import disk_cache
if len(sys.argv) > 1:
    disk_cache._package_hash = lambda: sys.argv[1]
import small
value = small.answer(small.Marked(1.0))
print(value, sum(small.answer.stats.cache_hits.values()), sum(small.answer.stats.cache_misses.values()))
"""
RUN_INNER = """
import small
from numba import typeof
from pmcl.engine.contract import scratch_rows
inner = scratch_rows.compiled[small.Marked, None]
inner.compile((typeof(small.Marked(1.0)),))
print(sum(inner.stats.cache_hits.values()), sum(inner.stats.cache_misses.values()))
"""
SAMPLE = """
import numpy as np
from pmcl.filtering.kernels import smc
from pmcl.models.motions.increments.table import IncrementMotion
from pmcl.models.starts.table import GaussianStart
from pmcl.models.tables import Tables
tables = Tables(GaussianStart(np.zeros(3), np.ones(3)), IncrementMotion(np.zeros((2, 3)), np.ones((2, 3))), ())
print("%.6f" % smc.joint_terms(tables, np.zeros((2, 3)))[0], len(smc.joint_terms.stats.cache_hits))
"""
WITH_USER_MODEL = """
import numpy as np
from oracles.random_walk_model import rail_log, rail_model
from pmcl.filtering.particle_filter import log_joint
print(log_joint(rail_model().bind(rail_log(4, 1)).tables(np.ones(2))[0], np.full((4, 1), 50.0)))
"""


def _run(code, folder, *arguments, cache, paths=()):
    """Run a program in a process of its own and return what it prints; its kernels are cached in `cache`."""
    (folder / "program.py").write_text(code)
    environment = _environment(cache, paths)
    command = [sys.executable, str(folder / "program.py"), *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def _environment(cache, paths=()):
    return os.environ | {
        "NUMBA_CACHE_DIR": str(cache),
        "PYTHONPATH": os.pathsep.join(str(path) for path in (PACKAGE, *paths)),
    }


def test_two_models_run_twice_are_compiled_once_each():
    """What counts is how many signatures the entry point knows."""
    rail = rail_model().bind(rail_log(6, seed=1)).tables(np.array([0.5, 0.4]))[0]
    chain, rng = hidden_markov.chain_tables(), make_rng(1)

    def run():
        update_path(rail, np.full((6, 1), 50.0), 6, 5, rng, "smoothing")
        update_path(chain, np.zeros((4, 1)), 4, 5, rng, "smoothing")

    run()
    known = len(smc.redraw_path.signatures)
    handled = sum(smc.redraw_path.stats.cache_hits.values()) + sum(smc.redraw_path.stats.cache_misses.values())
    run()
    # Neither other numbers, nor other lengths, nor the other kernel make another program.
    update_path(rail, np.full((6, 1), 50.0), 4, 9, rng, "conditional")
    assert len(smc.redraw_path.signatures) == known
    assert sum(smc.redraw_path.stats.cache_hits.values()) + sum(smc.redraw_path.stats.cache_misses.values()) == handled


def test_tables_of_one_model_have_one_type():
    """A table that were read-only, or not contiguous, at another theta would compile everything again."""
    bound = rail_model().bind(rail_log(6, seed=1))
    kinds = {numba.typeof(bound.tables(np.array(theta))[0]) for theta in ([0.5, 0.4], [1.0, 2.0])}
    assert len(kinds) == 1


class Growing(NamedTuple):
    """A table whose implementation makes an array, without saying so."""

    number: float


@contract.scratch_rows.register(Growing)
def _rows_of_growing(table):
    return np.zeros(3).size


class Honest(NamedTuple):
    """One that says so."""

    number: float


@contract.scratch_rows.register(Honest, allocates=True)
def _rows_of_honest(table):
    return np.zeros(3).size


@entry
def rows_of(table):
    return contract.scratch_rows(table)


def test_an_implementation_that_makes_arrays_without_saying_so_is_named_in_one_line():
    with pytest.raises(ModelError, match=r"_rows_of_growing \(.*test_compile.py.*allocates=True") as caught:
        rows_of(Growing(1.0))
    assert "\n" not in str(caught.value)
    assert rows_of(Honest(1.0)) == 3


def rail_tables():
    return rail_model().bind(rail_log(6, seed=1)).tables(np.array([0.5, 0.4]))[0]


def _types(*tables):
    return tuple(numba.typeof(table) for table in tables)


def _file_of(signature=(1,), function=smc.redraw_path):
    return function._cache.file_of(signature, function.targetctx.codegen())


def test_the_file_changes_with_any_kernel_source(monkeypatch):
    before = _file_of()
    assert _file_of() == before
    monkeypatch.setattr(disk_cache, "_package_hash", lambda: "other sources")
    assert _file_of() != before


def test_the_file_changes_with_the_function_its_signature_and_how_it_is_compiled(tmp_path):
    names = {_file_of().name, _file_of((2,)).name, _file_of((1,), smc.joint_terms).name}
    names |= {_file_of((1,), function).name for function in (exp_into, smc.work_rows)}
    sweep = smc.redraw_path
    other = DiskCache(sweep.py_func, {"nogil": False}, sweep._cache._make)
    names.add(other.file_of((1,), sweep.targetctx.codegen()).name)
    assert len(names) == 6


def test_table_types_of_one_name_in_two_modules_have_two_files():
    """What numba calls a type says only how a table is called, not where it comes from."""
    files = set()
    for module in ("one", "other"):

        class Table(NamedTuple):
            number: float

        Table.__module__ = module
        files.add(_file_of((numba.typeof((Table(1.0),)),)))
    assert len(files) == 2


def test_the_file_covers_every_kernel_file_and_registered_implementation(monkeypatch):
    before = disk_cache._package_hash.__wrapped__()
    for name in ("neighbours.py", "plain.py", "smc.py", "vector_math.py", "tables.py"):
        with monkeypatch.context() as patch:
            real = Path.read_bytes
            patch.setattr(
                Path, "read_bytes", lambda path, name=name, real=real: real(path) + (b"#" if path.name == name else b"")
            )
            assert disk_cache._package_hash.__wrapped__() != before, name
    assert str(Path(hidden_markov.__file__)) in disk_cache._extra_sources


def test_every_source_of_the_package_that_holds_compiled_code_is_covered():
    """One that is not would count as a stranger's: imported later than others it would make all be compiled again."""
    home = Path(disk_cache.__file__).parents[1]
    holds = re.compile(r"^@(kernel|entry|generic)\b|^@[\w.]+\.register\(\w|^@overload_for_types", re.MULTILINE)
    found = {path for path in home.rglob("*.py") if holds.search(path.read_text(encoding="utf-8"))}
    assert len(found) > 50
    examples = {path for path in found if path.parent.name == "examples"}
    assert {path.name for path in examples} == {"own_sensor.py"}
    assert found - examples <= set(disk_cache._own_sources())


def _files(*tables):
    """The file of one of pmcl's functions of these tables, and of a tuple of them."""
    return [_file_of(_types(*tables)), _file_of(_types(tables))]


def test_only_tables_that_another_source_implements_something_for_depend_on_it(monkeypatch, tmp_path):
    own, foreign = rail_tables().start, rail_tables().motion
    sources, kinds = dict(disk_cache._extra_sources), set(disk_cache._extra_types)
    monkeypatch.setattr(disk_cache, "_extra_sources", sources)
    monkeypatch.setattr(disk_cache, "_extra_types", kinds)
    of_own, of_foreign, of_both = _files(own), _files(foreign), _files(own, foreign)
    in_tests = [_file_of(_types(own), rows_of)]
    sources[str(tmp_path / "another.py")] = "a hash"
    assert _files(own) == of_own
    changed = [_files(foreign), _files(own, foreign), [_file_of(_types(own), rows_of)]]
    for before, after in zip([of_foreign, of_both, in_tests], changed, strict=True):
        assert not set(before) & set(after)
    # From now on another source may be reached from pmcl's own functions.
    for kind in (type(own), object):
        with monkeypatch.context() as patch:
            patch.setattr(disk_cache, "_extra_types", kinds | {disk_cache._name_of(kind)})
            assert not set(_files(own)) & set(of_own), kind


def test_which_types_another_source_implements_something_for(monkeypatch):
    sources, kinds = dict(disk_cache._extra_sources), set()
    monkeypatch.setattr(disk_cache, "_extra_sources", sources)
    monkeypatch.setattr(disk_cache, "_extra_types", kinds)
    one = generic(lambda table: None)
    one.register(GaussianStart)(lambda table: 1)
    assert kinds == {disk_cache._name_of(GaussianStart)}
    kinds.clear()
    # Extras of one's own leave tables with other extras, and without any, as they are.
    one.register(GaussianStart, Growing)(lambda table: 2)
    assert kinds == {disk_cache._name_of(Growing)}
    one.register(object)(lambda table: 3)
    assert "builtins.object" in kinds


def test_a_second_process_uses_what_the_first_compiled_until_a_source_changes(tmp_path):
    source = tmp_path / "small.py"
    source.write_text(SMALL.replace("VALUE", "3"))

    def run(*arguments):
        return _run(RUN_SMALL, tmp_path, *arguments, cache=tmp_path / "cache", paths=(tmp_path,))

    assert run() == ["3", "0", "1"]
    assert run() == ["3", "1", "0"]
    # Another version of pmcl's own kernels, then another implementation: neither may find the old code.
    assert run("other") == ["3", "0", "1"]
    source.write_text(SMALL.replace("VALUE", "4"))
    assert run() == ["4", "0", "1"]
    assert run() == ["4", "1", "0"]


@pytest.mark.slow
def test_inner_functions_are_read_from_disk_by_another_process(tmp_path):
    """A second entry that calls the same inner function finds its intermediate code, although it is itself new."""
    source = tmp_path / "small.py"
    source.write_text(SMALL.replace("VALUE", "3"))
    _run(RUN_SMALL, tmp_path, cache=tmp_path / "cache", paths=(tmp_path,))
    for file in (tmp_path / "cache").rglob("small.answer*.nbc"):
        file.unlink()
    assert _run(RUN_SMALL, tmp_path, cache=tmp_path / "cache", paths=(tmp_path,)) == ["3", "0", "1"]
    assert _run(RUN_INNER, tmp_path, cache=tmp_path / "cache", paths=(tmp_path,)) == ["1", "0"]


@pytest.mark.slow
def test_a_damaged_file_is_compiled_anew(tmp_path):
    (tmp_path / "small.py").write_text(SMALL.replace("VALUE", "3"))

    def run():
        return _run(RUN_SMALL, tmp_path, cache=tmp_path / "cache", paths=(tmp_path,))

    run()
    for file in (tmp_path / "cache").rglob("*.nbc"):
        file.write_bytes(file.read_bytes()[:100])
    assert run() == ["3", "0", "1"]
    assert run() == ["3", "1", "0"]


def test_of_processes_that_start_together_only_the_first_compiles(tmp_path):
    """The others wait for its file; all of them get the right answer."""
    (tmp_path / "small.py").write_text(SMALL.replace("VALUE", "3"))
    (tmp_path / "program.py").write_text(RUN_SMALL)
    environment = _environment(tmp_path / "cache", (tmp_path,))
    command = [sys.executable, str(tmp_path / "program.py")]
    started = [subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    answers = [process.communicate(timeout=300)[0].split() for process in started]
    assert {answer[0] for answer in answers} == {"3"}
    assert [sum(int(answer[k]) for answer in answers) for k in (1, 2)] == [2, 1]
    assert not list((tmp_path / "cache").rglob("*.lock"))


def test_a_lock_is_free_again_when_it_is_given_back(tmp_path):
    path = tmp_path / "one.lock"
    with FileLock(path) as one, FileLock(path) as other:
        assert one.acquire()
        assert not other.acquire()
        one.release()
        assert other.acquire()
    assert not path.exists()


def test_where_nothing_can_be_written_a_lock_keeps_nobody_waiting(tmp_path):
    (tmp_path / "file").write_text("")
    with FileLock(tmp_path / "file" / "one.lock") as lock:
        assert lock.acquire()


@pytest.mark.slow
def test_kernels_survive_a_cache_that_names_types_they_cannot_import(tmp_path):
    """Somebody's own model was compiled here; a process that cannot import it works, and finds its own code again."""
    cache = tmp_path / "cache"
    _run(WITH_USER_MODEL, tmp_path, cache=cache, paths=(TESTS,))
    first = _run(SAMPLE, tmp_path, cache=cache)
    second = _run(SAMPLE, tmp_path, cache=cache)
    assert first[0] == second[0] == f"{-3.0 * np.log(2.0 * np.pi):.6f}"
    assert (first[1], second[1]) == ("0", "1")


def test_a_table_without_an_implementation_is_named():
    with pytest.raises(TypeError, match="propagate has no implementation for a table of type StartChain"):
        contract.propagate(hidden_markov.chain_tables().start, 0, None, None, None, None)


def test_defaults_serve_no_table_that_has_registered_nothing():
    """Else a table whose implementations are not imported yet would be compiled with defaults, and kept."""

    class Unregistered(NamedTuple):
        value: float

    with pytest.raises(TypeError, match="reading_count has no implementation for a table of type Unregistered"):
        contract.reading_count(Unregistered(1.0), 5)
    lookup = njit(lambda sensor: contract.reading_count(sensor, 5))
    with pytest.raises(errors.TypingError):
        lookup(Unregistered(1.0))


def test_another_process_is_told_of_every_module_with_an_implementation():
    assert sensors()  # imports all of them
    known = disk_cache.kernel_modules()
    for name in set(contract.__all__) - {"NOT_ASKED"}:  # all others are functions
        for implementation in getattr(contract, name).implementations.values():
            assert implementation.__module__ in known
    assert "pmcl.models.sensors.range_beams.kernels.plain" in known
