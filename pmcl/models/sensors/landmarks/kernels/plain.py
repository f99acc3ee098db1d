"""Plain kernels of :class:`~pmcl.models.sensors.landmarks.table.LandmarkSightings`, for tables without extras."""

from __future__ import annotations

import math

import numpy as np

from pmcl.engine.compile import entry, kernel
from pmcl.engine.contract import (
    has_reading,
    linear_information,
    looks_back,
    one_reading,
    path_reading_logpdf,
    reading_count,
    reading_logpdf,
    reading_slots,
    scratch_rows,
)
from pmcl.engine.linear_readings import BEARING, NOTHING, RANGE, SIZE, add_sums, with_reading
from pmcl.engine.scalars import HALF_LOG_2PI, LOG_2PI, wrap_angle
from pmcl.engine.tables import NoExtras
from pmcl.engine.vector_math import any_nonzero, atan2_into, exp_into, log_into, sincos_into, upper_tail_into
from pmcl.models.sensors.landmarks.table import LandmarkSightings


@scratch_rows.register(LandmarkSightings, NoExtras)
def _scratch_rows(table):
    return 7


@looks_back.register(LandmarkSightings, NoExtras)
def _looks_back(sensor):
    return False


@has_reading.register(LandmarkSightings, NoExtras)
def _has_reading(sensor, t):
    return sensor.first[t + 1] > sensor.first[t]


@kernel
def _add_distance(x, y, landmark_x, landmark_y, shifted, slope, constant, logp):
    for i in range(logp.size):
        dx, dy = landmark_x - x[i], landmark_y - y[i]
        r = shifted - slope * math.sqrt(dx * dx + dy * dy)
        logp[i] += constant - 0.5 * r * r


@reading_logpdf.register(LandmarkSightings, NoExtras)
def _reading_logpdf(sensor, t, previous, current, logp, scratch):
    n = logp.size
    sine, cosine, ahead, aside, work, angle = (
        scratch[0], scratch[1], scratch[2], scratch[3], scratch[4], scratch[5],
    )  # fmt: skip
    x, y = current[0], current[1]
    mount_x, mount_y, mount_yaw = sensor.sensor_pose[0], sensor.sensor_pose[1], sensor.sensor_pose[2]
    mounted = mount_x != 0.0 or mount_y != 0.0
    log_max_range = math.log(sensor.max_range)
    # Landmarks mostly share one standard deviation: its logarithm is not taken for each of them.
    usual_std, usual_constant = math.nan, 0.0
    turned = False
    for sighting in range(sensor.first[t], sensor.first[t + 1]):
        # Of signed indices numba asks each time whether they are negative.
        k = np.uint64(sighting)
        j = np.uint64(sensor.landmark[k])
        landmark_x, landmark_y = sensor.position[j, 0], sensor.position[j, 1]
        weight = sensor.outlier_weight[j]
        target = work if weight > 0.0 else logp
        if weight > 0.0:
            for i in range(n):
                work[i] = 0.0
        outlier = 0.0
        has_bearing = not math.isnan(sensor.bearing[k])
        z, size = sensor.range[k], sensor.size[k]
        # The commonest sighting needs no frame of the sensor: one loop instead of three.
        distance_only = not (has_bearing or mounted) and math.isnan(size)
        if has_bearing or mounted:
            if not turned:
                sincos_into(current[2], sine, cosine)
                turned = True
            # In the sensor's frame, turned further by minus the reading: the residual is then one angle, already
            # wrapped.
            expected = sensor.bearing[k] - sensor.bearing_bias[j] + mount_yaw if has_bearing else 0.0
            c, s = math.cos(expected), math.sin(expected)
            offset_ahead, offset_aside = mount_x * c + mount_y * s, mount_y * c - mount_x * s
            for i in range(n):
                c_i, s_i = cosine[i] * c - sine[i] * s, sine[i] * c + cosine[i] * s
                ahead[i] = (landmark_x - x[i]) * c_i + (landmark_y - y[i]) * s_i - offset_ahead
            for i in range(n):
                c_i, s_i = cosine[i] * c - sine[i] * s, sine[i] * c + cosine[i] * s
                aside[i] = (landmark_y - y[i]) * c_i - (landmark_x - x[i]) * s_i - offset_aside
        elif not distance_only:
            for i in range(n):
                ahead[i] = landmark_x - x[i]
            for i in range(n):
                aside[i] = landmark_y - y[i]
        if not math.isnan(z):
            scale, std = sensor.range_scale[j], sensor.range_std[j]
            if std != usual_std:
                usual_std, usual_constant = std, -math.log(std) - HALF_LOG_2PI
            inverse_std, constant = 1.0 / std, usual_constant
            shifted, slope = (z - sensor.range_bias[j]) * inverse_std, scale * inverse_std
            outlier -= log_max_range
            if distance_only:
                _add_distance(x, y, landmark_x, landmark_y, shifted, slope, constant, target)
            else:
                for i in range(n):
                    r = shifted - slope * math.sqrt(ahead[i] * ahead[i] + aside[i] * aside[i])
                    target[i] += constant - 0.5 * r * r
        if not math.isnan(size):
            # Gaussian on the ratio observed / ideal; the density of the pixels themselves divides by the ideal.
            inverse_std, per_area = 1.0 / sensor.size_std[j], 1.0 / sensor.size_constant[j]
            constant = math.log(inverse_std * per_area) - HALF_LOG_2PI
            outlier -= math.log(sensor.size_constant[j])
            area, log_area = scratch[6], angle
            for i in range(n):
                area[i] = ahead[i] * ahead[i] + aside[i] * aside[i]
            log_into(area, log_area)
            for i in range(n):
                r = (size * area[i] * per_area - 1.0) * inverse_std
                target[i] += log_area[i] + constant - 0.5 * r * r
        if has_bearing:
            inverse_std = 1.0 / sensor.bearing_std[j]
            constant = math.log(inverse_std) - HALF_LOG_2PI
            outlier -= LOG_2PI
            atan2_into(aside, ahead, angle)
            for i in range(n):
                r = angle[i] * inverse_std
                target[i] += constant - 0.5 * r * r
        if weight > 0.0:
            exp_into(work, 0.0, angle)
            floor = weight * math.exp(outlier)
            for i in range(n):
                angle[i] = (1.0 - weight) * angle[i] + floor
            log_into(angle, work)
            for i in range(n):
                logp[i] += work[i]


@reading_count.register(LandmarkSightings, NoExtras)
def _reading_count(sensor, n_steps):
    return 3 * sensor.first[n_steps]


@reading_slots.register(LandmarkSightings, NoExtras)
def _reading_slots(sensor, t):
    return 3 * sensor.first[t], 3 * sensor.first[t + 1]


@one_reading.register(LandmarkSightings, NoExtras)
def _one_reading(sensor, t, slot, previous, current, logp, low, high, memory, scratch):
    k, kind = slot // 3, slot % 3
    j, n = sensor.landmark[k], logp.size
    # All readings of a sighting share one coin: how likely it is a gross error, given those before.
    gross, sine, cosine = memory[0], memory[1], memory[2]
    if slot == 3 * sensor.first[t]:
        sincos_into(current[2], sine, cosine)
    if kind == RANGE:
        for i in range(n):
            gross[i] = sensor.outlier_weight[j]
    z = sensor.range[k] if kind == RANGE else (sensor.bearing[k] if kind == BEARING else sensor.size[k])
    if math.isnan(z):
        return False
    ahead, aside, deviation, share, draft = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    mount_x, mount_y, mount_yaw = sensor.sensor_pose[0], sensor.sensor_pose[1], sensor.sensor_pose[2]
    for i in range(n):
        dx, dy = sensor.position[j, 0] - current[0, i], sensor.position[j, 1] - current[1, i]
        ahead[i] = dx * cosine[i] + dy * sine[i] - mount_x
        aside[i] = dy * cosine[i] - dx * sine[i] - mount_y
    # How far the reading lies below what was expected, in standard deviations, and as a share of what a gross error may
    # read.
    if kind == RANGE:
        outlier, inverse_std = 1.0 / sensor.max_range, 1.0 / sensor.range_std[j]
        constant = math.log(inverse_std) - HALF_LOG_2PI
        for i in range(n):
            distance = math.sqrt(ahead[i] * ahead[i] + aside[i] * aside[i])
            deviation[i] = (sensor.range_scale[j] * distance + sensor.range_bias[j] - z) * inverse_std
            share[i] = z * outlier
    elif kind == BEARING:
        outlier, inverse_std = 0.5 / math.pi, 1.0 / sensor.bearing_std[j]
        constant = math.log(inverse_std) - HALF_LOG_2PI
        atan2_into(aside, ahead, draft)
        for i in range(n):
            residual = wrap_angle(z - sensor.bearing_bias[j] + mount_yaw - draft[i])
            deviation[i] = -residual * inverse_std
            share[i] = 0.5 + residual * outlier
    else:
        outlier, inverse_std = 1.0 / sensor.size_constant[j], 1.0 / sensor.size_std[j]
        constant = math.log(inverse_std * outlier) - HALF_LOG_2PI
        for i in range(n):
            share[i] = z * outlier
            draft[i] = ahead[i] * ahead[i] + aside[i] * aside[i]
            deviation[i] = (1.0 - share[i] * draft[i]) * inverse_std
        log_into(draft, ahead)
    upper_tail_into(deviation, low)
    for i in range(n):
        logp[i] = constant - 0.5 * deviation[i] * deviation[i] + (ahead[i] if kind == SIZE else 0.0)
    if sensor.outlier_weight[j] > 0.0:
        exp_into(logp, 0.0, draft)
        for i in range(n):
            wild = gross[i] * outlier
            draft[i] = (1.0 - gross[i]) * draft[i] + wild
            low[i] = (1.0 - gross[i]) * low[i] + gross[i] * min(max(share[i], 0.0), 1.0)
            gross[i] = wild / draft[i]
        log_into(draft, logp)
    for i in range(n):
        high[i] = low[i]
    return True


@path_reading_logpdf.register(LandmarkSightings, NoExtras)
def _path_reading_logpdf(sensor, n_steps, path, logp, scratch):
    """Evaluate as many sightings at once as the scratch space has columns, one kind of reading after the other."""
    sincos_into(path[2], scratch[0], scratch[1])
    mounted = sensor.sensor_pose[0] != 0.0 or sensor.sensor_pose[1] != 0.0
    stop, width = sensor.first[n_steps], scratch.shape[1]
    for begin in range(0, stop, width):
        count = min(width, stop - begin)
        square, angle, value = scratch[2, :count], scratch[3, :count], scratch[4, :count]
        scale, work = scratch[5, :count], scratch[6, :count]
        some_bearings = _any_number(sensor.bearing[begin : begin + count])
        some_sizes = _any_number(sensor.size[begin : begin + count])
        if some_bearings or mounted:
            _places(sensor, begin, path, scratch[0], scratch[1], square, angle, value, scale)
        else:
            _distances(sensor, begin, path, square)
        for i in range(count):
            value[i] = 0.0
        for i in range(count):
            scale[i] = 1.0
        # Products of standard deviations are gathered so that one logarithm serves all channels.
        _add_ranges(sensor, begin, square, value, scale, work)
        if some_bearings:
            _add_bearings(sensor, begin, angle, value, scale)
        if some_sizes:
            _add_sizes(sensor, begin, square, value, scale)
        # Landmarks mostly share one standard deviation: its logarithm is not taken for each of them.
        various = False
        for i in range(count):
            various |= scale[i] != scale[0]
        if various:
            log_into(scale, work)
            for i in range(count):
                value[i] -= work[i]
        else:
            usual = math.log(scale[0])
            for i in range(count):
                value[i] -= usual
        if any_nonzero(sensor.outlier_weight):
            _mix_gross_errors(sensor, begin, value, scale, work)
        for i in range(count):
            logp[sensor.time[begin + i]] += value[i]


@kernel
def _any_number(values):
    found = False
    for i in range(values.size):
        found |= values[i] == values[i]
    return found


@kernel
def _distances(sensor, begin, path, square):
    """Write squared distances of sightings begin ... from a sensor at the robot's centre."""
    x, y = path[0], path[1]
    for i in range(square.size):
        t, j = sensor.time[begin + i], sensor.landmark[begin + i]
        dx, dy = sensor.position[j, 0] - x[t], sensor.position[j, 1] - y[t]
        square[i] = dx * dx + dy * dy


@kernel
def _places(sensor, begin, path, sine, cosine, square, angle, ahead, aside):
    """Write squared distance and bearing of sightings begin ... along a path; `ahead` and `aside` are work space."""
    mount_x, mount_y = sensor.sensor_pose[0], sensor.sensor_pose[1]
    x, y = path[0], path[1]
    for i in range(square.size):
        t, j = sensor.time[begin + i], sensor.landmark[begin + i]
        dx, dy = sensor.position[j, 0] - x[t], sensor.position[j, 1] - y[t]
        ahead[i] = dx * cosine[t] + dy * sine[t] - mount_x
        aside[i] = dy * cosine[t] - dx * sine[t] - mount_y
    for i in range(square.size):
        square[i] = ahead[i] * ahead[i] + aside[i] * aside[i]
    atan2_into(aside, ahead, angle)


@kernel
def _add_ranges(sensor, begin, square, value, scale, distance):
    """Add the ranges' terms; `distance` is work space. Loops of few arrays are those that are vectorised."""
    reading = sensor.range[begin : begin + square.size]
    landmark = sensor.landmark[begin : begin + square.size]
    for i in range(square.size):
        distance[i] = math.sqrt(square[i])
    for i in range(square.size):
        z, j = reading[i], np.uint64(landmark[i])
        r = (z - sensor.range_bias[j] - sensor.range_scale[j] * distance[i]) / sensor.range_std[j]
        term = 0.5 * r * r + HALF_LOG_2PI
        value[i] -= term if z == z else 0.0  # NaN differs from itself
    for i in range(square.size):
        z, std = reading[i], sensor.range_std[np.uint64(landmark[i])]
        scale[i] *= std if z == z else 1.0


@kernel
def _add_bearings(sensor, begin, angle, value, scale):
    yaw = sensor.sensor_pose[2]
    for i in range(angle.size):
        z, j = sensor.bearing[begin + i], sensor.landmark[begin + i]
        if not math.isnan(z):
            r = wrap_angle(z - sensor.bearing_bias[j] + yaw - angle[i]) / sensor.bearing_std[j]
            value[i] -= 0.5 * r * r + HALF_LOG_2PI
            scale[i] *= sensor.bearing_std[j]


@kernel
def _add_sizes(sensor, begin, square, value, scale):
    for i in range(square.size):
        z, j = sensor.size[begin + i], sensor.landmark[begin + i]
        if not math.isnan(z):
            ideal = sensor.size_constant[j] / square[i]
            r = (z / ideal - 1.0) / sensor.size_std[j]
            value[i] -= 0.5 * r * r + HALF_LOG_2PI
            scale[i] *= sensor.size_std[j] * ideal


@kernel
def _mix_gross_errors(sensor, begin, value, density, work):
    """Replace the log density of sound sightings by that of the mixture with gross errors."""
    exp_into(value, 0.0, density)
    log_max_range = math.log(sensor.max_range)
    for i in range(value.size):
        k = begin + i
        j = sensor.landmark[k]
        weight, outlier = sensor.outlier_weight[j], 0.0
        outlier -= 0.0 if math.isnan(sensor.range[k]) else log_max_range
        outlier -= 0.0 if math.isnan(sensor.size[k]) else math.log(sensor.size_constant[j])
        outlier -= 0.0 if math.isnan(sensor.bearing[k]) else LOG_2PI
        density[i] = (1.0 - weight) * density[i] + weight * math.exp(outlier)
    log_into(density, work)
    for i in range(value.size):
        if sensor.outlier_weight[sensor.landmark[begin + i]] > 0.0:
            value[i] = work[i]


@linear_information.register(LandmarkSightings, NoExtras)
def _linear_information(sensor, linear, t, precision, shift):
    sums = NOTHING
    for k in range(linear.first[t], linear.first[t + 1]):
        j, kind = linear.channel[k], linear.kind[k]
        scale, expected, std = 1.0, linear.value[k], 1.0
        if kind == RANGE:
            scale, std = sensor.range_scale[j], sensor.range_std[j]
            expected = scale * expected + sensor.range_bias[j]
        elif kind == BEARING:
            std = sensor.bearing_std[j]
            expected += sensor.bearing_bias[j]
        else:
            # The ratio observed / ideal has its noise on the observed side: in pixels it is size_std * ideal.
            scale = sensor.size_constant[j]
            expected *= scale
            std = sensor.size_std[j] * expected
        residual = linear.reading[k] - expected
        if kind == BEARING:
            residual = wrap_angle(residual)
        weight = linear.weight[k] / (std * std)
        sums = with_reading(sums, linear.jacobian, k, scale, weight, residual)
    add_sums(sums, precision, shift)


@entry
def ideal_sightings(table, path):
    """Return distance [m] and bearing in the sensor frame [rad] of each sighting along a path (T, D), as (N, 2)."""
    n_steps = path.shape[0]
    n = table.first[n_steps]
    out = np.empty((n, 2))
    mount_x, mount_y, mount_yaw = table.sensor_pose[0], table.sensor_pose[1], table.sensor_pose[2]
    for t in range(n_steps):
        c, s = math.cos(path[t, 2]), math.sin(path[t, 2])
        for k in range(table.first[t], table.first[t + 1]):
            j = table.landmark[k]
            dx, dy = table.position[j, 0] - path[t, 0], table.position[j, 1] - path[t, 1]
            ahead, aside = dx * c + dy * s - mount_x, dy * c - dx * s - mount_y
            out[k, 0] = math.sqrt(ahead * ahead + aside * aside)
            out[k, 1] = math.atan2(aside, ahead) - mount_yaw
    return out
