"""The mistakes that people make in writing a log, each applied to a sound one."""

from __future__ import annotations

import numpy as np

from pmcl.geometry import compose, wrap
from pmcl.logs.robot_log import RobotLog


def changed(log, **changes):
    """The same log with other values, by variable name; a dict gives attributes."""
    dataset = log.dataset.copy(deep=True)
    for name, value in changes.items():
        if name == "max_range":
            dataset["range"].attrs["max_range"] = value
        else:
            dataset[name] = (dataset[name].dims, np.asarray(value, dtype=float), dataset[name].attrs)
    return RobotLog.from_dataset(dataset, "log with a mistake")


def retimed(log, period):
    return changed(log, time=period * np.arange(log.n_steps))


def bearings_in_degrees(log):
    # Only those that a landmark nearly ahead gives stay within one turn; the others are NaN.
    degrees = np.degrees(log.landmark_bearing)
    degrees = np.where(np.abs(degrees) <= 2 * np.pi, degrees, np.nan)
    seen = ~np.isnan(degrees)
    other = {
        name: np.where(seen, log.dataset[name].values, np.nan)
        for name in ("landmark_range", "landmark_size")
        if name in log.dataset
    }
    return changed(log, landmark_bearing=degrees, **other)


def bearings_in_world_frame(log):
    return changed(log, landmark_bearing=wrap(log.landmark_bearing + log.true_poses[:, 2:3]))


def bearing_sign_flipped(log):
    return changed(log, landmark_bearing=-log.landmark_bearing)


def with_odometry(log, odometry):
    return changed(log, odometry=odometry)


def velocities(log):
    """Velocities in place of increments, of a robot whose rows are 0.2 s apart (or as far as they are)."""
    period = np.diff(log.times, prepend=log.times[0] - 1.0)
    if abs(np.median(period) - 1.0) < 0.1:
        log = retimed(log, 0.2)
        period = np.full(log.n_steps, 0.2)
    return with_odometry(log, log.odometry / period[:, None])


def turns_in_degrees(log):
    return with_odometry(log, log.odometry * (1.0, 1.0, 180.0 / np.pi))


def turn_sign_flipped(log):
    return with_odometry(log, log.odometry * (1.0, 1.0, -1.0))


def poses_as_increments(log):
    pose, poses = np.zeros(3), []
    for increment in log.odometry:
        pose = compose(pose, increment)
        poses.append(pose)
    return with_odometry(log, poses)


def columns_swapped(log):
    return with_odometry(log, log.odometry[:, [1, 0, 2]])


def turn_first(log):
    return with_odometry(log, log.odometry[:, [2, 0, 1]])


def odometry_along_map(log):
    odometry = log.odometry.copy()
    heading = np.concatenate(([log.start_mean[2]], log.start_mean[2] + np.cumsum(odometry[1:, 2])))[:-1]
    c, s = np.cos(heading), np.sin(heading)
    forward, left = odometry[1:, 0].copy(), odometry[1:, 1].copy()
    odometry[1:, 0], odometry[1:, 1] = c * forward - s * left, s * forward + c * left
    return with_odometry(log, odometry)


def odometry_zero(log):
    return with_odometry(log, np.zeros_like(log.odometry))


def odometry_of_another_drive(log):
    return with_odometry(log, log.odometry[::-1])


def odometry_tiny(log):
    return with_odometry(log, 1e-3 * log.odometry)


def ranges_in_millimetres(log):
    if log.ranges is not None:
        return changed(log, range=1000.0 * log.ranges, max_range=1000.0 * log.max_range)
    return changed(log, landmark_range=1000.0 * log.landmark_range)


def ranges_in_millimetres_max_range_in_metres(log):
    return changed(log, range=1000.0 * log.ranges)


def ranges_in_centimetres(log):
    if log.ranges is not None:
        return changed(log, range=100.0 * log.ranges, max_range=100.0 * log.max_range)
    return changed(log, landmark_range=100.0 * log.landmark_range)


def max_range_in_millimetres(log):
    return changed(log, max_range=1000.0 * log.max_range)


def map_of(log):
    return "wall" if log.walls is not None else "landmark_position"


def with_map(log, change):
    return changed(log, **{map_of(log): change(log.dataset[map_of(log)].values)})


def map_mirrored(log):
    """Flipped upside down within its own bounds, as pictures are; the start stays."""

    def flip(points):
        return np.stack((points[..., 0], points[..., 1].min() + points[..., 1].max() - points[..., 1]), axis=-1)

    return with_map(log, flip)


def y_axis_flipped(log):
    return with_map(log, lambda points: points * (1.0, -1.0))


def map_in_millimetres(log):
    return with_map(log, lambda points: 1000.0 * points)


def map_in_centimetres(log):
    return with_map(log, lambda points: 100.0 * points)


def yaws_in_degrees(log):
    """Degrees of a sensor whose beams all look within six degrees of straight ahead."""
    poses = log.beam_poses.copy()
    poses[:, 2] = np.degrees(poses[:, 2])
    return changed(log, beam_pose=poses)


def yaws_flipped(log):
    return changed(log, beam_pose=log.beam_poses * (1.0, 1.0, -1.0))


def yaws_as_indices(log):
    poses = log.beam_poses[:6].copy()
    poses[:, 2] = np.arange(len(poses))
    dataset = log.dataset.isel(beam=slice(0, len(poses)))
    return changed(RobotLog.from_dataset(dataset), beam_pose=poses)


def zeros_for_not_seen(log):
    readings = ("landmark_range", "landmark_bearing", "landmark_size")
    return changed(
        log, **{name: np.nan_to_num(log.dataset[name].values, nan=0.0) for name in readings if name in log.dataset}
    )


def zeros_for_not_measured(log):
    rng = np.random.default_rng(log.n_steps)
    return changed(log, range=np.where(rng.random(log.ranges.shape) < 0.2, 0.0, log.ranges))


def nanoseconds(log):
    return changed(log, time=1e9 * log.times)


def milliseconds(log):
    return changed(log, time=1e3 * log.times)


def stuck_sensor(log):
    """The last 40 % of one channel's readings are the one before them."""
    name = "range" if log.ranges is not None else "landmark_bearing"
    values = log.dataset[name].values.copy()
    column = int(np.argmax((~np.isnan(values)).sum(axis=0)))
    rows = np.flatnonzero(~np.isnan(values[:, column]))
    stuck = rows[int(0.6 * rows.size) :]
    values[stuck, column] = values[stuck[0], column]
    return changed(log, **{name: values})


def stale_readings(log):
    """Every reading of an even row is written again in the row after it."""
    names = [name for name in ("range", "landmark_range", "landmark_bearing", "landmark_size") if name in log.dataset]
    out = {}
    for name in names:
        values = log.dataset[name].values.copy()
        values[1::2] = values[: 2 * (len(values) // 2) : 2]
        out[name] = values
    return changed(log, **out)


def all_at_max_range(log):
    return changed(log, range=np.full_like(log.ranges, log.max_range))


ODOMETRY = {
    "velocities-as-increments": velocities,
    "turns-in-degrees": turns_in_degrees,
    "turn-sign-flipped": turn_sign_flipped,
    "poses-as-increments": poses_as_increments,
    "odometry-columns-swapped": columns_swapped,
    "odometry-columns-swapped (turn first)": turn_first,
    "odometry-in-world-frame": odometry_along_map,
    "odometry-disagrees (zero)": odometry_zero,
    "odometry-disagrees (tiny)": odometry_tiny,
    "odometry-disagrees (another drive)": odometry_of_another_drive,
}
MAP = {
    "map-mirrored": map_mirrored,
    "map-mirrored (y axis)": y_axis_flipped,
    "map-in-millimetres": map_in_millimetres,
    "map-in-centimetres": map_in_centimetres,
}
TIMES = {"times-in-nanoseconds": nanoseconds, "times-in-milliseconds": milliseconds}
ANY_SENSOR = {"stuck-sensor": stuck_sensor, "stale-readings": stale_readings}
BEARINGS = {
    "bearings-in-degrees": bearings_in_degrees,
    "bearings-in-world-frame": bearings_in_world_frame,
    "bearing-sign-flipped": bearing_sign_flipped,
    "zero-for-not-seen": zeros_for_not_seen,
}
RANGES = {"ranges-in-millimetres": ranges_in_millimetres, "ranges-in-centimetres": ranges_in_centimetres}
BEAMS = {
    "ranges-in-millimetres (max_range in m)": ranges_in_millimetres_max_range_in_metres,
    "max-range-too-long": max_range_in_millimetres,
    "beam-yaw-sign-flipped": yaws_flipped,
    "beam-yaws-are-indices": yaws_as_indices,
    "zero-for-not-measured": zeros_for_not_measured,
    "all-at-max-range": all_at_max_range,
}


def mistakes_of(log):
    """Name of the finding (with a note in brackets) to mistake, for those that can be made in a log."""
    found = {**ODOMETRY, **TIMES, **ANY_SENSOR, **MAP}
    if log.ranges is not None:
        found |= RANGES | BEAMS
    if log.landmark_range is not None:
        found |= RANGES
    if log.landmark_bearing is not None:
        found |= BEARINGS
    return found
