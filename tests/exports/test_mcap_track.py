"""MCAP files, read back by another implementation of the format and, in one case, byte by byte."""

from __future__ import annotations

import builtins
import struct

import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from pmcl.errors import PmclError
from pmcl.exports.end_points import end_points
from pmcl.exports.mcap_track import write_mcap
from pmcl.logs.arrays import LidarScans
from pmcl.logs.robot_log import RobotLog
from pmcl.maps.occupancy_grid import OccupancyGrid
from pmcl.simulations.amigobot import simulate_amigobot


@pytest.fixture(scope="module")
def sonar_log():
    return simulate_amigobot(20.0)


@pytest.fixture(scope="module")
def lidar_log():
    """A robot that drives past a wall at x = 3 in a grid of 5 cm, two lasers, one of them turned."""
    cells = np.zeros((80, 100), dtype=np.uint8)
    cells[:, 80], cells[0, :] = OccupancyGrid.OCCUPIED, OccupancyGrid.UNKNOWN
    grid = OccupancyGrid(cells, 0.05, (-1.0, -2.0, 0.0))
    n = 6
    angles = np.linspace(-0.5, 0.5, 5)
    odometry = np.tile([0.1, 0.0, 0.0], (n, 1))
    x = 0.1 * np.arange(n)
    scans = {}
    for name, pose in (("front", (0.2, 0.0, 0.0)), ("side", (0.0, 0.1, 0.3))):
        direction = angles + pose[2]
        ranges = (3.025 - (x[:, None] + pose[0])) / np.cos(direction)
        ranges[2, 1], ranges[3, 2], ranges[4, 3] = np.nan, np.inf, 0.02
        scans[name] = LidarScans(ranges, angles, 0.05, 20.0, np.array(pose))
    return RobotLog.build(
        time=10.0 + 0.25 * np.arange(n), odometry=odometry, lidars=scans, grid_map=grid,
        start_mean=(0.0, 0.0, 0.0), start_std=(0.1, 0.1, 0.1),
        true_poses=np.column_stack([x, 0 * x, 0 * x]), warn=False,
    )  # fmt: skip


class MadeTrack:
    """A track with known poses."""

    def __init__(self, poses):
        self.pose_mean = np.asarray(poses, dtype=float)
        self.pose_cov = np.tile(np.array([[0.04, 0.01, 0.002], [0.01, 0.09, 0.003], [0.002, 0.003, 0.01]]),
                                (len(poses), 1, 1))  # fmt: skip


def read(path):
    """Messages by topic: lists of (time [ns], message)."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    found = {}
    with Reader(path) as reader:
        for connection, time, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((time, message, bytes(data)))
    return found


def points_of(cloud):
    return np.frombuffer(cloud.data.tobytes(), dtype="<f4").reshape(-1, 3)


def test_a_lidar_log_is_shown_with_map_path_and_end_points_on_the_wall(lidar_log, tmp_path):
    path = tmp_path / "track.mcap"
    write_mcap(path, MadeTrack(lidar_log.true_poses), lidar_log)
    found = read(path)
    assert set(found) == {"/map", "/tf", "/pose", "/path", "/true_path", "/end_points"}
    grid = found["/map"][0][1]
    assert (grid.info.width, grid.info.height) == (100, 80)
    assert grid.info.resolution == pytest.approx(0.05)
    assert (grid.info.origin.position.x, grid.info.origin.position.y) == (-1.0, -2.0)
    values = grid.data.reshape(80, 100)
    np.testing.assert_array_equal(values[1:, 80], 100)
    np.testing.assert_array_equal(values[0], -1)
    assert (values[1:, :80] == 0).all()
    assert [time for time, *_ in found["/pose"]] == [round(1e9 * time) for time in lidar_log.times]
    pose = found["/pose"][3][1]
    assert pose.header.frame_id == "map"
    assert pose.header.stamp.sec == 10
    assert pose.header.stamp.nanosec == 750_000_000
    assert pose.pose.pose.position.x == pytest.approx(0.3)
    covariance = pose.pose.covariance.reshape(6, 6)
    np.testing.assert_allclose(covariance[np.ix_([0, 1, 5], [0, 1, 5])], MadeTrack([[0, 0, 0]]).pose_cov[0])
    assert np.count_nonzero(covariance) == 9
    assert len(found["/path"][0][1].poses) == len(found["/true_path"][0][1].poses) == lidar_log.n_steps
    transform = found["/tf"][3][1].transforms[0]
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "base_link")
    # Two lasers of five rays; in rows 2, 3 and 4 one of each was missing, without echo or too near.
    clouds = [points_of(message) for _, message, _ in found["/end_points"]]
    assert [len(cloud) for cloud in clouds] == [10, 10, 8, 8, 8, 10]
    np.testing.assert_allclose(np.concatenate(clouds)[:, 0], 3.025, atol=1e-5)


def test_headings_turn_poses_and_end_points(lidar_log, tmp_path):
    """The same readings from a robot that looks along y end on a wall at y = 3."""
    turned = lidar_log.true_poses[:, [1, 0, 2]] + [0.0, 0.0, 0.5 * np.pi]
    write_mcap(tmp_path / "turned.mcap", MadeTrack(turned), lidar_log)
    found = read(tmp_path / "turned.mcap")
    np.testing.assert_allclose(points_of(found["/end_points"][0][1])[:, 1], 3.025, atol=1e-5)
    orientation = found["/pose"][0][1].pose.pose.orientation
    assert 2.0 * np.arctan2(orientation.z, orientation.w) == pytest.approx(0.5 * np.pi)


def test_a_pose_is_where_ros_looks_for_it_in_the_bytes(lidar_log, tmp_path):
    """CDR, little endian: encapsulation, stamp, frame with its length, padding to 8, then doubles."""
    write_mcap(tmp_path / "track.mcap", MadeTrack(lidar_log.true_poses), lidar_log)
    raw = read(tmp_path / "track.mcap")["/pose"][2][2]
    seconds, nanoseconds, length = struct.unpack_from("<iII", raw, 4)
    assert (seconds, nanoseconds, raw[16 : 16 + length]) == (10, 500_000_000, b"map\x00")
    assert struct.unpack_from("<7d", raw, 4 + 16) == pytest.approx((0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))


def test_a_sonar_log_needs_neither_grid_nor_lidar(sonar_log, tmp_path):
    write_mcap(tmp_path / "track.mcap", MadeTrack(sonar_log.true_poses), sonar_log)
    found = read(tmp_path / "track.mcap")
    assert set(found) == {"/map_markers", "/tf", "/pose", "/path", "/true_path", "/end_points"}
    walls = found["/map_markers"][0][1].markers[0]
    ends = np.array([(point.x, point.y) for point in walls.points]).reshape(-1, 2, 2)
    np.testing.assert_allclose(ends, sonar_log.walls.segments)
    # At the true poses most sonars end on a wall, within their noise.
    points = np.concatenate(end_points(sonar_log, sonar_log.true_poses))
    start, along = ends[:, 0], ends[:, 1] - ends[:, 0]
    share = np.einsum("pwd,wd->pw", points[:, None] - start, along) / np.einsum("wd,wd->w", along, along)
    nearest = start + np.clip(share, 0.0, 1.0)[..., None] * along
    distance = np.linalg.norm(points[:, None] - nearest, axis=-1).min(axis=1)
    assert np.median(distance) < 0.1


def test_a_track_of_another_log_is_refused(sonar_log, lidar_log, tmp_path):
    with pytest.raises(PmclError, match="localize this log"):
        write_mcap(tmp_path / "track.mcap", MadeTrack(lidar_log.true_poses), sonar_log)
    assert not (tmp_path / "track.mcap").exists()


def test_a_missing_library_is_named_with_the_command_that_installs_it(lidar_log, tmp_path, monkeypatch):
    real = builtins.__import__

    def without(name, *rest):
        if name.startswith("mcap"):
            raise ImportError("no such module", name="mcap")
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(PmclError, match=r"mcap is not installed; run pip install 'pmcl\[ros\]'"):
        write_mcap(tmp_path / "track.mcap", MadeTrack(lidar_log.true_poses), lidar_log)
