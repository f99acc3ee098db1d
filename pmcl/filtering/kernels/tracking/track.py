"""The localizing filter: one time step after the other, keeping only what a robot needs to know about where it is.

Unlike :mod:`~pmcl.filtering.kernels.smc` no history is kept: memory is O(n). The same machine code runs a whole log and
a single step on a robot, so both give the same numbers to the last bit. What is rarely needed, finding a robot that may
be anywhere, is compiled apart (:mod:`~pmcl.filtering.kernels.tracking.recovery`): this loop stops and says so. Numbers
in brackets are the equations of Kaboli, Bowling and Musilek (2006).
"""

from __future__ import annotations

import math

from pmcl.engine.compile import entry, kernel
from pmcl.engine.contract import draw_start, state_size
from pmcl.engine.parameter_draws import log_likelihood, move_by_draws
from pmcl.engine.sensor_tuples import any_reading
from pmcl.engine.views import columns
from pmcl.filtering.kernels.tracking.adapt import redraw
from pmcl.filtering.kernels.tracking.belief import level, summarise, weigh
from pmcl.filtering.kernels.tracking.state import (
    COUNT,
    EFFECTIVE,
    FAST,
    FRESH,
    SEEN,
    SLOW,
    STARTED,
    SUSPICION,
    WEIGHT_SUM,
)
from pmcl.filtering.kernels.weighing import ALL_ZERO, FINE

__all__ = ["SOMEWHERE_ELSE", "START_UNKNOWN", "localize_rows"]

# Why the loop stops before its end, besides the outcomes of any pass: the first reading is to be taken in by degrees;
# the readings say that the robot may be somewhere else.
START_UNKNOWN, SOMEWHERE_ELSE = 11, 12


@kernel
def _choose_draws(options, rng, shuffled):
    """Bring `picks` of the K draws to the front, without repetition."""
    if options.picks >= options.draws:
        return
    for j in range(options.picks):
        other = j + min(int(rng.random() * (options.draws - j)), options.draws - j - 1)
        shuffled[j], shuffled[other] = shuffled[other], shuffled[j]


@kernel
def _advance(tables, stack, options, row, rng, state, size, rows):
    """Resample if it is time, and move all particles from one row to the next (eqs. 1 and 21)."""
    numbers = state.numbers
    n = int(numbers[COUNT])
    if numbers[FRESH] == 0.0 and numbers[EFFECTIVE] <= options.threshold * n:
        n = redraw(options, rng, state, size, n, numbers[WEIGHT_SUM])
        level(state, n)
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
    likelihood is the geometric mean over the independent readings of a step, so that steps with many and with few
    compare. A step of few readings moves the averages less, as it tells less.
    """
    likelihood = math.exp(log_score / max(count, 1.0)) if status == FINE else 0.0
    if numbers[SEEN] == 0.0:
        numbers[FAST] = numbers[SLOW] = likelihood
    share = min(1.0, count / options.usual_readings)
    numbers[FAST] += (1.0 - (1.0 - options.fast) ** share) * (likelihood - numbers[FAST])
    numbers[SLOW] += (1.0 - (1.0 - options.slow) ** share) * (likelihood - numbers[SLOW])
    if status == ALL_ZERO:
        return 1.0  # nowhere near any particle
    if numbers[SLOW] <= 0.0:
        return 0.0
    return max(0.0, 1.0 - options.tolerance * numbers[FAST] / numbers[SLOW])


@kernel
def _read(tables, stack, options, row, count, rng, state, size, first):
    """Weigh the particles by the readings at `row` (eqs. 2 and 24); return (status, log score)."""
    numbers = state.numbers
    n = int(numbers[COUNT])
    rows = state.scratch.size // state.log_weights.size
    current = columns(state.particles, size, n)
    before = current if first else columns(state.before, size, n)
    log_like = state.log_like[:n]
    log_likelihood(
        tables, stack, row, state.shuffled[: options.picks], before, current, log_like,
        columns(state.log_densities, options.picks, n), columns(state.scratch, rows, n),
    )  # fmt: skip
    for i in range(n):
        log_like[i] += state.log_weights[i]
    status, log_score = weigh(state, n, log_like)
    if options.recover and status in (FINE, ALL_ZERO):
        numbers[SUSPICION] = _suspicion(options, numbers, status, log_score, count)
        if numbers[SUSPICION] > 0.0:
            status = SOMEWHERE_ELSE
    numbers[SEEN] = 1.0
    return status, log_score


@kernel
def _step(tables, stack, options, row, count, rng, state, mean, covariance, diagnostics):
    """Take in one row; return its status. One that is not FINE leaves the belief to be summarised."""
    size, numbers = state_size(tables.motion), state.numbers
    rows = state.scratch.size // state.log_weights.size
    _choose_draws(options, rng, state.shuffled)
    first = numbers[STARTED] == 0.0
    if first:
        numbers[STARTED] = 1.0
        level(state, options.particles)
        draw_start(tables.start, rng, columns(state.particles, size, options.particles))
    else:
        _advance(tables, stack, options, row, rng, state, size, rows)
    log_score = 0.0
    if any_reading(tables.sensors, row):
        if numbers[SEEN] == 0.0 and (options.annealed == 2 or (options.annealed == 1 and first)):
            return START_UNKNOWN
        status, log_score = _read(tables, stack, options, row, count, rng, state, size, first)
        diagnostics[0] = log_score
        if status != FINE:
            return status
    summarise(state, size, log_score, mean, covariance, diagnostics)
    return FINE


@entry
def localize_rows(tables, stack, options, origin, begin, end, counts, rng, state, means, covariances, diagnostics):
    """Run the filter over rows ``begin <= row < end`` of a log, going on from `state`.

    Parameters
    ----------
    tables, stack : Tables
        Tables of one draw of the parameters, and the stack of all K (the same object when theta is one value).
    options : Options
        See :class:`~pmcl.filtering.kernels.tracking.state.Options`.
    origin, begin, end : int
        Rows of the tables: the one that results are counted from, and those to take in.
    counts : ndarray, shape (N,)
        How many independent readings those of rows origin, origin + 1, ... are worth.
    rng : numpy.random.Generator
        Source of randomness.
    state : FilterState
        Memory of the filter, changed in place.
    means, covariances, diagnostics : ndarray, shape (N, D), (N, D, D), (N, 3)
        Filled: belief at each row; log score, effective sample size and number of particles.

    Returns
    -------
    status, row : int
        How it ended and at which row.
    """
    for row in range(begin, end):
        i = row - origin
        status = _step(tables, stack, options, row, counts[i], rng, state, means[i], covariances[i], diagnostics[i])
        if status != FINE:
            return status, row
    return FINE, end - 1
