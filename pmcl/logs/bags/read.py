"""A bag as a robot log."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmcl.checks import check_choice, check_number
from pmcl.defaults import MAX_BEAMS, UPDATE_MIN_A, UPDATE_MIN_D, UPDATE_RULES
from pmcl.errors import LogError
from pmcl.geometry import compose
from pmcl.logs.amcl_rows import thinned
from pmcl.logs.bags.messages import Bag
from pmcl.logs.bags.streams import SCAN_STAMPS, Scans, Streams, read_streams
from pmcl.logs.bags.topics import POSES, choose_odometry, choose_scans, contents, laser_names, require
from pmcl.logs.bags.transforms import Edge, TransformTree
from pmcl.logs.clock import in_order
from pmcl.logs.lidar_recording import LidarRecording, LidarStream, RowSettings, log_of_lidars, usual_readings
from pmcl.logs.resample import interpolate_poses
from pmcl.logs.robot_log import RobotLog
from pmcl.logs.validation import fail
from pmcl.maps.occupancy_grid import OccupancyGrid

__all__ = ["read_bag"]

Float = NDArray[np.float64]

_ODOMETRY_FRAME = "odom"
# What the frame of a robot is called (ROS REP 105 and common practice), where its odometry does not say it.
_BASE_FRAMES = ("base_footprint", "base_link")
_MOST_FRAMES = 15


def read_bag(
    path: str | os.PathLike[str],
    *,
    scans: Sequence[str] = (),
    odometry: str | None = None,
    truth: str | None = None,
    truth_to_map: ArrayLike = (0.0, 0.0, 0.0),
    truth_shift: float = 0.0,
    grid_map: OccupancyGrid | None = None,
    update_min_d: float = UPDATE_MIN_D,
    update_min_a: float = UPDATE_MIN_A,
    update_rule: str = UPDATE_RULES[0],
    max_beams: int | None = MAX_BEAMS,
    scan_stamp: str = SCAN_STAMPS[0],
    begin: float = 0.0,
    duration: float | None = None,
    start: str | Sequence[float] | None = None,
) -> RobotLog:
    """Read scans and odometry of a ROS 1 bag, a ROS 2 folder (sqlite3 or MCAP) or an MCAP file.

    Each row of the log is a scan that AMCL would use (:func:`~pmcl.logs.amcl_rows.amcl_rows`). The robot's pose at a
    scan is interpolated between odometry poses at the time of the first ray: like AMCL, this takes a sweep for an
    instant. Times are those in the messages' headers, not those of recording.

    Parameters
    ----------
    path : path
        File or folder.
    scans : sequence of str, optional
        Topics of ``sensor_msgs/LaserScan``; the only one of the bag by default. Several lasers get the names in which
        their topics differ.
    odometry : str, optional
        A topic of ``nav_msgs/Odometry``, or a frame of tf whose child is the robot. By default the only such topic,
        else the frame ``odom``.
    truth : str, optional
        Reference trajectory of the robot's frame, for scoring only: a topic of poses or transforms, or a frame of tf.
        Nothing by default: a transform from ``map`` to ``odom`` is somebody's estimate.
    truth_to_map : array_like, shape (3,), optional
        Pose (x, y, yaw) [m, m, rad] of the reference's frame in the frame of the map.
    truth_shift : float, optional
        What is added to the stamps of the reference [s]: positive where they are early.
    grid_map : OccupancyGrid, optional
        The map.
    update_min_d, update_min_a, update_rule : optional
        Which scans become rows [m], [rad]; see :func:`~pmcl.logs.amcl_rows.amcl_rows`.
    max_beams : int or None, optional
        About how many rays of each scan to keep, see :func:`~pmcl.logs.amcl_rows.thinned`; None keeps all.
    scan_stamp : {"first", "last"}, optional
        Whether scans are stamped with the time of their first or of their last ray.
    begin, duration : float, optional
        Part of the recording [s], counted from the first scan that can be used.
    start : {"reference", "anywhere"} or three floats, optional
        Belief about the first pose, see :class:`~pmcl.logs.lidar_recording.RowSettings`.

    Returns
    -------
    RobotLog
        Variables ``scan`` and ``scan_angle``, or ``scan_NAME`` and ``scan_angle_NAME`` for several lasers. Attributes
        that begin with ``dropped_`` count what was left out.

    Raises
    ------
    LogError
        When the bag is damaged, holds no scans or odometry, or more than one of them and the choice is not stated; when
        no chain of constant transforms leads from the robot to a laser; and as
        :func:`~pmcl.logs.lidar_recording.log_of_lidars` raises it.
    MapError
        When the start lies outside the map.
    """
    where = os.fspath(path)
    check_choice("scan_stamp", scan_stamp, SCAN_STAMPS, error=LogError)
    thinned(1, max_beams)  # a wrong number is refused before the bag is read
    shift = check_number("truth_shift", truth_shift, unit="s", error=LogError, where=where)
    to_map = np.asarray(truth_to_map, dtype=np.float64)
    if to_map.shape != (3,) or not np.isfinite(to_map).all():
        fail(
            where,
            f"expected truth_to_map as three finite numbers X,Y,YAW [m, m, rad], got {to_map.tolist()}: correct it",
        )
    with Bag(path) as bag:
        topics = bag.topics
        of_truth = _truth_topic(bag, truth)
        of_scans = choose_scans(topics, scans, where)
        of_odometry = choose_odometry(topics, odometry, of_truth, where)
        streams = read_streams(bag, of_scans, of_odometry, of_truth, max_beams=max_beams, scan_stamp=scan_stamp)
    for topic in of_scans:
        if topic not in streams.scans:
            fail(where, f"expected messages in {topic}, got none: choose another with --scan; {contents(topics)}")
    frame, base, edge = _odometry(streams, of_odometry, odometry, where)
    lidars, n_others = _lidars(streams, of_scans, base, max_beams, where)
    odometry_times, odometry_poses = np.array(edge.times), edge.planar()
    truth_times, truth_poses = np.zeros(0), np.zeros((0, 3))
    if truth is not None:
        truth_times, truth_poses = _truth(
            streams, of_truth, truth, (frame, base), (odometry_times, odometry_poses), where
        )
        truth_times, truth_poses = truth_times + shift, compose(to_map, truth_poses)
    return log_of_lidars(
        LidarRecording(lidars, odometry_times, odometry_poses, truth_times, truth_poses),
        RowSettings(update_min_d, update_min_a, update_rule, begin, duration, start),
        grid_map=grid_map,
        robot=base,
        source=f"{Path(path).name}: {', '.join(of_scans)}, odometry {of_odometry or f'{frame} -> {base} in tf'}",
        dropped={
            "dropped_scans_of_another_shape": n_others,
            "dropped_messages_that_are_missing": bag.n_missing,
            "dropped_invalid_poses": streams.tree.n_invalid + streams.odometry.n_invalid + streams.truth.n_invalid,
        },
        time_zero=(streams.origin or 0) * 1e-9,
        where=where,
    )


def _truth_topic(bag: Bag, truth: str | None) -> str | None:
    """Return the topic of the reference trajectory; None where there is none, or where it is a frame of tf."""
    if truth is None or not (truth.startswith("/") or truth in bag.topics or f"/{truth}" in bag.topics):
        return None
    return require(bag.topics, truth, POSES, "--truth", bag.where)


def _odometry(streams: Streams, topic: str | None, asked: str | None, where: str) -> tuple[str, str, Edge]:
    """Find frame of the odometry, frame of the robot, and the poses between them."""
    if topic is not None:
        if not streams.odometry.edges:
            fail(where, f"expected valid poses in {topic}, got none: choose another with --odom")
        (frame, base), edge = max(streams.odometry.edges.items(), key=lambda item: len(item[1].times))
        if not base:
            known = streams.tree.frames()
            base = next((name for name in _BASE_FRAMES if name in known), _BASE_FRAMES[-1])
        return frame, base, edge
    tree = streams.tree
    wanted = (asked or _ODOMETRY_FRAME).lstrip("/")
    above = [set(tree.ancestors(scans.frame)) for scans in streams.scans.values()]
    found = [
        (parent, child)
        for parent, child in tree.edges
        if (parent == wanted or (asked is None and parent.endswith(f"/{wanted}")))
        and all(child in line for line in above)
    ]
    if len(found) != 1:
        lasers = ", ".join(f"'{scans.frame}'" for scans in streams.scans.values())
        fail(
            where,
            f"expected one transform in /tf from '{wanted}' to the robot that carries {lasers}, got {len(found)} "
            f"({_pairs(tree)}): state topic or frame of the odometry with --odom",
        )
    return *found[0], tree.edges[found[0]]


def _lidars(
    streams: Streams, topics: Sequence[str], base: str, max_beams: int | None, where: str
) -> tuple[tuple[LidarStream, ...], int]:
    """Put lasers on the robot; return them, and how many scans have another shape than the usual one."""
    names = laser_names(topics)
    lidars, n_others = [], 0
    for topic in topics:
        scans: Scans = streams.scans[topic]
        mount = streams.tree.mount(base, scans.frame, where, topic)
        times, ranges, angles, others = scans.of_usual_shape(max_beams, where)
        n_others += others
        lidars.append(
            LidarStream(
                names[topic],
                times,
                usual_readings(ranges, scans.min_range, scans.max_range),
                # Seen from above, the angles of a laser that hangs upside down run clockwise.
                -angles if mount.upside_down else angles,
                scans.min_range,
                scans.max_range,
                mount.pose,
            )
        )
    return tuple(lidars), n_others


def _truth(
    streams: Streams, topic: str | None, asked: str, frames: tuple[str, str], odometry: tuple[Float, Float], where: str
) -> tuple[Float, Float]:
    """Return times and poses of the reference trajectory, in its own frame."""
    if topic is not None:
        if not streams.truth.edges:
            fail(where, f"expected valid poses in {topic}, got none: choose another with --truth")
        edge: Any = max(streams.truth.edges.values(), key=lambda each: len(each.times))
        return np.array(edge.times), edge.planar()
    odometry_frame, base = frames
    edges, name = streams.tree.edges, asked.lstrip("/")
    if (name, base) in edges:
        edge = edges[name, base]
        return np.array(edge.times), edge.planar()
    if (name, odometry_frame) in edges:
        edge = edges[name, odometry_frame]
        kept, _ = in_order(np.array(edge.times))
        times, poses = odometry
        corrections = interpolate_poses(np.array(edge.times)[kept], edge.planar()[kept], times, np.inf)
        known = ~np.isnan(corrections[:, 0])
        return times[known], compose(corrections[known], poses[known])
    fail(
        where,
        f"expected --truth to name a topic, or a frame of tf above '{base}' or '{odometry_frame}', got {asked!r} "
        f"({_pairs(streams.tree)}): choose another",
    )


def _pairs(tree: TransformTree) -> str:
    pairs = [f"{parent} -> {child}" for parent, child in sorted(tree.edges)]
    more = f" and {len(pairs) - _MOST_FRAMES} more" * (len(pairs) > _MOST_FRAMES)
    return f"transforms: {', '.join(pairs[:_MOST_FRAMES])}{more}" if pairs else "there are no transforms"
