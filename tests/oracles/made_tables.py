"""Coefficient tables with every awkward value in them, and the states at which to evaluate them."""

from __future__ import annotations

import numpy as np

from pmcl.maps.walls import WallMap
from pmcl.models.motions.increments.table import IncrementMotion
from pmcl.models.sensor import sensors
from pmcl.models.sensors.landmarks.table import LandmarkSightings
from pmcl.models.sensors.lidar.table import BEAM, LidarTable
from pmcl.models.sensors.range_beams.table import RangeBeams
from pmcl.models.starts.table import GaussianStart, PoseStart

# The classes of sensors bring the compiled functions of their tables.
sensors()

ROOM = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 1.5], [2.5, 1.5], [2.5, 3.0], [0.0, 3.0]])


def increment_motion(rng, n_steps=6):
    """Increments of all sizes with other noise at every step; row 0 holds what must never be read."""
    mean, std = rng.normal(0.0, [0.3, 0.1, 0.5], (n_steps, 3)), rng.uniform(0.01, 0.3, (n_steps, 3))
    mean[0], std[0] = np.nan, np.nan
    return IncrementMotion(mean, std)


def gaussian_start():
    return GaussianStart(np.array([1.2, 1.4, 0.3]), np.array([0.2, 0.1, 0.4]))


def pose_start(position="room", heading=np.inf):
    """A start anywhere in the room (or its bounding box), or Gaussian in position, with this std of the heading."""
    walls = WallMap.from_polygon(ROOM)
    segments = walls.segments.reshape(-1, 4).copy() if position == "room" else np.empty((0, 4))
    area = {"room": 4.0 * 1.5 + 2.5 * 1.5, "box": 12.0, "gaussian": 1.0}[position]
    std = 0.2 if position == "gaussian" else np.inf
    log_density = -np.log(area) - (np.log(2.0 * np.pi) if np.isinf(heading) else 0.0)
    return PoseStart(
        np.array([1.2, 1.4, 0.3]),
        np.array([std, std, heading]),
        np.array([0.0, 0.0]),
        np.array([4.0, 3.0]),
        segments,
        log_density,
    )


def range_beams(poses, rng, *, outliers=True, open_room=True):
    """Beams around each pose (T, 3): biased, scaled, some off the centre; the room lacks a wall so that rays get lost.

    Readings scatter around what the middle pose would see, and among them are NaN, 0, the greatest range, beyond it,
    inf, a gross error, a row with one beam and a row with none.
    """
    walls = WallMap.from_polygon(ROOM)
    if open_room:
        walls = WallMap(walls.segments[1:])
    vertices, start, stop = walls.vertices_and_edges()
    n_steps, n_beams, max_range = len(poses), 5, 3.2
    beam_pose = np.column_stack([rng.uniform(-0.2, 0.2, (n_beams, 2)), np.arange(n_beams) * 2.0 * np.pi / n_beams])
    beam_pose[1, :2] = beam_pose[0, :2]
    reading = rng.uniform(0.2, 3.0, (n_steps, n_beams))
    reading[1, 0], reading[1, 1], reading[1, 2] = 0.0, max_range, np.inf
    reading[2, 0], reading[2, 3], reading[2, 4] = max_range + 1.0, np.nan, 1e-9
    reading[3] = np.nan
    reading[4, 1:] = np.nan
    return RangeBeams(
        reading=reading,
        measured=np.count_nonzero(~np.isnan(reading), axis=1).astype(np.int64),
        beam_pose=beam_pose,
        bias=np.array([0.0, 0.07, -0.05, 0.0, 0.2]),
        scale=np.array([1.0, 1.04, 1.0, 0.9, 1.1]),
        std=np.array([0.4, 0.5, 0.3, 0.6, 0.45]),
        outlier_weight=np.array([0.0, 0.1, 0.0, 0.3, 0.02]) if outliers else np.zeros(n_beams),
        max_range=max_range,
        vertices=vertices.copy(),
        wall_start=start,
        wall_stop=stop,
    )


def sightings(n_steps, rng, *, outliers=True, channels=(True, True, True), mount=(0.1, -0.2, 0.5)):
    """Sightings with other channels missing in each: T rows of 0 to 3 sightings of four landmarks."""
    count = np.resize([2, 3, 0, 1, 3], n_steps)
    first = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    n = int(first[-1])
    reading = np.column_stack([rng.uniform(0.5, 4.0, n), rng.uniform(-np.pi, np.pi, n), rng.uniform(5.0, 60.0, n)])
    reading[:, ~np.array(channels)] = np.nan
    if all(channels):
        # Every combination of missing channels that leaves one reading.
        for k in range(n):
            for channel in range(3):
                if (k % 7) + 1 & (1 << channel) == 0:
                    reading[k, channel] = np.nan
    return LandmarkSightings(
        first=first,
        time=np.repeat(np.arange(n_steps), count).astype(np.int64),
        landmark=rng.integers(0, 4, n),
        range=reading[:, 0].copy(),
        bearing=reading[:, 1].copy(),
        size=reading[:, 2].copy(),
        position=np.array([[0.0, 0.0], [5.0, 0.5], [4.0, 4.0], [-0.5, 3.0]]),
        sensor_pose=np.array(mount, dtype=float),
        range_scale=np.array([1.0, 1.05, 0.95, 1.0]),
        range_bias=np.array([0.0, 0.1, -0.1, 0.02]),
        range_std=np.array([0.3, 0.5, 0.4, 0.6]),
        bearing_bias=np.array([0.0, 0.05, -0.1, 0.2]),
        bearing_std=np.array([0.4, 0.5, 0.3, 0.6]),
        size_constant=np.array([100.0, 120.0, 90.0, 80.0]),
        size_std=np.array([0.4, 0.5, 0.6, 0.3]),
        outlier_weight=np.array([0.0, 0.1, 0.02, 0.3]) if outliers else np.zeros(4),
        max_range=8.0,
    )


def lidar_scans(n_steps, rng, n_lasers=2):
    """Scans of two lasers with three rays each on a small grid; the arrays of the map hold any numbers."""
    n_rays, n_levels, height, width = 3 * n_lasers, 5, 4, 7
    reading = rng.uniform(0.2, 3.0, (n_steps, n_rays))
    reading[1, 0], reading[2, :2] = np.nan, 3.2
    return LidarTable(
        reading=reading,
        measured=np.count_nonzero(~np.isnan(reading), axis=1).astype(np.int64),
        beam_pose=rng.uniform(-0.5, 0.5, (n_rays, 3)),
        bias=rng.uniform(-0.1, 0.1, n_rays),
        scale=rng.uniform(0.9, 1.1, n_rays),
        std=rng.uniform(0.1, 0.3, n_rays),
        max_range=np.full(n_rays, 3.2),
        laser=np.repeat(np.arange(n_lasers), 3),
        ray=np.tile(np.arange(3), n_lasers),
        names=np.frombuffer(b"scan_front\nscan_back", dtype=np.uint8).copy(),
        model=BEAM,
        exponent=0.5,
        z_hit=0.7,
        z_short=0.1,
        z_max=0.05,
        z_rand=0.15,
        lambda_short=0.4,
        level_log_density=rng.normal(size=(n_lasers, n_levels)),
        level_distance=np.linspace(0.0, 2.0, n_levels),
        levels=rng.integers(0, n_levels, (height + 2, width + 2)).astype(np.uint16),
        squares=rng.integers(0, 3, (4, height, width)).astype(np.uint8),
        resolution=0.1,
        origin=np.array([-1.0, 0.5, 0.3]),
    )


def poses_in_room(rng, count):
    """Poses (count, 3) in the lower part of the room, clear of its walls; headings beyond the circle too."""
    low, high = np.array([0.4, 0.3, -9.0]), np.array([3.6, 1.2, 9.0])
    return rng.uniform(low, high, (count, 3))
