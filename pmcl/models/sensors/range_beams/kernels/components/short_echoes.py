"""A short echo: something unknown stands before the wall, with an exponential distribution that ends at the wall."""

from __future__ import annotations

import math

import numpy as np

from pmcl.engine.compile import kernel
from pmcl.engine.vector_math import exp_into
from pmcl.models.sensors.range_beams.kernels.components.drawing import Alternative, BeamsAlongPath
from pmcl.models.sensors.range_beams.kernels.rows import (
    DRAFT,
    EXPECTED,
    OTHERS,
    OWN_SHARE,
    READING,
    VALUES,
    first_row,
)
from pmcl.models.sensors.range_beams.table import RangeBeams, extras_of

__all__ = ["draw_short_echoes", "mix_short_echoes", "mix_short_echoes_below"]

# Shortest room before the wall in which something may stand [m].
_LEAST_ROOM = 0.01


@kernel
def _room(sensor, expected):
    """Return the room before the wall [m], which ends where readings do."""
    return max(min(expected, sensor.max_range), _LEAST_ROOM)


@kernel
def _densities_into(sensor, stride, n, z, expected, draft, out):
    """Write the density of a short echo in each column into `out`; with stride 0 all columns have one reading."""
    length = sensor.extras.short_length
    for i in range(n):
        draft[i] = -_room(sensor, expected[i]) / length
    exp_into(draft, 0.0, out)
    if stride == 0:
        decay = math.exp(-z[0] / length)
        for i in range(n):
            draft[i] = decay
    else:
        for i in range(n):
            draft[i] = -z[i] / length
        exp_into(draft, 0.0, draft)
    for i in range(n):
        room = _room(sensor, expected[i])
        out[i] = draft[i] / (length * (1.0 - out[i])) if (z[i] > 0.0) & (z[i] < room) else 0.0


@kernel
def mix_short_echoes(sensor, beam, stride, n, scratch):
    """Mix in the density of short echoes."""
    weight = sensor.extras.short_weight[beam]
    if weight == 0.0:
        return
    rows = scratch[first_row(sensor) :]
    own_share, others, densities = rows[OWN_SHARE], rows[OTHERS], rows[VALUES]
    _densities_into(sensor, stride, n, rows[READING], rows[EXPECTED], rows[DRAFT], densities)
    for i in range(n):
        own_share[i] *= 1.0 - weight
        others[i] = (1.0 - weight) * others[i] + weight * densities[i]


@kernel
def mix_short_echoes_below(sensor, beam, z, low, high, scratch):
    """Mix in the distribution function of short echoes."""
    weight, length = sensor.extras.short_weight[beam], sensor.extras.short_length
    if weight == 0.0:
        return
    rows = scratch[first_row(sensor) :]
    expected, draft, at_wall = rows[EXPECTED], rows[DRAFT], rows[VALUES]
    for i in range(low.size):
        draft[i] = -_room(sensor, expected[i]) / length
    exp_into(draft, 0.0, at_wall)
    decay = math.exp(-max(z, 0.0) / length)
    for i in range(low.size):
        below = (1.0 - max(decay, at_wall[i])) / (1.0 - at_wall[i])
        low[i], high[i] = low[i] + weight * (below - low[i]), high[i] + weight * (below - high[i])


def draw_short_echoes(table: RangeBeams, beams: BeamsAlongPath, rng: np.random.Generator) -> Alternative:
    """Draw a short echo for each reading."""
    shape, extras = table.reading.shape, extras_of(table)
    length = extras.short_length
    room = np.clip(beams.expected, _LEAST_ROOM, table.max_range)
    reading = -length * np.log1p(rng.random(shape) * np.expm1(-room / length))
    return Alternative(np.broadcast_to(extras.short_weight, shape), reading)
