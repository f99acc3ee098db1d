"""Kernels of :class:`~pmcl.models.tables.RangeBeams`: range readings of any number of beams against walls."""

from __future__ import annotations

import math

import numpy as np

from pmcl.engine.compile import kernel
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
from pmcl.engine.linear_readings import add_information
from pmcl.engine.parameter_draws import is_shared, reading_logpdf_draws
from pmcl.engine.student import log_normal_tail
from pmcl.engine.tables import NoExtras
from pmcl.engine.vector_math import exp_into, log_into, sincos_into, upper_tail_into
from pmcl.engine.views import take
from pmcl.models.sensors.range_beams.kernels.rays import inverse_lengths, middle_and_reach, wall_numerators
from pmcl.models.sensors.range_beams.table import RangeBeams

_HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)
# Work rows before those for the walls.
_FIXED_ROWS = CASTING_ROWS = 17
# A ray that meets nothing has length inf; this many times the longest reading stands for it.
_FAR = 2.0


@scratch_rows.register(RangeBeams, NoExtras)
def _scratch_rows(table):
    return _FIXED_ROWS + table.wall_start.size


@looks_back.register(RangeBeams, NoExtras)
def _looks_back(sensor):
    return False


@has_reading.register(RangeBeams, NoExtras)
def _has_reading(sensor, t):
    return sensor.measured[t] > 0


@kernel
def beam_logpdf(z, inverse_length, bias, scale, std, outlier_weight, max_range, logp, work, mixture):
    """Add the log density of one reading `z` [m] given 1 / length of each ray; see :class:`RangeBeams`.

    A reading of 0 or of `max_range` is a clipped one: its probability is that of the Gaussian tail.
    """
    n = logp.size
    clipped_low, clipped_high = z <= 0.0, z >= max_range
    weight = 1.0 / std
    far = _FAR * max_range
    constant = math.log(weight) - _HALF_LOG_2PI
    if not (clipped_low or clipped_high or outlier_weight > 0.0):
        shifted = (z - bias) * weight
        slope, limit = scale * weight, (z - far) * weight
        for i in range(n):
            r = max(shifted - slope / inverse_length[i], limit)
            logp[i] += constant - 0.5 * r * r
        return
    for i in range(n):
        work[i] = inlier_logpdf(z, min(scale / inverse_length[i] + bias, far), weight, max_range)
    if outlier_weight > 0.0:
        # A clipped reading has no share of the uniform density: outliers lie strictly inside.
        floor = 0.0 if clipped_low or clipped_high else outlier_weight / max_range
        exp_into(work, 0.0, mixture)
        for i in range(n):
            mixture[i] = (1.0 - outlier_weight) * mixture[i] + floor
        log_into(mixture, work)
    for i in range(n):
        logp[i] += work[i]


@kernel
def inlier_logpdf(z, expected, weight, max_range):
    """Return the log density of one reading around `expected` [m]; `weight` is 1 / std."""
    if z <= 0.0:
        return log_normal_tail(expected * weight)
    if z >= max_range:
        return log_normal_tail((max_range - expected) * weight)
    r = (z - expected) * weight
    return math.log(weight) - _HALF_LOG_2PI - 0.5 * r * r


@kernel
def _same_origin(beam_pose, one, other):
    return beam_pose[one, 0] == beam_pose[other, 0] and beam_pose[one, 1] == beam_pose[other, 1]


@kernel
def one_origin(beam_pose):
    """Return whether several beams leave the robot, all from one point."""
    for beam in range(1, beam_pose.shape[0]):
        if not _same_origin(beam_pose, beam, 0):
            return False
    return beam_pose.shape[0] > 1


@kernel
def _remember(scratch, row, interval):
    scratch[row, 0], scratch[row + 1, 0] = interval


@kernel
def cast_one_beam(sensor, beam, current, sine, cosine, moved, scratch):
    """Write 1 / length of one beam for all particles into scratch row 2; reuse the origins when `moved` is False.

    Rows 9 to 16 of `scratch` hold, in their first element, what bounds all origins and headings.
    """
    n = current.shape[1]
    best, x, y = scratch[2], scratch[3], scratch[4]
    inverse = scratch[_FIXED_ROWS : _FIXED_ROWS + sensor.wall_start.size]
    shared = one_origin(sensor.beam_pose)
    if moved:
        mount_x, mount_y = sensor.beam_pose[beam, 0], sensor.beam_pose[beam, 1]
        for i in range(n):
            x[i] = current[0, i] + mount_x * cosine[i] - mount_y * sine[i]
        for i in range(n):
            y[i] = current[1, i] + mount_x * sine[i] + mount_y * cosine[i]
        _remember(scratch, np.int64(9), middle_and_reach(x))
        _remember(scratch, np.int64(11), middle_and_reach(y))
        _remember(scratch, np.int64(13), middle_and_reach(cosine))
        _remember(scratch, np.int64(15), middle_and_reach(sine))
        if shared:
            wall_numerators(sensor.vertices, sensor.wall_start, sensor.wall_stop, x, y, inverse)
    cast_along(sensor, sensor.beam_pose[beam, 2], shared, sine, cosine, scratch, best)


@kernel
def cast_along(sensor, yaw, shared, sine, cosine, scratch, best):
    """Write 1 / length of rays at `yaw` to the robots' headings into `best`, from the origins of the last beam cast."""
    dx, dy, x, y = scratch[0], scratch[1], scratch[3], scratch[4]
    moment, inverse = scratch[8], scratch[_FIXED_ROWS : _FIXED_ROWS + sensor.wall_start.size]
    c, s = math.cos(yaw), math.sin(yaw)
    for i in range(x.size):
        dx[i] = cosine[i] * c - sine[i] * s
        dy[i] = sine[i] * c + cosine[i] * s
    middle_c, reach_c, middle_s, reach_s = scratch[13, 0], scratch[14, 0], scratch[15, 0], scratch[16, 0]
    bounds = (
        (scratch[9, 0], scratch[10, 0]),
        (scratch[11, 0], scratch[12, 0]),
        (middle_c * c - middle_s * s, reach_c * abs(c) + reach_s * abs(s)),
        (middle_s * c + middle_c * s, reach_s * abs(c) + reach_c * abs(s)),
    )
    inverse_lengths(
        sensor.vertices, sensor.wall_start, sensor.wall_stop, x, y, dx, dy, bounds, inverse, shared, moment, best
    )


@reading_logpdf.register(RangeBeams, NoExtras)
def _reading_logpdf(sensor, t, previous, current, logp, scratch):
    sine, cosine, work, best = scratch[5], scratch[6], scratch[7], scratch[2]
    sincos_into(current[2], sine, cosine)
    origin_x, origin_y = np.nan, np.nan
    for beam in range(sensor.reading.shape[1]):
        z = sensor.reading[t, beam]
        if math.isnan(z):
            continue
        moved = sensor.beam_pose[beam, 0] != origin_x or sensor.beam_pose[beam, 1] != origin_y
        origin_x, origin_y = sensor.beam_pose[beam, 0], sensor.beam_pose[beam, 1]
        cast_one_beam(sensor, beam, current, sine, cosine, moved, scratch)
        beam_logpdf(
            z, best, sensor.bias[beam], sensor.scale[beam], sensor.std[beam],
            sensor.outlier_weight[beam], sensor.max_range, logp, work, scratch[0],
        )  # fmt: skip


@reading_count.register(RangeBeams, NoExtras)
def _reading_count(sensor, n_steps):
    return n_steps * sensor.reading.shape[1]


@reading_slots.register(RangeBeams, NoExtras)
def _reading_slots(sensor, t):
    return t * sensor.reading.shape[1], (t + 1) * sensor.reading.shape[1]


@one_reading.register(RangeBeams, NoExtras)
def _one_reading(sensor, t, slot, previous, current, logp, low, high, memory, scratch):
    beam = slot - t * sensor.reading.shape[1]
    sine, cosine, last = memory[0], memory[1], memory[2]
    if beam == 0:
        sincos_into(current[2], sine, cosine)
        last[0] = -1.0
    z = sensor.reading[t, beam]
    if math.isnan(z):
        return False
    # What was computed of the origins for the beam before serves those that leave from the same point.
    before = int(last[0])
    moved = before < 0 or not _same_origin(sensor.beam_pose, before, beam)
    last[0] = float(beam)
    cast_one_beam(sensor, beam, current, sine, cosine, moved, scratch)
    best, work = scratch[2], scratch[7]
    bias, scale, std = sensor.bias[beam], sensor.scale[beam], sensor.std[beam]
    share, max_range = sensor.outlier_weight[beam], sensor.max_range
    for i in range(logp.size):
        logp[i] = 0.0
    beam_logpdf(z, best, bias, scale, std, share, max_range, logp, work, scratch[0])
    shrink, far = 1.0 / std, _FAR * max_range
    # Tails of a reading at the lower end are those of a reading of 0, at the upper end of one of max_range.
    reached = min(max(z, 0.0), max_range)
    for i in range(logp.size):
        work[i] = (min(scale / best[i] + bias, far) - reached) * shrink
    upper_tail_into(work, low)
    outside = 0.0 if z <= 0.0 else share * reached / max_range
    for i in range(logp.size):
        below = outside + (1.0 - share) * low[i]
        low[i] = 0.0 if z <= 0.0 else below
        high[i] = 1.0 if z >= max_range else below
    return True


@path_reading_logpdf.register(RangeBeams, NoExtras)
def _path_reading_logpdf(sensor, n_steps, path, logp, scratch):
    sine, cosine, best = scratch[5], scratch[6], scratch[2]
    sincos_into(path[2], sine, cosine)
    reading, beam_pose, max_range = sensor.reading, sensor.beam_pose, sensor.max_range
    origin_x, origin_y = np.nan, np.nan
    for beam in range(reading.shape[1]):
        moved = beam_pose[beam, 0] != origin_x or beam_pose[beam, 1] != origin_y
        origin_x, origin_y = beam_pose[beam, 0], beam_pose[beam, 1]
        cast_one_beam(sensor, beam, path, sine, cosine, moved, scratch)
        weight, scale, bias = 1.0 / sensor.std[beam], sensor.scale[beam], sensor.bias[beam]
        constant, share = math.log(weight) - _HALF_LOG_2PI, sensor.outlier_weight[beam]
        for t in range(n_steps):
            z = reading[t, beam]
            if math.isnan(z):
                continue
            expected = min(scale / best[t] + bias, _FAR * max_range)
            clipped = z <= 0.0 or z >= max_range
            if clipped:
                value = inlier_logpdf(z, expected, weight, max_range)
            else:
                r = (z - expected) * weight
                value = constant - 0.5 * r * r
            if share > 0.0:
                # Outliers lie strictly inside: a clipped reading is never one, however improbable it is.
                value = (
                    value + math.log(1.0 - share)
                    if clipped
                    else math.log((1.0 - share) * math.exp(value) + share / max_range)
                )
            logp[t] += value


@linear_information.register(RangeBeams, NoExtras)
def _linear_information(sensor, geometry, t, precision, shift):
    jacobian = geometry.jacobian
    for k in range(geometry.first[t], geometry.first[t + 1]):
        beam = geometry.channel[k]
        scale = sensor.scale[beam]
        weight = geometry.weight[k] / sensor.std[beam] ** 2
        residual = geometry.reading[k] - (scale * geometry.value[k] + sensor.bias[beam])
        add_information(jacobian, k, scale, weight, residual, precision, shift)


@reading_logpdf_draws.register(RangeBeams, NoExtras)
def _logpdf_of_draws(sensor, stack, picks, t, previous, current, log_densities, scratch):
    """Cast each ray once for all draws, unless map or mounts differ between them."""
    fixed = is_shared(sensor.beam_pose, stack.beam_pose) and is_shared(sensor.vertices, stack.vertices)
    if not (fixed and is_shared(sensor.reading, stack.reading) and is_shared(sensor.max_range, stack.max_range)):
        for j in range(picks.size):
            reading_logpdf(take(sensor, stack, picks[j]), t, previous, current, log_densities[j], scratch)
        return
    sine, cosine, work, best = scratch[5], scratch[6], scratch[7], scratch[2]
    sincos_into(current[2], sine, cosine)
    origin_x, origin_y = math.nan, math.nan
    for beam in range(sensor.reading.shape[1]):
        z = sensor.reading[t, beam]
        if math.isnan(z):
            continue
        moved = sensor.beam_pose[beam, 0] != origin_x or sensor.beam_pose[beam, 1] != origin_y
        origin_x, origin_y = sensor.beam_pose[beam, 0], sensor.beam_pose[beam, 1]
        cast_one_beam(sensor, beam, current, sine, cosine, moved, scratch)
        for j in range(picks.size):
            k = picks[j]
            beam_logpdf(
                z, best, take(sensor.bias, stack.bias, k)[beam], take(sensor.scale, stack.scale, k)[beam],
                take(sensor.std, stack.std, k)[beam], take(sensor.outlier_weight, stack.outlier_weight, k)[beam],
                sensor.max_range, log_densities[j], work, scratch[0],
            )  # fmt: skip
