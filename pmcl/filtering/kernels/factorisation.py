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
from pmcl.engine.contract import linearise_start, linearise_transition, state_size
from pmcl.engine.sensor_tuples import sum_information

__all__ = ["Factors", "eliminate", "factorise"]

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
def eliminate(tables, linear_readings, reference, path, begin, stop, factors, work, size):
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
    log_determinant = eliminate(
        tables, linear_readings, reference, reference, np.int64(0), n_steps, Factors(factor, gain, centre), work, size
    )
    return log_determinant, factor, gain, centre
