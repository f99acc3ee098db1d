"""Compilation happens once per model, is kept on disk, and never outlives the source it was made from."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba.core import caching
from oracles import hidden_markov
from oracles.random_walk_model import rail_log, rail_model

from pmcl.filtering.kernels import compile as compilation
from pmcl.filtering.kernels import contract, smc
from pmcl.filtering.particle_filter import make_rng, sweep_path

TESTS = Path(__file__).resolve().parents[1]
PACKAGE = Path(compilation.__file__).resolve().parents[3]

# A kernel of one's own, in a file of its own: its answer is VALUE, so a stale one would be seen.
SMALL = """
from typing import NamedTuple
from pmcl.filtering.kernels.compile import entry
from pmcl.filtering.kernels.contract import scratch_rows

class Marked(NamedTuple):
    number: float

@scratch_rows.register(Marked, allocates=False)
def rows(table):
    return VALUE

@entry
def answer(table):
    return scratch_rows(table)
"""
RUN_SMALL = """
import sys
import pmcl.filtering.kernels.compile as compilation
if len(sys.argv) > 1:
    compilation._package_hash = lambda: sys.argv[1]
import small
value = small.answer(small.Marked(1.0))
print(value, sum(small.answer.stats.cache_hits.values()), sum(small.answer.stats.cache_misses.values()))
"""
SAMPLE = """
import numpy as np
from pmcl.filtering.kernels import smc
from pmcl.models.tables import GaussianStart, IncrementMotion, Tables
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
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(cache),
        "PYTHONPATH": os.pathsep.join(str(path) for path in (PACKAGE, *paths)),
    }
    command = [sys.executable, str(folder / "program.py"), *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_two_models_run_twice_are_compiled_once_each():
    """What counts is how many signatures the entry point knows."""
    rail = rail_model().bind(rail_log(6, seed=1)).tables(np.array([0.5, 0.4]))[0]
    chain, rng = hidden_markov.chain_tables(), make_rng(1)

    def run():
        sweep_path(rail, np.full((6, 1), 50.0), 6, 5, rng, "smoothing")
        sweep_path(chain, np.zeros((4, 1)), 4, 5, rng, "smoothing")

    run()
    known = len(smc.sweep.signatures)
    handled = sum(smc.sweep.stats.cache_hits.values()) + sum(smc.sweep.stats.cache_misses.values())
    run()
    # Neither other numbers, nor other lengths, nor the other kernel make another program.
    sweep_path(rail, np.full((6, 1), 50.0), 4, 9, rng, "conditional")
    assert len(smc.sweep.signatures) == known
    assert sum(smc.sweep.stats.cache_hits.values()) + sum(smc.sweep.stats.cache_misses.values()) == handled


def test_tables_of_one_model_have_one_type():
    """A table that were read-only, or not contiguous, at another theta would compile everything again."""
    import numba

    bound = rail_model().bind(rail_log(6, seed=1))
    kinds = {numba.typeof(bound.tables(np.array(theta))[0]) for theta in ([0.5, 0.4], [1.0, 2.0])}
    assert len(kinds) == 1


def test_the_key_changes_with_any_kernel_source(monkeypatch):
    cache, signature = smc.sweep._cache, (1,)
    codegen = smc.sweep.targetctx.codegen()
    key = cache._index_key(signature, codegen)
    assert cache._index_key(signature, codegen) == key
    monkeypatch.setattr(compilation, "_package_hash", lambda: "other sources")
    assert cache._index_key(signature, codegen) != key


def test_the_key_covers_every_kernel_file_and_registered_implementation(monkeypatch):
    before = compilation._package_hash.__wrapped__()
    for name in ("ranges.py", "smc.py", "vector_math.py", "tables.py"):
        with monkeypatch.context() as patch:
            real = Path.read_bytes
            patch.setattr(
                Path, "read_bytes", lambda path, name=name, real=real: real(path) + (b"#" if path.name == name else b"")
            )
            assert compilation._package_hash.__wrapped__() != before, name
    assert str(Path(hidden_markov.__file__)) in compilation._extra_sources


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


@pytest.mark.parametrize("kind", ["pmcl's", "numba's"])
def test_two_processes_that_save_at_once_do_not_mix_up_their_code(tmp_path, kind):
    """One saves all of its own between the other's two files, knowing nothing of it; numba's own files then lie."""
    files = compilation._CacheFiles if kind == "pmcl's" else caching.IndexDataCacheFile
    one, two, later = (files(str(tmp_path), "function", "stamp") for _ in range(3))
    save_data = one._save_data

    def interrupted(name, data):
        if not list(tmp_path.glob("*.nbc")):
            two._load_index = dict
            two.save("key of two", "code of two")
        save_data(name, data)

    one._save_data = interrupted
    one.save("key of one", "code of one")
    found = later.load("key of two")
    assert found == ("code of two" if kind == "pmcl's" else "code of one")
    assert later.load("key of one") in ("code of one", None)


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
