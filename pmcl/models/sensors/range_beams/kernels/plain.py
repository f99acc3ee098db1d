"""Plain kernels of :class:`~pmcl.models.sensors.range_beams.table.RangeBeams`, for tables without extras."""

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
from pmcl.engine.linear_readings import NOTHING, add_sums, with_reading
from pmcl.engine.parameter_draws import is_shared, reading_logpdf_draws
from pmcl.engine.scalars import HALF_LOG_2PI
from pmcl.engine.student import log_normal_tail
from pmcl.engine.tables import NoExtras
from pmcl.engine.vector_math import exp_into, log_into, sincos_into, upper_tail_into
from pmcl.engine.views import take
from pmcl.models.sensors.range_beams.kernels.casting import (
    CASTING_ROWS,
    COSINE,
    DIRECTION_X,
    INVERSE_LENGTH,
    SINE,
    WORK,
    cast_beam,
    has_origin,
    same_origin,
)
from pmcl.models.sensors.range_beams.table import OPEN_RAY, RangeBeams

# The directions of the rays are no longer needed when the readings are weighed.
_MIXTURE = DIRECTION_X


@scratch_rows.register(RangeBeams, NoExtras)
def _scratch_rows(table):
    return CASTING_ROWS + table.wall_start.size


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
    far = OPEN_RAY * max_range
    constant = math.log(weight) - HALF_LOG_2PI
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
    return math.log(weight) - HALF_LOG_2PI - 0.5 * r * r


@reading_logpdf.register(RangeBeams, NoExtras)
def _reading_logpdf(sensor, t, previous, current, logp, scratch):
    inverse_length, work = scratch[INVERSE_LENGTH], scratch[WORK]
    sincos_into(current[2], scratch[SINE], scratch[COSINE])
    origin_x, origin_y = np.nan, np.nan
    for beam in range(sensor.reading.shape[1]):
        z = sensor.reading[t, beam]
        if math.isnan(z):
            continue
        moved = not has_origin(sensor.beam_pose, beam, origin_x, origin_y)
        origin_x, origin_y = sensor.beam_pose[beam, 0], sensor.beam_pose[beam, 1]
        cast_beam(sensor, beam, current, scratch[SINE], scratch[COSINE], moved, scratch)
        beam_logpdf(
            z, inverse_length, sensor.bias[beam], sensor.scale[beam], sensor.std[beam],
            sensor.outlier_weight[beam], sensor.max_range, logp, work, scratch[_MIXTURE],
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
    last = memory[0]
    if beam == 0:
        sincos_into(current[2], scratch[SINE], scratch[COSINE])
        last[0] = -1.0
    z = sensor.reading[t, beam]
    if math.isnan(z):
        return False
    # What was computed of the origins for the beam before serves those that leave from the same point.
    before = int(last[0])
    moved = before < 0 or not same_origin(sensor.beam_pose, before, beam)
    last[0] = float(beam)
    cast_beam(sensor, beam, current, scratch[SINE], scratch[COSINE], moved, scratch)
    inverse_length, work = scratch[INVERSE_LENGTH], scratch[WORK]
    bias, scale, std = sensor.bias[beam], sensor.scale[beam], sensor.std[beam]
    share, max_range = sensor.outlier_weight[beam], sensor.max_range
    for i in range(logp.size):
        logp[i] = 0.0
    beam_logpdf(z, inverse_length, bias, scale, std, share, max_range, logp, work, scratch[_MIXTURE])
    shrink, far = 1.0 / std, OPEN_RAY * max_range
    # Tails of a reading at the lower end are those of a reading of 0, at the upper end of one of max_range.
    reached = min(max(z, 0.0), max_range)
    for i in range(logp.size):
        work[i] = (min(scale / inverse_length[i] + bias, far) - reached) * shrink
    upper_tail_into(work, low)
    outside = 0.0 if z <= 0.0 else share * reached / max_range
    for i in range(logp.size):
        below = outside + (1.0 - share) * low[i]
        low[i] = 0.0 if z <= 0.0 else below
        high[i] = 1.0 if z >= max_range else below
    return True


@path_reading_logpdf.register(RangeBeams, NoExtras)
def _path_reading_logpdf(sensor, n_steps, path, logp, scratch):
    inverse_length = scratch[INVERSE_LENGTH]
    sincos_into(path[2], scratch[SINE], scratch[COSINE])
    reading, beam_pose, max_range = sensor.reading, sensor.beam_pose, sensor.max_range
    origin_x, origin_y = np.nan, np.nan
    for beam in range(reading.shape[1]):
        moved = not has_origin(beam_pose, beam, origin_x, origin_y)
        origin_x, origin_y = beam_pose[beam, 0], beam_pose[beam, 1]
        cast_beam(sensor, beam, path, scratch[SINE], scratch[COSINE], moved, scratch)
        weight, scale, bias = 1.0 / sensor.std[beam], sensor.scale[beam], sensor.bias[beam]
        constant, share = math.log(weight) - HALF_LOG_2PI, sensor.outlier_weight[beam]
        for t in range(n_steps):
            z = reading[t, beam]
            if math.isnan(z):
                continue
            expected = min(scale / inverse_length[t] + bias, OPEN_RAY * max_range)
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
def _linear_information(sensor, linear, t, precision, shift):
    sums = NOTHING
    for k in range(linear.first[t], linear.first[t + 1]):
        beam = linear.channel[k]
        scale = sensor.scale[beam]
        weight = linear.weight[k] / sensor.std[beam] ** 2
        residual = linear.reading[k] - (scale * linear.value[k] + sensor.bias[beam])
        sums = with_reading(sums, linear.jacobian, k, scale, weight, residual)
    add_sums(sums, precision, shift)


@reading_logpdf_draws.register(RangeBeams, NoExtras)
def _logpdf_of_draws(sensor, stack, picks, t, previous, current, log_densities, scratch):
    """Cast each ray once for all draws, unless map or mounts differ between them."""
    fixed = is_shared(sensor.beam_pose, stack.beam_pose) and is_shared(sensor.vertices, stack.vertices)
    if not (fixed and is_shared(sensor.reading, stack.reading) and is_shared(sensor.max_range, stack.max_range)):
        for j in range(picks.size):
            reading_logpdf(take(sensor, stack, picks[j]), t, previous, current, log_densities[j], scratch)
        return
    inverse_length, work = scratch[INVERSE_LENGTH], scratch[WORK]
    sincos_into(current[2], scratch[SINE], scratch[COSINE])
    origin_x, origin_y = math.nan, math.nan
    for beam in range(sensor.reading.shape[1]):
        z = sensor.reading[t, beam]
        if math.isnan(z):
            continue
        moved = not has_origin(sensor.beam_pose, beam, origin_x, origin_y)
        origin_x, origin_y = sensor.beam_pose[beam, 0], sensor.beam_pose[beam, 1]
        cast_beam(sensor, beam, current, scratch[SINE], scratch[COSINE], moved, scratch)
        for j in range(picks.size):
            k = picks[j]
            beam_logpdf(
                z, inverse_length, take(sensor.bias, stack.bias, k)[beam], take(sensor.scale, stack.scale, k)[beam],
                take(sensor.std, stack.std, k)[beam], take(sensor.outlier_weight, stack.outlier_weight, k)[beam],
                sensor.max_range, log_densities[j], work, scratch[_MIXTURE],
            )  # fmt: skip
