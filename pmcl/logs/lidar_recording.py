"""A recording of scans and odometry, and its conversion to a robot log whose rows are scans."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.defaults import UPDATE_MIN_A, UPDATE_MIN_D, UPDATE_RULES
from pmcl.geometry import between
from pmcl.logs.amcl_rows import amcl_rows
from pmcl.logs.arrays import LidarScans
from pmcl.logs.clock import in_order
from pmcl.logs.odometry import LONGEST_PAUSE
from pmcl.logs.recording import REFERENCE_START_STD
from pmcl.logs.resample import interpolate_poses
from pmcl.logs.robot_log import RobotLog
from pmcl.logs.schema import MOST_NUMBERS
from pmcl.logs.validation import fail
from pmcl.maps.occupancy_grid import OccupancyGrid

__all__ = [
    "LidarRecording",
    "LidarStream",
    "RowSettings",
    "log_of_lidars",
    "require_few_readings",
    "usual_readings",
]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# Readings of all scans that are kept while a recording is read. They take 0.2 to 0.4 GB, and 0.9 GB while scans become
# rows. A laser of 1440 rays at 10 Hz makes as many in an hour; with 60 rays of each scan they last for a day.
_MOST_READINGS = 50_000_000
# Clocks of one recording that mean the same instant differ by rounding only [s].
_SAME_INSTANT = 1e-6


class LidarStream(NamedTuple):
    """The scans of one laser.

    Attributes
    ----------
    name : str
        Its name in the log; empty when there is only one.
    times : ndarray, shape (N,)
        When each scan began [s], in the order of recording.
    ranges : ndarray, shape (N, R)
        Ranges [m] in the convention of logs: NaN not measured, inf no echo.
    angles : ndarray, shape (R,)
        Angle of each ray in the laser's frame, counter-clockwise [rad].
    min_range, max_range : float
        Limits of the readings [m].
    mount : ndarray, shape (3,)
        Where the laser sits on the robot [m, m, rad].
    poses : ndarray, shape (N, 3), or None
        Pose of the robot at each scan in the odometry's fixed frame [m, m, rad], where the recording states it; else
        the odometry is interpolated.
    """

    name: str
    times: Float
    ranges: NDArray[Any]
    angles: Float
    min_range: float
    max_range: float
    mount: Float
    poses: Float | None = None


class LidarRecording(NamedTuple):
    """Scans, odometry and reference poses, each with its own clock.

    Attributes
    ----------
    lidars : tuple of LidarStream
        One or more lasers.
    odometry_times, odometry_poses : ndarray, shapes (N,) and (N, 3)
        Poses that odometry integrated in its fixed frame [s; m, m, rad], in the order of recording.
    truth_times, truth_poses : ndarray, shapes (M,) and (M, 3)
        Reference poses of the robot in the frame of the map [s; m, m, rad]; M = 0 when there are none.
    """

    lidars: tuple[LidarStream, ...]
    odometry_times: Float
    odometry_poses: Float
    truth_times: Float
    truth_poses: Float


class RowSettings(NamedTuple):
    """Which scans become rows, and what is believed about the first pose.

    Attributes
    ----------
    update_min_d, update_min_a, update_rule
        As :func:`~pmcl.logs.amcl_rows.amcl_rows` takes them [m], [rad].
    begin, duration : float, float or None
        Part of the recording [s], from the first usable scan on; None for all that is there.
    start : {"reference", "anywhere"}, three floats, or None
        The first reference pose, nothing, or a pose in the map's frame [m, m, rad]; poses are believed within
        :data:`~pmcl.logs.recording.REFERENCE_START_STD`. None is "reference" where there are reference poses, else
        "anywhere".
    """

    update_min_d: float = UPDATE_MIN_D
    update_min_a: float = UPDATE_MIN_A
    update_rule: str = UPDATE_RULES[0]
    begin: float = 0.0
    duration: float | None = None
    start: str | Sequence[float] | None = None


def usual_readings(ranges: NDArray[Any], min_range: float, max_range: float) -> NDArray[Any]:
    """Bring ranges into the convention of logs, as nav2's AMCL reads them.

    Parameters
    ----------
    ranges : ndarray
        Ranges as the driver wrote them [m].
    min_range, max_range : float
        Limits that the driver states [m].

    Returns
    -------
    ndarray
        NaN stays (not measured). Readings of at least `max_range` become inf (no echo). So do readings of at most
        `min_range`, zero and -inf among them: nav2's ``amcl_node.cpp`` maps them to the greatest range, and many
        drivers write zero where nothing came back.
    """
    with np.errstate(invalid="ignore"):
        return np.where((ranges <= min_range) | (ranges >= max_range), ranges.dtype.type(np.inf), ranges)


def require_few_readings(count: int, where: str) -> None:
    """Check that the readings that are kept of a recording fit into memory.

    Parameters
    ----------
    count : int
        How many there are so far.
    where : str
        File, for messages.

    Raises
    ------
    LogError
        When there are too many.
    """
    if count > _MOST_READINGS:
        fail(
            where,
            f"expected at most {_MOST_READINGS} readings, got more: choose a smaller --max-beams, or cut the "
            "recording into parts",
        )


@dataclass(frozen=True)
class _Scans:
    """Scans of all lasers: when they were taken, by which laser, their place in its stream, and the robot's pose."""

    times: Float
    laser: Int
    place: Int
    poses: Float

    def __getitem__(self, chosen: Any) -> _Scans:
        return _Scans(self.times[chosen], self.laser[chosen], self.place[chosen], self.poses[chosen])


def log_of_lidars(
    recording: LidarRecording,
    rows: RowSettings,
    *,
    grid_map: OccupancyGrid | None,
    robot: str,
    source: str,
    dropped: Mapping[str, int],
    time_zero: float = 0.0,
    where: str,
) -> RobotLog:
    """Make a log with one row for each scan that AMCL would use.

    The time of a row is that of its scan, and the robot's pose there is interpolated between odometry poses. Scans of
    two lasers at the same instant share a row; else each scan has its own, in which the other lasers have no readings.

    Parameters
    ----------
    recording : LidarRecording
        What was recorded.
    rows : RowSettings
        Which scans become rows.
    grid_map : OccupancyGrid or None
        The map.
    robot, source : str
        What moved, and where the data come from.
    dropped : mapping
        Numbers of what the reader left out already, as attributes of the log.
    time_zero : float, optional
        Time zero of the streams on the recording's clock [s].
    where : str
        File, for messages.

    Returns
    -------
    RobotLog
        With ``true_pose`` where there are reference poses, and attributes ``time_origin``, ``update_min_d``,
        ``update_min_a``, ``update_rule`` and the numbers of scans left out.

    Raises
    ------
    LogError
        When a setting is out of range, no scan has odometry, fewer than two rows or too many readings remain, or the
        start has no reference.
    MapError
        When the start lies outside the map.
    """
    _check(rows, where)
    clock, odometry, jumped_odometry = _sorted(recording.odometry_times, recording.odometry_poses)
    if len(clock) < 2:
        fail(where, f"expected at least two odometry poses, got {len(clock)}: check the recording")
    true_clock, truth, jumped_truth = _sorted(recording.truth_times, recording.truth_poses)
    start = rows.start if rows.start is not None else ("reference" if len(true_clock) else "anywhere")
    if start == "reference" and not len(true_clock):
        fail(where, "expected reference poses for start = 'reference', got none: state a pose, or 'anywhere'")
    scans, counts = _usable(recording.lidars, clock, odometry, where)
    counts["dropped_clock_jumps"] += jumped_odometry + jumped_truth
    if start == "reference":
        known = ~np.isnan(interpolate_poses(true_clock, truth, scans.times, LONGEST_PAUSE)[:, 0])
        if not known.any():
            fail(
                where,
                f"expected reference poses while scans were taken ({_span(scans.times)}), got them "
                f"{_span(true_clock)}: check that both use one clock",
            )
        first = int(np.argmax(known))
        counts["dropped_scans_before_reference"] = first
        scans = scans[first:]
    origin = float(scans.times[0])
    end = math.inf if rows.duration is None else rows.begin + rows.duration
    inside = (scans.times - origin >= rows.begin) & (scans.times - origin <= end)
    scans = scans[inside]
    if len(scans.times):
        used = amcl_rows(scans.poses, rows.update_min_d, rows.update_min_a, rows.update_rule, laser=scans.laser)
        scans = scans[used]
    row = np.cumsum(np.append(True, np.diff(scans.times) > _SAME_INSTANT)) - 1 if len(scans.times) else np.zeros(0)
    if len(row) == 0 or row[-1] < 1:
        fail(
            where,
            f"expected at least two scans to use, got {len(row)} of {len(inside)}, of which {inside.sum()} lie in "
            "the part chosen: choose a longer part, or smaller update_min_d and update_min_a if the robot hardly moved",
        )
    heads = np.flatnonzero(np.append(True, np.diff(row) > 0))
    times, poses = scans.times[heads], scans.poses[heads]
    n_readings = len(times) * sum(len(lidar.angles) for lidar in recording.lidars)
    if n_readings > MOST_NUMBERS:
        fail(
            where,
            f"expected at most {MOST_NUMBERS} readings in a log, got {n_readings} in {len(times)} rows: "
            "choose a smaller --max-beams, a greater --update-min-d, or a shorter --duration",
        )
    increments = np.zeros((len(times), 3))
    increments[1:] = between(poses[:-1], poses[1:])
    true_poses = interpolate_poses(true_clock, truth, times, LONGEST_PAUSE) if len(true_clock) else None
    mean, std = _start(start, true_poses, rows.begin, where)
    lidars = {}
    for k, lidar in enumerate(recording.lidars):
        mine = scans.laser == k
        table = np.full((len(times), len(lidar.angles)), np.nan)
        table[row[mine]] = lidar.ranges[scans.place[mine]]
        lidars[lidar.name] = LidarScans(table, lidar.angles, lidar.min_range, lidar.max_range, lidar.mount)
    settings = {name: getattr(rows, name) for name in ("update_min_d", "update_min_a", "update_rule")}
    return RobotLog.build(
        time=times - origin,
        odometry=increments,
        lidars=lidars,
        start_mean=mean,
        start_std=std,
        true_poses=true_poses,
        robot=robot,
        source=source,
        grid_map=grid_map,
        attributes={**settings, "time_origin": time_zero + origin, **dropped, **counts},
        where=where,
    )


def _check(rows: RowSettings, where: str) -> None:
    if isinstance(rows.start, str) and rows.start not in ("reference", "anywhere"):
        fail(where, f"expected start = 'reference', 'anywhere' or three numbers, got {rows.start!r}: choose one")
    for name, value, allowed in (
        ("update_min_d", rows.update_min_d, 0.0 <= rows.update_min_d < math.inf),
        ("update_min_a", rows.update_min_a, 0.0 <= rows.update_min_a < math.inf),
        ("begin", rows.begin, 0.0 <= rows.begin < math.inf),
        ("duration", rows.duration, rows.duration is None or 0.0 < rows.duration < math.inf),
    ):
        if not allowed:
            bound = "> 0" if name == "duration" else ">= 0"
            unit = {"update_min_d": "m", "update_min_a": "rad"}.get(name, "s")
            fail(where, f"expected {name} {bound} [{unit}], got {value}: choose another")


def _sorted(times: Float, poses: Float) -> tuple[Float, Float, int]:
    kept, jumped = in_order(times)
    return times[kept], poses[kept], jumped


def _usable(lidars: Sequence[LidarStream], clock: Float, odometry: Float, where: str) -> tuple[_Scans, dict[str, int]]:
    """Find the scans that follow the clock and have odometry, in order of time, and count the others."""
    counts = {"dropped_clock_jumps": 0, "dropped_scans_with_repeated_stamps": 0, "dropped_scans_without_odometry": 0}
    parts: list[_Scans] = []
    for k, lidar in enumerate(lidars):
        kept, jumped = in_order(lidar.times)
        counts["dropped_clock_jumps"] += jumped
        counts["dropped_scans_with_repeated_stamps"] += len(lidar.times) - jumped - len(kept)
        times = lidar.times[kept]
        if lidar.poses is not None:
            poses = lidar.poses[kept]
        else:
            poses = interpolate_poses(clock, odometry, times, LONGEST_PAUSE)
        known = ~np.isnan(poses[:, 0])
        counts["dropped_scans_without_odometry"] += int((~known).sum())
        index = kept[known]
        parts.append(_Scans(times[known], np.full(len(index), k), index, poses[known]))
    joined = _Scans(
        np.concatenate([part.times for part in parts]),
        np.concatenate([part.laser for part in parts]),
        np.concatenate([part.place for part in parts]),
        np.concatenate([part.poses for part in parts]),
    )
    if not len(joined.times):
        all_times = np.concatenate([lidar.times for lidar in lidars])
        fail(
            where,
            f"expected odometry while scans were taken ({_span(all_times)}), got it {_span(clock)}: check that both "
            "were recorded together and use one clock",
        )
    order = np.lexsort((joined.laser, joined.times))
    return joined[order], counts


def _span(times: Float) -> str:
    return f"from {times.min():.9g} s to {times.max():.9g} s" if len(times) else "never"


def _start(start: str | Sequence[float], true_poses: Float | None, begin: float, where: str) -> tuple[Float, Float]:
    if isinstance(start, str):
        if start == "anywhere":
            return np.zeros(3), np.full(3, np.inf)
        if true_poses is None or np.isnan(true_poses[0]).any():
            fail(
                where,
                f"expected a reference pose at {begin:g} s for start = 'reference', got none: "
                "choose another begin, or start = 'anywhere'",
            )
        return true_poses[0], np.array(REFERENCE_START_STD)
    mean = np.asarray(start, dtype=np.float64)
    if mean.shape != (3,) or not np.isfinite(mean).all():
        fail(where, f"expected start as three finite numbers X,Y,YAW [m, m, rad], got {start}: correct it")
    return mean, np.array(REFERENCE_START_STD)
