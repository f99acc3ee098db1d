"""A robot that may be anywhere: its first reading, and where else it may be when its readings become unlikely."""

from __future__ import annotations

import math

import numpy as np

from pmcl.engine.compile import entry
from pmcl.engine.contract import state_size
from pmcl.engine.views import columns
from pmcl.filtering.kernels.resampling import SYSTEMATIC, resample
from pmcl.filtering.kernels.tracking.adapt import gather
from pmcl.filtering.kernels.tracking.anneal import draw_annealed
from pmcl.filtering.kernels.tracking.belief import level, summarise, weigh
from pmcl.filtering.kernels.tracking.state import COUNT, EFFECTIVE, SEEN, SUSPICION, WEIGHT_SUM
from pmcl.filtering.kernels.weighing import ALL_ZERO, FINE

__all__ = ["first_reading", "look_elsewhere"]


@entry
def first_reading(tables, stack, options, row, rng, state, mean, covariance, diagnostics):
    """Take in the readings at `row` by degrees, from the start belief; return the status.

    Arguments are those of :func:`~pmcl.filtering.kernels.tracking.track.localize_rows`, and the arrays of this row.
    """
    size, numbers = state_size(tables.motion), state.numbers
    n, rows = int(numbers[COUNT]), state.scratch.size // state.log_weights.size
    status, log_score, effective = draw_annealed(
        tables, stack, tables.start, row, rng, state, state.shuffled[: options.picks],
        columns(state.particles, size, n), columns(state.log_densities, options.picks, n),
        columns(state.scratch, rows, n),
    )  # fmt: skip
    if status != FINE:
        return status
    level(state, n)
    numbers[SEEN], numbers[EFFECTIVE] = 1.0, effective
    summarise(state, size, log_score, mean, covariance, diagnostics)
    return FINE


@entry
def look_elsewhere(tables, stack, anywhere, options, row, rng, state, mean, covariance, diagnostics):
    """Replace a part of the particles by states that the readings at `row` alone suggest; return the status.

    With probability ``numbers[SUSPICION]`` the robot is anywhere: that part of the belief is drawn anew, by annealing
    from the belief `anywhere`, with the evidence of the readings as its weight. The weighted mixture is the filter's
    belief under exactly that assumption, so a false alarm costs little: the new states then weigh next to nothing.
    ``diagnostics[0]`` holds the log score of the old states, and afterwards that of the mixture.
    """
    size, numbers = state_size(tables.motion), state.numbers
    known, suspicion = int(numbers[COUNT]), numbers[SUSPICION]
    # A robot that may be anywhere needs as many particles as the filter may have; they become fewer with its spread.
    n, rows = options.most, state.scratch.size // state.log_weights.size
    fresh = n if suspicion >= 1.0 else n // 2
    kept = n - fresh
    particles, spare = columns(state.particles, size, known), columns(state.spare, size, n)
    if kept > 0:
        ancestors = state.ancestors[:kept]
        resample(SYSTEMATIC, state.weights[:known], numbers[WEIGHT_SUM], rng, ancestors, columns(state.rate, 2, n))
        gather(particles, ancestors, kept, spare, 0)
    drawn = columns(state.particles, size, fresh)
    status, log_evidence, _ = draw_annealed(
        tables, stack, anywhere, row, rng, state, state.shuffled[: options.picks], drawn,
        columns(state.log_densities, options.picks, fresh), columns(state.scratch, rows, fresh),
    )  # fmt: skip
    if status != FINE and (status != ALL_ZERO or kept == 0):
        return status
    for d in range(size):
        for i in range(fresh):
            spare[d, kept + i] = drawn[d, i]
    for i in range(size * n):
        state.particles[i] = state.spare[i]
    log_weights = state.new_like[:n]
    for i in range(kept):
        log_weights[i] = math.log1p(-suspicion) + diagnostics[0] - math.log(kept)
    for i in range(kept, n):
        log_weights[i] = math.log(suspicion) + log_evidence - math.log(fresh) if status == FINE else -np.inf
    status, log_score = weigh(state, n, log_weights)
    if status == FINE:
        summarise(state, size, log_score, mean, covariance, diagnostics)
    return status
