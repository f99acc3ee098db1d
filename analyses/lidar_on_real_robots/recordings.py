"""The logs of this folder: Jarvis in two parts, Wean Hall twice, and simulated rooms whose maps are wrong."""

from __future__ import annotations

import functools
import os
from pathlib import Path

import numpy as np
from scipy import ndimage

from pmcl.filtering.particle_filter import draw_paths, make_rng, run_filter
from pmcl.geometry import wrap
from pmcl.logs.arrays import LidarScans
from pmcl.logs.bags.read import read_bag
from pmcl.logs.robot_log import RobotLog
from pmcl.logs.wean import read_wean
from pmcl.maps.occupancy_grid import OccupancyGrid
from pmcl.maps.wean import read_wean_map
from pmcl.models.motions.odometry.motion import Differential
from pmcl.models.robot_model import RobotModel
from pmcl.models.sensors.lidar.sensor import Lidar
from pmcl.simulations.lidar_room import simulate_lidar_room

DATA = Path(os.environ.get("PMCL_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
LASERS = {
    "navigation": ("/driver_laser_navigation/laser_scan",),
    "security": ("/driver_laser_security/laser_scan",),
    "both": ("/driver_laser_navigation/laser_scan", "/driver_laser_security/laser_scan"),
}
PARTS = {"first": {"duration": 35.0}, "second": {"begin": 35.0}}


@functools.cache
def jarvis_map() -> OccupancyGrid:
    return OccupancyGrid.read(DATA / "jarvis" / "i-108_10mm.yaml")


@functools.cache
def jarvis(laser: str, part: str, max_beams: int | None = 60) -> RobotLog:
    """Return a part of the drive as the README's commands convert it; without `max_beams`, scans are whole."""
    return read_bag(
        DATA / "jarvis" / "jarvis_complex_path_fast.bag", scans=LASERS[laser], truth="/pose_ground_truth",
        truth_to_map=(14.617, 3.361, -0.033), truth_shift=0.09, grid_map=jarvis_map(), max_beams=max_beams,
        **PARTS[part],
    )  # fmt: skip


def with_scans(log: RobotLog, lidars: dict[str, LidarScans], **changes) -> RobotLog:
    """Return a log with other scans, and what else is changed."""
    settings = {
        "time": log.times, "odometry": log.odometry, "grid_map": log.grid_map, "start_mean": log.start_mean,
        "start_std": log.start_std, "true_poses": log.true_poses, "warn": False,
    }  # fmt: skip
    return RobotLog.build(**{**settings, "lidars": lidars, **changes})


def thinned_to(log: RobotLog, rays) -> RobotLog:
    """Return a log of one laser with some of its rays."""
    ((name, scans),) = log.lidars.items()
    some = LidarScans(scans.ranges[:, rays], scans.angles[rays], scans.min_range, scans.max_range, scans.pose)
    return with_scans(log, {name: some})


WEAN_ROWS = {"1": 160, "2": 150}
"""Rows of each Wean recording that are used. In the second one scans and map disagree from row 190 on, and smoothers
that begin with other random numbers end in different places."""


@functools.cache
def wean(number: str, max_beams: int | None = 60) -> RobotLog:
    """Return a recording in Wean Hall, cut to the rows that are used; its start is unknown."""
    grid = read_wean_map(DATA / "wean" / "wean.dat.gz")
    log = read_wean(DATA / "wean" / f"robotdata{number}.log", grid_map=grid, max_beams=max_beams)
    rows = slice(0, WEAN_ROWS[number])
    lidars = {
        name: LidarScans(each.ranges[rows], each.angles, each.min_range, each.max_range, each.pose)
        for name, each in log.lidars.items()
    }
    return with_scans(log, lidars, time=log.times[rows], odometry=log.odometry[rows])


RAYS_OF_FILTERS = 3
"""Filters read every third of Wean's 180 rays, from the first on; the reference reads the others."""


def smoothed(log: RobotLog, theta, particles: int, paths: int, seeds) -> np.ndarray:
    """Return paths out of the smoothing distribution by that seed whose filter explains the log best."""
    bound = log_model(log).bind(log)
    (tables,) = bound.tables(np.asarray(theta))
    best = None
    for seed in seeds:
        rng = make_rng(seed)
        run = run_filter(tables, log.n_steps, particles, rng)
        if best is None or run.log_evidence > best[0]:
            best = run.log_evidence, draw_paths(tables, run, paths, rng)
    return best[1]


def log_model(log: RobotLog) -> RobotModel:
    ((_, scans),) = log.lidars.items()
    beams = scans.angles.size
    # The reference reads twice as many beams as filters do, and a scan is worth twice as many independent ones.
    return RobotModel(Differential(), (Lidar(max_beams=beams, exponent=4.0 / beams),))


def wean_reference(number: str, particles: int = 20_000) -> tuple[np.ndarray, np.ndarray]:
    """Return means (T, 3) and covariances (T, 3, 3) of the path, smoothed over the whole log with the other rays.

    Numbers by judgement, for a robot whose noise is not known: alphas of 0.1 and 0.02, sigma_hit 0.15 m, z_rand 0.2.
    The start is found first, among all poses of the map; the path is then smoothed from a start within 1 m and 0.3 rad
    of that.
    """
    whole = wean(number, None)
    rays = [k for k in range(180) if k % RAYS_OF_FILTERS]
    log = thinned_to(whole, rays)
    theta = (0.1, 0.02, 0.1, 0.02, 0.15, 0.2)
    first = smoothed(log, theta, particles, 20, range(6))[:, 0]
    near = with_scans(log, log.lidars, start_mean=circular_mean(first), start_std=(1.0, 1.0, 0.3))
    paths = smoothed(near, theta, particles, 300, range(3))
    mean = np.array([circular_mean(paths[:, t]) for t in range(log.n_steps)])
    off = paths - mean
    off[..., 2] = wrap(off[..., 2])
    return mean, np.einsum("nti,ntj->tij", off, off) / len(paths)


def circular_mean(poses) -> np.ndarray:
    mean = poses.mean(axis=0)
    mean[2] = np.arctan2(np.sin(poses[:, 2]).mean(), np.cos(poses[:, 2]).mean())
    return mean


def room(kind: str, seed: int) -> RobotLog:
    """Return a simulated log of whole scans, in a room whose map is right or wrong.

    Each beam errs by itself, with 0.03 m. The wrong map has the walls where they are, but furniture was moved by some
    0.15 m, three boxes came in, and the room is 0.5 % longer than on the map.
    """
    log = simulate_lidar_room(100, seed, {"sigma_forward": 0.02, "sigma_left": 0.005, "sigma_turn": 0.02}, n_rays=180)
    ((name, scans),) = log.lidars.items()
    rng = np.random.default_rng([seed, 1])
    there = log.grid_map if kind == "right map" else changed(log.grid_map, log.true_poses, rng)
    beams = Lidar(model="beam", max_beams=scans.angles.size)
    # The simulation fills only as many rays as its own model reads.
    all_rays = LidarScans(np.ones_like(scans.ranges), scans.angles, scans.min_range, scans.max_range, scans.pose)
    table = beams.bind(with_scans(log, {name: all_rays}, grid_map=there)).table(np.array([0.03, 0.02, 0.01, 0.02, 0.5]))
    drawn = Lidar.simulate(table, log.true_poses, rng)
    made = LidarScans(drawn.reading, scans.angles, scans.min_range, scans.max_range, scans.pose)
    return with_scans(log, {name: made})


def changed(grid: OccupancyGrid, path, rng) -> OccupancyGrid:
    """Return a room with what stands in it moved, boxes that came in, and a longer side."""
    occupied = grid.cells == OccupancyGrid.OCCUPIED
    parts, number = ndimage.label(occupied, np.ones((3, 3)))
    # The part that reaches over the whole room is its walls, with what stands at them.
    spans = [np.ptp(np.nonzero(parts == k)[1]) for k in range(1, number + 1)]
    walls = 1 + int(np.argmax(spans))
    cells = parts == walls
    for k in range(1, number + 1):
        if k != walls:
            down, right = np.rint(rng.normal(0.0, 0.15 / grid.resolution, 2)).astype(int)
            cells |= np.roll(parts == k, (down, right), (0, 1))
    boxes = 0
    while boxes < 3:
        centre = rng.uniform((1.0, 1.0), (15.0, 11.0))
        if np.hypot(*(path[:, :2] - centre).T).min() > 0.8:
            column, row = np.floor(grid.to_cells(centre)).astype(int)
            cells[row - 4 : row + 5, column - 4 : column + 5] = True
            boxes += 1
    longer = OccupancyGrid(cells.astype(np.uint8), grid.resolution * 1.005, grid.origin)
    return longer


def rooms_log(kind: str, seed: int, max_beams: int | None = 60) -> RobotLog:
    """Return :func:`room` with as many rays as a filter reads, or whole."""
    log = room(kind, seed)
    return log if max_beams is None else thinned_to(log, np.arange(0, 180, 3))
