"""Names of methods, and the same methods run against the clock."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.random_walk_model import rail_log, rail_model

from pmcl.comparison.compare import compare
from pmcl.comparison.curves import Reference, learning_curve, reference_of
from pmcl.comparison.methods import METHODS, Method, parse_methods
from pmcl.errors import SamplingError
from pmcl.robots.amigobot import simulate_amigobot
from pmcl.sampling.run import run_particle_gibbs
from pmcl.sampling.stages import Plan
from pmcl.sampling.stopwatch import Stopwatch


def test_names_with_and_without_particles():
    assert parse_methods("conditional:25, smoothing,ensemble:50") == (
        Method("conditional", 25),
        Method("smoothing", METHODS["smoothing"][0]),
        Method("ensemble", 50),
    )
    assert parse_methods("particle-gibbs:30") == (Method("conditional", 30),)
    assert [str(method) for method in parse_methods("plain,plain:7")] == ["plain:25", "plain:7"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "but got ''"),
        ("conditional,", "but got ''"),
        ("smothing", "did you mean 'smoothing'"),
        ("hmc", "such as conditional:25"),
        ("smoothing:", "after 'smoothing:', but got ''"),
        ("smoothing:many", "but got 'many'"),
        ("smoothing:1", "at least 2"),
        ("smoothing:-5", "but got '-5'"),
        ("conditional:25,particle-gibbs", "conditional:25 twice"),
    ],
)
def test_methods_that_cannot_be_read(text, message):
    with pytest.raises(SamplingError, match="expected") as caught:
        parse_methods(text)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("settings", [{"seconds": 0.0}, {"seconds": np.inf}, {"chains": 1}, {"methods": ()}])
def test_impossible_comparisons(settings):
    with pytest.raises(SamplingError, match="expected a positive time, at least two chains"):
        compare(simulate_amigobot(20.0), **{"methods": "plain", **settings})


def test_a_stopped_run_is_the_beginning_of_the_whole():
    bound = rail_model().bind(rail_log(12, seed=3))
    plan = Plan(particles=8, burn_in_particles=40, data_rate=6, settle=4, tuning=(6, 8), draws=40, trajectories=1)
    whole = run_particle_gibbs(bound, plan, 2, 5)
    told: list[float] = []
    clock = Stopwatch(limit=0.0, tell=told.append)
    stopped = run_particle_gibbs(bound, plan, 2, 5, stopwatch=clock)
    np.testing.assert_array_equal(stopped.theta, whole.theta[:, :4])
    np.testing.assert_array_equal(stopped.warmup_theta, whole.warmup_theta)
    assert stopped.settings["draws"] == 4
    # One note for every step of burn-in (2 + 4 of inclusion, 6, 8) and every draw.
    assert len(clock.wall) == len(clock.cpu) == 6 + 6 + 8 + 4
    assert clock.wall == told == sorted(told)
    assert np.all(np.diff(clock.cpu) >= 0.0)


def test_curves_of_independent_draws_fall_as_they_should(rng):
    # Standard normal draws about a mean that is 0.5 sd from the reference, the truth 2 sd away.
    theta = rng.normal(0.5, 1.0, (4, 4000, 1))
    reference = Reference(np.array([0.0]), np.array([1.0]), 0.0, 1.0, 1e6)
    wall = np.linspace(1.0, 5.0, 4000)
    curve = learning_curve(theta, wall, 2.0 * wall, reference, np.array([2.5]))
    assert curve.draws[0] == 8
    assert curve.draws[-1] == 4000
    np.testing.assert_allclose(curve.cpu, 2.0 * curve.wall)
    assert curve.wall[-1] == 5.0
    assert curve.error[-1] == pytest.approx(0.5, abs=5.0 / np.sqrt(16000.0))
    assert curve.error_of_truth[-1] == pytest.approx(2.0, abs=5.0 / np.sqrt(16000.0))
    assert curve.r_hat[-1] < 1.005 < curve.r_hat[0]
    assert curve.ess[-1] == pytest.approx(16000.0, rel=0.1)
    assert np.isnan(learning_curve(theta, wall, wall, reference, None).error_of_truth).all()


def test_the_reference_knows_its_own_error(rng):
    theta = rng.normal([1.0, -3.0], [0.1, 2.0], (4, 1000, 2))
    reference = reference_of(theta)
    assert (np.abs(reference.mean - [1.0, -3.0]) < 5.0 * np.array([0.1, 2.0]) / np.sqrt(4000.0)).all()
    np.testing.assert_allclose(reference.sd, [0.1, 2.0], rtol=5.0 / np.sqrt(8000.0))
    assert reference.error == pytest.approx(1.0 / np.sqrt(4000.0), rel=0.15)
