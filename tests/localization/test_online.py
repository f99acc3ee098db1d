"""One time step at a time gives what the whole log gives, to the last bit."""

from __future__ import annotations

import time

import numpy as np
import pytest
from localization.posteriors import around
from oracles.random_walk_model import rail_log, rail_model

import pmcl
from pmcl.errors import LogError
from pmcl.localization.online import OnlineLocalizer
from pmcl.localization.options import FilterOptions
from pmcl.models.motions.increments.motion import GrowingIncrementNoise
from pmcl.models.robot_model import RobotModel
from pmcl.models.sensors.range_beams.sensor import RangeNoise
from pmcl.simulations.landmark_field import simulate_landmark_field

CHANNELS = {"range": "ranges", "landmark_range": "landmark_range", "landmark_bearing": "landmark_bearing"}


def readings(log, t):
    held = {name: getattr(log, attribute) for name, attribute in CHANNELS.items()}
    return {name: values[t] for name, values in held.items() if values is not None}


def feed(robot, log, begin=0):
    return [robot.update(log.times[t], log.odometry[t], **readings(log, t)) for t in range(begin, log.n_steps)]


def assert_same(estimates, track):
    np.testing.assert_array_equal([each.mean for each in estimates], track.pose_mean)
    np.testing.assert_array_equal([each.covariance for each in estimates], track.pose_cov)
    np.testing.assert_array_equal([each.log_score for each in estimates], track.log_score)
    np.testing.assert_array_equal([each.effective_size for each in estimates], track.ess)


@pytest.mark.parametrize("method", ["mean", pytest.param("posterior", marks=pytest.mark.slow)])
def test_a_robot_among_walls(room_log, theta, method):
    data = around(theta, 0.1)
    settings = {"particles": 60, "seed": 8}
    robot = OnlineLocalizer(room_log, None, data, method, **settings)
    assert_same(feed(robot, room_log), pmcl.localize(room_log, None, data, method, **settings))


@pytest.mark.slow
def test_a_robot_that_may_be_anywhere_and_is_carried_away(room_log, theta):
    """Annealing, adaptive numbers and recovery are the same step by step."""
    options = FilterOptions(recover=True, least_particles=60, scheme="systematic", threshold=0.7)
    lost = room_log.select(0, 30, start_mean=np.zeros(3), start_std=np.full(3, np.inf))
    moved = lost.dataset.copy(deep=True)
    moved["range"] = moved["range"].copy(data=np.concatenate([lost.ranges[:15], room_log.ranges[60:75]]))
    moved["range"].attrs = lost.dataset["range"].attrs
    log = pmcl.RobotLog.from_dataset(moved)
    settings = {"theta": theta, "particles": 300, "seed": 1, "options": options}
    estimates, track = feed(OnlineLocalizer(log, **settings), log), pmcl.localize(log, **settings)
    assert_same(estimates, track)
    assert len({each.particles for each in estimates}) > 3


@pytest.mark.slow
def test_landmarks_some_of_them_out_of_sight():
    log = simulate_landmark_field(40, 2, bearings=True, reach=8.0)
    data = around(log.true_theta, 0.05)
    for method in ("map", "posterior"):
        robot = OnlineLocalizer(log, None, data, method, particles=50)
        assert_same(feed(robot, log), pmcl.localize(log, None, data, method, particles=50))


def test_a_model_of_ones_own():
    log = rail_log(30, seed=3, missing=(0, 1, 7))
    theta = {"process_std": 0.5, "reading_std": 0.4}
    robot = OnlineLocalizer(log, rail_model(), theta=theta, particles=40, memory=3)
    assert_same(feed(robot, log), pmcl.localize(log, rail_model(), theta=theta, particles=40))


def test_a_robot_that_stands_still_has_noise_that_grows_all_the_same(room_log, theta):
    grown = theta | {"sigma_forward_per_metre": 0.1, "sigma_turn_per_radian": 0.1, "sigma_turn_per_metre": 0.1}
    model = RobotModel(motion=GrowingIncrementNoise(), sensors=(RangeNoise(),))
    robot = OnlineLocalizer(room_log, model, theta=grown, particles=50)
    for t in range(12):
        still = np.zeros(3)
        estimate = robot.update(float(t), still, range=room_log.ranges[0])
    assert np.hypot(*(estimate.mean[:2] - room_log.true_poses[0, :2])) < 0.2


def test_memory_does_not_grow_and_a_step_is_quick(room_log, theta):
    """A step takes milliseconds, so a generous bound of 50 on a busy machine still tells a step from a compilation."""
    robot = OnlineLocalizer(room_log, theta=theta, particles=500)
    feed(robot, room_log)
    spent = []
    for lap in range(1, 4):
        for t in range(1, room_log.n_steps):
            began = time.perf_counter()
            robot.update(100.0 * lap + t, room_log.odometry[t], **readings(room_log, t))
            spent.append(time.perf_counter() - began)
    assert robot._rows.n_steps == 8
    assert np.median(spent) < 0.05


BAD = {
    "time stands still": ({"time": 0.0}, "expected a time later than the last one, 0 s, but got 0 s"),
    "time is no number": ({"time": np.nan}, "but got nan s"),
    "no odometry": ({"odometry": None}, "expected odometry as"),
    "odometry of two": ({"odometry": [0.0, 0.0]}, "expected odometry as"),
    "odometry is no number": ({"odometry": [0.0, np.nan, 0.0]}, "three finite numbers"),
    "a beam too few": ({"range": np.ones(7)}, "expected 8 numbers in 'range', but got shape"),
    "a negative range": ({"range": np.r_[np.ones(7), -1.0]}, "got -1 at place 7"),
    "a sensor it has not": ({"landmark_range": [1.0]}, "expected no 'landmark_range'"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_steps_change_nothing(name, room_log, theta):
    change, message = BAD[name]
    robot = OnlineLocalizer(room_log, theta=theta, particles=30)
    robot.update(0.0, range=room_log.ranges[0])
    good = {"time": 1.0, "odometry": room_log.odometry[1], "range": room_log.ranges[1]}
    with pytest.raises(LogError, match=message):
        robot.update(**(good | change))
    track = pmcl.localize(room_log, theta=theta, particles=30)
    np.testing.assert_array_equal(robot.update(**good).mean, track.pose_mean[1])


def test_the_belief_itself(room_log, theta):
    robot = OnlineLocalizer(room_log, theta=theta, particles=40)
    estimate = robot.update(0.0, range=room_log.ranges[0])
    states, weights = robot.particles
    assert states.shape == (3, 40)
    assert weights.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(states[:2] @ weights, estimate.mean[:2], rtol=1e-12)


def test_too_short_a_memory(room_log, theta):
    with pytest.raises(LogError, match="memory of at least 3"):
        OnlineLocalizer(room_log, theta=theta, memory=2)
