"""The fused loops over time: particle filter, backward sampling, conditional SMC, joint density.

One specialised loop is compiled for each combination of table types. Numbers in brackets are the equations of Kaboli,
Bowling and Musilek (2006).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.compile import entry, kernel
from pmcl.engine.contract import (
    draw_start,
    path_reading_logpdf,
    path_transition_logpdf,
    propagate,
    scratch_rows,
    start_logpdf,
    state_size,
    transition_logpdf,
)
from pmcl.engine.sensor_tuples import (
    any_look_back,
    any_reading,
    count_slots,
    most_rows,
    sum_logpdf,
    sum_path_logpdf,
)
from pmcl.engine.vector_math import total
from pmcl.filtering.kernels.resampling import Independent, draw_index, draw_parents
from pmcl.filtering.kernels.weighing import (
    ALL_ZERO,
    FINE,
    NO_ANCESTOR,
    NOT_A_NUMBER,
    AllAtOnce,
    OneByOne,
    normalise,
    weigh,
)

__all__ = [
    "ALL_ZERO",
    "FINE",
    "NOT_A_NUMBER",
    "NO_ANCESTOR",
    "filter_pass",
    "joint_logpdf",
    "joint_terms",
    "motion_terms",
    "predictive_pass",
    "redraw_path",
    "sample_backward",
    "sensor_terms",
    "work_rows",
]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# How many particles are weighed when one state of a trajectory is drawn backward.
_WEIGHED = 32


class History(NamedTuple):
    """What a pass of the filter leaves, and what backward sampling needs.

    Attributes
    ----------
    particles : ndarray, shape (T, D, n)
        The states.
    log_weights : ndarray, shape (T, n)
        Logs of their weights, not normalised.
    ancestors : ndarray of uint32, shape (T, n)
        The parent of each particle; row 0 means nothing.
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


class BackwardWork(NamedTuple):
    """Work space of backward sampling; m is how many particles are weighed for each state but the last, at most n.

    Attributes
    ----------
    weights : ndarray, shape (n,)
        Weights of the last row.
    drawn : ndarray of int, shape (m,)
        The particles that are weighed.
    states : ndarray, shape (2, D, m)
        Their states, and the state after them.
    scratch : ndarray, shape (rows, m)
        As many rows as :func:`work_rows` says.
    """

    weights: Float
    drawn: Int
    states: Float
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
def _forward(tables, rng, n_steps, scheme, threshold, conditional, path, record, arrays):
    """Run the filter (eqs. 1 and 2) over the first `n_steps` rows.

    With `conditional`, particle 0 follows `path` and the others choose their parents independently (conditional SMC:
    Andrieu, Doucet, Holenstein 2010). Weights are reset by resampling only where something was measured since the
    last time: whether it was does not depend on the particles, so this keeps conditional SMC exact.

    `record` says how readings are weighed, see :mod:`pmcl.filtering.kernels.weighing`. `arrays` is a
    :class:`FilterWork`. Returns (status, time, log evidence).
    """
    particles, log_weights, ancestors = arrays.history
    steps, previous = arrays.steps, arrays.previous
    size, n = particles.shape[1], particles.shape[2]
    # What resampling needs is no longer needed when a model uses its scratch space.
    weights, draft, work = arrays.scratch[0], arrays.scratch[1:3], arrays.scratch[1:]
    log_evidence, log_norm = 0.0, math.log(n)
    weighted = False
    weight_sum = float(n)
    for t in range(n_steps):
        current, logw = particles[t], log_weights[t]
        parent = ancestors[t]
        if t == 0:
            draw_start(tables.start, rng, current)
            before = current
            for i in range(n):
                logw[i] = 0.0
        else:
            before = particles[t - 1]
            if weighted and (conditional or steps[t - 1, 1] <= threshold * n):
                draw_parents(scheme, weights, weight_sum, rng, parent, draft)
                if conditional:
                    parent[0] = 0
                for d in range(size):
                    source, gathered = particles[t - 1, d], previous[d]
                    for i in range(n):
                        gathered[i] = source[parent[i]]
                before = previous
                weighted = False
                log_norm = math.log(n)
            else:
                for i in range(n):
                    parent[i] = i
            propagate(tables.motion, t, rng, before, current, work)
            for i in range(n):
                logw[i] = log_weights[t - 1, i] if weighted else 0.0
        if conditional:
            for d in range(size):
                current[d, 0] = path[t, d]
        steps[t, 0] = 0.0
        if any_reading(tables.sensors, t):
            weigh(record, tables.sensors, t, before, current, logw, weights, work)
            status, greatest, weight_sum = normalise(logw, weights)
            if status != FINE:
                return status, t, -np.inf
            new_norm = greatest + math.log(weight_sum)
            steps[t, 0] = new_norm - log_norm
            steps[t, 1] = _effective_size(weights, weight_sum)
            log_evidence += steps[t, 0]
            log_norm = new_norm
            weighted = True
        else:
            steps[t, 1] = steps[t - 1, 1] if weighted else float(n)
    return FINE, n_steps - 1, log_evidence


@kernel
def _state_before(tables, rng, t, ancestor, history, path, arrays):
    """Choose the state at t that leads to ``path[t + 1]`` (eq. 5); return (status, which).

    Its weight is w_t p(x_t+1 | x_t), times the density of the next readings where those look back. Of many particles
    not all are weighed, but the ancestor in the filter and some others drawn evenly. The ancestor of a state has the
    law of eq. 5 itself, and a choice among it and rivals by their weights leaves that law as it is (conditional
    importance resampling; compare Dau and Chopin, On backward smoothing algorithms, 2023).
    """
    particles, log_weights, drawn, work = history.particles, history.log_weights, arrays.drawn, arrays.scratch
    size, n, count = particles.shape[1], particles.shape[2], drawn.size
    before, after, log_b, b = arrays.states[0], arrays.states[1], work[0], work[1]
    if count == n:
        before = particles[t]
        for j in range(n):
            drawn[j] = j
            log_b[j] = log_weights[t, j]
    else:
        for j in range(count):
            drawn[j] = min(int(rng.random() * n), n - 1)
        drawn[0] = ancestor
        for j in range(count):
            log_b[j] = log_weights[t, drawn[j]]
        for d in range(size):
            source, target = particles[t, d], before[d]
            for j in range(count):
                target[j] = source[drawn[j]]
    transition_logpdf(tables.motion, t + 1, before, path[t + 1], log_b, work[2:])
    if any_look_back(tables.sensors) and any_reading(tables.sensors, t + 1):
        for d in range(size):
            for j in range(count):
                after[d, j] = path[t + 1, d]
        sum_logpdf(tables.sensors, t + 1, before, after, log_b, work[2:])
    status, _, b_sum = normalise(log_b, b)
    if status != FINE:
        return (NO_ANCESTOR if status == ALL_ZERO else status), 0
    return FINE, drawn[draw_index(b, b_sum, rng)]


@kernel
def _backward(tables, rng, n_steps, history, path, arrays):
    """Draw one trajectory backward in time (eqs. 3 to 7) into `path` (T, D); `arrays` is a :class:`BackwardWork`.

    The last state is drawn with the filter's weights. Returns (status, time, number of states that differ from what
    `path` held).
    """
    particles = history.particles
    size, changed = particles.shape[1], 0
    status, _, weight_sum = normalise(history.log_weights[n_steps - 1], arrays.weights)
    if status != FINE:
        return status, n_steps - 1, changed
    chosen = draw_index(arrays.weights, weight_sum, rng)
    for t in range(n_steps - 1, -1, -1):
        if t < n_steps - 1:
            ancestor = history.ancestors[t + 1, chosen]
            status, chosen = _state_before(tables, rng, t, ancestor, history, path, arrays)
        if status != FINE:
            return status, t, changed
        different = False
        for d in range(size):
            if path[t, d] != particles[t, d, chosen]:
                different = True
                path[t, d] = particles[t, d, chosen]
        changed += different
    return FINE, 0, changed


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
    status, t, log_evidence = _forward(
        tables, rng, n_steps, scheme, threshold, False, np.empty((0, size)), AllAtOnce(0.0), arrays
    )
    return status, t, log_evidence, particles, log_weights, steps, ancestors


@entry
def predictive_pass(tables, rng, n_steps, n, scheme, threshold):
    """Do the same, taking the readings of a row one after another.

    Returns what :func:`filter_pass` does, then log score, low and high (N,) of each slot (see
    :class:`~pmcl.filtering.kernels.weighing.OneByOne`); NaN where nothing was measured.
    """
    size = state_size(tables.motion)
    particles, log_weights = np.empty((n_steps, size, n)), np.empty((n_steps, n))
    steps, ancestors = np.empty((n_steps, 2)), np.empty((n_steps, n), np.uint32)
    slots = count_slots(tables.sensors, n_steps)
    log_score, low, high = np.full(slots, np.nan), np.full(slots, np.nan), np.full(slots, np.nan)
    history = History(particles, log_weights, ancestors)
    arrays = FilterWork(history, steps, np.empty((size, n)), np.empty((work_rows(tables), n)))
    record = OneByOne(n_steps, log_score, low, high, np.empty((6, n)))
    status, t, log_evidence = _forward(
        tables, rng, n_steps, scheme, threshold, False, np.empty((0, size)), record, arrays
    )
    return status, t, log_evidence, particles, log_weights, steps, ancestors, log_score, low, high


@entry
def sample_backward(tables, rng, particles, log_weights, ancestors, n_paths):
    """Draw trajectories from a filter pass; return (status, time, paths (n_paths, T, D))."""
    n_steps, size, n = particles.shape
    count = min(n, _WEIGHED)
    history, paths = History(particles, log_weights, ancestors), np.zeros((n_paths, n_steps, size))
    arrays = BackwardWork(
        np.empty(n), np.empty(count, np.int64), np.empty((2, size, count)), np.empty((work_rows(tables), count))
    )
    for k in range(n_paths):
        status, t, _ = _backward(tables, rng, n_steps, history, paths[k], arrays)
        if status != FINE:
            return status, t, paths
    return FINE, 0, paths


@entry
def redraw_path(tables, rng, n_steps, n, conditional, path):
    """Replace the first `n_steps` states of `path` (T, D) by one smoothing or conditional draw, in place.

    Returns (status, time, log evidence, mean effective sample size where something was measured, states changed).
    A failed pass leaves `path` as it was.
    """
    size = path.shape[1]
    steps, scratch = np.empty((n_steps, 2)), np.empty((work_rows(tables), n))
    history = History(np.empty((n_steps, size, n)), np.empty((n_steps, n)), np.empty((n_steps, n), np.uint32))
    arrays = FilterWork(history, steps, np.empty((size, n)), scratch)
    scheme = Independent(1 if conditional else 0)
    status, t, log_evidence = _forward(
        tables, rng, n_steps, scheme, 1.0, conditional, path, AllAtOnce(0.0), arrays
    )
    if status != FINE:
        return status, t, log_evidence, 0.0, 0
    # Copies are loops: numba compiles four seconds of error messages for each assignment of a slice.
    new, count = np.empty((n_steps, size)), min(n, _WEIGHED)
    for t in range(n_steps):
        for d in range(size):
            new[t, d] = path[t, d]
    backward = BackwardWork(
        scratch[0], np.empty(count, np.int64), np.empty((2, size, count)), np.empty((work_rows(tables), count))
    )
    status, t, changed = _backward(tables, rng, n_steps, history, new, backward)
    if status != FINE:
        return status, t, log_evidence, 0.0, 0
    for s in range(n_steps):
        for d in range(size):
            path[s, d] = new[s, d]
    effective, measured = 0.0, 0
    for s in range(n_steps):
        if steps[s, 0] != 0.0:
            effective += steps[s, 1]
            measured += 1
    return FINE, 0, log_evidence, effective / max(measured, 1), changed


@kernel
def joint_logpdf(tables, columns, logp, scratch):
    """Return log p(path, readings | theta) of a path as `columns` (D, T); `logp` (T,) receives each row's share."""
    n_steps, size = columns.shape[1], columns.shape[0]
    for t in range(n_steps):
        logp[t] = 0.0
    first = scratch[0, :size]
    for d in range(size):
        first[d] = columns[d, 0]
    start_logpdf(tables.start, first.reshape(size, 1), logp[:1])
    path_transition_logpdf(tables.motion, n_steps, columns, logp, scratch)
    sum_path_logpdf(tables.sensors, n_steps, columns, logp, scratch)
    return total(logp)


@entry
def joint_terms(tables, path):
    """Return log p(path, readings | theta) of `path` (T, D), eq. 16 without the prior, and each row's share (T,)."""
    n_steps, size = path.shape
    columns, logp = np.empty((size, n_steps)), np.empty(n_steps)
    for t in range(n_steps):
        for d in range(size):
            columns[d, t] = path[t, d]
    value = joint_logpdf(tables, columns, logp, np.empty((work_rows(tables), max(n_steps, size))))
    return value, logp


@entry
def motion_terms(start, motion, columns):
    """Return the log densities of start and transitions of trajectories `columns` (M, D, T), as (M, T)."""
    n_paths, size, n_steps = columns.shape
    logp = np.zeros((n_paths, n_steps))
    rows = max(scratch_rows(motion), scratch_rows(start)) + 3
    scratch = np.empty((rows, max(n_steps, size)))
    for k in range(n_paths):
        first = scratch[0, :size]
        for d in range(size):
            first[d] = columns[k, d, 0]
        start_logpdf(start, first.reshape(size, 1), logp[k, :1])
        path_transition_logpdf(motion, n_steps, columns[k], logp[k], scratch)
    return logp


@entry
def sensor_terms(sensor, columns):
    """Return the log densities of one sensor's readings along trajectories `columns` (M, D, T), as (M, T)."""
    n_paths, size, n_steps = columns.shape
    logp = np.zeros((n_paths, n_steps))
    scratch = np.empty((scratch_rows(sensor) + 3, max(n_steps, size)))
    for k in range(n_paths):
        path_reading_logpdf(sensor, n_steps, columns[k], logp[k], scratch)
    return logp
