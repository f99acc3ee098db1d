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

__all__ = ["Factors", "cholesky", "eliminate", "factorise", "solve"]

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
def cholesky(a, c, size):
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
def solve(c, inverse_diagonal, b, begin, stride, size):
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
    if size == 3:
        return _eliminate_poses(tables, linear_readings, reference, path, begin, stop, factors, work)
    return _eliminate_any(tables, linear_readings, reference, path, begin, stop, factors, work, size)


@kernel
def _solve_three(lower, inverse, b):
    """Return (L D L^T)^-1 b for a unit lower triangle `lower` = (l10, l20, l21) and the `inverse` of D."""
    l10, l20, l21 = lower
    y1 = b[1] - l10 * b[0]
    y2 = b[2] - l20 * b[0] - l21 * y1
    x2 = y2 * inverse[2]
    x1 = y1 * inverse[1] - l21 * x2
    return b[0] * inverse[0] - l10 * x1 - l20 * x2, x1, x2


@kernel
def _eliminate_poses(tables, linear_readings, reference, path, begin, stop, factors, work):
    """Do what :func:`_eliminate_any` does for states of three components.

    All numbers of a row are held in registers: loops over work arrays, of which the compiler cannot tell that they are
    distinct, take three times as long.
    """
    n_steps = reference.shape[0]
    jacobian, noise, information = work[0:9].reshape(3, 3), work[9:18].reshape(3, 3), work[18:27].reshape(3, 3)
    offset, shift = work[36:39], work[39:42]
    for i in range(3):
        shift[i] = 0.0
        for j in range(3):
            information[i, j] = 0.0
    if begin == 0:
        linearise_start(tables.start, reference[0], information, shift)
    else:
        linearise_transition(tables.motion, begin, reference[begin - 1], reference[begin], jacobian, offset, noise)
        for i in range(3):
            for k in range(3):
                offset[i] += jacobian[i, k] * (path[begin - 1, k] - reference[begin - 1, k])
        for i in range(3):
            for k in range(3):
                information[i, k] = noise[i, k]
                shift[i] += noise[i, k] * offset[k]
    # a: the lower triangle of what is known of d[t], s: the shift.
    a00, a10, a11 = information[0, 0], information[1, 0], information[1, 1]
    a20, a21, a22 = information[2, 0], information[2, 1], information[2, 2]
    s0, s1, s2 = shift[0], shift[1], shift[2]
    log_determinant, square = 0.0, 1.0
    for t in range(begin, stop):
        for i in range(3):
            shift[i] = 0.0
            for j in range(3):
                information[i, j] = 0.0
        sum_information(tables.sensors, linear_readings, t, information, shift)
        a00, a10, a11 = a00 + information[0, 0], a10 + information[1, 0], a11 + information[1, 1]
        a20, a21, a22 = a20 + information[2, 0], a21 + information[2, 1], a22 + information[2, 2]
        s0, s1, s2 = s0 + shift[0], s1 + shift[1], s2 + shift[2]
        inner = t < stop - 1
        n00 = n10 = n11 = n20 = n21 = n22 = 0.0
        w00 = w01 = w02 = w10 = w11 = w12 = w20 = w21 = w22 = h0 = h1 = h2 = 0.0
        if t < n_steps - 1:
            linearise_transition(tables.motion, t + 1, reference[t], reference[t + 1], jacobian, offset, noise)
            o0, o1, o2 = offset[0], offset[1], offset[2]
            if not inner:
                o0 -= path[stop, 0] - reference[stop, 0]
                o1 -= path[stop, 1] - reference[stop, 1]
                o2 -= path[stop, 2] - reference[stop, 2]
            n00, n10, n11 = noise[0, 0], noise[1, 0], noise[1, 1]
            n20, n21, n22 = noise[2, 0], noise[2, 1], noise[2, 2]
            j00, j01, j02 = jacobian[0, 0], jacobian[0, 1], jacobian[0, 2]
            j10, j11, j12 = jacobian[1, 0], jacobian[1, 1], jacobian[1, 2]
            j20, j21, j22 = jacobian[2, 0], jacobian[2, 1], jacobian[2, 2]
            # h: noise times offset, w: noise times jacobian.
            h0 = n00 * o0 + n10 * o1 + n20 * o2
            h1 = n10 * o0 + n11 * o1 + n21 * o2
            h2 = n20 * o0 + n21 * o1 + n22 * o2
            w00, w01 = n00 * j00 + n10 * j10 + n20 * j20, n00 * j01 + n10 * j11 + n20 * j21
            w10, w11 = n10 * j00 + n11 * j10 + n21 * j20, n10 * j01 + n11 * j11 + n21 * j21
            w20, w21 = n20 * j00 + n21 * j10 + n22 * j20, n20 * j01 + n21 * j11 + n22 * j21
            w02, w12 = n00 * j02 + n10 * j12 + n20 * j22, n10 * j02 + n11 * j12 + n21 * j22
            w22 = n20 * j02 + n21 * j12 + n22 * j22
            # The precision of d[t]: what is known up to t, and the transition to t + 1.
            s0 -= j00 * h0 + j10 * h1 + j20 * h2
            s1 -= j01 * h0 + j11 * h1 + j21 * h2
            s2 -= j02 * h0 + j12 * h1 + j22 * h2
            a00 += j00 * w00 + j10 * w10 + j20 * w20
            a10 += j01 * w00 + j11 * w10 + j21 * w20
            a11 += j01 * w01 + j11 * w11 + j21 * w21
            a20 += j02 * w00 + j12 * w10 + j22 * w20
            a21 += j02 * w01 + j12 * w11 + j22 * w21
            a22 += j02 * w02 + j12 * w12 + j22 * w22
        # L D L^T instead of C C^T: square roots are then no part of the chain of operations from row to row.
        i0 = 1.0 / a00
        l10, l20 = a10 * i0, a20 * i0
        d1, rest = a11 - l10 * a10, a21 - l20 * a10
        i1 = 1.0 / d1
        l21 = rest * i1
        d2 = a22 - l20 * a20 - l21 * rest
        if not (a00 > 0.0 and d1 > 0.0 and d2 > 0.0):
            return -np.inf
        lower, inverse = (l10, l20, l21), (i0, i1, 1.0 / d2)
        # One logarithm serves many rows, as long as the product stays far from the ends of the numbers.
        square *= a00 * d1 * d2
        if not 1e-180 < square < 1e180:
            log_determinant += 0.5 * math.log(square)
            square = 1.0
        factor, gain, centre = factors.factor[t], factors.gain[t], factors.centre[t]
        c00, c11 = math.sqrt(a00), math.sqrt(d1)
        factor[0], factor[3], factor[4] = c00, l10 * c00, c11
        factor[6], factor[7], factor[8] = l20 * c00, l21 * c11, math.sqrt(d2)
        x0, x1, x2 = _solve_three(lower, inverse, (s0, s1, s2))
        centre[0], centre[1], centre[2] = x0, x1, x2
        if inner:
            k00, k10, k20 = _solve_three(lower, inverse, (w00, w01, w02))
            k01, k11, k21 = _solve_three(lower, inverse, (w10, w11, w12))
            k02, k12, k22 = _solve_three(lower, inverse, (w20, w21, w22))
            gain[0], gain[1], gain[2] = k00, k01, k02
            gain[3], gain[4], gain[5] = k10, k11, k12
            gain[6], gain[7], gain[8] = k20, k21, k22
            # Marginalise d[t]: what remains is the information about d[t + 1].
            s0 = h0 + w00 * x0 + w01 * x1 + w02 * x2
            s1 = h1 + w10 * x0 + w11 * x1 + w12 * x2
            s2 = h2 + w20 * x0 + w21 * x1 + w22 * x2
            a00 = n00 - (w00 * k00 + w01 * k10 + w02 * k20)
            a10 = n10 - (w10 * k00 + w11 * k10 + w12 * k20)
            a11 = n11 - (w10 * k01 + w11 * k11 + w12 * k21)
            a20 = n20 - (w20 * k00 + w21 * k10 + w22 * k20)
            a21 = n21 - (w20 * k01 + w21 * k11 + w22 * k21)
            a22 = n22 - (w20 * k02 + w21 * k12 + w22 * k22)
    return log_determinant + 0.5 * math.log(square)


@kernel
def _eliminate_any(tables, linear_readings, reference, path, begin, stop, factors, work, size):
    """Do what :func:`eliminate` says for states of any size."""
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
        if not cholesky(information, c, size):
            return -np.inf
        determinant = 1.0
        for i in range(size):
            determinant *= c[i * size + i]
            inverse_diagonal[i] = 1.0 / c[i * size + i]
            centre_t[i] = shift[i]
        log_determinant += math.log(determinant)
        solve(c, inverse_diagonal, centre_t, np.int64(0), np.int64(1), size)
        if inner:
            for i in range(size):
                for j in range(size):
                    k_t[i * size + j] = weighted[j * size + i]
            for j in range(size):
                solve(c, inverse_diagonal, k_t, j, np.int64(size), size)
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
