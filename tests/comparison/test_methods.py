"""Names of methods, and the same methods run against the clock."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest
from oracles.random_walk_model import rail_log, rail_model

from pmcl.calibration import Ensemble, ParticleGibbs, ParticleMetropolis
from pmcl.comparison.compare import compare
from pmcl.comparison.curves import Reference, learning_curve, reference_of
from pmcl.comparison.methods import parse_methods
from pmcl.errors import SamplingError
from pmcl.sampling import ensemble as sampling_ensemble
from pmcl.sampling import move as sampling_move
from pmcl.sampling import particle_target
from pmcl.sampling.options import RunOptions
from pmcl.sampling.stages import hurried_rate
from pmcl.sampling.stopwatch import Stopwatch
from pmcl.simulations.amigobot import simulate_amigobot


def test_names_with_and_without_particles():
    parsed = parse_methods("conditional:20, smoothing,ensemble:50")
    assert [compared.method for compared in parsed] == [
        ParticleGibbs(particles=20, sweeps_per_draw=1),
        ParticleGibbs(kernel="smoothing", particles=500, sweeps_per_draw=1),
        Ensemble(particles=50),
    ]
    assert [str(compared) for compared in parsed] == ["conditional:20", "smoothing:500", "ensemble:50"]
    (exact,), (other,) = parse_methods("particle-gibbs:30"), parse_methods("conditional:30")
    assert exact.method == other.method
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
        ("conditional:25,particle-gibbs", "conditional:25 and particle-gibbs:25"),
    ],
)
def test_methods_that_cannot_be_read(text, message):
    with pytest.raises(SamplingError, match="expected") as caught:
        parse_methods(text)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"seconds": 0.0}, "expected seconds as a number of more than 0 s, but got 0 s"),
        ({"seconds": np.inf}, "expected seconds as a number of more than 0 s, but got inf s"),
        ({"chains": 1}, "expected chains of at least 2, but got 1"),
        ({"methods": ()}, "expected at least one method, but got none"),
    ],
)
def test_impossible_comparisons(settings, message):
    with pytest.raises(SamplingError, match=message):
        compare(simulate_amigobot(20.0), **{"methods": "plain", **settings})


# Small, but with all stages: 8 steps of inclusion, 6 and 8 of tuning, 40 draws.
SHORT = ParticleGibbs(particles=8, burn_in_particles=40, data_rate=3, settling_sweeps=4, tuning_sweeps=(6, 8))
OPTIONS = RunOptions(draws=40, chains=2, seed=5, trajectories=1)
ENDLESS = replace(OPTIONS, draws=10**9)


class SimulatedTime:
    """A clock that runs only while a walker makes its sweeps: some seconds for each particle and included row."""

    def __init__(self, monkeypatch, seconds):
        self.now, self.lock = 0.0, threading.Lock()
        move, ensemble = sampling_move.step, sampling_ensemble.PseudoMarginalTarget.__call__

        def step(bound, settings, transport, transform, state, seed):
            new, info = move(bound, settings, transport, transform, state, seed)
            # Left open, it is two sweeps, or one where the log is easy.
            self.advance(seconds * (settings.sweeps or 2) * settings.particles * new.rows)
            return new, info

        def target(this, theta):
            self.advance(seconds * this.particles * max(this.bound.lengths))
            return ensemble(this, theta)

        monkeypatch.setattr(sampling_move, "step", step)
        monkeypatch.setattr(sampling_ensemble.PseudoMarginalTarget, "__call__", target)

    def advance(self, seconds):
        with self.lock:
            self.now += seconds

    def __call__(self):
        return self.now


@pytest.fixture(scope="module")
def rail():
    return rail_model().bind(rail_log(12, seed=3))


@pytest.fixture(scope="module")
def whole(rail):
    return SHORT.run(rail, OPTIONS)


@pytest.mark.slow
def test_a_run_with_time_enough_is_the_whole_run(rail, whole, monkeypatch):
    told: list[float] = []
    clock = Stopwatch(1e6, told.append, SimulatedTime(monkeypatch, 0.001))
    made = SHORT.run(rail, replace(OPTIONS, stopwatch=clock))
    np.testing.assert_array_equal(made.theta, whole.theta)
    np.testing.assert_array_equal(made.warmup_theta, whole.warmup_theta)
    assert len(clock.wall) == len(clock.cpu) == 8 + 6 + 8 + 40
    assert clock.wall == told == sorted(told)
    assert np.all(np.diff(clock.cpu) >= 0.0)


@pytest.mark.slow
def test_a_stopped_run_is_the_beginning_of_the_whole(rail, whole, monkeypatch):
    """When burn-in takes less than its share, only the draws are cut."""
    clock = Stopwatch(60.0, clock=SimulatedTime(monkeypatch, 0.001))
    stopped = SHORT.run(rail, replace(ENDLESS, stopwatch=clock))
    clock.stop()
    np.testing.assert_array_equal(stopped.warmup_theta, whole.warmup_theta)
    assert 40 < stopped.n_draws == stopped.settings["draws"] < 200
    np.testing.assert_array_equal(stopped.theta[:, :40], whole.theta)
    assert clock.seconds == pytest.approx(60.0, rel=0.02)


# With 0.001 s for each particle and row, burn-in takes 10 s, and one sweep of all rows with 40 particles 0.96 s.
@pytest.mark.parametrize("seconds", [24.0, 12.0, 6.0])
def test_burn_in_takes_at_most_half_of_the_time(rail, seconds, monkeypatch):
    clock = Stopwatch(seconds, clock=SimulatedTime(monkeypatch, 0.001))
    made = SHORT.run(rail, replace(ENDLESS, stopwatch=clock))
    clock.stop()
    assert clock.seconds == pytest.approx(seconds, rel=0.1)
    assert clock.wall[-made.n_draws - 1] <= 0.6 * seconds
    assert made.n_draws >= 4
    assert np.isfinite(made.theta).all()


def test_time_for_nothing_is_said_to_be_too_short(rail, monkeypatch):
    clock = Stopwatch(1.0, clock=SimulatedTime(monkeypatch, 0.01))
    with pytest.raises(SamplingError, match="the time was over before the first draw; give more time"):
        SHORT.run(rail, replace(OPTIONS, stopwatch=clock))


@pytest.mark.parametrize("seconds", [30.0, 6.0])
def test_an_ensemble_keeps_its_time_too(rail, seconds, monkeypatch):
    clock = Stopwatch(seconds, clock=SimulatedTime(monkeypatch, 0.001))
    made = Ensemble(particles=8, burn_in=50).run(
        rail, RunOptions(draws=10**6, chains=6, seed=3, stopwatch=clock)
    )
    clock.stop()
    assert clock.seconds == pytest.approx(seconds, rel=0.05)
    assert clock.wall[-made.n_draws - 1] <= 0.6 * seconds


@pytest.mark.parametrize("seconds", [0.05, 0.5, 2.0, 6.0])
def test_a_walk_in_a_hurry_ends_in_time_or_says_why(rail, seconds, monkeypatch):
    """Also where the time of a stage of burn-in is over before its first step."""
    time = SimulatedTime(monkeypatch, 0.0)
    evidence = particle_target.ParticleTarget.__call__

    def slow(this, theta, numbers):
        time.advance(0.2)
        return evidence(this, theta, numbers)

    monkeypatch.setattr(particle_target.ParticleTarget, "__call__", slow)
    clock = Stopwatch(seconds, clock=time)
    method = ParticleMetropolis(particles=16, tuning_steps=(4, 4, 4))
    options = RunOptions(draws=10**6, chains=2, seed=3, stopwatch=clock)
    try:
        made, reason = method.run(rail, options), ""
    except SamplingError as error:
        made, reason = None, str(error)
    if made is None:
        # Two chains share half a second: which of them comes first decides whether there is a draw.
        assert "the time was over before the first draw" in reason
        assert seconds <= 0.5
        return
    assert seconds >= 0.5
    assert np.isfinite(made.theta).all()
    assert made.n_draws >= 1


def test_the_rate_of_inclusion_follows_from_the_time_that_is_left():
    # No hurry: as planned.
    assert hurried_rate(10, 10, 1000, pace=1e-5, left=100.0) == 10
    # 4 sweeps of 1000 rows are set aside; 20000 rows remain to be passed over: (1000^2 - 10^2) / 2 r of them.
    assert hurried_rate(10, 10, 1000, pace=1e-3, left=24.0) == 25
    # No time: all at once.
    assert hurried_rate(10, 10, 1000, pace=1.0, left=24.0) == 990


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
