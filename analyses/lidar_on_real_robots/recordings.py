"""The logs of this folder: Jarvis in two parts, Wean Hall twice, and simulated rooms whose maps are wrong."""

from __future__ import annotations

import functools
import os
from pathlib import Path

import numpy as np

from pmcl.logs.arrays import LidarScans
from pmcl.logs.bags.read import read_bag
from pmcl.logs.robot_log import RobotLog
from pmcl.maps.occupancy_grid import OccupancyGrid

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
