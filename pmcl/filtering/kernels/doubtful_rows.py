"""Blocks of a path, redrawn as if doubtful readings in them were sound, or as if they were gross errors."""

from __future__ import annotations

import numpy as np

from pmcl.engine.compile import entry, kernel
from pmcl.engine.contract import linearise_transition, state_size
from pmcl.engine.scalars import log_sum
from pmcl.engine.vector_math import total
from pmcl.filtering.kernels.densities import joint_logpdf
from pmcl.filtering.kernels.factorisation import Factors, eliminate
from pmcl.filtering.kernels.forward import work_rows
from pmcl.filtering.kernels.linear import realise_row, standardise_row

__all__ = ["choose_blocks", "redraw_doubtful_rows", "squared_steps"]


@entry
def choose_blocks(rows, order, before, after, n_steps):
    """Choose blocks of rows around some rows, so that between two blocks there is a row at least.

    Parameters
    ----------
    rows : ndarray of int, shape (n,)
        The rows.
    order : ndarray of int, shape (n,)
        The order in which they get a block, if it has room beside those that there are.
    before, after : ndarray of int, shape (n,)
        How many rows each block would have before and after its row.
    n_steps : int
        Rows of the log.

    Returns
    -------
    blocks : ndarray of int, shape (n_blocks, 3)
        First row of each block, the row after its last, and its own row, in ascending order.
    """
    own, free = np.full(n_steps + 1, -1), np.full(n_steps + 1, True)
    count = 0
    for k in order:
        begin, stop = max(0, rows[k] - before[k]), min(n_steps, rows[k] + 1 + after[k])
        # The row after a block holds the transition out of it, and belongs to no other block.
        room = True
        for t in range(begin, stop + 1):
            room &= free[t]
        if room:
            for t in range(begin, stop + 1):
                free[t] = False
            own[begin] = k
            count += 1
    blocks, block = np.empty((count, 3), np.int64), 0
    for begin in range(n_steps):
        k = own[begin]
        if k >= 0:
            blocks[block, 0], blocks[block, 2] = begin, rows[k]
            blocks[block, 1] = min(n_steps, rows[k] + 1 + after[k])
            block += 1
    return blocks


@entry
def squared_steps(motion, path):
    """Return how far each step of a path lies from the motion's mean: its squared standardised deviation, (T,).

    That of row t is of the step that leads there; it has the chi-square distribution with D degrees of freedom if the
    noise is Gaussian. The first row has none: 0.
    """
    n_steps, size = path.shape[0], state_size(motion)
    jacobian, precision, offset = np.empty((size, size)), np.empty((size, size)), np.empty(size)
    squared = np.zeros(n_steps)
    for t in range(1, n_steps):
        linearise_transition(motion, t, path[t - 1], path[t], jacobian, offset, precision)
        for i in range(size):
            for j in range(size):
                squared[t] += offset[i] * precision[i, j] * offset[j]
    return squared


@kernel
def _log_density(motion, path, reference, begin, stop, factors, log_determinant, z, size):
    """Return the log density of the rows begin ... stop - 1 of a path under one linearised model, up to a constant."""
    if log_determinant == -np.inf:
        return -np.inf
    value = log_determinant
    for t in range(stop - 1, begin - 1, -1):
        standardise_row(motion, t, t < stop - 1, path, reference, factors, z, size)
        for i in range(size):
            value -= 0.5 * z[i] * z[i]
    return value


@entry
def redraw_doubtful_rows(tables, sound, gross, reference, path, rows, begins, stops, as_sound, noise, log_uniform):
    """Redraw some blocks of a trajectory, each as if doubtful readings in it were sound or were gross errors, in place.

    The proposal of a block is the mixture, in equal parts, of its conditionals under two linearised models, so that it
    leads from a path that fits the readings to one that does not and back (Metropolis-Hastings with an independent
    proposal). Each block is accepted or refused by itself.

    Parameters
    ----------
    tables
        Coefficients at the current theta.
    sound, gross : tuple of LinearReadings
        The readings, linearised at the reference, with the doubtful ones in full, and without them.
    reference : ndarray, shape (T, D)
        The reference trajectory.
    path : ndarray, shape (T, D)
        The trajectory; it is changed.
    rows : ndarray, shape (T,)
        Each row's share of log p(path, readings | theta); it is changed as well. Where the first is not a number, all
        are computed.
    begins, stops : ndarray of int, shape (n_blocks,)
        First row of each block, and the row after its last. Between two blocks there must be a row.
    as_sound : ndarray of bool, shape (n_blocks,)
        The part of the mixture from which each block is drawn.
    noise : ndarray, shape (T, D)
        Standard normals.
    log_uniform : ndarray, shape (n_blocks,)
        Logs of uniform numbers.

    Returns
    -------
    log_joint : float
        log p(path, readings | theta) afterwards.
    """
    n_steps, size = reference.shape[0], state_size(tables.motion)
    square = size * size
    one = Factors(np.empty((n_steps, square)), np.empty((n_steps, square)), np.empty((n_steps, size)))
    other = Factors(np.empty((n_steps, square)), np.empty((n_steps, square)), np.empty((n_steps, size)))
    work, z = np.empty(4 * square + 4 * size), np.empty(size)
    columns, scratch = np.empty((size, n_steps)), np.empty((work_rows(tables), max(n_steps, size)))
    new_rows, log_ratio = np.empty(n_steps), np.empty(begins.size)
    proposed = path.copy()
    for block in range(begins.size):
        begin, stop = begins[block], stops[block]
        if_sound = eliminate(tables, sound, reference, path, begin, stop, one, work, size)
        if_gross = eliminate(tables, gross, reference, path, begin, stop, other, work, size)
        log_ratio[block] = -np.inf
        if (if_sound if as_sound[block] else if_gross) == -np.inf:
            continue
        for t in range(stop - 1, begin - 1, -1):
            for i in range(size):
                z[i] = noise[t, i]
            if as_sound[block]:
                realise_row(tables.motion, t, t < stop - 1, proposed, reference, one, z, size)
            else:
                realise_row(tables.motion, t, t < stop - 1, proposed, reference, other, z, size)
        log_ratio[block] = log_sum(
            _log_density(tables.motion, path, reference, begin, stop, one, if_sound, z, size),
            _log_density(tables.motion, path, reference, begin, stop, other, if_gross, z, size),
        ) - log_sum(
            _log_density(tables.motion, proposed, reference, begin, stop, one, if_sound, z, size),
            _log_density(tables.motion, proposed, reference, begin, stop, other, if_gross, z, size),
        )  # fmt: skip
    if np.isnan(rows[0]):
        for t in range(n_steps):
            for d in range(size):
                columns[d, t] = path[t, d]
        joint_logpdf(tables, columns, rows, scratch)
    for t in range(n_steps):
        for d in range(size):
            columns[d, t] = proposed[t, d]
    joint_logpdf(tables, columns, new_rows, scratch)
    for block in range(begins.size):
        begin, stop = begins[block], stops[block]
        # The row after the block holds the transition out of it.
        for t in range(begin, min(stop + 1, n_steps)):
            log_ratio[block] += new_rows[t] - rows[t]
        if log_uniform[block] < log_ratio[block]:
            for t in range(begin, min(stop + 1, n_steps)):
                rows[t] = new_rows[t]
            for t in range(begin, stop):
                for d in range(size):
                    path[t, d] = proposed[t, d]
    return total(rows)
