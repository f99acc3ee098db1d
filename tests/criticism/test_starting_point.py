"""Where fits of candidates start: an effect that moves the whole sensor takes the path with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.effect_logs import path_of

from pmcl.criticism.fitting.quick_fit import GLANCE, quick_fit
from pmcl.criticism.fitting.starting_point import starting_point
from pmcl.filtering.kernels import smc
from pmcl.models.effects.selection import effect_named
from pmcl.models.robot_model import default_model
from pmcl.simulations.amigobot import simulate_amigobot

# mypy: disable-error-code="no-untyped-def"

CARRYING = {"sensor-yaw": (0.2,), "sensor-offset": (0.12, -0.08), "sensor-latency": (0.15,)}


def reading_density(bound, theta, path):
    """The log density of all readings along a path [nat]."""
    tables = bound.tables(theta)[0]
    (sensor,) = tables.sensors
    return float(smc.sensor_terms(sensor, np.ascontiguousarray(path.T[None])).sum())


@pytest.mark.parametrize("name", CARRYING)
def test_readings_along_a_carried_path_are_as_before(name):
    """For a mount exactly; for a latency up to what lies between the rows, far below what the path as it was loses."""
    log = simulate_amigobot(200.0, 3)
    effect = effect_named(name, log)
    bound = replace(default_model(log), effects=(effect,)).bind(log)
    path = path_of(log)
    base = np.array([log.true_theta[one] for one in bound.names[: -len(effect.null)]])
    values = np.array(CARRYING[name])
    before = reading_density(bound, np.concatenate([base, effect.null]), path)
    theta = np.concatenate([base, values])
    carried = reading_density(bound, theta, np.ascontiguousarray(effect.carries(path, values, log)))
    stayed = reading_density(bound, theta, path)
    if name == "sensor-latency":
        assert before - carried < 0.5 * (before - stayed)
    else:
        assert carried == pytest.approx(before, abs=1e-6)
    assert stayed < before - 100.0


@pytest.mark.parametrize(
    ("given", "size"),
    [("sensor-yaw=large", 0.25), pytest.param("sensor-latency=large", 0.5, marks=pytest.mark.slow)],
)
def test_a_short_fit_of_a_moved_sensor_comes_to_its_size(given, size):
    """Sharp sensors hold a path where it is: without the carried path a large latency is not reached."""
    log = simulate_amigobot(300.0, 4, {"sigma_range": 0.03, "sigma_turn": 0.04}, effects=(given,), hide_effects=True)
    effect = effect_named(given.partition("=")[0], log)
    fit = quick_fit(default_model(log).bind(log), 1)
    found = []
    for candidate in (effect, replace(effect, carries=None)):
        bound = replace(default_model(log), effects=(candidate,)).bind(log)
        values, path = starting_point(bound, fit, candidate, 3.0, np.array([True]))
        start = np.concatenate([fit.theta, values])
        found.append(quick_fit(bound, 2, theta=start, path=path, effort=GLANCE).theta[-1])
    assert abs(found[0] - size) < 0.15 * size
    assert given != "sensor-latency=large" or found[1] < 0.7 * size


@pytest.mark.parametrize("score", [3.0, -3.0])
def test_the_search_for_a_moved_sensor_comes_near_its_place_from_either_side(score):
    noise = {"sigma_range": 0.03, "sigma_forward": 0.004, "sigma_turn": 0.05}
    given = ("sensor-offset=large",)
    log = simulate_amigobot(300.0, 4, noise, effects=given, hide_effects=True)
    effect = effect_named("sensor-offset", log)
    fit = quick_fit(default_model(log).bind(log), 1)
    bound = replace(default_model(log), effects=(effect,)).bind(log)
    values, path = starting_point(bound, fit, effect, score, np.array([True, True]))
    clear = np.array(effect.magnitude("large"))
    assert np.linalg.norm(values - clear) < 0.5 * np.linalg.norm(clear)
    assert path is not fit.path


def test_a_fit_of_another_effect_starts_near_none_on_the_path_as_it_is():
    log = simulate_amigobot(100.0, 5)
    fit = quick_fit(default_model(log).bind(log), 1)
    effect = effect_named("range-bias", log)
    bound = replace(default_model(log), effects=(effect,)).bind(log)
    (above,), path = starting_point(bound, fit, effect, 3.0, np.array([True]))
    (below,), _ = starting_point(bound, fit, effect, -3.0, np.array([True]))
    assert path is fit.path
    assert 0.0 < above < effect.magnitude("clear")[0]
    assert below == -above
    (given,), _ = starting_point(bound, fit, effect, 3.0, np.array([True]), np.array([-0.07]))
    assert given == -0.07
