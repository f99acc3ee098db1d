"""Full kernels of :class:`~pmcl.models.sensors.range_beams.table.RangeBeams`, for tables with extras.

:mod:`~.all_rays` casts the beams, :mod:`~.mixture` evaluates their readings, :mod:`~.rows` names the scratch space.
"""

from __future__ import annotations

import math

import numpy as np

from pmcl.engine.compile import entry
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
    states_asked,
)
from pmcl.engine.linear_readings import add_information
from pmcl.engine.vector_math import any_nonzero, sincos_into
from pmcl.models.sensors.range_beams.kernels.all_rays import cast_all, cast_beams
from pmcl.models.sensors.range_beams.kernels.casting import COSINE, SINE
from pmcl.models.sensors.range_beams.kernels.components.noise import below_is_costly
from pmcl.models.sensors.range_beams.kernels.mixture import add_beam, add_gaussian_beam, beam_below, is_gaussian
from pmcl.models.sensors.range_beams.kernels.rows import BEAM_ROWS, POSE, POSE_BEFORE, first_row, row_count
from pmcl.models.sensors.range_beams.table import RangeBeams, RangeExtras

# The distribution function of heavy-tailed echoes costs twenty times as much as all else of a pass over single
# readings. Its mean over so many of 1000 states has an error of 0.02 (Amigobot, 600 rows).
_STATES_ASKED = 64


@scratch_rows.register(RangeBeams, RangeExtras)
def _scratch_rows(table):
    return row_count(table)


@looks_back.register(RangeBeams, RangeExtras)
def _looks_back(sensor):
    return any_nonzero(sensor.extras.lag) or any_nonzero(sensor.extras.correlation)


@has_reading.register(RangeBeams, RangeExtras)
def _has_reading(sensor, t):
    return sensor.measured[t] > 0


@reading_logpdf.register(RangeBeams, RangeExtras)
def _reading_logpdf(sensor, t, previous, current, logp, scratch):
    cast_all(sensor, t, 0, previous, current, scratch)
    for beam in range(sensor.reading.shape[1]):
        z = sensor.reading[t, beam]
        if 0.0 < z < sensor.max_range and is_gaussian(sensor, beam, scratch):
            add_gaussian_beam(sensor, beam, t, logp, scratch)
        elif not math.isnan(z):
            add_beam(sensor, beam, t, 0, logp, scratch)


@path_reading_logpdf.register(RangeBeams, RangeExtras)
def _path_reading_logpdf(sensor, n_steps, path, logp, scratch):
    begin = first_row(sensor) + POSE_BEFORE
    previous = scratch[begin : begin + 3]
    for d in range(3):
        previous[d, 0] = path[d, 0]
        for t in range(1, n_steps):
            previous[d, t] = path[d, t - 1]
    cast_all(sensor, 0, 1, previous, path, scratch)
    for beam in range(sensor.reading.shape[1]):
        add_beam(sensor, beam, 0, 1, logp, scratch)


@reading_count.register(RangeBeams, RangeExtras)
def _reading_count(sensor, n_steps):
    return n_steps * sensor.reading.shape[1]


@reading_slots.register(RangeBeams, RangeExtras)
def _reading_slots(sensor, t):
    return t * sensor.reading.shape[1], (t + 1) * sensor.reading.shape[1]


@states_asked.register(RangeBeams, RangeExtras)
def _states_asked(sensor):
    return _STATES_ASKED if below_is_costly(sensor) else 0


@one_reading.register(RangeBeams, RangeExtras)
def _one_reading(sensor, t, slot, previous, current, logp, low, high, memory, scratch):
    beam = slot - t * sensor.reading.shape[1]
    if beam == 0:
        cast_all(sensor, t, 0, previous, current, scratch)
    z = sensor.reading[t, beam]
    if math.isnan(z):
        return False
    for i in range(logp.size):
        logp[i] = 0.0
    add_beam(sensor, beam, t, 0, logp, scratch)
    beam_below(sensor, beam, t, z, low, high, scratch)
    return True


@linear_information.register(RangeBeams, RangeExtras)
def _linear_information(sensor, linear, t, precision, shift):
    extras = sensor.extras
    for k in range(linear.first[t], linear.first[t + 1]):
        beam, length = linear.channel[k], linear.value[k]
        scale, correlation = sensor.scale[beam], extras.correlation[beam]
        std = sensor.std[beam] * extras.std_factor[t] * (1.0 + extras.growth[beam] * min(length, sensor.max_range))
        # What rounding, heavy tails and a memory add to the scatter.
        variance = std * std * (1.0 + min(2.0 * extras.tail, 1.0)) + extras.step * extras.step / 12.0
        variance *= (1.0 + correlation) / (1.0 - correlation)
        now = length - extras.lag[t] * linear.extras.velocity[k]
        residual = linear.reading[k] - (scale * now + sensor.bias[beam] + extras.bias_at[t, beam])
        add_information(linear.jacobian, k, scale, linear.weight[k] / variance, residual, precision, shift)


@entry
def rays_along(sensor, columns):
    """Return 1 / length of every beam along trajectories `columns` (M, D, T), as (M, B, T), without any delay."""
    n_paths, n_steps, n_beams = columns.shape[0], columns.shape[2], sensor.reading.shape[1]
    inverses = np.empty((n_paths, n_beams, n_steps))
    scratch = np.empty((row_count(sensor), n_steps))
    cosines = scratch[first_row(sensor) + BEAM_ROWS :]
    for k in range(n_paths):
        cast_beams(sensor, columns[k, :3], -1, False, scratch, inverses[k], cosines)
    return inverses


@entry
def terms_given_rays(sensor, columns, inverses, which):
    """Return the log densities of readings along trajectories `columns` (M, D, T), as (M, T).

    Beam b has the rays ``inverses[:, which[b]]`` of :func:`rays_along`: tables that change neither how beams run nor
    the map, without delay or specular reflections, share their rays.
    """
    n_paths, n_steps, n_beams = columns.shape[0], columns.shape[2], sensor.reading.shape[1]
    logp = np.zeros((n_paths, n_steps))
    scratch = np.empty((row_count(sensor), n_steps))
    rows = scratch[first_row(sensor) :]
    rays = rows[BEAM_ROWS:]
    correlated = any_nonzero(sensor.extras.correlation)
    for k in range(n_paths):
        sincos_into(columns[k, 2], scratch[SINE], scratch[COSINE])
        for d in range(3):
            for t in range(n_steps):
                rows[POSE + d, t] = columns[k, d, t]
        for beam in range(n_beams):
            for t in range(n_steps):
                rays[beam, t] = inverses[k, which[beam], t]
            if correlated:
                # The ray of the row before; the first row has none, and nothing is compared with it.
                for t in range(n_steps):
                    rays[2 * n_beams + beam, t] = rays[beam, max(t - 1, 0)]
        for beam in range(n_beams):
            add_beam(sensor, beam, 0, 1, logp[k], scratch)
    return logp
