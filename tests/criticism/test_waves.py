"""Waves in time that no effect of the catalogue describes: found at their period and phase, and only where they are."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from pmcl.criticism.fitting.quick_fit import BRIEF, quick_fit
from pmcl.criticism.judging.judged_log import judge_log
from pmcl.criticism.naming.formulas import steady_changes, wave
from pmcl.criticism.naming.waves import remarkable_waves
from pmcl.criticism.settings import Settings
from pmcl.criticism.workflow import criticize
from pmcl.models.effects.effect import Effect
from pmcl.models.parameters import Parameter
from pmcl.models.robot_model import default_model
from pmcl.simulations.amigobot import simulate_amigobot

# mypy: disable-error-code="no-untyped-def"

NOISE = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.05}
PERIOD, BEGINS = 45.0, 10.0
SETTINGS = Settings(particles=300, seed=1, level=0.05, simulations=20, paths=10, workers=2, progress=False)


def _swinging_gyro():
    def change(tables, values, log, where):
        mean = tables.motion.mean.copy()
        mean[:, 2] += values[0] * np.sin(2.0 * np.pi * (log.times - BEGINS) / PERIOD)
        return tables._replace(motion=tables.motion._replace(mean=mean))

    swing = Parameter("swing", "rad", stats.norm(0.0, 1.0))
    return Effect("swing", "The gyro swings.", (swing,), (0.0,), change, carrier="motion", typical={"clear": (0.1,)})


def _log(size, seed=3):
    effects = ((_swinging_gyro(), (size,)),) if size else ()
    return simulate_amigobot(240.0, seed, NOISE, effects=effects, hide_effects=True)


def _waves(log):
    fit = quick_fit(default_model(log).bind(log), 1, effort=BRIEF)
    judged = judge_log(log, fit, (), SETTINGS)
    return remarkable_waves(judged, log, fit.tables, SETTINGS)


def _period_and_start(name):
    start, _, period = name.partition("time - ")[2].partition(")/")
    return float(period.rstrip(")")), float(start)


@pytest.mark.slow
def test_period_and_phase_are_found_and_nothing_where_nothing_swings():
    found = _waves(_log(0.06))
    effect, z, *_ = found.found[0]
    assert effect.name.startswith("formula: turn += c*sin(")
    assert z > found.critical_z
    period, start = _period_and_start(effect.name)
    assert abs(period - PERIOD) < 2.0
    # Around the middle of the part that was looked at, the wave found runs with the true one.
    t = np.linspace(50.0, 100.0, 200)
    both = np.sin(2.0 * np.pi * (t - start) / period), np.sin(2.0 * np.pi * (t - BEGINS) / PERIOD)
    assert np.corrcoef(*both)[0, 1] > 0.9
    assert sum(bool(_waves(_log(0.0, seed)).found) for seed in range(3, 9)) <= 2


def test_a_wave_is_a_steady_change_times_a_sine():
    log = simulate_amigobot(60.0, 1, NOISE)
    bound = default_model(log).bind(log)
    tables = bound.tables(np.array([NOISE[name] for name in bound.names]))[0]
    sine = np.sin(2.0 * np.pi * (log.times - 12.25) / 20.0)
    changes = {one.effect.name: one for one in steady_changes(tables, log.n_steps)}
    assert len(changes) == 3
    turned = wave(changes["formula: turn += c*1"], log, 20.0, 12.25)
    assert turned.name == "formula: turn += c*sin(2*pi*(time - 12.25)/20)"
    np.testing.assert_allclose(turned.edit(tables, [0.1], log).motion.mean[:, 2], tables.motion.mean[:, 2] + 0.1 * sine)
    longer = wave(changes["formula: range += c*1"], log, 20.0, 12.25).edit(tables, [0.1], log).sensors[0]
    np.testing.assert_allclose(longer.extras.bias_at, np.tile(0.1 * sine[:, None], (1, 8)), atol=1e-15)
    # A part of the log is edited like the same rows of the whole.
    part = log.select(0, 30)
    short = default_model(part).bind(part).tables(np.array([NOISE[name] for name in bound.names]))[0]
    changed = turned.edit(short, [0.1], part).motion.mean[:, 2]
    np.testing.assert_allclose(changed, short.motion.mean[:, 2] + 0.1 * sine[:30])


@pytest.mark.long
def test_a_wave_wins_over_noise_with_a_memory():
    result = criticize(_log(0.08), simulations=20, joint=False, seed=1, rounds=1)
    (effect,) = result.effects
    assert effect.name.startswith("formula: turn += 0.0")
    assert "sin(2*pi*(time" in effect.name
    (estimate,) = effect.parameters.values()
    assert abs(estimate.mean - 0.08) < 5.0 * estimate.sd
    tried = {one.name for one in result.steps[0].candidates if np.isfinite(one.log_score_gain)}
    assert "turn-noise-correlated" in tried
