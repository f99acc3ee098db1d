"""Draws of a state of which nothing is known but what the robot reads at one time: annealing from the start belief.

Few of a thousand poses drawn anywhere come near enough to where the robot is to survive a sharp reading. So the reading
is taken in by degrees, raised to powers between 0 and 1, with resampling and random-walk Metropolis moves in between
(Neal 2001; Del Moral, Doucet, Jasra 2006). As the number of particles grows the draws are exactly from the belief given
the readings, and the product of the mean weights is an estimate of the readings' evidence.
"""

from __future__ import annotations

import math

import numpy as np

from pmcl.engine.compile import kernel
from pmcl.engine.contract import draw_start, start_logpdf
from pmcl.engine.parameter_draws import log_likelihood
from pmcl.engine.vector_math import exp_into, maximum, total
from pmcl.engine.views import columns
from pmcl.filtering.kernels.resampling import SYSTEMATIC, resample
from pmcl.filtering.kernels.tracking.adapt import gather
from pmcl.filtering.kernels.weighing import ALL_ZERO, FINE, NOT_A_NUMBER

__all__ = ["draw_annealed"]

# Each degree leaves at least this share of effective particles, and is followed by this many moves.
_SHARE, _MOVES = 0.5, 6
# Steps of the moves, as shares of the spread of the start belief: log-uniform between these, since how wide the modes
# are at some degree is not known beforehand.
_LONGEST, _SHORTEST = 0.5, 0.0015
_SMALLEST_DEGREE = 1e-4


@kernel
def _effective_at(step, like, greatest, weights):
    """Write the weights of one degree; return their effective sample size and sum."""
    for i in range(like.size):
        weights[i] = step * (like[i] - greatest)
    exp_into(weights, 0.0, weights)
    squares = 0.0
    for i in range(like.size):
        squares += weights[i] * weights[i]
    weight_sum = total(weights)
    return weight_sum * weight_sum / squares, weight_sum


@kernel
def _next_degree(like, greatest, limit, weights):
    """Return the greatest step up to `limit` that keeps the share of effective particles."""
    least_size = _SHARE * like.size
    if _effective_at(limit, like, greatest, weights)[0] >= least_size:
        return limit
    low, high = 0.0, limit
    for _ in range(25):
        middle = 0.5 * (low + high)
        if _effective_at(middle, like, greatest, weights)[0] >= least_size:
            low = middle
        else:
            high = middle
    # Particles that are impossible keep the share low at any step: those go at once.
    return min(max(low, _SMALLEST_DEGREE), limit)


@kernel
def _measure_spread(current, spread):
    n = current.shape[1]
    for d in range(current.shape[0]):
        mean, square = 0.0, 0.0
        for i in range(n):
            mean += current[d, i] / n
        for i in range(n):
            square += (current[d, i] - mean) ** 2 / n
        spread[d] = math.sqrt(square)


@kernel
def _move(tables, stack, start, row, rng, state, picks, degree, current, like, log_start, log_densities, scratch):
    """One random-walk Metropolis step of each particle; target: start belief times likelihood to the power `degree`."""
    size, n = current.shape
    proposed = columns(state.proposed, size, n)
    new_like, new_start = state.new_like[:n], state.new_start[:n]
    ratio = math.log(_SHORTEST / _LONGEST)
    for i in range(n):
        step = _LONGEST * math.exp(ratio * rng.random())
        for d in range(size):
            proposed[d, i] = current[d, i] + step * state.spread[d] * rng.standard_normal()
        new_start[i] = 0.0
    start_logpdf(start, proposed, new_start)
    log_likelihood(tables, stack, row, picks, proposed, proposed, new_like, log_densities, scratch)
    if not total(new_like) < np.inf:
        return NOT_A_NUMBER
    for i in range(n):
        gain = degree * (new_like[i] - like[i]) + new_start[i] - log_start[i]
        if rng.random() < math.exp(min(gain, 0.0)):
            for d in range(size):
                current[d, i] = proposed[d, i]
            like[i], log_start[i] = new_like[i], new_start[i]
    return FINE


@kernel
def _keep(state, like, log_start, current, n, rng, weights, weight_sum):
    """Resample particles with what is known of them."""
    size = current.shape[0]
    ancestors, copied = state.ancestors[:n], columns(state.proposed, size, n)
    resample(SYSTEMATIC, weights, weight_sum, rng, ancestors, columns(state.rate, 2, n))
    gather(current, ancestors, n, copied, 0)
    for i in range(n):
        state.new_like[i], state.new_start[i] = like[ancestors[i]], log_start[ancestors[i]]
    for i in range(n):
        like[i], log_start[i] = state.new_like[i], state.new_start[i]
        for d in range(size):
            current[d, i] = copied[d, i]


@kernel
def draw_annealed(tables, stack, start, row, rng, state, picks, current, log_densities, scratch):
    """Fill `current` (D, n) with draws of the state given only the start belief and the readings at `row`.

    All have the same weight. Returns (status, log evidence, effective sample size of the last degree).
    """
    n = current.shape[1]
    like, log_start, weights = state.log_like[:n], state.log_start[:n], state.weights[:n]
    draw_start(start, rng, current)
    _measure_spread(current, state.spread)
    for i in range(n):
        log_start[i] = 0.0
    start_logpdf(start, current, log_start)
    log_likelihood(tables, stack, row, picks, current, current, like, log_densities, scratch)
    degree, log_evidence, effective = 0.0, 0.0, float(n)
    while degree < 1.0:
        if not total(like) < np.inf:
            return NOT_A_NUMBER, 0.0, 0.0
        greatest = maximum(like)
        if greatest == -np.inf:
            return ALL_ZERO, -np.inf, 0.0
        step = _next_degree(like, greatest, 1.0 - degree, weights)
        effective, weight_sum = _effective_at(step, like, greatest, weights)
        log_evidence += step * greatest + math.log(weight_sum / n)
        degree = 1.0 if step >= 1.0 - degree else degree + step
        _keep(state, like, log_start, current, n, rng, weights, weight_sum)
        for _ in range(_MOVES):
            status = _move(
                tables, stack, start, row, rng, state, picks, degree, current, like, log_start, log_densities, scratch
            )
            if status != FINE:
                return status, 0.0, 0.0
    return FINE, log_evidence, effective
