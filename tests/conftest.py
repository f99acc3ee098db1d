"""Fixtures that every test may use."""

from __future__ import annotations

import os
import zlib
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from pmcl import registry

# How long an example takes says how busy the machine is, and nothing about the code.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

# Tests already run on all processors; no test gets a second process that compiles for it, unless it asks.
os.environ.setdefault("PMCL_COMPILE_AHEAD", "0")


# Files that take longest for their number of tests, as two processes took them from an empty cache in November 2026.
# They begin first: none is left for one process at the end while the other has nothing to do.
_LONGEST = (
    "docs/test_readme.py", "criticism/test_workflow.py", "docs/test_examples.py", "rooms/test_rooms.py",
    "fleet/test_cluster.py", "sampling/test_killed_runs.py", "test_recorded_robots.py", "cli/test_criticize.py",
    "sampling/test_posterior_grid.py", "corpus/test_corpus.py", "criticism/test_other_runs.py",
    "sampling/test_pseudo_marginal.py", "criticism/test_evidence.py", "reports/test_criticism_report.py",
    "cli/test_wean_bags.py", "preflight/test_sound_logs.py", "criticism/test_held_out_log.py",
    "analyses/test_experiments.py", "cli/test_own_effects.py", "preflight/test_lidar_mistakes.py",
    "localization/test_lidar_anywhere.py", "localization/test_draws.py", "criticism/test_quick_fit.py",
    "sampling/test_kalman.py", "sampling/test_walk_resume.py",
)  # fmt: skip


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest files first, then those with the most tests; tests of a file stay together."""
    here = Path(__file__).parent
    name = {item: item.path.relative_to(here).as_posix() for item in items}
    count, first = Counter(name.values()), {}
    for k, item in enumerate(items):
        first.setdefault(name[item], k)
    rank = {one: _LONGEST.index(one) if one in _LONGEST else len(_LONGEST) for one in count}
    items.sort(key=lambda item: (rank[name[item]], -count[name[item]], first[name[item]]))


@pytest.fixture(autouse=True)
def only_own_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """No test sees sensors, motions and effects that another test, or an example that it imports, has registered."""
    for group in (registry.SENSORS, registry.MOTIONS, registry.EFFECTS):
        monkeypatch.setitem(registry._added, group, {})


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """A generator seeded from the test's name: the same numbers every run, others in every test."""
    return np.random.default_rng(zlib.crc32(request.node.name.encode()))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of recorded robot data; it is not part of the repository."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("PMCL_DATA", beside))
    if not folder.is_dir():
        pytest.skip(f"recorded robot data absent: no folder {folder} (set PMCL_DATA to where it is)")
    return folder
