"""The Gaussian path of a linearised model, as needed by the Gaussian transport move.

Around a frozen reference trajectory the model is linear and Gaussian in the deviations d[t] of the states. Its joint
precision is block tridiagonal; eliminating the blocks forward in time (a block Cholesky factorisation) gives

    d[t] = k[t] + K[t] d[t+1] + C[t]^-T z[t],   z[t] standard normal,   d[T-1] = k[T-1] + C[T-1]^-T z[T-1],

with lower triangular C[t]: Kalman filtering forward, sampling backward, in information form. For any theta this is a
linear bijection between z and the path; carrying a path from theta to theta' with its z fixed has the Jacobian
prod det C[t] / det C'[t]. Cost: O(T D^3).
"""

from __future__ import annotations

import math

import numpy as np

from pmcl.filtering.kernels.compile import entry, kernel
from pmcl.filtering.kernels.contract import linearise_start, linearise_transition, state_size
from pmcl.filtering.kernels.smc import joint, work_rows
from pmcl.filtering.kernels.tuples import sum_information

# mypy: disable-error-code="no-untyped-def"

__all__ = ["carry", "factorise", "transport_trial"]


@kernel
def _cholesky(a, size):
    """Replace the lower triangle of `a` by its Cholesky factor; return False where it is not positive definite."""
    for i in range(size):
        for j in range(i + 1):
            value = a[i, j]
            for k in range(j):
                value -= a[i, k] * a[j, k]
            if i == j:
                if not value > 0.0:
                    return False
                a[i, i] = math.sqrt(value)
            else:
                a[i, j] = value / a[j, j]
    return True


@kernel
def _solve(factor, size, b):
    """Replace the vector `b` by (C C^T)^-1 b."""
    for i in range(size):
        for k in range(i):
            b[i] -= factor[i, k] * b[k]
        b[i] /= factor[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            b[i] -= factor[k, i] * b[k]
        b[i] /= factor[i, i]


@kernel
def _factorise(tables, geometries, reference, factor, gain, centre, work):
    n_steps = reference.shape[0]
    size = state_size(tables.motion)  # a constant after inlining, so that the small loops are unrolled
    jacobian, noise_precision = work[0:size], work[size : 2 * size]
    information, weighted = work[2 * size : 3 * size], work[3 * size : 4 * size]
    offset, shift, column, shifted = work[4 * size], work[4 * size + 1], work[4 * size + 2], work[4 * size + 3]
    for i in range(size):
        shift[i] = 0.0
        for j in range(size):
            information[i, j] = 0.0
    linearise_start(tables.start, reference[0], information, shift)
    log_determinant = 0.0
    for t in range(n_steps):
        sum_information(tables.sensors, geometries, t, information, shift)
        last = t == n_steps - 1
        if not last:
            linearise_transition(
                tables.motion, t + 1, reference[t], reference[t + 1], jacobian, offset, noise_precision
            )
            for i in range(size):
                shifted[i] = 0.0
                for j in range(size):
                    shifted[i] += noise_precision[i, j] * offset[j]
                    value = 0.0
                    for k in range(size):
                        value += noise_precision[i, k] * jacobian[k, j]
                    weighted[i, j] = value
            # Both terms of d[t]'s precision: what is known up to t, and the transition to t + 1.
            for i in range(size):
                for j in range(size):
                    value = 0.0
                    for k in range(size):
                        value += jacobian[k, i] * weighted[k, j]
                    information[i, j] += value
                value = 0.0
                for k in range(size):
                    value += jacobian[k, i] * shifted[k]
                shift[i] -= value
        c = factor[t]
        for i in range(size):
            for j in range(size):
                c[i, j] = information[i, j]
        if not _cholesky(c, size):
            return -np.inf
        for i in range(size):
            log_determinant += math.log(c[i, i])
            centre[t, i] = shift[i]
        _solve(c, size, centre[t])
        if not last:
            for j in range(size):
                for i in range(size):
                    column[i] = weighted[j, i]
                _solve(c, size, column)
                for i in range(size):
                    gain[t, i, j] = column[i]
            # Marginalise d[t]: what remains is the information about d[t + 1].
            for i in range(size):
                for j in range(size):
                    value = noise_precision[i, j]
                    for k in range(size):
                        value -= weighted[i, k] * gain[t, k, j]
                    information[i, j] = value
                value = shifted[i]
                for k in range(size):
                    value += weighted[i, k] * centre[t, k]
                shift[i] = value
    return log_determinant


@entry
def factorise(tables, geometries, reference):
    """Factorise the linearised path of one log.

    Parameters
    ----------
    tables : Tables
        Coefficients under some theta.
    geometries : tuple of ReadingGeometry
        The readings, linearised at the reference.
    reference : ndarray, shape (T, D)
        The reference trajectory.

    Returns
    -------
    log_determinant : float
        Sum of the logs of the diagonals of all C[t]; -inf where the linearised precision is not positive definite.
    factor, gain : ndarray, shape (T, D, D)
        C[t] (lower triangle) and K[t].
    centre : ndarray, shape (T, D)
        k[t].
    """
    n_steps, size = reference.shape
    factor, gain = np.empty((n_steps, size, size)), np.zeros((n_steps, size, size))
    centre, work = np.empty((n_steps, size)), np.empty((4 * size + 4, size))
    log_determinant = _factorise(tables, geometries, reference, factor, gain, centre, work)
    return log_determinant, factor, gain, centre


@kernel
def _carry(path, reference, factor, gain, centre, new_factor, new_gain, new_centre, out, z, size):
    n_steps = path.shape[0]
    for t in range(n_steps - 1, -1, -1):
        for i in range(size):
            z[i] = path[t, i] - reference[t, i] - centre[t, i]
            if t < n_steps - 1:
                for j in range(size):
                    z[i] -= gain[t, i, j] * (path[t + 1, j] - reference[t + 1, j])
        for i in range(size):  # z <- C^T z; row i of C^T needs only entries from i on
            value = 0.0
            for k in range(i, size):
                value += factor[t, k, i] * z[k]
            z[i] = value
        for i in range(size - 1, -1, -1):  # z <- C'^-T z
            for k in range(i + 1, size):
                z[i] -= new_factor[t, k, i] * z[k]
            z[i] /= new_factor[t, i, i]
        for i in range(size):
            value = reference[t, i] + new_centre[t, i] + z[i]
            if t < n_steps - 1:
                for j in range(size):
                    value += new_gain[t, i, j] * (out[t + 1, j] - reference[t + 1, j])
            out[t, i] = value


@entry
def carry(path, reference, factor, gain, centre, new_factor, new_gain, new_centre):
    """Return the path (T, D) that has the same z under the new factorisation as `path` has under the old one."""
    out = np.empty_like(path)
    _carry(path, reference, factor, gain, centre, new_factor, new_gain, new_centre, out, np.empty(path.shape[1]), path.shape[1])
    return out


@entry
def transport_trial(tables, geometries, reference, path, factor, gain, centre):
    """Carry a path to another theta and evaluate it there: one call does all the compiled work of a transport move.

    Parameters
    ----------
    tables, geometries, reference
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
    new_factor, new_gain = np.empty((n_steps, size, size)), np.zeros((n_steps, size, size))
    new_centre, carried = np.empty((n_steps, size)), np.empty_like(path)
    work, columns = np.empty((4 * size + 4, size)), np.empty((size, n_steps))
    log_determinant = _factorise(tables, geometries, reference, new_factor, new_gain, new_centre, work)
    if log_determinant == -np.inf:
        return -np.inf, log_determinant, new_factor, new_gain, new_centre, carried
    _carry(path, reference, factor, gain, centre, new_factor, new_gain, new_centre, carried, work[0], size)
    for t in range(n_steps):
        for d in range(size):
            columns[d, t] = carried[t, d]
    log_joint = joint(tables, columns, np.empty(n_steps), np.empty((work_rows(tables), max(n_steps, size))))
    return log_joint, log_determinant, new_factor, new_gain, new_centre, carried
