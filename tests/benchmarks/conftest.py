"""Models and states that the benchmarks share: ``pytest tests/benchmarks --benchmark-only -n 0``."""

from __future__ import annotations

import numpy as np
import pytest

from pmcl.filtering.particle_filter import draw_paths, make_rng, run_filter
from pmcl.logs.robot_log import RobotLog
from pmcl.models.robot_model import default_model
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field

AMIGOBOT_THETA = {"sigma_forward": 0.02, "sigma_left": 0.01, "sigma_turn": 0.03, "sigma_range": 0.05}


class Case:
    """A log bound to its default model, tables at the true parameters, and one smoothed path."""

    def __init__(self, log: RobotLog) -> None:
        self.bound = default_model(log).bind(log)
        assert log.true_theta is not None
        self.theta = np.array([log.true_theta[name] for name in self.bound.names])
        self.tables = self.bound.tables(self.theta)
        self.rng = make_rng(1)
        filtered = run_filter(self.tables[0], log.n_steps, 1000, self.rng)
        self.path = draw_paths(self.tables[0], filtered, 1, self.rng)[0]


@pytest.fixture(scope="session")
def amigobot() -> Case:
    return Case(simulate_amigobot(2000.0, 1, AMIGOBOT_THETA))


@pytest.fixture(scope="session", params=[400, 2000], ids="T={}".format)
def landmarks(request) -> Case:
    return Case(simulate_landmark_field(request.param, 1))
