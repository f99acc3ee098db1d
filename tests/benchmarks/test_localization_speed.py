"""How long localization takes: thousands of runs on all cores, and one step on a robot."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from pmcl.localization.many import localize_many
from pmcl.localization.online import OnlineLocalizer
from pmcl.simulations.amigobot import simulate_amigobot

sys.path.insert(0, str(Path(__file__).parents[1]))  # the posteriors of the localization tests
from localization.posteriors import around

THETA = {"sigma_forward": 0.02, "sigma_left": 0.01, "sigma_turn": 0.03, "sigma_range": 0.05}


@pytest.fixture(scope="module")
def log():
    return simulate_amigobot(600.0, 1, THETA)


@pytest.fixture(scope="module")
def posterior():
    return around(THETA, 0.1, shape=(4, 250))


@pytest.mark.parametrize("method", ["mean", "posterior"])
def test_a_thousand_runs_of_600_steps_with_500_particles(benchmark, log, posterior, method):
    localize_many(log, None, posterior, method, repetitions=2)  # compile
    runs = benchmark.pedantic(
        localize_many, (log, None, posterior, method), {"repetitions": 1000, "particles": 500}, rounds=1
    )
    seconds = benchmark.stats["min"]
    benchmark.extra_info["ns_per_particle_step"] = seconds / (1000 * 600 * 500) * 1e9
    benchmark.extra_info["position_rmse"] = float(runs.position_rmse.mean())
    print(f"\n{method}: {seconds:.1f} s for 1000 runs")


@pytest.mark.parametrize("method", ["mean", "posterior"])
def test_one_step_on_a_robot(benchmark, log, posterior, method):
    robot, steps = OnlineLocalizer(log, None, posterior, method), iter(range(10**6))

    def step():
        t = next(steps)
        row = 1 + t % (log.n_steps - 1)
        return robot.update(float(t), log.odometry[row], range=log.ranges[row])

    step()
    estimate = benchmark.pedantic(step, rounds=400)
    assert np.isfinite(estimate.mean).all()
