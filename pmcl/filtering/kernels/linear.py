"""Moves along the Gaussian path of a linearised model: carry a path to another theta, redraw it block by block.

The bijection between a path and its standardised deviations z is that of :mod:`~.factorisation`.
"""

from __future__ import annotations

import numpy as np

from pmcl.engine.compile import entry, kernel
from pmcl.engine.contract import deviation_of_state, draw_precision, state_of_deviation, state_size
from pmcl.engine.vector_math import total
from pmcl.filtering.kernels.densities import joint_logpdf
from pmcl.filtering.kernels.factorisation import Factors, eliminate, factorise
from pmcl.filtering.kernels.forward import work_rows

__all__ = [
    "Factors", "draw_precisions", "factorise", "realise", "realise_row", "refresh_blocks", "standardise",
    "standardise_row", "standardised", "transport_trial",
]  # fmt: skip

# A path that a nearly singular factorisation carries further than this [m or rad] is impossible: the Earth is 4e7 m
# around. Beyond 1e15 rad the kernels' sine is no number, and with it the path's density.
_FARTHEST = 1e9


@kernel
def standardise_row(motion, t, inner, path, reference, factors, z, size):
    """Write z[t] of a path into `z`: C^T (deviation - centre - gain deviation[t + 1])."""
    c, k_t, centre_t = factors.factor[t], factors.gain[t], factors.centre[t]
    if t < path.shape[0] - 1:
        deviation_of_state(motion, t, reference, path[t + 1], path[t], z)
    else:
        for i in range(size):
            z[i] = path[t, i] - reference[t, i]
    for i in range(size):
        value = z[i] - centre_t[i]
        if inner:
            for j in range(size):
                value -= k_t[i * size + j] * (path[t + 1, j] - reference[t + 1, j])
        z[i] = value
    for i in range(size):  # row i of C^T needs only entries from i on
        value = 0.0
        for k in range(i, size):
            value += c[k * size + i] * z[k]
        z[i] = value


@kernel
def realise_row(motion, t, inner, out, reference, factors, z, size):
    """Write the state at t that has standardised deviation `z` into ``out[t]``; `z` is overwritten."""
    c, k_t, centre_t = factors.factor[t], factors.gain[t], factors.centre[t]
    for i in range(size - 1, -1, -1):
        value = z[i]
        for k in range(i + 1, size):
            value -= c[k * size + i] * z[k]
        z[i] = value / c[i * size + i]
    for i in range(size):
        value = centre_t[i] + z[i]
        if inner:
            for j in range(size):
                value += k_t[i * size + j] * (out[t + 1, j] - reference[t + 1, j])
        z[i] = value
    if t < out.shape[0] - 1:
        state_of_deviation(motion, t, reference, out[t + 1], z, out[t])
    else:
        for i in range(size):
            out[t, i] = reference[t, i] + z[i]


@kernel
def standardise(motion, path, reference, factors, z, size):
    """Write the standardised deviations of a path (T, D) into `z` (T, D); `size` is D."""
    n_steps = path.shape[0]
    for t in range(n_steps):
        standardise_row(motion, t, t < n_steps - 1, path, reference, factors, z[t], size)


@kernel
def realise(motion, z, reference, factors, out, work, size):
    """Write the path that has the standardised deviations `z` (T, D) into `out`; `work` (D,) is work space."""
    n_steps = z.shape[0]
    for t in range(n_steps - 1, -1, -1):
        for i in range(size):
            work[i] = z[t, i]
        realise_row(motion, t, t < n_steps - 1, out, reference, factors, work, size)


@entry
def standardised(tables, linear_readings, reference, path):
    """Return the standardised deviations of a path under the linearised model of some theta.

    Parameters
    ----------
    tables, linear_readings, reference
        As for :func:`factorise`.
    path : ndarray, shape (T, D)
        The path.

    Returns
    -------
    log_determinant : float
        As from :func:`factorise`.
    z : ndarray, shape (T, D)
        The standardised deviations; undefined where there is no factorisation.
    """
    log_determinant, factor, gain, centre = factorise(tables, linear_readings, reference)
    z = np.empty_like(path)
    if log_determinant > -np.inf:
        factors = Factors(factor, gain, centre)
        standardise(tables.motion, path, reference, factors, z, state_size(tables.motion))
    return log_determinant, z


@entry
def transport_trial(tables, linear_readings, reference, z):
    """Carry a path to another theta and evaluate it there: one call does all the compiled work of a transport move.

    Parameters
    ----------
    tables, linear_readings, reference
        As for :func:`factorise`, at the proposed theta.
    z : ndarray, shape (T, D)
        The standardised deviations of the path, which stay as they are.

    Returns
    -------
    log_joint : float
        log p(carried path, readings | proposed theta); -inf where the proposal has no factorisation.
    log_determinant : float
        As from :func:`factorise`.
    carried : ndarray, shape (T, D)
        The path that has these z under the proposed theta.
    """
    n_steps, size = reference.shape[0], state_size(tables.motion)
    log_determinant, factor, gain, centre = factorise(tables, linear_readings, reference)
    carried = np.empty_like(z)
    if log_determinant == -np.inf:
        return -np.inf, log_determinant, carried
    work, columns = np.empty(size), np.empty((size, n_steps))
    realise(tables.motion, z, reference, Factors(factor, gain, centre), carried, work, size)
    for t in range(n_steps):
        for d in range(size):
            # Negated, so that a carried state that is not a number counts as too far, too.
            if not abs(carried[t, d]) < _FARTHEST:
                return -np.inf, log_determinant, carried
            columns[d, t] = carried[t, d]
    log_joint = joint_logpdf(tables, columns, np.empty(n_steps), np.empty((work_rows(tables), max(n_steps, size))))
    return log_joint, log_determinant, carried


@entry
def draw_precisions(tables, path, rng):
    """Draw the precisions of the motion's noise along a path, relative to its scale.

    Parameters
    ----------
    tables
        Coefficients under some theta.
    path : ndarray, shape (T, D)
        The path.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    precision : ndarray, shape (T, 3)
        Those of forward, left and turn noise; one where a row has none.
    drawn : ndarray of bool, shape (T,)
        Rows that have precisions: those that a step of the motion leads to.
    """
    precision, drawn = np.ones((path.shape[0], 3)), np.zeros(path.shape[0], np.bool_)
    for t in range(1, path.shape[0]):
        drawn[t] = draw_precision(tables.motion, t, path[t - 1], path[t], rng, precision[t])
    return precision, drawn


@kernel
def _redraw(motion, path, reference, begin, stop, factors, noise, out, z, size):
    """Draw the rows begin ... stop - 1 anew into `out`; return half the change of the squared norm of z."""
    change = 0.0
    for t in range(stop - 1, begin - 1, -1):
        inner = t < stop - 1
        standardise_row(motion, t, inner, path, reference, factors, z, size)
        for i in range(size):
            change += 0.5 * (noise[t, i] * noise[t, i] - z[i] * z[i])
            z[i] = noise[t, i]
        realise_row(motion, t, inner, out, reference, factors, z, size)
    return change


@kernel
def _joint_rows(tables, path, columns, rows, scratch):
    for t in range(path.shape[0]):
        for d in range(path.shape[1]):
            columns[d, t] = path[t, d]
    return joint_logpdf(tables, columns, rows, scratch)


@entry
def refresh_blocks(tables, linear_readings, reference, path, starts, noise, log_uniform):
    """Redraw a trajectory block by block from the linearised model, each block given its neighbours, in place.

    Every second block is proposed at once, then the others: blocks that do not touch are independent given the rest, so
    each is accepted or refused by itself (Metropolis-Hastings with the linearised conditional as proposal). Short
    blocks are nearly Gaussian and nearly always accepted.

    Parameters
    ----------
    tables, linear_readings, reference
        As for :func:`factorise`, at the current theta.
    path : ndarray, shape (T, D)
        The trajectory; it is changed.
    starts : ndarray of int, shape (n_blocks + 1,)
        First row of each block, and T.
    noise : ndarray, shape (T, D)
        Standard normals.
    log_uniform : ndarray, shape (n_blocks,)
        Logs of uniform numbers.

    Returns
    -------
    log_joint : float
        log p(path, readings | theta) afterwards.
    accepted : float
        Share of rows whose block was accepted.
    """
    n_steps, size = reference.shape[0], state_size(tables.motion)
    n_blocks = starts.size - 1
    factors = Factors(np.empty((n_steps, size * size)), np.empty((n_steps, size * size)), np.empty((n_steps, size)))
    work, z = np.empty(4 * size * size + 4 * size), np.empty(size)
    columns, scratch = np.empty((size, n_steps)), np.empty((work_rows(tables), max(n_steps, size)))
    rows, new_rows, log_ratio = np.empty(n_steps), np.empty(n_steps), np.empty(n_blocks)
    proposed = np.empty_like(path)
    _joint_rows(tables, path, columns, rows, scratch)
    accepted = 0
    for parity in range(2):
        for t in range(n_steps):
            for d in range(size):
                proposed[t, d] = path[t, d]
        for block in range(parity, n_blocks, 2):
            begin, stop = starts[block], starts[block + 1]
            log_ratio[block] = -np.inf
            log_determinant = eliminate(
                tables, linear_readings, reference, path, begin, stop, factors, work, size
            )
            if log_determinant > -np.inf:
                log_ratio[block] = _redraw(
                    tables.motion, path, reference, begin, stop, factors, noise, proposed, z, size
                )
        _joint_rows(tables, proposed, columns, new_rows, scratch)
        for block in range(parity, n_blocks, 2):
            begin, stop = starts[block], starts[block + 1]
            # The row after the block holds the transition out of it.
            for t in range(begin, min(stop + 1, n_steps)):
                log_ratio[block] += new_rows[t] - rows[t]
            if log_uniform[block] < log_ratio[block]:
                accepted += stop - begin
                for t in range(begin, min(stop + 1, n_steps)):
                    rows[t] = new_rows[t]
                for t in range(begin, stop):
                    for d in range(size):
                        path[t, d] = proposed[t, d]
    return total(rows), accepted / n_steps
