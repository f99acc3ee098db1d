"""The echo of an obstacle that the map lacks: a disc that a beam meets before its wall."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.compile import kernel
from pmcl.models.sensors.discs import disc_length, disc_lengths
from pmcl.models.sensors.range_beams.kernels.casting import COSINE, SINE
from pmcl.models.sensors.range_beams.kernels.components.drawing import (
    Alternative,
    BeamsAlongPath,
    expected_reading,
    origins_and_directions,
)
from pmcl.models.sensors.range_beams.kernels.components.noise import draw_echo, echo_below, echo_logpdf
from pmcl.models.sensors.range_beams.kernels.rows import (
    BEAM_ROWS,
    OTHERS,
    OWN_SHARE,
    POSE,
    READING,
    STD,
    VALUES,
    first_row,
)
from pmcl.models.sensors.range_beams.table import OPEN_RAY, RangeBeams, extras_of

__all__ = ["draw_obstacle_echoes", "meets_obstacle", "mix_obstacles", "mix_obstacles_below"]

Float = NDArray[np.float64]


@kernel
def _obstacle_lengths(sensor, k, beam, scratch, lengths):
    """Write how far a beam runs from each pose to obstacle `k`; inf where it passes by or the robot stands in it."""
    mount_x, mount_y, yaw = sensor.beam_pose[beam, 0], sensor.beam_pose[beam, 1], sensor.beam_pose[beam, 2]
    x, y, radius = sensor.extras.obstacles[k, 0], sensor.extras.obstacles[k, 1], sensor.extras.obstacles[k, 2]
    pose, sine, cosine = scratch[first_row(sensor) + POSE :], scratch[SINE], scratch[COSINE]
    c, s = math.cos(yaw), math.sin(yaw)
    for i in range(lengths.size):
        dx, dy = cosine[i] * c - sine[i] * s, sine[i] * c + cosine[i] * s
        away_x = x - (pose[0, i] + mount_x * cosine[i] - mount_y * sine[i])
        away_y = y - (pose[1, i] + mount_x * sine[i] + mount_y * cosine[i])
        lengths[i] = disc_length(away_x, away_y, dx, dy, radius)


@kernel
def meets_obstacle(sensor, beam, scratch):
    """Return whether any ray of a beam, cast before, meets an obstacle before its wall."""
    rows = scratch[first_row(sensor) :]
    met, lengths, inverse = False, rows[VALUES], rows[BEAM_ROWS + beam]
    for k in range(sensor.extras.obstacles.shape[0]):
        if sensor.extras.obstacles[k, 3] != 0.0:
            _obstacle_lengths(sensor, k, beam, scratch, lengths)
            for i in range(lengths.size):
                met |= lengths[i] * inverse[i] < 1.0
    return met


@kernel
def mix_obstacles(sensor, beam, first, stride, n, scratch):
    """Mix in the density of the echoes of obstacles."""
    rows, far, bias_at = scratch[first_row(sensor) :], OPEN_RAY * sensor.max_range, sensor.extras.bias_at
    z, std, own_share, others, lengths = rows[READING], rows[STD], rows[OWN_SHARE], rows[OTHERS], rows[VALUES]
    inverse = rows[BEAM_ROWS + beam]
    for k in range(sensor.extras.obstacles.shape[0]):
        weight = sensor.extras.obstacles[k, 3]
        if weight == 0.0:
            continue
        _obstacle_lengths(sensor, k, beam, scratch, lengths)
        for i in range(n):
            if lengths[i] * inverse[i] < 1.0:
                shift = sensor.bias[beam] + bias_at[first + stride * i, beam]
                centre = min(sensor.scale[beam] * lengths[i] + shift, far)
                density = math.exp(echo_logpdf(sensor, z[i], centre, std[i]))
                own_share[i] *= 1.0 - weight
                others[i] = (1.0 - weight) * others[i] + weight * density


@kernel
def mix_obstacles_below(sensor, beam, t, z, low, high, scratch):
    """Mix in the distribution function of the echoes of obstacles."""
    rows, far = scratch[first_row(sensor) :], OPEN_RAY * sensor.max_range
    std, lengths, inverse = rows[STD], rows[VALUES], rows[BEAM_ROWS + beam]
    scale, shift = sensor.scale[beam], sensor.bias[beam] + sensor.extras.bias_at[t, beam]
    for k in range(sensor.extras.obstacles.shape[0]):
        weight = sensor.extras.obstacles[k, 3]
        if weight == 0.0:
            continue
        _obstacle_lengths(sensor, k, beam, scratch, lengths)
        for i in range(low.size):
            if lengths[i] * inverse[i] < 1.0:
                below, as_much = echo_below(sensor, z, min(scale * lengths[i] + shift, far), std[i])
                low[i], high[i] = low[i] + weight * (below - low[i]), high[i] + weight * (as_much - high[i])


def draw_obstacle_echoes(table: RangeBeams, beams: BeamsAlongPath, rng: np.random.Generator) -> list[Alternative]:
    """Draw the echo of each obstacle for each reading, the last obstacle first: it is the last that is mixed in."""
    alternatives = []
    for x, y, radius, weight in extras_of(table).obstacles[::-1]:
        lengths = _lengths_along_path(table, beams.poses, x, y, radius)
        echo = draw_echo(table, expected_reading(table, lengths), beams.std, rng)
        alternatives.append(Alternative(np.where(lengths < beams.lengths, weight, 0.0), echo))
    return alternatives


def _lengths_along_path(table: RangeBeams, poses: Float, x: float, y: float, radius: float) -> Float:
    """Return how far each beam runs to a disc; inf where it misses, or the robot stands in it."""
    from_x, from_y, dx, dy = origins_and_directions(table, poses)
    return disc_lengths(x - from_x, y - from_y, dx, dy, radius)
