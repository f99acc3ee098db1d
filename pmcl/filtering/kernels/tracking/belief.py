"""The belief of a localizing filter: equal weights, weights from readings, and its moments."""

from __future__ import annotations

import math

import numpy as np

from pmcl.engine.compile import kernel
from pmcl.engine.scalars import wrap_angle
from pmcl.engine.vector_math import sincos_into
from pmcl.engine.views import columns
from pmcl.filtering.kernels.tracking.state import COUNT, EFFECTIVE, FRESH, WEIGHT_SUM
from pmcl.filtering.kernels.weighing import FINE, normalise

__all__ = ["level", "summarise", "weigh"]


@kernel(reorder=True)
def _dot(weights, values):
    value = 0.0
    for i in range(weights.size):
        value += weights[i] * values[i]
    return value


@kernel(reorder=True)
def _dot3(weights, a, b):
    value = 0.0
    for i in range(weights.size):
        value += weights[i] * a[i] * b[i]
    return value


@kernel
def _moments(particles, weights, weight_sum, mean, covariance, work):
    """Write weighted mean (D,) and covariance (D, D); component 2 of a pose is an angle and has a circular mean."""
    size, n = particles.shape
    for d in range(size):
        if d == 2:
            sine, cosine = work[0], work[1]
            sincos_into(particles[2], sine, cosine)
            mean[2] = math.atan2(_dot(weights, sine), _dot(weights, cosine))
        else:
            mean[d] = _dot(weights, particles[d]) / weight_sum
    for d in range(size):
        source, deviation, centre = particles[d], work[d], mean[d]
        if d == 2:
            for i in range(n):
                deviation[i] = wrap_angle(source[i] - centre)
        else:
            for i in range(n):
                deviation[i] = source[i] - centre
    for a in range(size):
        for b in range(a + 1):
            covariance[a, b] = covariance[b, a] = _dot3(weights, work[a], work[b]) / weight_sum


@kernel
def level(state, n):
    """Give n particles equal weights."""
    log_weight = -math.log(n)
    for i in range(n):
        state.weights[i] = 1.0
        state.log_weights[i] = log_weight
    numbers = state.numbers
    numbers[COUNT], numbers[WEIGHT_SUM], numbers[EFFECTIVE], numbers[FRESH] = n, n, n, 1.0


@kernel
def weigh(state, n, log_weights):
    """Take `log_weights` (n,), normalise them; return (status, log of what their sum was)."""
    status, greatest, weight_sum = normalise(log_weights, state.weights[:n])
    if status != FINE:
        return status, -np.inf
    log_sum = greatest + math.log(weight_sum)
    squares = 0.0
    for i in range(n):
        state.log_weights[i] = log_weights[i] - log_sum
        squares += state.weights[i] * state.weights[i]
    numbers = state.numbers
    numbers[COUNT], numbers[WEIGHT_SUM], numbers[FRESH] = n, weight_sum, 0.0
    numbers[EFFECTIVE] = weight_sum * weight_sum / squares
    return FINE, log_sum


@kernel
def summarise(state, size, log_score, mean, covariance, diagnostics):
    """Write mean (D,), covariance (D, D) and (log score, effective sample size, n) of the belief."""
    numbers = state.numbers
    n = int(numbers[COUNT])
    rows = state.scratch.size // state.log_weights.size
    diagnostics[0], diagnostics[1], diagnostics[2] = log_score, numbers[EFFECTIVE], n
    work = columns(state.scratch, rows, n)
    _moments(columns(state.particles, size, n), state.weights[:n], numbers[WEIGHT_SUM], mean, covariance, work)
