"""How fast AMCL's odometry models move particles; compare with nav2_amcl and beluga (7.0e6 and 5.9e6 per second).

``particles_per_second`` stands in the extra info of each benchmark.
"""

from __future__ import annotations

import numpy as np
import pytest

from pmcl.engine.compile import entry
from pmcl.engine.contract import propagate, transition_logpdf
from pmcl.filtering.particle_filter import make_rng
from pmcl.models.motions.odometry.motion import Differential, Omni
from pmcl.models.motions.odometry.table import DifferentialMotion, OmniMotion

ROUNDS = 100
MEAN = np.array([[0.0, 0.0, 0.0], [0.25, 0.02, 0.1]])
ALPHA = np.array([0.1, 0.05, 0.02, 0.01, 0.02])
MOTIONS = {
    "differential": (DifferentialMotion(MEAN, ALPHA[:4].copy()), Differential()),
    "omni": (OmniMotion(MEAN, ALPHA), Omni()),
}


@entry
def move(motion, rng, previous, current, scratch, rounds):
    for _ in range(rounds):
        propagate(motion, 1, rng, previous, current, scratch)


@entry
def weigh(motion, previous, after, logp, scratch, rounds):
    for _ in range(rounds):
        transition_logpdf(motion, 1, previous, after, logp, scratch)


@pytest.mark.parametrize("n", [50, 10_000])
@pytest.mark.parametrize("kind", MOTIONS)
def test_drawing(benchmark, kind, n):
    previous, current, scratch = np.zeros((3, n)), np.empty((3, n)), np.empty((5, n))
    benchmark(move, MOTIONS[kind][0], make_rng(1), previous, current, scratch, ROUNDS)
    benchmark.extra_info["particles_per_second"] = ROUNDS * n / benchmark.stats["min"]
    assert np.isfinite(current).all()


@pytest.mark.parametrize("n", [50, 10_000])
@pytest.mark.parametrize("kind", MOTIONS)
def test_weighing_for_backward_sampling(benchmark, kind, n):
    previous, after = 0.1 * np.random.default_rng(1).standard_normal((3, n)), np.array([0.25, 0.0, 0.1])
    benchmark(weigh, MOTIONS[kind][0], previous, after, np.zeros(n), np.empty((5, n)), ROUNDS)
    benchmark.extra_info["particles_per_second"] = ROUNDS * n / benchmark.stats["min"]
