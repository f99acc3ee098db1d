"""The localizing filter: one time step after the other, keeping only what a robot needs to know about where it is.

Unlike :mod:`~pmcl.filtering.kernels.smc` no history is kept: memory is O(n). The same machine code runs a whole log and
a single step on a robot, so both give the same numbers to the last bit. Numbers in brackets are the equations of
Kaboli, Bowling and Musilek (2006).
"""

from __future__ import annotations

import math

import numpy as np

from pmcl.filtering.kernels import drawn_tables  # noqa: F401  (registers itself)
from pmcl.filtering.kernels.adapt import gather, redraw
from pmcl.filtering.kernels.anneal import draw_annealed, log_likelihood
from pmcl.filtering.kernels.compile import entry, kernel
from pmcl.filtering.kernels.contract import draw_start, state_size
from pmcl.filtering.kernels.drawn import move_by_draws
from pmcl.filtering.kernels.localize_state import (
    COUNT,
    EFFECTIVE,
    FAST,
    FRESH,
    SEEN,
    SLOW,
    STARTED,
    WEIGHT_SUM,
)
from pmcl.filtering.kernels.resampling import SYSTEMATIC, resample
from pmcl.filtering.kernels.smc import ALL_ZERO, FINE, normalise
from pmcl.filtering.kernels.tuples import any_reading
from pmcl.filtering.kernels.vector_math import sincos_into
from pmcl.filtering.kernels.views import columns

__all__ = ["localize_rows"]

_TURN = 2.0 * math.pi


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
def moments(particles, weights, weight_sum, mean, covariance, work):
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
                turn = source[i] - centre
                deviation[i] = turn - _TURN * math.floor(turn / _TURN + 0.5)
        else:
            for i in range(n):
                deviation[i] = source[i] - centre
    for a in range(size):
        for b in range(a + 1):
            covariance[a, b] = covariance[b, a] = _dot3(weights, work[a], work[b]) / weight_sum


@kernel
def _choose_draws(options, rng, shuffled):
    """Bring `picks` of the K draws to the front, without repetition."""
    if options.picks >= options.draws:
        return
    for j in range(options.picks):
        other = j + min(int(rng.random() * (options.draws - j)), options.draws - j - 1)
        shuffled[j], shuffled[other] = shuffled[other], shuffled[j]


@kernel
def _level(state, n):
    """Give n particles equal weights."""
    log_weight = -math.log(n)
    for i in range(n):
        state.weights[i] = 1.0
        state.log_weights[i] = log_weight
    numbers = state.numbers
    numbers[COUNT], numbers[WEIGHT_SUM], numbers[EFFECTIVE], numbers[FRESH] = n, n, n, 1.0


@kernel
def _weigh(state, n, log_weights):
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
def _advance(tables, stack, options, row, rng, state, size, rows):
    """Resample if it is time, and move all particles from one row to the next (eqs. 1 and 21)."""
    numbers = state.numbers
    n = int(numbers[COUNT])
    if numbers[FRESH] == 0.0 and numbers[EFFECTIVE] <= options.threshold * n:
        n = redraw(options, rng, state, size, n, numbers[WEIGHT_SUM])
        _level(state, n)
    else:
        for i in range(size * n):
            state.before[i] = state.particles[i]
    move_by_draws(
        tables.motion, stack.motion, options.draws, row, rng, state.which[:n], columns(state.before, size, n),
        columns(state.particles, size, n), columns(state.scratch, rows, n), state.order[:n], state.counts,
        state.spare,
    )  # fmt: skip


@kernel
def _suspicion(options, numbers, status, log_score, count):
    """Update the average likelihoods of a reading; return the probability that the robot is somewhere else.

    The rule of Gutmann and Fox (2002): one minus the ratio of short- to long-term average, with a tolerance. The
    likelihood is the geometric mean over the readings of a step, so that steps with many and with few compare.
    """
    likelihood = math.exp(log_score / max(count, 1)) if status == FINE else 0.0
    if numbers[SEEN] == 0.0:
        numbers[FAST] = numbers[SLOW] = likelihood
    numbers[FAST] += options.fast * (likelihood - numbers[FAST])
    numbers[SLOW] += options.slow * (likelihood - numbers[SLOW])
    if status == ALL_ZERO:
        return 1.0
    if numbers[SLOW] <= 0.0:
        return 0.0
    return max(0.0, 1.0 - options.tolerance * numbers[FAST] / numbers[SLOW])


@kernel
def _look_elsewhere(tables, stack, anywhere, row, rng, state, size, rows, suspicion, picks, log_score):
    """Replace a part of the particles by poses that the readings alone suggest.

    With probability `suspicion` the robot may be anywhere: that part of the belief is drawn anew, by annealing, with
    the evidence of the readings as its weight. The weighted mixture is the filter's belief under exactly that
    assumption. Returns (status, log score of the mixture).
    """
    numbers = state.numbers
    n = int(numbers[COUNT])
    fresh = n if suspicion >= 1.0 else n // 2
    kept = n - fresh
    particles, spare = columns(state.particles, size, n), columns(state.spare, size, n)
    if kept > 0:
        ancestors = state.ancestors[:kept]
        resample(SYSTEMATIC, state.weights[:n], numbers[WEIGHT_SUM], rng, ancestors, state.rate[:n])
        gather(particles, ancestors, kept, spare, 0)
    drawn = columns(state.particles, size, fresh)
    status, log_evidence, _ = draw_annealed(
        tables, stack, anywhere, row, rng, state, picks, drawn,
        columns(state.log_densities, picks.size, fresh), columns(state.scratch, rows, fresh),
    )  # fmt: skip
    if status != FINE and (status != ALL_ZERO or kept == 0):
        return status, -np.inf
    for d in range(size):
        for i in range(fresh):
            spare[d, kept + i] = drawn[d, i]
    for i in range(size * n):
        state.particles[i] = state.spare[i]
    log_weights = state.new_like[:n]
    for i in range(kept):
        log_weights[i] = math.log1p(-suspicion) + log_score - math.log(kept)
    for i in range(kept, n):
        log_weights[i] = math.log(suspicion) + log_evidence - math.log(fresh)
    return _weigh(state, n, log_weights)


@kernel
def _read(tables, stack, anywhere, options, row, count, rng, state, size, rows, before, current, first):
    """Weigh the particles by the readings at `row` (eqs. 2 and 24); return (status, log score)."""
    numbers = state.numbers
    n = int(numbers[COUNT])
    picks = state.shuffled[: options.picks]
    log_densities, scratch = columns(state.log_densities, options.picks, n), columns(state.scratch, rows, n)
    if numbers[SEEN] == 0.0 and (options.annealed == 2 or (options.annealed == 1 and first)):
        status, log_score, effective = draw_annealed(
            tables, stack, tables.start, row, rng, state, picks, current, log_densities, scratch
        )
        _level(state, n)
        numbers[EFFECTIVE] = effective
    else:
        log_like = state.log_like[:n]
        log_likelihood(tables, stack, row, picks, before, current, log_like, log_densities, scratch)
        for i in range(n):
            log_like[i] += state.log_weights[i]
        status, log_score = _weigh(state, n, log_like)
    if options.recover and status in (FINE, ALL_ZERO):
        suspicion = _suspicion(options, numbers, status, log_score, count)
        if suspicion > 0.0:
            status, log_score = _look_elsewhere(
                tables, stack, anywhere, row, rng, state, size, rows, suspicion, picks, log_score
            )
    numbers[SEEN] = 1.0
    return status, log_score


@kernel
def _step(tables, stack, anywhere, options, row, count, rng, state, mean, covariance, told):
    """Take in one row; write mean (D,), covariance (D, D) and (log score, effective sample size, n); return status."""
    size, numbers = state_size(tables.motion), state.numbers
    rows = state.scratch.size // state.log_weights.size
    _choose_draws(options, rng, state.shuffled)
    first = numbers[STARTED] == 0.0
    if first:
        numbers[STARTED] = 1.0
        _level(state, options.particles)
        draw_start(tables.start, rng, columns(state.particles, size, options.particles))
    else:
        _advance(tables, stack, options, row, rng, state, size, rows)
    n = int(numbers[COUNT])
    current = columns(state.particles, size, n)
    before = current if first else columns(state.before, size, n)
    told[0] = 0.0
    if any_reading(tables.sensors, row):
        status, told[0] = _read(
            tables, stack, anywhere, options, row, count, rng, state, size, rows, before, current, first
        )
        if status != FINE:
            return status
    told[1], told[2] = numbers[EFFECTIVE], n
    moments(current, state.weights[:n], numbers[WEIGHT_SUM], mean, covariance, columns(state.scratch, rows, n))
    return FINE


@entry
def localize_rows(tables, stack, anywhere, options, begin, end, counts, rng, state, means, covariances, told):
    """Run the filter over rows ``begin <= row < end`` of a log, going on from `state`.

    Parameters
    ----------
    tables, stack : Tables
        Tables of one draw of the parameters, and the stack of all K (the same object when theta is one value).
    anywhere : NamedTuple
        Start belief of a robot that may be anywhere, for recovery.
    options : Options
        See :class:`~pmcl.filtering.kernels.localize_state.Options`.
    begin, end : int
        Rows of the tables.
    counts : ndarray of int, shape (end - begin,)
        Number of readings at each row.
    rng : numpy.random.Generator
        Source of randomness.
    state : FilterState
        Memory of the filter, changed in place.
    means, covariances, told : ndarray, shape (end - begin, D), (end - begin, D, D), (end - begin, 3)
        Filled: belief at each row; log score, effective sample size and number of particles.

    Returns
    -------
    status, row : int
        How it ended and at which row.
    """
    for row in range(begin, end):
        i = row - begin
        status = _step(
            tables, stack, anywhere, options, row, counts[i], rng, state, means[i], covariances[i], told[i]
        )
        if status != FINE:
            return status, row
    return FINE, end - 1
