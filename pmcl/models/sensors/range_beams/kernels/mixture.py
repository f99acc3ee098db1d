"""The density and the distribution function of one beam's readings: its own echo, and all other components mixed in.

The components are mixed in from the innermost to the outermost: what is mixed in later is asked first.
"""

from __future__ import annotations

import math

import numpy as np

from pmcl.engine.compile import kernel
from pmcl.engine.scalars import HALF_LOG_2PI
from pmcl.engine.vector_math import any_nonzero, exp_into, log_into
from pmcl.models.sensors.range_beams.kernels.components.detours import mix_detours, mix_detours_below
from pmcl.models.sensors.range_beams.kernels.components.neighbours import mix_neighbours, mix_neighbours_below
from pmcl.models.sensors.range_beams.kernels.components.noise import echo_below_into, echo_logpdf_into
from pmcl.models.sensors.range_beams.kernels.components.obstacles import (
    meets_obstacle,
    mix_obstacles,
    mix_obstacles_below,
)
from pmcl.models.sensors.range_beams.kernels.components.own_echo import expect_own_echo
from pmcl.models.sensors.range_beams.kernels.components.short_echoes import mix_short_echoes, mix_short_echoes_below
from pmcl.models.sensors.range_beams.kernels.components.unrelated import mix_unrelated, mix_unrelated_below
from pmcl.models.sensors.range_beams.kernels.rows import (
    BEAM_ROWS,
    CENTRE,
    DRAFT,
    ECHO,
    OTHERS,
    OWN_SHARE,
    READING,
    VALUES,
    WIDTH,
    first_row,
)
from pmcl.models.sensors.range_beams.table import OPEN_RAY

__all__ = ["add_beam", "add_gaussian_beam", "beam_below", "is_gaussian"]

# Densities below this have lost digits, or everything, in the exponential.
_LEAST_DENSITY = 1e-290


@kernel
def _is_mixture(sensor, beam):
    """Return whether a beam may read anything but its own echo, obstacles aside."""
    extras = sensor.extras
    weight = abs(sensor.outlier_weight[beam]) + extras.no_echo_weight[beam] + extras.short_weight[beam]
    weight += extras.specular_weight[beam] + extras.talk_weight[beam]
    return weight != 0.0


@kernel
def is_gaussian(sensor, beam, scratch):
    """Return whether all that a beam, cast before, may read are echoes of walls with one standard deviation in a row.

    A clipped reading of such a beam is not Gaussian either.
    """
    uneven = sensor.extras.growth[beam] != 0.0 or sensor.extras.correlation[beam] != 0.0
    if uneven or sensor.extras.tail != 0.0 or sensor.extras.step != 0.0 or _is_mixture(sensor, beam):
        return False
    return not meets_obstacle(sensor, beam, scratch)


@kernel
def add_gaussian_beam(sensor, beam, t, logp, scratch):
    """Add the log density of an unclipped reading of a Gaussian beam, cast before: a shortcut of :func:`add_beam`."""
    inverse = scratch[first_row(sensor) + BEAM_ROWS + beam]
    std, far = sensor.std[beam] * sensor.extras.std_factor[t], OPEN_RAY * sensor.max_range
    constant, inverse_std, scale = -math.log(std) - HALF_LOG_2PI, 1.0 / std, sensor.scale[beam]
    z, shift = sensor.reading[t, beam], sensor.bias[beam] + sensor.extras.bias_at[t, beam]
    for i in range(logp.size):
        r = (z - min(scale / inverse[i] + shift, far)) * inverse_std
        logp[i] += constant - 0.5 * r * r


@kernel
def _mix(sensor, beam, first, stride, n, scratch):
    """Fill the rows OWN_SHARE and OTHERS: the density of a reading is OWN_SHARE * exp(ECHO) + OTHERS."""
    rows = scratch[first_row(sensor) :]
    own_share, others = rows[OWN_SHARE], rows[OTHERS]
    for i in range(n):
        own_share[i], others[i] = 1.0, 0.0
    mix_neighbours(sensor, beam, first, stride, n, scratch)
    mix_obstacles(sensor, beam, first, stride, n, scratch)
    mix_detours(sensor, beam, n, scratch)
    mix_short_echoes(sensor, beam, stride, n, scratch)
    mix_unrelated(sensor, beam, n, scratch)


@kernel
def add_beam(sensor, beam, first, stride, logp, scratch):
    """Add the log density of one beam's readings, cast before; columns without a reading are left alone.

    Column i belongs to row ``first + stride * i`` of the readings.
    """
    n, rows = logp.size, scratch[first_row(sensor) :]
    z, echo, draft = rows[READING], rows[ECHO], rows[DRAFT]
    expect_own_echo(sensor, beam, first, stride, n, scratch)
    even = stride == 0 and sensor.extras.growth[beam] == 0.0 and sensor.extras.correlation[beam] == 0.0
    echo_logpdf_into(sensor, n, z, rows[CENTRE], rows[WIDTH], even, draft, echo)
    if not (_is_mixture(sensor, beam) or meets_obstacle(sensor, beam, scratch)):
        for i in range(n):
            logp[i] += 0.0 if math.isnan(z[i]) else echo[i]
        return
    _mix(sensor, beam, first, stride, n, scratch)
    own_share, others, density = rows[OWN_SHARE], rows[OTHERS], rows[VALUES]
    exp_into(echo, 0.0, density)
    ordinary = True
    for i in range(n):
        density[i] = own_share[i] * density[i] + others[i]
        ordinary &= density[i] > _LEAST_DENSITY
    log_into(density, draft)
    if ordinary:
        for i in range(n):
            logp[i] += draft[i]
        return
    for i in range(n):
        if math.isnan(z[i]):
            continue
        if density[i] > _LEAST_DENSITY or math.isnan(density[i]):
            logp[i] += draft[i]
        elif own_share[i] > 0.0:
            # So unlikely that the exponential vanished: on the scale of logarithms it did not.
            logp[i] += echo[i] + math.log(own_share[i])
        else:
            logp[i] = -np.inf


@kernel
def beam_below(sensor, beam, t, z, low, high, scratch):
    """Write the probabilities that a beam reads less than `z` at row t, and less or the same.

    :func:`add_beam` has been called for the same reading.
    """
    rows = scratch[first_row(sensor) :]
    echo_below_into(sensor, z, rows[CENTRE], rows[WIDTH], rows[DRAFT], low, high)
    if _is_mixture(sensor, beam) or any_nonzero(sensor.extras.obstacles[:, 3]):
        mix_neighbours_below(sensor, beam, t, z, low, high, scratch)
        mix_obstacles_below(sensor, beam, t, z, low, high, scratch)
        mix_detours_below(sensor, beam, z, low, high, scratch)
        mix_short_echoes_below(sensor, beam, z, low, high, scratch)
        mix_unrelated_below(sensor, beam, z, low, high)
