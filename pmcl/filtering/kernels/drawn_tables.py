"""Faster ways to use many parameter draws with the built-in tables, where the draws have most of the work in common."""

from __future__ import annotations

import math

from pmcl.filtering.kernels.contract import reading_logpdf
from pmcl.filtering.kernels.drawn import is_shared, propagate_draws, reading_logpdf_draws
from pmcl.filtering.kernels.random_numbers import normals_into
from pmcl.filtering.kernels.ranges import beam_logpdf, cast_one_beam
from pmcl.filtering.kernels.vector_math import sincos_into
from pmcl.filtering.kernels.views import take
from pmcl.models.tables import IncrementMotion, RangeBeams


@propagate_draws.register(IncrementMotion, allocates=False)
def _increments(motion, stack, t, rng, which, previous, current, scratch, order, counts, gathered):
    """Use the mean and noise of each particle's own draw."""
    sine, cosine, forward, left, turn = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    n = current.shape[1]
    x, y, heading = current[0], current[1], current[2]
    before_x, before_y, before_heading = previous[0], previous[1], previous[2]
    normals_into(rng, scratch[2:5], sine)
    for i in range(n):
        mean, std = take(motion.mean, stack.mean, which[i]), take(motion.std, stack.std, which[i])
        forward[i] = mean[t, 0] + std[t, 0] * forward[i]
        left[i] = mean[t, 1] + std[t, 1] * left[i]
        turn[i] = mean[t, 2] + std[t, 2] * turn[i]
    sincos_into(before_heading, sine, cosine)
    for i in range(n):
        x[i] = before_x[i] + forward[i] * cosine[i] - left[i] * sine[i]
    for i in range(n):
        y[i] = before_y[i] + forward[i] * sine[i] + left[i] * cosine[i]
    for i in range(n):
        heading[i] = before_heading[i] + turn[i]


@reading_logpdf_draws.register(RangeBeams, allocates=False)
def _beams(sensor, stack, picks, t, previous, current, log_densities, scratch):
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
