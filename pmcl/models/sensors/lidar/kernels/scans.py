"""The contract of the engine for :class:`~pmcl.models.sensors.lidar.table.LidarTable`.

Tables with extras differ only in the pose from which a scan is read: that of a late reading lies between two rows.
"""

from __future__ import annotations

import math

from pmcl.engine.compile import kernel
from pmcl.engine.contract import (
    has_reading,
    linear_information,
    looks_back,
    one_reading,
    path_reading_logpdf,
    reading_count,
    reading_exponent,
    reading_logpdf,
    reading_slots,
    scratch_rows,
)
from pmcl.engine.linear_readings import add_information
from pmcl.engine.tables import NoExtras
from pmcl.engine.vector_math import any_nonzero, sincos_into
from pmcl.models.sensors.lidar.kernels.beam import beam_below, beam_logpdf, expected_range
from pmcl.models.sensors.lidar.kernels.casting import WALL_DEPTH, cast_ray
from pmcl.models.sensors.lidar.kernels.field import add_end_points, level_at
from pmcl.models.sensors.lidar.table import BEAM, LidarExtras, LidarTable

# Rows of scratch space: sine and cosine of each heading in the grid's frame, where the robot is in cells, the sum of
# the log densities, and three rows each for the poses of late readings and for those of the row before.
_SINE, _COSINE, _COLUMN, _ROW, _TOTAL, _LATE, _BEFORE = 0, 1, 2, 3, 4, 5, 8
_ROWS = 11
# The grid of levels has a border of one cell, the grid of squares none.
_BORDER = 1.0


@scratch_rows.register(LidarTable)
def _scratch_rows(table):
    return _ROWS


@has_reading.register(LidarTable)
def _has_reading(sensor, t):
    return sensor.measured[t] > 0


@looks_back.register(LidarTable, NoExtras)
def _looks_back(sensor):
    return False


@looks_back.register(LidarTable, LidarExtras)
def _looks_back_with_lag(sensor):
    return any_nonzero(sensor.extras.lag)


@reading_exponent.register(LidarTable)
def _exponent(sensor):
    return sensor.exponent


@reading_count.register(LidarTable)
def _reading_count(sensor, n_steps):
    return n_steps * sensor.reading.shape[1]


@reading_slots.register(LidarTable)
def _reading_slots(sensor, t):
    return t * sensor.reading.shape[1], (t + 1) * sensor.reading.shape[1]


@kernel
def _place(sensor, pose, scratch):
    """Write where the grid has each `pose` (3, n) into the rows SINE, COSINE, COLUMN and ROW."""
    sine, cosine, column, row = scratch[_SINE], scratch[_COSINE], scratch[_COLUMN], scratch[_ROW]
    c0, s0 = math.cos(sensor.origin[2]), math.sin(sensor.origin[2])
    x0, y0, yaw = sensor.origin[0], sensor.origin[1], sensor.origin[2]
    per_cell = 1.0 / sensor.resolution
    for i in range(pose.shape[1]):
        row[i] = pose[2, i] - yaw
    sincos_into(row, sine, cosine)
    for i in range(pose.shape[1]):
        x, y = pose[0, i] - x0, pose[1, i] - y0
        column[i] = (c0 * x + s0 * y) * per_cell
        row[i] = (c0 * y - s0 * x) * per_cell


@kernel
def _mount(sensor, r):
    """Return where a ray begins on the robot, in cells, and cosine and sine of its direction there."""
    per_cell, yaw = 1.0 / sensor.resolution, sensor.beam_pose[r, 2]
    return sensor.beam_pose[r, 0] * per_cell, sensor.beam_pose[r, 1] * per_cell, math.cos(yaw), math.sin(yaw)


@kernel
def _expected(sensor, r, mount, i, scratch):
    """Return what a hit of ray r, mounted as :func:`_mount` says, should read from the i-th place [m]."""
    c, s = scratch[_COSINE, i], scratch[_SINE, i]
    x, y, cosine, sine = mount
    length = cast_ray(
        sensor.squares, scratch[_COLUMN, i] + c * x - s * y, scratch[_ROW, i] + s * x + c * y,
        c * cosine - s * sine, s * cosine + c * sine, sensor.max_range[r] / sensor.resolution,
    )  # fmt: skip
    return expected_range(
        (length + WALL_DEPTH) * sensor.resolution, sensor.scale[r], sensor.bias[r], sensor.max_range[r]
    )


@kernel
def _end_point(sensor, r, z):
    """Return where a reading ends in the robot's frame, in cells."""
    per_cell = 1.0 / sensor.resolution
    length, yaw = (z - sensor.bias[r]) / sensor.scale[r], sensor.beam_pose[r, 2]
    u = (sensor.beam_pose[r, 0] + length * math.cos(yaw)) * per_cell
    return u, (sensor.beam_pose[r, 1] + length * math.sin(yaw)) * per_cell


@kernel
def _beam_logpdf(sensor, r, z, expected):
    return beam_logpdf(
        z, expected, sensor.max_range[r], sensor.std[r], sensor.z_hit, sensor.z_short, sensor.z_max, sensor.z_rand,
        sensor.lambda_short,
    )  # fmt: skip


@kernel
def _add_scan(sensor, t, pose, logp, scratch):
    """Add the log density of the scan at row t from each `pose` (3, n)."""
    _place(sensor, pose, scratch)
    total = scratch[_TOTAL]
    # A pose that is no number has no density, wherever its readings seem to end.
    for i in range(logp.size):
        total[i] = 0.0 * (pose[0, i] + pose[1, i] + pose[2, i])
    if sensor.model == BEAM:
        for r in range(sensor.reading.shape[1]):
            z = sensor.reading[t, r]
            if math.isnan(z):
                continue
            mount = _mount(sensor, r)
            for i in range(logp.size):
                total[i] += _beam_logpdf(sensor, r, z, _expected(sensor, r, mount, i, scratch))
    else:
        column, row = scratch[_COLUMN], scratch[_ROW]
        for i in range(logp.size):
            column[i] += _BORDER
            row[i] += _BORDER
        for r in range(sensor.reading.shape[1]):
            z = sensor.reading[t, r]
            if not z < sensor.max_range[r]:
                continue
            u, v = _end_point(sensor, r, z)
            add_end_points(
                sensor.levels, sensor.level_log_density[sensor.laser[r]], u, v, column, row, scratch[_SINE],
                scratch[_COSINE], total,
            )  # fmt: skip
    for i in range(logp.size):
        logp[i] += sensor.exponent * total[i]


@kernel
def _add_path(sensor, n_steps, pose, logp, scratch):
    """Add the log density of each row's scan from the pose of that row in `pose` (3, T)."""
    _place(sensor, pose, scratch)
    total = scratch[_TOTAL]
    column, row, sine, cosine = scratch[_COLUMN], scratch[_ROW], scratch[_SINE], scratch[_COSINE]
    for t in range(n_steps):
        total[t] = 0.0
    for r in range(sensor.reading.shape[1]):
        if sensor.model == BEAM:
            mount = _mount(sensor, r)
            for t in range(n_steps):
                z = sensor.reading[t, r]
                if not math.isnan(z):
                    total[t] += _beam_logpdf(sensor, r, z, _expected(sensor, r, mount, t, scratch))
            continue
        begin_u, begin_v = _end_point(sensor, r, 0.0)
        end_u, end_v = _end_point(sensor, r, 1.0)
        log_density = sensor.level_log_density[sensor.laser[r]]
        for t in range(n_steps):
            z = sensor.reading[t, r]
            if z < sensor.max_range[r]:
                u, v = begin_u + z * (end_u - begin_u), begin_v + z * (end_v - begin_v)
                x = column[t] + cosine[t] * u - sine[t] * v + _BORDER
                y = row[t] + sine[t] * u + cosine[t] * v + _BORDER
                total[t] += log_density[level_at(sensor.levels, x, y)]
    for t in range(n_steps):
        logp[t] += sensor.exponent * total[t]


@kernel
def _late_poses(sensor, first, stride, previous, current, pose):
    """Write the pose from which the scan of row ``first + stride * i`` was read into column i."""
    for d in range(3):
        for i in range(current.shape[1]):
            pose[d, i] = current[d, i] - sensor.extras.lag[first + stride * i] * (current[d, i] - previous[d, i])


@reading_logpdf.register(LidarTable, NoExtras)
def _reading_logpdf(sensor, t, previous, current, logp, scratch):
    _add_scan(sensor, t, current, logp, scratch)


@reading_logpdf.register(LidarTable, LidarExtras)
def _late_reading_logpdf(sensor, t, previous, current, logp, scratch):
    pose = scratch[_LATE : _LATE + 3]
    _late_poses(sensor, t, 0, previous, current, pose)
    _add_scan(sensor, t, pose, logp, scratch)


@path_reading_logpdf.register(LidarTable, NoExtras)
def _path_reading_logpdf(sensor, n_steps, path, logp, scratch):
    _add_path(sensor, n_steps, path, logp, scratch)


@path_reading_logpdf.register(LidarTable, LidarExtras)
def _late_path_reading_logpdf(sensor, n_steps, path, logp, scratch):
    previous, pose = scratch[_BEFORE : _BEFORE + 3], scratch[_LATE : _LATE + 3]
    for d in range(3):
        previous[d, 0] = path[d, 0]
        for t in range(1, n_steps):
            previous[d, t] = path[d, t - 1]
    _late_poses(sensor, 0, 1, previous, path, pose)
    _add_path(sensor, n_steps, pose, logp, scratch)


@kernel
def _one_of_beam(sensor, r, z, logp, low, high, scratch):
    mount = _mount(sensor, r)
    for i in range(logp.size):
        expected = _expected(sensor, r, mount, i, scratch)
        logp[i] = _beam_logpdf(sensor, r, z, expected)
        low[i], high[i] = beam_below(
            z, expected, sensor.max_range[r], sensor.std[r], sensor.z_hit, sensor.z_short, sensor.z_max, sensor.z_rand,
            sensor.lambda_short,
        )  # fmt: skip


@kernel
def _level_of(sensor, r, z, i, scratch):
    """Return the level at which a reading of ray r ends from the i-th place."""
    u, v = _end_point(sensor, r, z)
    c, s = scratch[_COSINE, i], scratch[_SINE, i]
    x = scratch[_COLUMN, i] + c * u - s * v + _BORDER
    return level_at(sensor.levels, x, scratch[_ROW, i] + s * u + c * v + _BORDER)


@kernel
def _one_of_field(sensor, r, z, logp, low, high, scratch):
    """Do the same for a likelihood field: see :class:`~pmcl.models.sensors.lidar.sensor.Lidar` for its distribution."""
    log_density, half = sensor.level_log_density[sensor.laser[r]], 0.5 * sensor.resolution
    # A reading's place within its cells is uniform, and adds to the scatter of its distance.
    per_std = math.sqrt(0.5 / (sensor.std[r] ** 2 + sensor.resolution**2 / 12.0))
    mount = _mount(sensor, r)
    unrelated = sensor.z_rand * z / sensor.max_range[r]
    for i in range(logp.size):
        level = _level_of(sensor, r, z, i, scratch)
        logp[i] = log_density[level]
        expected = _expected(sensor, r, mount, i, scratch)
        if z > expected:
            # As far behind the wall as its mirror image is before it: what the map has behind a wall does not count.
            mirrored = max(2.0 * expected - z, 0.0)
            distance = sensor.level_distance[_level_of(sensor, r, mirrored, i, scratch)]
        else:
            distance = -sensor.level_distance[level]
        low[i] = sensor.z_hit * 0.5 * math.erfc(-(distance - half) * per_std) + unrelated
        high[i] = sensor.z_hit * 0.5 * math.erfc(-(distance + half) * per_std) + unrelated


@kernel
def _one_of_either(sensor, t, slot, pose, logp, low, high, scratch):
    r = slot - t * sensor.reading.shape[1]
    if r == 0:
        _place(sensor, pose, scratch)
    z = sensor.reading[t, r]
    if math.isnan(z) or (sensor.model != BEAM and z >= sensor.max_range[r]):
        return False
    if sensor.model == BEAM:
        _one_of_beam(sensor, r, z, logp, low, high, scratch)
    else:
        _one_of_field(sensor, r, z, logp, low, high, scratch)
    return True


@one_reading.register(LidarTable, NoExtras)
def _one_reading(sensor, t, slot, previous, current, logp, low, high, memory, scratch):
    return _one_of_either(sensor, t, slot, current, logp, low, high, scratch)


@one_reading.register(LidarTable, LidarExtras)
def _one_late_reading(sensor, t, slot, previous, current, logp, low, high, memory, scratch):
    pose = scratch[_LATE : _LATE + 3]
    if slot == t * sensor.reading.shape[1]:
        _late_poses(sensor, t, 0, previous, current, pose)
    return _one_of_either(sensor, t, slot, pose, logp, low, high, scratch)


@kernel
def _add_linear(sensor, linear, k, lag, precision, shift):
    """Add one linearised reading: its residual along the ray (beam model) or along the wall's normal (field)."""
    r = linear.channel[k]
    scale, bias = sensor.scale[r], sensor.bias[r]
    length = linear.value[k] - lag * linear.velocity[k]
    weight = sensor.exponent * linear.weight[k] / sensor.std[r] ** 2
    if sensor.model == BEAM:
        residual = linear.reading[k] - (scale * length + bias)
        add_information(linear.jacobian, k, scale, weight, residual, precision, shift)
    else:
        cosine = linear.cosine[k]
        residual = cosine * ((linear.reading[k] - bias) / scale - length)
        add_information(linear.jacobian, k, cosine, weight, residual, precision, shift)


@linear_information.register(LidarTable, NoExtras)
def _linear_information(sensor, linear, t, precision, shift):
    for k in range(linear.first[t], linear.first[t + 1]):
        _add_linear(sensor, linear, k, 0.0, precision, shift)


@linear_information.register(LidarTable, LidarExtras)
def _late_linear_information(sensor, linear, t, precision, shift):
    for k in range(linear.first[t], linear.first[t + 1]):
        _add_linear(sensor, linear, k, sensor.extras.lag[t], precision, shift)
