"""Localization with models that have effects: further states, densities that look back, posteriors of all of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from localization.posteriors import around

import pmcl
from pmcl.errors import ModelError
from pmcl.localization.many import localize_many
from pmcl.localization.offline import localize
from pmcl.localization.online import OnlineLocalizer
from pmcl.localization.options import FilterOptions
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.formula import formula_effect
from pmcl.models.effects.selection import effect_named
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.models.sensors.landmarks.sensor import LandmarkNoise
from pmcl.models.sensors.range_beams.sensor import RangeNoise
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field

# A wandering turn rate is a fourth state; correlated readings look back at the reading before.
RICH = ("turn-noise-correlated", "range-noise-correlated", "wheel-slip")


def model_with(log, names):
    return RobotModel(sensors=(RangeNoise(),), effects=tuple(effect_named(name, log) for name in names))


def theta_of(log, model, theta):
    """The base values, and each effect's parameters at a clear magnitude."""
    bound, found = model.bind(log), dict(theta)
    clear = [value for effect in bound.effects for value in effect.typical["clear"]]
    return found | dict(zip(bound.names[len(theta) :], clear, strict=True))


@pytest.fixture(scope="module")
def rich(room_log, theta):
    log = room_log.select(0, 30)
    model = model_with(log, RICH)
    return log, model, theta_of(log, model, theta)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["mean", "posterior"])
def test_online_is_offline_with_states_and_readings_that_look_back(rich, method):
    log, model, values = rich
    data = around(values, 0.1)
    settings = {"particles": 80, "seed": 2}
    robot = OnlineLocalizer(log, model, data, method, **settings)
    track = pmcl.localize(log, model, data, method, **settings)
    for t in range(log.n_steps):
        estimate = robot.update(log.times[t], log.odometry[t], range=log.ranges[t])
        np.testing.assert_array_equal(estimate.mean, track.pose_mean[t])
        assert estimate.log_score == track.log_score[t]
    assert robot.particles[0].shape == (4, 80)
    assert track.pose_mean.shape == (30, 3)


@pytest.mark.slow
def test_online_is_offline_with_landmarks_whose_errors_last():
    log = simulate_landmark_field(30, 2, bearings=True, reach=9.0, effects=["landmark-noise-correlated=0.8,0.6"])
    model = RobotModel(sensors=(LandmarkNoise(bearing=True),), effects=(effect_named("landmark-noise-correlated"),))
    settings = {"theta": log.true_theta, "particles": 80, "seed": 2}
    robot = OnlineLocalizer(log, model, memory=3, **settings)
    track = pmcl.localize(log, model, **settings)
    for t in range(log.n_steps):
        readings = {"landmark_range": log.landmark_range[t], "landmark_bearing": log.landmark_bearing[t]}
        estimate = robot.update(log.times[t], log.odometry[t], **readings)
        np.testing.assert_array_equal(estimate.mean, track.pose_mean[t])
        assert estimate.log_score == track.log_score[t]
    base = {name: value for name, value in log.true_theta.items() if name.startswith("sigma_")}
    plain = pmcl.localize(log, RobotModel(sensors=model.sensors), theta=base, particles=80, seed=2)
    assert track.log_score.sum() > plain.log_score.sum() + 10.0


@pytest.mark.slow
def test_a_robot_with_more_states_is_found_anywhere_and_again(rich):
    log, model, values = rich
    lost = log.select(0, 30, start_mean=np.zeros(3), start_std=np.full(3, np.inf))
    track = pmcl.localize(lost, model, theta=values, particles=500, options=FilterOptions(recover=True))
    assert np.nanmax(track.dataset["position_error"].values[10:]) < 0.3


def test_what_the_model_knows_helps(theta):
    """Odometry that turns a fifth too far: with the effect in the model the filter is far better."""
    truth = theta | {"sigma_forward": 0.01, "sigma_left": 0.01, "sigma_turn": 0.01}
    log = simulate_amigobot(150.0, 3, truth, effects=["odometry-turn-scale=0.2"])
    model = model_with(log, ("odometry-turn-scale",))
    knowing = localize_many(log, model, theta=truth | {"odometry_turn_scale": 0.2}, repetitions=20)
    ignorant = localize_many(log, theta=truth, repetitions=20)
    assert knowing.position_rmse.mean() < 0.7 * ignorant.position_rmse.mean()
    assert knowing.log_evidence.mean() > ignorant.log_evidence.mean() + 100.0


@pytest.mark.slow
def test_effects_of_the_whole_log_do_not_run_online(room_log, theta):
    model = model_with(room_log, ("range-noise-changes-in-time",))
    values = theta_of(room_log, model, theta)
    assert pmcl.localize(room_log, model, theta=values).position_rmse < 0.2
    with pytest.raises(ModelError, match="still running"):
        OnlineLocalizer(room_log, model, theta=values)


@pytest.mark.slow
def test_a_formula_of_the_pose_helps_where_it_is_true_and_needs_a_whole_log():
    """Ranges err by the direction of the beam in the world; the filter is told so by a formula."""
    noise = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.03}

    log = simulate_amigobot(80.0, 5, noise)
    path = np.array(log.true_poses)
    dataset = log.dataset.copy(deep=True)
    dataset["range"] = dataset["range"].copy(data=dataset["range"].values.copy())
    direction = path[:, 2, None] + log.beam_poses[:, 2]
    dataset["range"].values[:] += 0.15 * np.cos(direction)
    wrong = RobotLog(dataset, "leaning.nc")
    plain = default_model(wrong)
    known = replace(plain, effects=(formula_effect("range", ["cos(world_direction)"]),))
    (coefficient,) = (parameter.name for parameter in known.effects[0].parameters)
    with_it = localize(wrong, known, theta={**noise, coefficient: 0.15}, particles=300, seed=1)
    without = localize(wrong, plain, theta={**noise, "sigma_range": 0.1}, particles=300, seed=1)
    assert with_it.position_rmse < 0.6 * without.position_rmse
    with pytest.raises(ModelError, match=r"expected effects that need no path.*world_direction"):
        OnlineLocalizer(wrong, known, theta={**noise, coefficient: 0.15})
