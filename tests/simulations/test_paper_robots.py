"""The simulated robots: geometry, noise, reproducibility, and that they stay where they should without being pushed."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from pmcl.errors import ModelError
from pmcl.geometry import between, compose, wrap
from pmcl.maps.walls import WallMap
from pmcl.simulations.amigobot import AMIGOBOT_BEAMS, AMIGOBOT_ROOM, simulate_amigobot
from pmcl.simulations.driving import WaypointDriver, drive
from pmcl.simulations.landmark_field import simulate_landmark_field

EXACT = {"sigma_forward": 1e-9, "sigma_left": 1e-9, "sigma_turn": 1e-9, "sigma_range": 1e-9}


def ray_length(pose, outline):
    """Length of a ray to the room's outline, by shapely."""
    far = shapely.LineString([pose[:2], pose[:2] + 10.0 * np.array([np.cos(pose[2]), np.sin(pose[2])])])
    return shapely.distance(shapely.Point(pose[:2]), shapely.intersection(far, outline))


def test_without_noise_sonars_read_the_length_of_their_rays():
    log = simulate_amigobot(60.0, seed=3, theta=EXACT)
    outline = shapely.MultiLineString([list(map(tuple, wall)) for wall in AMIGOBOT_ROOM.segments])
    for t in range(0, 60, 7):
        for beam in range(8):
            expected = ray_length(compose(log.true_poses[t], AMIGOBOT_BEAMS[beam]), outline)
            assert log.ranges[t, beam] == pytest.approx(expected, abs=1e-6)


def test_odometry_is_the_command_and_the_noise_is_theta():
    log = simulate_amigobot(2000.0, seed=4)
    error = between(log.true_poses[:-1], log.true_poses[1:]) - log.odometry[1:]
    error[:, 2] = wrap(error[:, 2])
    truth = np.array([log.true_theta[name] for name in ("sigma_forward", "sigma_left", "sigma_turn")])
    standard_error = 1.0 / np.sqrt(2.0 * len(error))
    np.testing.assert_allclose(np.sqrt(np.mean(error**2, axis=0)) / truth, 1.0, atol=5.0 * standard_error)
    assert (np.abs(error.mean(axis=0)) < 5.0 * truth / np.sqrt(len(error))).all()
    # Independent from step to step.
    correlation = np.mean(error[1:] * error[:-1], axis=0) / truth**2
    assert (np.abs(correlation) < 5.0 / np.sqrt(len(error))).all()


def test_the_start_is_drawn_from_its_belief():
    offsets = []
    for seed in range(40):
        log = simulate_amigobot(2.0, seed=seed)
        offsets.append((log.true_poses[0] - log.start_mean) / log.start_std)
    spread = np.sqrt(np.mean(np.square(offsets), axis=0))
    np.testing.assert_allclose(spread, 1.0, atol=5.0 / np.sqrt(80.0))


def test_the_robot_practically_never_crosses_a_wall():
    crossed = [not AMIGOBOT_ROOM.contains(simulate_amigobot(seed=seed).true_poses).all() for seed in range(40)]
    assert sum(crossed) <= 1


def test_a_seed_gives_one_log_and_another_seed_another():
    one, again, other = (simulate_amigobot(50.0, seed=seed) for seed in (5, 5, 6))
    assert one.fingerprint() == again.fingerprint()
    assert one.true_theta == again.true_theta
    assert one.fingerprint() != other.fingerprint()
    assert one.dataset.attrs["seed"] == 5
    assert one.n_steps == 50


def test_given_parameters_are_the_truth():
    log = simulate_amigobot(20.0, theta={"sigma_range": 0.123})
    assert log.true_theta["sigma_range"] == 0.123
    assert set(log.true_theta) == {"sigma_forward", "sigma_left", "sigma_turn", "sigma_range"}


def test_the_amigobot_drives_in_another_room():
    hall = WallMap.from_polygon([(0.0, 0.0), (6.0, 0.0), (6.0, 3.0), (0.0, 3.0)])
    points = [(4.5, 1.0), (3.0, 2.0), (1.5, 1.0)]
    log = simulate_amigobot(200.0, 1, EXACT, room=hall, waypoints=points)
    np.testing.assert_array_equal(log.walls.segments, hall.segments)
    np.testing.assert_allclose(log.start_mean, (1.5, 1.0, 0.0))
    assert hall.contains(log.true_poses).all()
    for point in points:
        assert np.hypot(*(log.true_poses[:, :2] - point).T).min() < 0.25
    round_the_room = simulate_amigobot(60.0, 1, EXACT, waypoints=points[1:])
    np.testing.assert_array_equal(round_the_room.walls.segments, AMIGOBOT_ROOM.segments)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"room": AMIGOBOT_ROOM}, "expected waypoints for a room of your own"),
        ({"waypoints": [(1.0, 1.0)]}, "at least two points"),
        ({"waypoints": [(1.0, 1.0, 0.0), (2.0, 1.0, 0.0)]}, "at least two points"),
        ({"waypoints": [(1.0, 1.0), (np.nan, 1.0)]}, "finite"),
    ],
)
def test_rooms_without_a_way_are_refused(given, message):
    with pytest.raises(ModelError, match=message):
        simulate_amigobot(20.0, **given)


@pytest.mark.parametrize("wrong", [{"duration": 1.0}, {"duration": np.nan}, {"duration": np.inf}, {"seed": -1}])
def test_impossible_settings_of_the_amigobot_are_refused(wrong):
    with pytest.raises(ModelError, match=r"simulate_amigobot: expected (duration|seed)"):
        simulate_amigobot(**wrong)


def test_the_driver_turns_first_and_visits_all_waypoints():
    waypoints = np.array([(2.0, 0.0), (2.0, 2.0), (0.0, 0.0)])
    driver = WaypointDriver(waypoints, step=0.2, turn=0.5, reached=0.1)
    path, command = drive((0.0, 0.0, np.pi), driver, np.zeros(3), 120, np.random.default_rng(0))
    assert command[1, 0] == 0.0
    assert abs(command[:, 2]).max() <= 0.5
    assert command[:, 0].max() <= 0.2 + 1e-12
    distance = np.hypot(*(path[:, None, :2] - waypoints).transpose(2, 0, 1))
    assert (distance.min(axis=0) < 0.1).all()
    np.testing.assert_allclose(compose(path[:-1], command[1:]), path[1:], atol=1e-12)


def test_the_landmark_field_is_seen_from_many_sides():
    log = simulate_landmark_field(400, bearings=True)
    assert log.landmarks.positions.shape == (8, 2)
    assert np.isfinite(log.landmark_range).all()
    true_distance = np.hypot(*(log.landmarks.positions - log.true_poses[:, None, :2]).transpose(2, 0, 1))
    assert (true_distance.min(axis=0) < 11.0).all()
    assert true_distance.min() < 5.0
    assert (true_distance.max(axis=0) > 14.0).all()
    assert np.sqrt(np.mean((log.landmark_range - true_distance) ** 2)) == pytest.approx(0.3, rel=0.1)
    assert log.odometry[:, 2].min() < -0.3
    assert log.odometry[:, 2].max() > 0.3


def test_landmarks_out_of_reach_are_not_seen():
    log = simulate_landmark_field(200, reach=9.0, n_landmarks=5)
    true_distance = np.hypot(*(log.landmarks.positions - log.true_poses[:, None, :2]).transpose(2, 0, 1))
    np.testing.assert_array_equal(np.isnan(log.landmark_range), true_distance > 9.0)
    assert 0.1 < np.isnan(log.landmark_range).mean() < 0.99
    assert log.landmark_bearing is None


@pytest.mark.parametrize("wrong", [{"n_steps": 1}, {"n_landmarks": 0}, {"seed": -1}, {"ranges": False}])
def test_impossible_settings_of_the_field_are_refused(wrong):
    with pytest.raises(ModelError, match="expected at least 2 rows"):
        simulate_landmark_field(**wrong)
