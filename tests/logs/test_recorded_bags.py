"""Bags that robots recorded: Jarvis (tricycle, two lasers, reference) and Guardian (differential base)."""

from __future__ import annotations

import numpy as np
import pytest

from pmcl.geometry import between, compose
from pmcl.logs.bags.read import read_bag
from pmcl.maps.occupancy_grid import OccupancyGrid

NAVIGATION, SECURITY = "/driver_laser_navigation/laser_scan", "/driver_laser_security/laser_scan"


@pytest.fixture(scope="module")
def jarvis(shared_data):
    folder = shared_data / "jarvis"
    return read_bag(
        folder / "jarvis_complex_path_fast.bag",
        scans=[NAVIGATION, SECURITY],
        truth="/pose_ground_truth",
        truth_to_map=(14.617, 3.361, -0.033),
        truth_shift=0.09,
        grid_map=OccupancyGrid.read(folder / "i-108_10mm.yaml"),
    )


def test_the_mounts_of_jarvis_are_those_of_its_transforms(jarvis):
    lidars = jarvis.lidars
    np.testing.assert_allclose(lidars["driver_laser_navigation"].pose, [0.194, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(lidars["driver_laser_security"].pose, [0.895, 0.0, 0.0], atol=1e-9)
    assert lidars["driver_laser_navigation"].ranges.shape[1] == 60
    assert lidars["driver_laser_security"].ranges.shape[1] == 64


def test_the_odometry_of_jarvis_follows_its_reference(jarvis):
    """Over ten rows, some metres, wheel odometry and reference differ by centimetres."""
    k, known = 10, ~np.isnan(jarvis.true_poses[:, 0])
    assert known.mean() > 0.95
    pose, moved, drift = np.zeros(3), [], []
    path = [pose := compose(pose, step) for step in jarvis.odometry]
    for first in range(0, jarvis.n_steps - k, k):
        if known[first] and known[first + k]:
            true = between(jarvis.true_poses[first], jarvis.true_poses[first + k])
            moved.append(np.hypot(*true[:2]))
            drift.append(np.hypot(*(between(path[first], path[first + k]) - true)[:2]))
    assert np.median(moved) > 1.0
    assert np.median(drift) < 0.05 * np.median(moved)


def endpoints_off_the_walls(log, name, mirrored=False):
    """Median distance [m] from the endpoints of scans at the reference poses to the nearest wall of the map."""
    lidar, grid = log.lidars[name], log.grid_map
    known = ~np.isnan(log.true_poses[:, 0])
    sensor = compose(log.true_poses[known], lidar.pose)
    ranges = lidar.ranges[known]
    direction = sensor[:, 2:] + (-lidar.angles if mirrored else lidar.angles)
    ends = sensor[:, None, :2] + ranges[..., None] * np.stack([np.cos(direction), np.sin(direction)], axis=-1)
    cells = grid.to_cells(ends[np.isfinite(ranges)])
    column, row = np.floor(cells).astype(int).T
    rows, columns = grid.cells.shape
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    assert inside.mean() > 0.5
    return np.median(grid.distance_field[row[inside], column[inside]])


def test_the_scans_of_jarvis_end_at_the_walls_of_its_map(jarvis):
    assert endpoints_off_the_walls(jarvis, "driver_laser_navigation") < 0.06
    assert endpoints_off_the_walls(jarvis, "driver_laser_navigation", mirrored=True) > 0.3


def test_rows_of_jarvis_are_as_far_apart_as_asked_for(jarvis):
    attributes = jarvis.dataset.attrs
    assert (attributes["update_min_d"], attributes["update_min_a"], attributes["update_rule"]) == (0.25, 0.2, "nav2")
    one = ~np.isnan(jarvis.lidars["driver_laser_navigation"].ranges).all(axis=1)
    assert 60 < one.sum() < 80


def test_jarvis_without_a_choice_of_laser(shared_data):
    with pytest.raises(ValueError, match="got 2: choose one, or several, with --scan; the bag holds"):
        read_bag(shared_data / "jarvis" / "jarvis_complex_path_fast.bag")


@pytest.mark.slow
def test_guardian(shared_data):
    bag = shared_data / "guardian" / "guardian_3.bag"
    log = read_bag(bag, scans=["/scan", "/hokuyo_back_scan"])
    front, rear = log.lidars["scan"], log.lidars["hokuyo_back_scan"]
    # base_footprint -> base_link -> laser_tilt_mount_link -> laser_tilt_link -> hokuyo_frontal_laser_link
    np.testing.assert_allclose(front.pose, [0.46781 + 0.018, 0.0, 0.0], atol=1e-4)
    np.testing.assert_allclose(rear.pose[:2], [-0.43171, 0.0], atol=1e-6)
    assert abs(rear.pose[2]) == pytest.approx(np.pi, abs=1e-6)
    of_tf = read_bag(bag, scans=["/scan"], odometry="odom", update_min_d=0.0, update_min_a=0.0)
    of_topic = read_bag(bag, scans=["/scan"], odometry="/guardian_node/odom", update_min_d=0.0, update_min_a=0.0)
    n = min(of_tf.n_steps, of_topic.n_steps)
    assert n > 1000
    ends = [np.abs(log.odometry[1:]).sum(axis=0) for log in (of_tf, of_topic)]
    np.testing.assert_allclose(ends[0], ends[1], rtol=0.02, atol=0.02)
