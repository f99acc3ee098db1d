"""The particle filter: one loop forward in time, with its history (equations of Kaboli, Bowling and Musilek 2006)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.compile import entry, kernel
from pmcl.engine.contract import draw_start, propagate, propagate_widely, scratch_rows, state_size, widens
from pmcl.engine.sensor_tuples import any_reading, count_slots, most_rows
from pmcl.filtering.kernels.resampling import Independent, draw_parents
from pmcl.filtering.kernels.weighing import FINE, AllAtOnce, OneByOne, normalise, weigh

__all__ = ["FilterWork", "History", "conditional_pass", "filter_pass", "forward", "predictive_pass", "work_rows"]

Float = NDArray[np.float64]


class History(NamedTuple):
    """What a pass of the filter leaves, and what backward sampling needs.

    It holds R rows, all T of the log or only the last ones: row t of the log is in row ``t % R``.

    Attributes
    ----------
    particles : ndarray, shape (R, D, n)
        The states.
    log_weights : ndarray, shape (R, n)
        Logs of their weights, not normalised.
    ancestors : ndarray of uint32, shape (R, n)
        The parent of each particle; that of the log's row 0 means nothing.
    """

    particles: Float
    log_weights: Float
    ancestors: NDArray[np.uint32]


class FilterWork(NamedTuple):
    """The arrays of one pass of the filter.

    Attributes
    ----------
    history : History
        Filled.
    steps : ndarray, shape (T, 2)
        Filled with the increment of the log evidence by each step, and the effective sample size.
    previous : ndarray, shape (D, n)
        Work space: the resampled states.
    scratch : ndarray, shape (rows, n)
        Work space, as many rows as :func:`work_rows` says.
    """

    history: History
    steps: Float
    previous: Float
    scratch: Float


@kernel
def work_rows(tables):
    """Return how many rows of scratch space a pass over these tables needs."""
    rows = max(scratch_rows(tables.motion), scratch_rows(tables.start))
    return max(rows, most_rows(tables.sensors)) + 3


@kernel(reorder=True)
def _effective_size(weights, weight_sum):
    squares = 0.0
    for i in range(weights.size):
        squares += weights[i] * weights[i]
    return weight_sum * weight_sum / squares


@kernel
def forward(tables, rng, begin, stop, weighted, scheme, threshold, conditional, path, record, arrays):
    """Run the filter (eqs. 1 and 2) over the rows begin ... stop - 1, going on from row ``begin - 1``.

    With `conditional`, particle 0 follows `path` and the others choose their parents independently (conditional SMC:
    Andrieu, Doucet, Holenstein 2010). Weights are reset by resampling only where something was measured since the
    last time: whether it was does not depend on the particles, so this keeps conditional SMC exact.

    `weighted` says whether the weights of row ``begin - 1`` have not been used by a resampling yet; False for a pass
    from row 0. `record` says how readings are weighed, see :mod:`pmcl.filtering.kernels.weighing`. `arrays` is a
    :class:`FilterWork`. Returns (status, time, log evidence of these rows, weighted), the last for the next rows.
    """
    particles, log_weights, ancestors = arrays.history
    steps, previous = arrays.steps, arrays.previous
    rows, size, n = particles.shape
    # What resampling needs is no longer needed when a model uses its scratch space.
    weights, draft, work = arrays.scratch[0], arrays.scratch[1:3], arrays.scratch[1:]
    log_evidence, log_norm = 0.0, math.log(n)
    # The path that conditional SMC follows is drawn by the transition alone.
    widely = not conditional and widens(tables.motion)
    weight_sum = float(n)
    if weighted:
        status, greatest, weight_sum = normalise(log_weights[(begin - 1) % rows], weights)
        if status != FINE:
            return status, begin - 1, -np.inf, weighted
        log_norm = greatest + math.log(weight_sum)
    for t in range(begin, stop):
        current, logw = particles[t % rows], log_weights[t % rows]
        parent = ancestors[t % rows]
        if t == 0:
            draw_start(tables.start, rng, current)
            before = current
            for i in range(n):
                logw[i] = 0.0
        else:
            before = particles[(t - 1) % rows]
            if weighted and (conditional or steps[t - 1, 1] <= threshold * n):
                draw_parents(scheme, weights, weight_sum, rng, parent, draft)
                if conditional:
                    parent[0] = 0
                for d in range(size):
                    source, gathered = particles[(t - 1) % rows, d], previous[d]
                    for i in range(n):
                        gathered[i] = source[parent[i]]
                before = previous
                weighted = False
                log_norm = math.log(n)
            else:
                for i in range(n):
                    parent[i] = i
            for i in range(n):
                logw[i] = log_weights[(t - 1) % rows, i] if weighted else 0.0
            if widely:
                propagate_widely(tables.motion, t, rng, before, current, logw, work)
            else:
                propagate(tables.motion, t, rng, before, current, work)
        if conditional:
            for d in range(size):
                current[d, 0] = path[t, d]
        steps[t, 0] = 0.0
        read = any_reading(tables.sensors, t)
        if read:
            weigh(record, tables.sensors, t, before, current, logw, weights, work)
        if read or (widely and t > 0):
            status, greatest, weight_sum = normalise(logw, weights)
            if status != FINE:
                return status, t, -np.inf, weighted
            new_norm = greatest + math.log(weight_sum)
            steps[t, 0] = new_norm - log_norm
            steps[t, 1] = _effective_size(weights, weight_sum)
            log_evidence += steps[t, 0]
            log_norm = new_norm
            weighted = True
        else:
            steps[t, 1] = steps[t - 1, 1] if weighted else float(n)
    return FINE, stop - 1, log_evidence, weighted


@entry
def filter_pass(tables, rng, n_steps, n, scheme, threshold):
    """Filter; `scheme` is an :class:`~pmcl.filtering.kernels.resampling.AnyScheme`.

    Returns (status, time, log evidence, particles (T, D, n), log weights (T, n), steps (T, 2), ancestors (T, n)).
    """
    size = state_size(tables.motion)
    particles, log_weights = np.empty((n_steps, size, n)), np.empty((n_steps, n))
    steps, ancestors = np.empty((n_steps, 2)), np.empty((n_steps, n), np.uint32)
    history = History(particles, log_weights, ancestors)
    arrays = FilterWork(history, steps, np.empty((size, n)), np.empty((work_rows(tables), n)))
    status, t, log_evidence, _ = forward(
        tables, rng, 0, n_steps, False, scheme, threshold, False, np.empty((0, size)), AllAtOnce(0.0), arrays
    )
    return status, t, log_evidence, particles, log_weights, steps, ancestors


@entry
def conditional_pass(tables, rng, path, n):
    """Filter with one particle that follows `path` (T, D) (conditional SMC); return what :func:`filter_pass` does."""
    n_steps, size = path.shape
    particles, log_weights = np.empty((n_steps, size, n)), np.empty((n_steps, n))
    steps, ancestors = np.empty((n_steps, 2)), np.empty((n_steps, n), np.uint32)
    history = History(particles, log_weights, ancestors)
    arrays = FilterWork(history, steps, np.empty((size, n)), np.empty((work_rows(tables), n)))
    status, t, log_evidence, _ = forward(
        tables, rng, 0, n_steps, False, Independent(1), 1.0, True, path, AllAtOnce(0.0), arrays
    )
    return status, t, log_evidence, particles, log_weights, steps, ancestors


@entry
def predictive_pass(tables, rng, n_steps, n, scheme, threshold, alone, rows):
    """Do the same, taking the readings of a row one after another, or each `alone`.

    Returns what :func:`filter_pass` does, with a history of `rows` rows (:class:`History`), at least 2 of a log that
    has as many; then log score, low and high (N,) of each slot (see
    :class:`~pmcl.filtering.kernels.weighing.OneByOne`), NaN where nothing was measured.
    """
    size = state_size(tables.motion)
    particles, log_weights = np.empty((rows, size, n)), np.empty((rows, n))
    steps, ancestors = np.empty((n_steps, 2)), np.empty((rows, n), np.uint32)
    slots = count_slots(tables.sensors, n_steps)
    log_score, low, high = np.full(slots, np.nan), np.full(slots, np.nan), np.full(slots, np.nan)
    history = History(particles, log_weights, ancestors)
    arrays = FilterWork(history, steps, np.empty((size, n)), np.empty((work_rows(tables), n)))
    record = OneByOne(n_steps, log_score, low, high, np.empty((7, n)), alone)
    status, t, log_evidence, _ = forward(
        tables, rng, 0, n_steps, False, scheme, threshold, False, np.empty((0, size)), record, arrays
    )
    return status, t, log_evidence, particles, log_weights, steps, ancestors, log_score, low, high
