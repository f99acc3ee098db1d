"""Streams of one's own robot as rows of a log: exact values, an independent integrator, and what is refused."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.linalg import expm

from pmcl.errors import LogError
from pmcl.geometry import compose, wrap
from pmcl.logs import (
    RobotLog,
    beam_rows,
    landmark_rows,
    odometry_from_poses,
    odometry_from_velocities,
    poses_at,
    row_times,
    sightings_from_camera,
)
from pmcl.maps import LandmarkMap

TAGS = LandmarkMap([[1.0, 0.0], [0.0, 2.0], [3.0, 3.0]], ["7", "12", "40"])


def driven(odometry, start=(0.0, 0.0, 0.0)):
    """The poses that increments lead to."""
    poses = [np.array(start)]
    for increment in odometry[1:]:
        poses.append(compose(poses[-1], increment))
    return np.array(poses)


def test_rows_cover_the_time_that_all_streams_share():
    np.testing.assert_allclose(row_times(0.5, [0.0, 2.2], [0.4, 1.0, 1.9]), [0.4, 0.9, 1.4, 1.9])


def test_increments_between_poses_lead_from_pose_to_pose(rng):
    poses = np.column_stack((rng.normal(size=(50, 2)), rng.uniform(-4.0, 4.0, 50)))
    odometry = odometry_from_poses(poses)
    np.testing.assert_array_equal(odometry[0], 0.0)
    again = driven(odometry, poses[0])
    np.testing.assert_allclose(again[:, :2], poses[:, :2], atol=1e-12)
    np.testing.assert_allclose(wrap(again[:, 2] - poses[:, 2]), 0.0, atol=1e-12)


def test_increments_are_in_the_robots_frame_and_do_not_depend_on_the_odometrys_frame():
    # From (1, 1) looking along y the robot drives 2 m ahead and turns left by a quarter.
    np.testing.assert_allclose(
        odometry_from_poses([[1.0, 1.0, math.pi / 2], [1.0, 3.0, math.pi]])[1], [2.0, 0.0, math.pi / 2], atol=1e-15
    )
    np.testing.assert_allclose(
        odometry_from_poses([[1.0, 1.0, math.pi / 2], [0.0, 1.0, math.pi / 2]])[1], [0.0, 1.0, 0.0], atol=1e-15
    )


def test_poses_between_two_are_interpolated_the_shorter_way_round():
    poses = np.array([[0.0, 0.0, 3.0], [1.0, 2.0, -3.0]])
    middle = poses_at([10.0, 10.8], poses, [10.0, 10.4, 11.0])
    np.testing.assert_allclose(middle[0], poses[0], atol=1e-15)
    np.testing.assert_allclose(middle[1, :2], [0.5, 1.0])
    assert abs(wrap(middle[1, 2] - math.pi)) < 1e-12
    assert np.isnan(middle[2]).all()
    odometry = odometry_from_poses(poses, [10.0, 10.8], [10.0, 10.4, 10.8])
    assert odometry[1:, 2].sum() == pytest.approx(2.0 * math.pi - 6.0)
    np.testing.assert_allclose(driven(odometry, poses[0])[-1, :2], poses[1, :2], atol=1e-12)


def test_pauses_matter_only_where_a_row_lies_in_them():
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    np.testing.assert_allclose(odometry_from_poses(poses, [0.0, 5.0, 10.0], [0.0, 5.0, 10.0])[1:, 0], 1.0)
    with pytest.raises(LogError, match=r"poses without a pause of more than 1 s, got one at 2\.5 s: make two logs"):
        odometry_from_poses(poses, [0.0, 5.0, 10.0], [0.0, 2.5, 5.0])
    assert odometry_from_poses(poses, [0.0, 5.0, 10.0], [0.0, 2.5, 5.0], max_pause=5.0)[1, 0] == pytest.approx(0.5)
    rate = np.ones(3)
    with pytest.raises(LogError, match=r"velocities without a pause of more than 1 s, got one at 0\.5 s"):
        odometry_from_velocities([0.0, 0.5, 3.0], rate, rate, [0.0, 2.0])
    # Before the first row and after the last one nothing is integrated.
    odometry_from_velocities([0.0, 4.0, 4.5, 9.0], [1.0] * 4, [0.0] * 4, [4.0, 5.0])
    with pytest.raises(LogError, match=r"velocities without a pause.*got one at 4\.5 s"):
        odometry_from_velocities([0.0, 4.0, 4.5, 9.0], [1.0] * 4, [0.0] * 4, [4.0, 6.0])


def test_velocities_are_integrated_as_the_matrix_exponential_does(rng):
    """For a robot that drives in all directions, between rows and velocities that have nothing in common."""
    clock = np.concatenate(([0.0], np.sort(rng.uniform(0.0, 4.0, 40)), [4.0]))
    v, u, w = rng.normal(size=(3, len(clock)))
    times = np.array([0.05, 0.9, 1.31, 3.7])
    odometry = odometry_from_velocities(clock, v, w, times, left=u, max_pause=4.0)
    for t in range(1, len(times)):
        motion = np.eye(3)
        knots = np.unique(np.concatenate((times[t - 1 : t + 1], clock[(clock > times[t - 1]) & (clock < times[t])])))
        for begin, end in itertools.pairwise(knots):
            k = np.flatnonzero(clock <= begin)[-1]
            motion = motion @ expm((end - begin) * np.array([[0.0, -w[k], v[k]], [w[k], 0.0, u[k]], [0.0, 0.0, 0.0]]))
        np.testing.assert_allclose(odometry[t, :2], motion[:2, 2], atol=1e-12)
        assert abs(wrap(odometry[t, 2] - math.atan2(motion[1, 0], motion[0, 0]))) < 1e-12
    np.testing.assert_array_equal(
        odometry_from_velocities(clock, v, w, times, max_pause=4.0),
        odometry_from_velocities(clock, v, w, times, left=np.zeros_like(v), max_pause=4.0),
    )


def test_wheel_speeds_of_a_differential_drive_give_an_arc():
    # Radii 1.5 and 2.5 m about a centre 2 m to the left: a quarter turn in one second.
    slow, fast, track = 1.5 * math.pi / 2, 2.5 * math.pi / 2, 1.0
    odometry = odometry_from_velocities([0.0], [(slow + fast) / 2], [(fast - slow) / track], [0.0, 1.0])
    np.testing.assert_allclose(odometry[1], [2.0, 2.0, math.pi / 2], atol=1e-14)


def test_sightings_go_to_the_nearest_row_under_their_names():
    rows = landmark_rows(
        [0.0, 1.0, 2.0], TAGS, [1.1, 0.2, 0.9, 1.6, 5.0], [12, 7, 12, 40, 7],
        ranges=[1.0, 2.0, 3.0, 4.0, 5.0], bearings=[0.1, 0.2, 0.3, 0.4, 0.5],
    )  # fmt: skip
    assert set(rows) == {"landmark_range", "landmark_bearing", "landmark_time_offset"}
    nan = np.nan
    # At 1.1 and 0.9 s tag 12 is equally near to the row at 1 s up to rounding; the order of the file does not decide.
    np.testing.assert_array_equal(rows["landmark_range"], [[2.0, nan, nan], [nan, 3.0, nan], [nan, nan, 4.0]])
    np.testing.assert_array_equal(rows["landmark_bearing"], [[0.2, nan, nan], [nan, 0.3, nan], [nan, nan, 0.4]])
    np.testing.assert_allclose(rows["landmark_time_offset"], [[0.2, nan, nan], [nan, -0.1, nan], [nan, nan, -0.4]])
    assert np.isnan(landmark_rows([0.0, 1.0], TAGS, [0.3], ["7"], sizes=[9.0], max_offset=0.2)["landmark_size"]).all()


def test_beams_take_their_nearest_reading_each():
    nan, inf = np.nan, np.inf
    ranges = beam_rows(
        [0.0, 1.0],
        [0.3, 0.1, 0.2, 1.4, 7.0],
        [[1.0, nan], [2.0, nan], [nan, 3.0], [inf, nan], [9.0, 9.0]],
    )
    np.testing.assert_array_equal(ranges, [[2.0, 3.0], [inf, nan]])


def test_the_columns_make_a_log_that_knows_its_path(rng):
    """Everything together: streams of an exact drive give a log whose readings are those of its path."""
    clock = np.arange(0.0, 20.0, 0.05)
    forward, turn = 0.3 + 0.1 * np.sin(clock), 0.4 * np.cos(0.5 * clock)
    times = row_times(0.5, clock)
    odometry = odometry_from_velocities(clock, forward, turn, times)
    path = driven(odometry, (0.0, -1.0, 0.3))
    seen = np.tile(times, 3)
    names = np.repeat(TAGS.names, len(times))
    pose = np.tile(path, (3, 1))
    dx, dy = (np.repeat(TAGS.positions, len(times), axis=0) - pose[:, :2]).T
    order = rng.permutation(len(seen))
    rows = landmark_rows(
        times, TAGS, seen[order], names[order],
        ranges=np.hypot(dx, dy)[order], bearings=wrap(np.arctan2(dy, dx) - pose[:, 2])[order],
    )  # fmt: skip
    log = RobotLog.build(time=times, odometry=odometry, landmarks=TAGS, true_poses=path, **rows)
    assert log.n_readings == 3 * len(times)
    apart = TAGS.positions - log.true_poses[:, None, :2]
    np.testing.assert_allclose(log.landmark_range, np.hypot(*apart.transpose(2, 0, 1)), atol=1e-12)
    np.testing.assert_array_equal(log.landmark_time_offset, 0.0)


def test_a_level_camera_sees_what_a_ruler_on_the_floor_measures():
    ranges, bearings = sightings_from_camera([[-3.0, 0.5, 4.0], [0.0, -2.0, 2.0], [1.0, 0.0, 0.0]])
    np.testing.assert_allclose(ranges, [5.0, 2.0, 1.0])
    np.testing.assert_allclose(bearings, [math.atan2(3.0, 4.0), 0.0, -math.pi / 2])


def test_tilt_and_roll_of_a_camera_are_taken_out(rng):
    """Against rotation matrices: the camera's axes in the level frame (ahead, left, up)."""
    tilt, roll = 0.4, -0.2
    points = rng.normal(loc=(4.0, 0.0, 0.0), size=(20, 3))
    ahead, right, down = np.array([1.0, 0.0, 0.0]), np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, -1.0])
    z = math.cos(tilt) * ahead + math.sin(tilt) * down
    lower = np.cross(z, right)  # the image's downward direction before the roll
    x = math.cos(roll) * right + math.sin(roll) * lower
    y = np.cross(z, x)
    optical = points @ np.column_stack((x, y, z))
    ranges, bearings = sightings_from_camera(optical, tilt=tilt, roll=roll)
    np.testing.assert_allclose(ranges, np.hypot(points[:, 0], points[:, 1]), rtol=1e-12)
    np.testing.assert_allclose(bearings, np.arctan2(points[:, 1], points[:, 0]), atol=1e-12)


ONE = [1.0, 1.0]
REFUSED = {
    "no period": (lambda: row_times(0.0, [0.0, 1.0]), "period > 0"),
    "no stream": (lambda: row_times(0.5), "at least one stream"),
    "streams apart": (lambda: row_times(0.5, [0.0, 1.0], [5.0, 6.0]), "at least two rows, got 0.*same clock"),
    "times back": (lambda: row_times(0.5, [0.0, 2.0, 1.0]), "strictly increasing 'stream 0', got 1 s after 2 s"),
    "dates": (lambda: row_times(0.5, np.array(["2026-01-01"], dtype="M8[s]")), "'stream 0', got dates"),
    "pose columns": (lambda: odometry_from_poses([[1.0, 2.0]]), r"'poses' of shape \(N, 3\).*got \(1, 2\)"),
    "pose missing": (lambda: odometry_from_poses([[1.0, 2.0, np.nan]]), r"in 'poses', got nan at \[0, 2"),
    "times alone": (lambda: odometry_from_poses([[1.0, 2.0, 0.0]], times=[0.0]), "pose_times together with times"),
    "row early": (lambda: odometry_from_velocities([1.0, 2.0], ONE, ONE, [0.5, 1.5]), "row at 0.5 s before 1 s"),
    "speeds short": (lambda: odometry_from_velocities([1.0, 2.0], [1.0], ONE, [1.0, 2.0]), "got 2 and 1"),
    "stranger": (lambda: landmark_rows([0.0], TAGS, [0.0], [99], ranges=[1.0]), r"\(7, 12, 40\), got '99'"),
    "nothing read": (lambda: landmark_rows([0.0], TAGS, [0.0], [7]), "ranges, bearings or sizes, got none"),
    "flat ranges": (lambda: beam_rows([0.0], [0.0], [1.0]), r"shape \(R, B\)"),
    "offset": (lambda: beam_rows([0.0], [0.0], [[1.0]], max_offset=-1.0), "max_offset >= 0"),
    "camera columns": (lambda: sightings_from_camera([[1.0, 2.0]]), r"shape \(R, 3\)"),
    "camera failed": (lambda: sightings_from_camera([[1.0, np.nan, 2.0]]), "leave failed detections out"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_unusable_streams_are_refused_in_one_line(case):
    call, message = REFUSED[case]
    with pytest.raises(LogError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)
