"""Backward sampling: trajectories from the history of a particle filter (eqs. 3 to 7)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.compile import entry, kernel
from pmcl.engine.contract import transition_logpdf
from pmcl.engine.sensor_tuples import any_look_back, any_reading, sum_logpdf
from pmcl.filtering.kernels.forward import History, work_rows
from pmcl.filtering.kernels.resampling import draw_index
from pmcl.filtering.kernels.weighing import ALL_ZERO, FINE, NO_ANCESTOR, normalise

__all__ = ["WEIGHED", "BackwardWork", "backward", "sample_backward"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

WEIGHED = 32
"""How many particles are weighed when one state of a trajectory is drawn backward."""


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
def _state_before(tables, rng, t, ancestor, history, path, arrays):
    """Choose the state at t that leads to ``path[t + 1]`` (eq. 5); return (status, which).

    Its weight is w_t p(x_t+1 | x_t), times the density of the next readings where those look back. Of many particles
    not all are weighed, but the ancestor in the filter and some others drawn evenly. The ancestor of a state has the
    law of eq. 5 itself, and a choice among it and rivals by their weights leaves that law as it is (conditional
    importance resampling; compare Dau and Chopin, On backward smoothing algorithms, 2023).
    """
    particles, log_weights, drawn, work = history.particles, history.log_weights, arrays.drawn, arrays.scratch
    (rows, size, n), count = particles.shape, drawn.size
    row = t % rows
    before, after, log_b, b = arrays.states[0], arrays.states[1], work[0], work[1]
    if count == n:
        before = particles[row]
        for j in range(n):
            drawn[j] = j
            log_b[j] = log_weights[row, j]
    else:
        for j in range(count):
            drawn[j] = min(int(rng.random() * n), n - 1)
        drawn[0] = ancestor
        for j in range(count):
            log_b[j] = log_weights[row, drawn[j]]
        for d in range(size):
            source, target = particles[row, d], before[d]
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
def backward(tables, rng, begin, stop, ancestor, history, path, arrays):
    """Draw the states stop - 1 ... begin of one trajectory, backward in time (eqs. 3 to 7), into `path` (T, D).

    `ancestor` is the filter's parent of state ``stop``, which `path` holds; or -1 where the filter ended at
    ``stop - 1``, whose state is then drawn with the filter's weights. `arrays` is a :class:`BackwardWork`. Returns
    (status, time, number of states that differ from what `path` held, parent of the state at `begin`).
    """
    particles = history.particles
    (rows, size, _), changed, status, chosen = particles.shape, 0, FINE, 0
    for t in range(stop - 1, begin - 1, -1):
        if ancestor < 0:
            status, _, weight_sum = normalise(history.log_weights[t % rows], arrays.weights)
            if status == FINE:
                chosen = draw_index(arrays.weights, weight_sum, rng)
        else:
            status, chosen = _state_before(tables, rng, t, ancestor, history, path, arrays)
        if status != FINE:
            return status, t, changed, ancestor
        ancestor = np.int64(history.ancestors[t % rows, chosen])
        different = False
        for d in range(size):
            if path[t, d] != particles[t % rows, d, chosen]:
                different = True
                path[t, d] = particles[t % rows, d, chosen]
        changed += different
    return FINE, begin, changed, ancestor


@entry
def sample_backward(tables, rng, particles, log_weights, ancestors, n_paths):
    """Draw trajectories from a filter pass; return (status, time, paths (n_paths, T, D))."""
    n_steps, size, n = particles.shape
    count = min(n, WEIGHED)
    history, paths = History(particles, log_weights, ancestors), np.zeros((n_paths, n_steps, size))
    arrays = BackwardWork(
        np.empty(n), np.empty(count, np.int64), np.empty((2, size, count)), np.empty((work_rows(tables), count))
    )
    for k in range(n_paths):
        status, t, _, _ = backward(tables, rng, 0, n_steps, np.int64(-1), history, paths[k], arrays)
        if status != FINE:
            return status, t, paths
    return FINE, 0, paths
