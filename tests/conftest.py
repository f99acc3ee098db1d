"""Fixtures that every test may use."""

from __future__ import annotations

import os
import zlib
from pathlib import Path

import numpy as np
import pytest

from pmcl import registry

# Tests already run on all processors; no test gets a second process that compiles for it, unless it asks.
os.environ.setdefault("PMCL_COMPILE_AHEAD", "0")


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
