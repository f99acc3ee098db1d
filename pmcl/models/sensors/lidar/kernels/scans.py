"""The contract of the engine for :class:`~pmcl.models.sensors.lidar.table.LidarTable`.

Tables with extras differ in the pose from which a scan is read, since that of a late reading lies between two rows,
and in what may stand before the walls (:mod:`~pmcl.models.sensors.lidar.kernels.obstacles`).
"""

from __future__ import annotations

import math

from pmcl.engine.compile import kernel
from pmcl.engine.contract import (
    NOT_ASKED,
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
    states_asked,
)
from pmcl.engine.linear_readings import add_information
from pmcl.engine.tables import NoExtras
from pmcl.engine.vector_math import any_nonzero
from pmcl.models.sensors.lidar.kernels.beam import beam_below
from pmcl.models.sensors.lidar.kernels.field import add_end_points, level_at
from pmcl.models.sensors.lidar.kernels.obstacles import (
    has_obstacles,
    meets_obstacle,
    with_obstacles,
    with_obstacles_below,
)
from pmcl.models.sensors.lidar.kernels.rays import (
    BEFORE,
    BORDER,
    COLUMN,
    COSINE,
    LATE,
    ROW,
    ROWS,
    SINE,
    TOTAL,
    beam_reading_logpdf,
    end_point,
    expected_of,
    level_of,
    mount_of,
    place,
)
from pmcl.models.sensors.lidar.table import BEAM, LidarExtras, LidarTable

# The distribution function of a reading costs a ray through the grid, ten times as much as its density under a
# likelihood field. Its mean over so many states has an error of 0.01 on a recorded drive (Jarvis, 154 scans), and of
# 0.5 / sqrt(64) = 0.06 at most.
_STATES_ASKED = 64


@scratch_rows.register(LidarTable)
def _scratch_rows(table):
    return ROWS


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


@states_asked.register(LidarTable)
def _states_asked(sensor):
    return _STATES_ASKED


@reading_count.register(LidarTable)
def _reading_count(sensor, n_steps):
    return n_steps * sensor.reading.shape[1]


@reading_slots.register(LidarTable)
def _reading_slots(sensor, t):
    return t * sensor.reading.shape[1], (t + 1) * sensor.reading.shape[1]


@kernel
def _add_scan(sensor, t, pose, logp, scratch):
    """Add the log density of the scan at row t from each `pose` (3, n)."""
    place(sensor, pose, scratch)
    total = scratch[TOTAL]
    # A pose that is no number has no density, wherever its readings seem to end.
    for i in range(logp.size):
        total[i] = 0.0 * (pose[0, i] + pose[1, i] + pose[2, i])
    if sensor.model == BEAM:
        for r in range(sensor.reading.shape[1]):
            z = sensor.reading[t, r]
            if math.isnan(z):
                continue
            mount = mount_of(sensor, r)
            for i in range(logp.size):
                own = beam_reading_logpdf(sensor, r, z, expected_of(sensor, r, mount, i, scratch))
                total[i] += with_obstacles(sensor, r, z, mount, i, scratch, own)
    else:
        if has_obstacles(sensor):
            _add_obstacles(sensor, t, total, scratch)
        column, row = scratch[COLUMN], scratch[ROW]
        for i in range(logp.size):
            column[i] += BORDER
            row[i] += BORDER
        for r in range(sensor.reading.shape[1]):
            z = sensor.reading[t, r]
            if not z < sensor.max_range[r]:
                continue
            u, v = end_point(sensor, r, z)
            add_end_points(
                sensor.levels, sensor.level_log_density[sensor.laser[r]], u, v, column, row, scratch[SINE],
                scratch[COSINE], total,
            )  # fmt: skip
    for i in range(logp.size):
        logp[i] += sensor.exponent * total[i]


@kernel
def _add_obstacles(sensor, t, total, scratch):
    """Add what obstacles change in the log density of a scan under the likelihood field; few rays meet one."""
    for r in range(sensor.reading.shape[1]):
        z = sensor.reading[t, r]
        if not z < sensor.max_range[r]:
            continue
        mount, log_density = mount_of(sensor, r), sensor.level_log_density[sensor.laser[r]]
        for i in range(total.size):
            if meets_obstacle(sensor, r, mount, i, scratch):
                own = log_density[level_of(sensor, r, z, i, scratch)]
                total[i] += with_obstacles(sensor, r, z, mount, i, scratch, own) - own


@kernel
def _add_path(sensor, n_steps, pose, logp, scratch):
    """Add the log density of each row's scan from the pose of that row in `pose` (3, T)."""
    place(sensor, pose, scratch)
    total = scratch[TOTAL]
    column, row, sine, cosine = scratch[COLUMN], scratch[ROW], scratch[SINE], scratch[COSINE]
    for t in range(n_steps):
        total[t] = 0.0
    for r in range(sensor.reading.shape[1]):
        mount = mount_of(sensor, r)
        if sensor.model == BEAM:
            for t in range(n_steps):
                z = sensor.reading[t, r]
                if not math.isnan(z):
                    own = beam_reading_logpdf(sensor, r, z, expected_of(sensor, r, mount, t, scratch))
                    total[t] += with_obstacles(sensor, r, z, mount, t, scratch, own)
            continue
        begin_u, begin_v = end_point(sensor, r, 0.0)
        end_u, end_v = end_point(sensor, r, 1.0)
        log_density = sensor.level_log_density[sensor.laser[r]]
        for t in range(n_steps):
            z = sensor.reading[t, r]
            if z < sensor.max_range[r]:
                u, v = begin_u + z * (end_u - begin_u), begin_v + z * (end_v - begin_v)
                x = column[t] + cosine[t] * u - sine[t] * v + BORDER
                y = row[t] + sine[t] * u + cosine[t] * v + BORDER
                own = log_density[level_at(sensor.levels, x, y)]
                total[t] += with_obstacles(sensor, r, z, mount, t, scratch, own)
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
    pose = scratch[LATE : LATE + 3]
    _late_poses(sensor, t, 0, previous, current, pose)
    _add_scan(sensor, t, pose, logp, scratch)


@path_reading_logpdf.register(LidarTable, NoExtras)
def _path_reading_logpdf(sensor, n_steps, path, logp, scratch):
    _add_path(sensor, n_steps, path, logp, scratch)


@path_reading_logpdf.register(LidarTable, LidarExtras)
def _late_path_reading_logpdf(sensor, n_steps, path, logp, scratch):
    previous, pose = scratch[BEFORE : BEFORE + 3], scratch[LATE : LATE + 3]
    for d in range(3):
        previous[d, 0] = path[d, 0]
        for t in range(1, n_steps):
            previous[d, t] = path[d, t - 1]
    _late_poses(sensor, 0, 1, previous, path, pose)
    _add_path(sensor, n_steps, pose, logp, scratch)


@kernel
def _one_of_beam(sensor, r, z, logp, low, high, scratch):
    mount = mount_of(sensor, r)
    for i in range(logp.size):
        expected = expected_of(sensor, r, mount, i, scratch)
        logp[i] = with_obstacles(
            sensor, r, z, mount, i, scratch, beam_reading_logpdf(sensor, r, z, expected)
        )
        if low[i] == NOT_ASKED:
            continue
        below, as_much = beam_below(
            z, expected, sensor.max_range[r], sensor.std[r], sensor.z_hit, sensor.z_short, sensor.z_max, sensor.z_rand,
            sensor.lambda_short,
        )  # fmt: skip
        low[i], high[i] = with_obstacles_below(sensor, r, z, mount, i, scratch, below, as_much)


@kernel
def _one_of_field(sensor, r, z, logp, low, high, scratch):
    """Do the same for a likelihood field: see :class:`~pmcl.models.sensors.lidar.sensor.Lidar` for its distribution."""
    log_density, half = sensor.level_log_density[sensor.laser[r]], 0.5 * sensor.resolution
    # A reading's place within its cells is uniform, and adds to the scatter of its distance.
    per_std = math.sqrt(0.5 / (sensor.std[r] ** 2 + sensor.resolution**2 / 12.0))
    mount = mount_of(sensor, r)
    unrelated = sensor.z_rand * z / sensor.max_range[r]
    u, v = end_point(sensor, r, z)
    column, row, sine, cosine = scratch[COLUMN], scratch[ROW], scratch[SINE], scratch[COSINE]
    for i in range(logp.size):
        x = column[i] + cosine[i] * u - sine[i] * v + BORDER
        logp[i] = log_density[level_at(sensor.levels, x, row[i] + sine[i] * u + cosine[i] * v + BORDER)]
    if has_obstacles(sensor):
        for i in range(logp.size):
            logp[i] = with_obstacles(sensor, r, z, mount, i, scratch, logp[i])
    for i in range(logp.size):
        if low[i] == NOT_ASKED:
            continue
        expected = expected_of(sensor, r, mount, i, scratch)
        if z > expected:
            # As far behind the wall as its mirror image is before it: what the map has behind a wall does not count.
            mirrored = max(2.0 * expected - z, 0.0)
            distance = sensor.level_distance[level_of(sensor, r, mirrored, i, scratch)]
        else:
            distance = -sensor.level_distance[level_of(sensor, r, z, i, scratch)]
        below = sensor.z_hit * 0.5 * math.erfc(-(distance - half) * per_std) + unrelated
        as_much = sensor.z_hit * 0.5 * math.erfc(-(distance + half) * per_std) + unrelated
        low[i], high[i] = with_obstacles_below(sensor, r, z, mount, i, scratch, below, as_much)


@kernel
def _one_of_either(sensor, t, slot, pose, logp, low, high, scratch):
    r = slot - t * sensor.reading.shape[1]
    if r == 0:
        place(sensor, pose, scratch)
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
    pose = scratch[LATE : LATE + 3]
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
