"""The Gaussian path of a linearised model, as needed by the Gaussian transport move.

Around a frozen reference trajectory the model is linear and Gaussian in the deviations d[t] of the states. Its joint
precision is block tridiagonal; eliminating the blocks forward in time (a block Cholesky factorisation) gives

    d[t] = k[t] + K[t] d[t+1] + C[t]^-T z[t],   z[t] standard normal,   d[T-1] = k[T-1] + C[T-1]^-T z[T-1],

with lower triangular C[t]: Kalman filtering forward, sampling backward, in information form. For any theta this is a
linear bijection between z and the path; carrying a path from theta to theta' with its z fixed has the Jacobian
prod det C[t] / det C'[t]. Cost: O(T D^3).

A motion model may bend the map from deviations to states, with unit Jacobian (:func:`.contract.state_of_deviation`):
then d[t] above stands for the unbent deviation, and everything else holds as it is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.compile import entry, kernel
from pmcl.engine.contract import (
    deviation_of_state,
    linearise_start,
    linearise_transition,
    state_of_deviation,
    state_size,
)
from pmcl.engine.sensor_tuples import sum_information
from pmcl.engine.vector_math import total
from pmcl.filtering.kernels.smc import joint_logpdf, work_rows

__all__ = ["Factors", "carry", "factorise", "refresh_blocks", "transport_trial"]

Float = NDArray[np.float64]


class Factors(NamedTuple):
    """The factorisation of a linearised path.

    Attributes
    ----------
    factor, gain : ndarray, shape (T, D * D)
        C[t] (its lower triangle; the rest is undefined) and K[t], row by row.
    centre : ndarray, shape (T, D)
        k[t].
    """

    factor: Float
    gain: Float
    centre: Float


@kernel
def _cholesky(a, c, size):
    """Write the Cholesky factor of the flat matrix `a` into `c`; return False if it is not positive definite."""
    for i in range(size):
        for j in range(i + 1):
            value = a[i * size + j]
            for k in range(j):
                value -= c[i * size + k] * c[j * size + k]
            if i == j:
                if not value > 0.0:
                    return False
                c[i * size + i] = math.sqrt(value)
            else:
                c[i * size + j] = value / c[j * size + j]
    return True


@kernel
def _solve(c, inverse_diagonal, b, begin, stride, size):
    """Replace the vector ``b[begin::stride]`` by (C C^T)^-1 b."""
    for i in range(size):
        value = b[begin + i * stride]
        for k in range(i):
            value -= c[i * size + k] * b[begin + k * stride]
        b[begin + i * stride] = value * inverse_diagonal[i]
    for i in range(size - 1, -1, -1):
        value = b[begin + i * stride]
        for k in range(i + 1, size):
            value -= c[k * size + i] * b[begin + k * stride]
        b[begin + i * stride] = value * inverse_diagonal[i]


@kernel
def _eliminate(tables, linear_readings, reference, path, begin, stop, factors, work, size):
    """Eliminate the rows begin ... stop - 1 forward in time, given their neighbours in `path` where they have any.

    `factors` are filled. `size` must be the constant D: the small loops are then unrolled; matrices are flat for the
    same reason. Returns the log determinant.
    """
    n_steps = reference.shape[0]
    square = size * size
    jacobian, noise, information = work[0:square], work[square : 2 * square], work[2 * square : 3 * square]
    weighted = work[3 * square : 4 * square]
    vectors = work[4 * square : 4 * square + 4 * size]
    offset, shift, shifted = vectors[0:size], vectors[size : 2 * size], vectors[2 * size : 3 * size]
    inverse_diagonal = vectors[3 * size : 4 * size]
    jacobian_2d, noise_2d = jacobian.reshape(size, size), noise.reshape(size, size)
    information_2d = information.reshape(size, size)
    for i in range(size):
        shift[i] = 0.0
    for i in range(square):
        information[i] = 0.0
    if begin == 0:
        linearise_start(tables.start, reference[0], information_2d, shift)
    else:
        linearise_transition(
            tables.motion, begin, reference[begin - 1], reference[begin], jacobian_2d, offset, noise_2d
        )
        for i in range(size):
            for k in range(size):
                offset[i] += jacobian[i * size + k] * (path[begin - 1, k] - reference[begin - 1, k])
        for i in range(size):
            for k in range(size):
                information[i * size + k] = noise[i * size + k]
                shift[i] += noise[i * size + k] * offset[k]
    log_determinant = 0.0
    for t in range(begin, stop):
        sum_information(tables.sensors, linear_readings, t, information_2d, shift)
        inner = t < stop - 1
        if t < n_steps - 1:
            linearise_transition(tables.motion, t + 1, reference[t], reference[t + 1], jacobian_2d, offset, noise_2d)
            if not inner:
                for i in range(size):
                    offset[i] -= path[stop, i] - reference[stop, i]
            for i in range(size):
                value = 0.0
                for k in range(size):
                    value += noise[i * size + k] * offset[k]
                shifted[i] = value
                for j in range(size):
                    value = 0.0
                    for k in range(size):
                        value += noise[i * size + k] * jacobian[k * size + j]
                    weighted[i * size + j] = value
            # The precision of d[t]: what is known up to t, and the transition to t + 1. Only its lower triangle is
            # used.
            for i in range(size):
                value = shift[i]
                for k in range(size):
                    value -= jacobian[k * size + i] * shifted[k]
                shift[i] = value
                for j in range(i + 1):
                    value = information[i * size + j]
                    for k in range(size):
                        value += jacobian[k * size + i] * weighted[k * size + j]
                    information[i * size + j] = value
        c, k_t, centre_t = factors.factor[t], factors.gain[t], factors.centre[t]
        if not _cholesky(information, c, size):
            return -np.inf
        determinant = 1.0
        for i in range(size):
            determinant *= c[i * size + i]
            inverse_diagonal[i] = 1.0 / c[i * size + i]
            centre_t[i] = shift[i]
        log_determinant += math.log(determinant)
        _solve(c, inverse_diagonal, centre_t, np.int64(0), np.int64(1), size)
        if inner:
            for i in range(size):
                for j in range(size):
                    k_t[i * size + j] = weighted[j * size + i]
            for j in range(size):
                _solve(c, inverse_diagonal, k_t, j, np.int64(size), size)
            # Marginalise d[t]: what remains is the information about d[t + 1].
            for i in range(size):
                value = shifted[i]
                for k in range(size):
                    value += weighted[i * size + k] * centre_t[k]
                shift[i] = value
                for j in range(i + 1):
                    value = noise[i * size + j]
                    for k in range(size):
                        value -= weighted[i * size + k] * k_t[k * size + j]
                    information[i * size + j] = value
    return log_determinant


@entry
def factorise(tables, linear_readings, reference):
    """Factorise the linearised path of one log.

    Parameters
    ----------
    tables : Tables
        Coefficients under some theta.
    linear_readings : tuple of LinearReadings
        The readings, linearised at the reference.
    reference : ndarray, shape (T, D)
        The reference trajectory.

    Returns
    -------
    log_determinant : float
        Sum of the logs of the diagonals of all C[t]; -inf where the linearised precision is not positive definite.
    factor, gain : ndarray, shape (T, D * D)
        C[t] (its lower triangle; the rest is undefined) and K[t], row by row.
    centre : ndarray, shape (T, D)
        k[t].
    """
    n_steps, size = reference.shape[0], state_size(tables.motion)
    factor, gain = np.empty((n_steps, size * size)), np.zeros((n_steps, size * size))
    centre, work = np.empty((n_steps, size)), np.empty(4 * size * size + 4 * size)
    log_determinant = _eliminate(
        tables, linear_readings, reference, reference, np.int64(0), n_steps, Factors(factor, gain, centre), work, size
    )
    return log_determinant, factor, gain, centre


@kernel
def _standardise(motion, t, inner, path, reference, factors, z, size):
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
def _realise(motion, t, inner, out, reference, factors, z, size):
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
def carry(motion, path, reference, factors, new_factors, out, z, size):
    """Write the path that has the same z under the new factors as `path` has under the old ones into `out` (T, D).

    `z` (D,) is work space, and `size` is D.
    """
    n_steps = path.shape[0]
    for t in range(n_steps - 1, -1, -1):
        inner = t < n_steps - 1
        _standardise(motion, t, inner, path, reference, factors, z, size)
        _realise(motion, t, inner, out, reference, new_factors, z, size)


@entry
def transport_trial(tables, linear_readings, reference, path, factor, gain, centre):
    """Carry a path to another theta and evaluate it there: one call does all the compiled work of a transport move.

    Parameters
    ----------
    tables, linear_readings, reference
        As for :func:`factorise`, at the proposed theta.
    path : ndarray, shape (T, D)
        The current path.
    factor, gain, centre : ndarray
        The factorisation at the current theta.

    Returns
    -------
    log_joint : float
        log p(carried path, readings | proposed theta); -inf where the proposal has no factorisation.
    log_determinant, new_factor, new_gain, new_centre
        As from :func:`factorise`.
    carried : ndarray, shape (T, D)
        The path with its z fixed.
    """
    n_steps, size = reference.shape[0], state_size(tables.motion)
    new_factor, new_gain = np.empty((n_steps, size * size)), np.zeros((n_steps, size * size))
    new_centre, carried = np.empty((n_steps, size)), np.empty_like(path)
    work, columns = np.empty(4 * size * size + 4 * size), np.empty((size, n_steps))
    new_factors = Factors(new_factor, new_gain, new_centre)
    log_determinant = _eliminate(
        tables, linear_readings, reference, path, np.int64(0), n_steps, new_factors, work, size
    )
    if log_determinant == -np.inf:
        return -np.inf, log_determinant, new_factor, new_gain, new_centre, carried
    old_factors = Factors(factor, gain, centre)
    carry(tables.motion, path, reference, old_factors, new_factors, carried, work[:size], size)
    for t in range(n_steps):
        for d in range(size):
            columns[d, t] = carried[t, d]
    log_joint = joint_logpdf(tables, columns, np.empty(n_steps), np.empty((work_rows(tables), max(n_steps, size))))
    return log_joint, log_determinant, new_factor, new_gain, new_centre, carried


@kernel
def _redraw(motion, path, reference, begin, stop, factors, noise, out, z, size):
    """Draw the rows begin ... stop - 1 anew into `out`; return half the change of the squared norm of z."""
    change = 0.0
    for t in range(stop - 1, begin - 1, -1):
        inner = t < stop - 1
        _standardise(motion, t, inner, path, reference, factors, z, size)
        for i in range(size):
            change += 0.5 * (noise[t, i] * noise[t, i] - z[i] * z[i])
            z[i] = noise[t, i]
        _realise(motion, t, inner, out, reference, factors, z, size)
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
            log_determinant = _eliminate(
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
