from __future__ import annotations

import pytest

from pmcl.simulations.amigobot import simulate_amigobot

THETA = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.08}


@pytest.fixture(scope="session")
def room_log():
    """Eighty seconds of the Amigobot, truth included."""
    return simulate_amigobot(80.0, 5, THETA)


@pytest.fixture(scope="session")
def theta():
    return THETA
