from __future__ import annotations

import pytest
from calibration.own_methods import PriorDraws, PriorMean

from pmcl import registry
from pmcl.simulations.amigobot import simulate_amigobot


@pytest.fixture(scope="session")
def log():
    return simulate_amigobot(30.0, seed=2)


@pytest.fixture
def registered_methods(monkeypatch):
    """Two methods of the tests, registered for the length of one test."""
    monkeypatch.setitem(registry._added, registry.METHODS, {})
    registry.register(registry.METHODS, "own-draws", PriorDraws)
    registry.register(registry.METHODS, "own-mean", PriorMean)
