"""A detour: at grazing incidence the wall is a mirror, and the echo comes back by way of something beyond it.

The reading is then uniform between the wall and max_range; where hardly any range is left beyond the wall, nothing
comes back, which reads as max_range.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.compile import kernel
from pmcl.engine.vector_math import atan2_into, exp_into
from pmcl.models.sensors.range_beams.kernels.components.drawing import (
    Alternative,
    BeamsAlongPath,
    origins_and_directions,
)
from pmcl.models.sensors.range_beams.kernels.rows import (
    BEAM_ROWS,
    DRAFT,
    EXPECTED,
    OTHERS,
    OWN_SHARE,
    READING,
    VALUES,
    first_row,
)
from pmcl.models.sensors.range_beams.table import RangeBeams, extras_of

__all__ = ["draw_detours", "mix_detours", "mix_detours_below"]

Float = NDArray[np.float64]

# Width of the step, over the angle of incidence, from no reflection to full specular reflection [rad].
_EDGE = 0.1
# Share of the range that must lie beyond the wall for a detour to come back.
_LEAST_DETOUR = 0.1


@kernel
def _weights_into(sensor, beam, cosine, draft, out):
    """Write the probability of a detour at each cosine of incidence into `out`; `draft` is work space."""
    n = out.size
    for i in range(n):
        c = min(cosine[i], 1.0)
        out[i] = math.sqrt(1.0 - c * c)
    atan2_into(out, cosine, draft)
    for i in range(n):
        draft[i] = (sensor.extras.specular_angle - draft[i]) / _EDGE
    exp_into(draft, 0.0, out)
    for i in range(n):
        out[i] = sensor.extras.specular_weight[beam] / (1.0 + out[i])


@kernel
def _density(sensor, z, expected):
    """Return the density of a detour that reads `z`, or the probability of one that reads max_range."""
    low, longest = max(expected, 0.0), sensor.max_range
    room = longest - low
    inside = 1.0 / room if (low < z) & (z < longest) else 0.0
    beyond = 1.0 if z >= longest else 0.0
    return inside if room > _LEAST_DETOUR * longest else beyond


@kernel
def _below(sensor, z, expected):
    """Return the probabilities that a detour reads less than `z`, and less or the same."""
    low, longest = max(expected, 0.0), sensor.max_range
    room = longest - low
    less = min(max((z - low) / room, 0.0), 1.0) if room > _LEAST_DETOUR * longest else 0.0
    return less, 1.0 if z >= longest else less


@kernel
def mix_detours(sensor, beam, n, scratch):
    """Mix in the density of detours."""
    if sensor.extras.specular_weight[beam] == 0.0:
        return
    n_beams, rows = sensor.reading.shape[1], scratch[first_row(sensor) :]
    z, expected, own_share, others = rows[READING], rows[EXPECTED], rows[OWN_SHARE], rows[OTHERS]
    weights = rows[VALUES]
    _weights_into(sensor, beam, rows[BEAM_ROWS + n_beams + beam], rows[DRAFT], weights)
    for i in range(n):
        weight = weights[i]
        own_share[i] *= 1.0 - weight
        others[i] = (1.0 - weight) * others[i] + weight * _density(sensor, z[i], expected[i])


@kernel
def mix_detours_below(sensor, beam, z, low, high, scratch):
    """Mix in the distribution function of detours."""
    if sensor.extras.specular_weight[beam] == 0.0:
        return
    n_beams, rows = sensor.reading.shape[1], scratch[first_row(sensor) :]
    weights, expected = rows[VALUES], rows[EXPECTED]
    _weights_into(sensor, beam, rows[BEAM_ROWS + n_beams + beam], rows[DRAFT], weights)
    for i in range(low.size):
        below, as_much = _below(sensor, z, expected[i])
        low[i] += weights[i] * (below - low[i])
        high[i] += weights[i] * (as_much - high[i])


def draw_detours(table: RangeBeams, beams: BeamsAlongPath, rng: np.random.Generator) -> Alternative:
    """Draw a detour for each reading."""
    shape, longest, extras = table.reading.shape, table.max_range, extras_of(table)
    incidence = np.arccos(_cosines_along_path(table, beams.poses))
    weight = extras.specular_weight / (1.0 + np.exp((extras.specular_angle - incidence) / _EDGE))
    low = np.maximum(beams.expected, 0.0)
    comes_back = longest - low > _LEAST_DETOUR * longest
    return Alternative(weight, np.where(comes_back, low + (longest - low) * rng.random(shape), longest))


def _cosines_along_path(table: RangeBeams, poses: Float) -> Float:
    """Return the cosine of the angle of incidence at the wall that each beam's middle ray meets; 1 without a wall."""
    if not extras_of(table).specular_weight.any():
        return np.ones(table.reading.shape)
    x, y, dx, dy = origins_and_directions(table, poses)
    nearest, cosine = np.full(x.shape, np.inf), np.ones(x.shape)
    for start, stop in zip(table.vertices[table.wall_start], table.vertices[table.wall_stop], strict=True):
        ex, ey = stop - start
        with np.errstate(divide="ignore", invalid="ignore"):
            determinant = dx * ey - dy * ex
            length = ((start[0] - x) * ey - (start[1] - y) * ex) / determinant
            share = ((start[0] - x) * dy - (start[1] - y) * dx) / determinant
        met = (length > 0.0) & (share >= 0.0) & (share <= 1.0) & (length < nearest)
        nearest = np.where(met, length, nearest)
        cosine = np.where(met, np.abs(determinant) / np.hypot(ex, ey), cosine)
    return np.minimum(cosine, 1.0)
