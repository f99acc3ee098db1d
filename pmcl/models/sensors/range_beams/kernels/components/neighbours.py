"""The echo of a neighbouring beam, received by mistake: either neighbour alike."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.compile import kernel
from pmcl.engine.vector_math import exp_into
from pmcl.models.sensors.range_beams.kernels.components.drawing import Alternative, BeamsAlongPath, expected_reading
from pmcl.models.sensors.range_beams.kernels.components.noise import draw_echo, echo_below_into, echo_logpdf_into
from pmcl.models.sensors.range_beams.kernels.rows import (
    BEAM_ROWS,
    DRAFT,
    OTHER_RAY,
    OTHERS,
    OWN_SHARE,
    READING,
    STD,
    VALUES,
    first_row,
)
from pmcl.models.sensors.range_beams.table import OPEN_RAY, RangeBeams, extras_of

__all__ = ["draw_neighbour_echoes", "mix_neighbours", "mix_neighbours_below"]

Float = NDArray[np.float64]


@kernel
def _mix_one_neighbour(sensor, beam, neighbour, weight, first, stride, n, scratch):
    rows, bias_at = scratch[first_row(sensor) :], sensor.extras.bias_at
    own_share, others, centre, echo = rows[OWN_SHARE], rows[OTHERS], rows[VALUES], rows[OTHER_RAY]
    inverse, far = rows[BEAM_ROWS + neighbour], OPEN_RAY * sensor.max_range
    for i in range(n):
        shift = sensor.bias[beam] + bias_at[first + stride * i, beam]
        centre[i] = min(sensor.scale[beam] / inverse[i] + shift, far)
    even = stride == 0 and sensor.extras.growth[beam] == 0.0
    echo_logpdf_into(sensor, n, rows[READING], centre, rows[STD], even, rows[DRAFT], echo)
    exp_into(echo, 0.0, centre)
    for i in range(n):
        own_share[i] *= 1.0 - weight
        others[i] = (1.0 - weight) * others[i] + weight * centre[i]


@kernel
def mix_neighbours(sensor, beam, first, stride, n, scratch):
    """Mix in the density of the neighbours' echoes."""
    weight = sensor.extras.talk_weight[beam]
    if weight > 0.0:
        # Two steps of a mixture: what the second leaves of the first has the same weight as the second itself.
        half = 0.5 * weight
        left, right = sensor.extras.neighbours[beam, 0], sensor.extras.neighbours[beam, 1]
        _mix_one_neighbour(sensor, beam, left, half / (1.0 - half), first, stride, n, scratch)
        _mix_one_neighbour(sensor, beam, right, half, first, stride, n, scratch)


@kernel
def mix_neighbours_below(sensor, beam, t, z, low, high, scratch):
    """Mix in the distribution function of the neighbours' echoes."""
    weight = sensor.extras.talk_weight[beam]
    if not weight > 0.0:
        return
    n, rows, far = low.size, scratch[first_row(sensor) :], OPEN_RAY * sensor.max_range
    centre, less, as_much = rows[VALUES], rows[OWN_SHARE], rows[OTHERS]
    scale, shift = sensor.scale[beam], sensor.bias[beam] + sensor.extras.bias_at[t, beam]
    for i in range(n):
        low[i], high[i] = (1.0 - weight) * low[i], (1.0 - weight) * high[i]
    for side in range(2):
        inverse = rows[BEAM_ROWS + sensor.extras.neighbours[beam, side]]
        for i in range(n):
            centre[i] = min(scale / inverse[i] + shift, far)
        echo_below_into(sensor, z, centre, rows[STD], rows[DRAFT], less, as_much)
        for i in range(n):
            low[i], high[i] = low[i] + 0.5 * weight * less[i], high[i] + 0.5 * weight * as_much[i]


def draw_neighbour_echoes(table: RangeBeams, beams: BeamsAlongPath, rng: np.random.Generator) -> Alternative:
    """Draw the echo of a neighbour for each reading."""
    shape, extras = table.reading.shape, extras_of(table)
    side = rng.integers(2, size=shape)
    neighbour = extras.neighbours[np.arange(shape[1]), side.reshape(-1, shape[1])]
    lengths = np.take_along_axis(beams.lengths, neighbour, axis=1)
    echo = draw_echo(table, expected_reading(table, lengths), beams.std, rng)
    return Alternative(np.broadcast_to(extras.talk_weight, shape), echo)
