"""The fused loops over time: particle filter, backward sampling, conditional SMC, joint density.

One specialised loop is compiled for each combination of table types. Numbers in brackets are the equations of Kaboli,
Bowling and Musilek (2006).
"""

from __future__ import annotations

import math

import numpy as np

import pmcl.filtering.kernels.landmarks
import pmcl.filtering.kernels.motion
import pmcl.filtering.kernels.ranges
import pmcl.filtering.kernels.rich_landmarks
import pmcl.filtering.kernels.rich_motion
import pmcl.filtering.kernels.rich_ranges
import pmcl.filtering.kernels.start  # noqa: F401  (they register themselves)
from pmcl.filtering.kernels.compile import entry, kernel
from pmcl.filtering.kernels.contract import (
    draw_start,
    path_reading_logpdf,
    path_transition_logpdf,
    propagate,
    scratch_rows,
    start_logpdf,
    state_size,
    transition_logpdf,
)
from pmcl.filtering.kernels.resampling import MULTINOMIAL, draw_index, multinomial_into, resample
from pmcl.filtering.kernels.tuples import (
    any_look_back,
    any_reading,
    count_slots,
    most_rows,
    sum_logpdf,
    sum_path_logpdf,
)
from pmcl.filtering.kernels.vector_math import total
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
    "joint",
    "joint_terms",
    "motion_terms",
    "predictive_pass",
    "sample_backward",
    "sensor_terms",
    "sweep",
    "work_rows",
]

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
def _forward(
    tables,
    rng,
    n_steps,
    scheme,
    threshold,
    conditional,
    path,
    record,
    particles,
    log_weights,
    steps,
    ancestors,
    previous,
    scratch,
):
    """Run the filter (eqs. 1 and 2) over the first `n_steps` rows.

    With `conditional`, slot 0 follows `path` and the other slots choose their parents independently (conditional SMC:
    Andrieu, Doucet, Holenstein 2010). Weights are reset by resampling only where something was measured since the
    last time: whether it was does not depend on the particles, so this keeps the conditional kernel exact.

    `record` says how readings are weighed, see :mod:`pmcl.filtering.kernels.weighing`. `steps` (T, 2) receives the log
    of each step's evidence increment and the effective sample size.
    Returns (status, time, log evidence).
    """
    size, n = particles.shape[1], particles.shape[2]
    weights, spacings = scratch[0], scratch[1]
    work = scratch[2:]
    log_evidence, log_norm = 0.0, math.log(n)
    weighted = False
    weight_sum = float(n)
    for t in range(n_steps):
        current, logw = particles[t], log_weights[t]
        if t == 0:
            draw_start(tables.start, rng, current)
            before = current
            for i in range(n):
                logw[i] = 0.0
        else:
            before = particles[t - 1]
            if weighted and (conditional or steps[t - 1, 1] <= threshold * n):
                if conditional:
                    multinomial_into(weights, weight_sum, rng, 1, ancestors, spacings)
                    ancestors[0] = 0
                else:
                    resample(scheme, weights, weight_sum, rng, ancestors, spacings)
                for d in range(size):
                    source, gathered = particles[t - 1, d], previous[d]
                    for i in range(n):
                        gathered[i] = source[ancestors[i]]
                before = previous
                weighted = False
                log_norm = math.log(n)
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
def _backward(tables, rng, n_steps, particles, log_weights, path, replicated, scratch):
    """Draw one trajectory backward in time (eqs. 3 to 7) into `path` (T, D).

    The last state is drawn with the filter's weights, each earlier one with weight w_t p(x_t+1 | x_t), times the
    density of the next readings where those look back. Returns (status, time, number of states that differ from what
    `path` held).
    """
    size, n = particles.shape[1], particles.shape[2]
    log_b, weights = scratch[0], scratch[1]
    work = scratch[2:]
    look_back = any_look_back(tables.sensors)
    changed = 0
    for t in range(n_steps - 1, -1, -1):
        for i in range(n):
            log_b[i] = log_weights[t, i]
        if t < n_steps - 1:
            transition_logpdf(tables.motion, t + 1, particles[t], path[t + 1], log_b, work)
            if look_back and any_reading(tables.sensors, t + 1):
                for d in range(size):
                    for i in range(n):
                        replicated[d, i] = path[t + 1, d]
                sum_logpdf(tables.sensors, t + 1, particles[t], replicated, log_b, work)
        status, _, weight_sum = normalise(log_b, weights)
        if status != FINE:
            return (NO_ANCESTOR if status == ALL_ZERO else status), t, changed
        chosen = draw_index(weights, weight_sum, rng)
        different = False
        for d in range(size):
            if path[t, d] != particles[t, d, chosen]:
                different = True
                path[t, d] = particles[t, d, chosen]
        changed += different
    return FINE, 0, changed


@entry
def filter_pass(tables, rng, n_steps, n, scheme, threshold):
    """Filter; return (status, time, log evidence, particles (T, D, n), log weights (T, n), steps (T, 2))."""
    size = state_size(tables.motion)
    particles, log_weights = np.empty((n_steps, size, n)), np.empty((n_steps, n))
    steps = np.empty((n_steps, 2))
    status, t, log_evidence = _forward(
        tables, rng, n_steps, scheme, threshold, False, np.empty((0, size)), AllAtOnce(0.0),
        particles, log_weights, steps,
        np.empty(n, np.int64), np.empty((size, n)), np.empty((work_rows(tables), n)),
    )  # fmt: skip
    return status, t, log_evidence, particles, log_weights, steps


@entry
def predictive_pass(tables, rng, n_steps, n, scheme, threshold):
    """Filter, taking the readings of a row one after another.

    Returns what :func:`filter_pass` does, then log score, low and high (N,) of each slot (see
    :class:`~pmcl.filtering.kernels.weighing.OneByOne`); NaN where nothing was measured.
    """
    size = state_size(tables.motion)
    particles, log_weights = np.empty((n_steps, size, n)), np.empty((n_steps, n))
    steps = np.empty((n_steps, 2))
    slots = count_slots(tables.sensors, n_steps)
    log_score, low, high = np.full(slots, np.nan), np.full(slots, np.nan), np.full(slots, np.nan)
    status, t, log_evidence = _forward(
        tables, rng, n_steps, scheme, threshold, False, np.empty((0, size)),
        OneByOne(n_steps, log_score, low, high, np.empty((6, n))), particles, log_weights, steps,
        np.empty(n, np.int64), np.empty((size, n)), np.empty((work_rows(tables), n)),
    )  # fmt: skip
    return status, t, log_evidence, particles, log_weights, steps, log_score, low, high


@entry
def sample_backward(tables, rng, particles, log_weights, n_paths):
    """Draw trajectories from a filter pass; return (status, time, paths (n_paths, T, D))."""
    n_steps, size = particles.shape[0], particles.shape[1]
    n = particles.shape[2]
    paths = np.zeros((n_paths, n_steps, size))
    replicated, scratch = np.empty((size, n)), np.empty((work_rows(tables), n))
    for k in range(n_paths):
        status, t, _ = _backward(tables, rng, n_steps, particles, log_weights, paths[k], replicated, scratch)
        if status != FINE:
            return status, t, paths
    return FINE, 0, paths


@entry
def sweep(tables, rng, n_steps, n, conditional, path):
    """Replace the first `n_steps` states of `path` (T, D) by one smoothing or conditional draw, in place.

    Returns (status, time, log evidence, mean effective sample size where something was measured, states changed).
    A failed pass leaves `path` as it was.
    """
    size = path.shape[1]
    particles, log_weights = np.empty((n_steps, size, n)), np.empty((n_steps, n))
    steps, previous = np.empty((n_steps, 2)), np.empty((size, n))
    scratch = np.empty((work_rows(tables), n))
    status, t, log_evidence = _forward(
        tables, rng, n_steps, MULTINOMIAL, 1.0, conditional, path, AllAtOnce(0.0), particles, log_weights, steps,
        np.empty(n, np.int64), previous, scratch,
    )  # fmt: skip
    if status != FINE:
        return status, t, log_evidence, 0.0, 0
    # Copies are loops: numba compiles four seconds of error messages for each assignment of a slice.
    drawn = np.empty((n_steps, size))
    for t in range(n_steps):
        for d in range(size):
            drawn[t, d] = path[t, d]
    status, t, changed = _backward(tables, rng, n_steps, particles, log_weights, drawn, previous, scratch)
    if status != FINE:
        return status, t, log_evidence, 0.0, 0
    for s in range(n_steps):
        for d in range(size):
            path[s, d] = drawn[s, d]
    effective, measured = 0.0, 0
    for s in range(n_steps):
        if steps[s, 0] != 0.0:
            effective += steps[s, 1]
            measured += 1
    return FINE, 0, log_evidence, effective / max(measured, 1), changed


@kernel
def joint(tables, columns, logp, scratch):
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
    value = joint(tables, columns, logp, np.empty((work_rows(tables), max(n_steps, size))))
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
