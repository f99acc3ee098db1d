"""Sequential Monte Carlo: everything that is compiled about filters, trajectories and their densities, in one place.

One specialised loop is compiled for each combination of table types. Numbers in brackets are the equations of Kaboli,
Bowling and Musilek (2006). The filter is in :mod:`~.forward`, backward sampling in :mod:`~.backward`, densities of
paths in :mod:`~.densities`; here filter and backward sampling together replace a trajectory, at once or in blocks.
"""

from __future__ import annotations

import numpy as np

from pmcl.engine.compile import entry
from pmcl.filtering.kernels.backward import WEIGHED, BackwardWork, backward, sample_backward
from pmcl.filtering.kernels.densities import joint_logpdf, joint_terms, motion_terms, sensor_terms
from pmcl.filtering.kernels.forward import (
    FilterWork,
    History,
    conditional_pass,
    filter_pass,
    forward,
    predictive_pass,
    work_rows,
)
from pmcl.filtering.kernels.resampling import Independent
from pmcl.filtering.kernels.weighing import ALL_ZERO, FINE, NO_ANCESTOR, NOT_A_NUMBER, AllAtOnce

__all__ = [
    "ALL_ZERO",
    "FINE",
    "NOT_A_NUMBER",
    "NO_ANCESTOR",
    "History",
    "conditional_pass",
    "draw_block",
    "filter_block",
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
    status, t, log_evidence, _ = forward(
        tables, rng, 0, n_steps, False, scheme, 1.0, conditional, path, AllAtOnce(0.0), arrays
    )
    if status != FINE:
        return status, t, log_evidence, 0.0, 0
    # Copies are loops: numba compiles four seconds of error messages for each assignment of a slice.
    new, count = np.empty((n_steps, size)), min(n, WEIGHED)
    for t in range(n_steps):
        for d in range(size):
            new[t, d] = path[t, d]
    workspace = BackwardWork(
        scratch[0], np.empty(count, np.int64), np.empty((2, size, count)), np.empty((work_rows(tables), count))
    )
    status, t, changed, _ = backward(tables, rng, 0, n_steps, np.int64(-1), history, new, workspace)
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


@entry
def filter_block(tables, rng, begin, stop, weighted, conditional, path, history, steps):
    """Filter the rows begin ... stop - 1 as :func:`redraw_path` does, going on from row ``begin - 1``.

    `history` is a :class:`~pmcl.filtering.kernels.forward.History`, which holds that row and is filled with these;
    `steps` (T, 2) as in :class:`~pmcl.filtering.kernels.forward.FilterWork`. Returns (status, time, log evidence of
    these rows, weighted).
    """
    _, size, n = history.particles.shape
    arrays = FilterWork(history, steps, np.empty((size, n)), np.empty((work_rows(tables), n)))
    scheme = Independent(1 if conditional else 0)
    return forward(
        tables, rng, begin, stop, weighted, scheme, 1.0, conditional, path, AllAtOnce(0.0), arrays
    )


@entry
def draw_block(tables, rng, begin, stop, ancestor, history, path):
    """Draw the states stop - 1 ... begin of a trajectory; see :func:`~pmcl.filtering.kernels.backward.backward`."""
    _, size, n = history.particles.shape
    count = min(n, WEIGHED)
    workspace = BackwardWork(
        np.empty(n), np.empty(count, np.int64), np.empty((2, size, count)), np.empty((work_rows(tables), count))
    )
    return backward(tables, rng, begin, stop, ancestor, history, path, workspace)
