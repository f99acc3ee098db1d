"""Readings that have nothing to do with what is around: no echo, which reads max_range, and outliers.

An outlier is uniform between 0 and max_range, and never clipped.
"""

from __future__ import annotations

import numpy as np

from pmcl.engine.compile import kernel
from pmcl.models.sensors.range_beams.kernels.components.drawing import Alternative
from pmcl.models.sensors.range_beams.kernels.rows import OTHERS, OWN_SHARE, READING, first_row
from pmcl.models.sensors.range_beams.table import RangeBeams, extras_of

__all__ = ["draw_no_echo", "draw_outliers", "mix_unrelated", "mix_unrelated_below"]


@kernel
def mix_unrelated(sensor, beam, n, scratch):
    """Mix in the probability of no echo, then the density of outliers."""
    silent, outlier, longest = sensor.extras.no_echo_weight[beam], sensor.outlier_weight[beam], sensor.max_range
    rows = scratch[first_row(sensor) :]
    z, own_share, others = rows[READING], rows[OWN_SHARE], rows[OTHERS]
    for i in range(n):
        others[i] = (1.0 - silent) * others[i] + (silent if z[i] >= longest else 0.0)
        others[i] = (1.0 - outlier) * others[i] + (outlier / longest if 0.0 < z[i] < longest else 0.0)
        own_share[i] *= (1.0 - silent) * (1.0 - outlier)


@kernel
def mix_unrelated_below(sensor, beam, z, low, high):
    """Mix in the distribution function of no echo, then that of outliers."""
    silent, outlier, longest = sensor.extras.no_echo_weight[beam], sensor.outlier_weight[beam], sensor.max_range
    no_echo = 1.0 if z >= longest else 0.0
    uniform = min(max(z / longest, 0.0), 1.0)
    for i in range(low.size):
        below, as_much = (1.0 - silent) * low[i], (1.0 - silent) * high[i] + silent * no_echo
        low[i], high[i] = below + outlier * (uniform - below), as_much + outlier * (uniform - as_much)


def draw_no_echo(table: RangeBeams) -> Alternative:
    """Return what each reading is without an echo; nothing is random about it."""
    shape = table.reading.shape
    return Alternative(np.broadcast_to(extras_of(table).no_echo_weight, shape), np.full(shape, table.max_range))


def draw_outliers(table: RangeBeams, rng: np.random.Generator) -> Alternative:
    """Draw an outlier for each reading."""
    shape = table.reading.shape
    return Alternative(np.broadcast_to(table.outlier_weight, shape), table.max_range * rng.random(shape))
