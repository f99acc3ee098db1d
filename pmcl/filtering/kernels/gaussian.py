"""Kalman filtering of any motion model, with readings as Gaussian information about the state.

A motion is known by its linearisation alone: with ``before`` the state that it is linearised at and ``after`` any
state, the expected next state is ``after + offset`` (:func:`pmcl.engine.contract.linearise_transition`). So both the
extended filter, which needs slopes, and the unscented filter, which needs the motion of sigma points, serve every model
that has one.
"""

from __future__ import annotations

import math

import numpy as np

from pmcl.engine.compile import entry, kernel
from pmcl.engine.contract import linearise_start, linearise_transition, state_size
from pmcl.engine.sensor_tuples import sum_information

__all__ = ["gaussian_pass", "information_rows"]


@entry
def information_rows(tables, linear_readings, n_steps):
    """Return the information that linearised readings give about each row: precision (T, D, D) and shift (T, D)."""
    size = state_size(tables.motion)
    precision, shift = np.zeros((n_steps, size, size)), np.zeros((n_steps, size))
    for t in range(n_steps):
        sum_information(tables.sensors, linear_readings, t, precision[t], shift[t])
        for i in range(size):
            for j in range(i):
                precision[t, j, i] = precision[t, i, j]
    return precision, shift


# Small matrices are worked on by loops: numba compiles the functions of numpy.linalg for ten seconds.


@kernel
def _solve(a, b):
    """Replace `b` (D, k) by the solution of a x = b, by elimination with row exchanges; return the determinant of `a`.

    `a` (D, D) is overwritten. Where it is singular, 0 is returned and `b` means nothing.
    """
    size, count = b.shape
    determinant = 1.0
    for column in range(size):
        best = column
        for i in range(column + 1, size):
            if abs(a[i, column]) > abs(a[best, column]):
                best = i
        if not abs(a[best, column]) > 0.0:
            return 0.0
        if best != column:
            determinant = -determinant
            for j in range(size):
                a[column, j], a[best, j] = a[best, j], a[column, j]
            for j in range(count):
                b[column, j], b[best, j] = b[best, j], b[column, j]
        pivot = a[column, column]
        determinant *= pivot
        for i in range(size):
            if i == column:
                continue
            factor = a[i, column] / pivot
            for j in range(column, size):
                a[i, j] -= factor * a[column, j]
            for j in range(count):
                b[i, j] -= factor * b[column, j]
        for j in range(count):
            b[column, j] /= pivot
        for j in range(column, size):
            a[column, j] /= pivot
    return determinant


@kernel
def _invert(a, out):
    """Write the inverse of `a` (D, D), which is overwritten, into `out`; return the determinant of `a`."""
    for i in range(a.shape[0]):
        for j in range(a.shape[0]):
            out[i, j] = 1.0 if i == j else 0.0
    return _solve(a, out)


@kernel
def _root(a, out):
    """Write the lower triangular root of `a` (D, D) into `out`; rounding below zero counts as zero."""
    size = a.shape[0]
    for i in range(size):
        for j in range(size):
            out[i, j] = 0.0
        for j in range(i + 1):
            value = a[i, j]
            for k in range(j):
                value -= out[i, k] * out[j, k]
            if i == j:
                out[i, i] = math.sqrt(max(value, 0.0))
            elif out[j, j] > 0.0:
                out[i, j] = value / out[j, j]


@kernel
def _product(a, b, transposed, out):
    """Write a b, or a times b transposed, into `out`; all (D, D)."""
    size = a.shape[0]
    for i in range(size):
        for j in range(size):
            value = 0.0
            for k in range(size):
                value += a[i, k] * (b[j, k] if transposed else b[k, j])
            out[i, j] = value


@kernel
def _symmetric(a):
    for i in range(a.shape[0]):
        for j in range(i):
            a[i, j] = a[j, i] = 0.5 * (a[i, j] + a[j, i])


@kernel
def _copy(a, out):
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            out[i, j] = a[i, j]


@kernel
def _expected(motion, t, before, jacobian, offset, noise, out):
    """Write the expected state at t into `out` (D,) and the slopes there into `jacobian` and `noise` (D, D)."""
    size = before.size
    for d in range(size):
        out[d] = before[d]
    # The linearisation is about the step from `before` to the expected state, which the first call finds.
    linearise_transition(motion, t, before, out, jacobian, offset, noise)
    for d in range(size):
        out[d] += offset[d]
    linearise_transition(motion, t, before, out, jacobian, offset, noise)
    for d in range(size):
        out[d] += offset[d]


@entry
def gaussian_pass(start, motion, precision, shift, reference, log_reference, spread):
    """Filter one log with Gaussian beliefs.

    Parameters
    ----------
    start, motion : NamedTuple
        Tables of the model.
    precision, shift : ndarray, shapes (T, D, D) and (T, D)
        The readings of each row as information about the deviation from the reference.
    reference : ndarray, shape (T, D)
        The states that the readings were linearised at.
    log_reference : ndarray, shape (T,)
        Log density of the readings of each row at the reference.
    spread : float
        0: the extended filter, whose motion is linearised at the mean. Else the unscented filter: sigma points lie
        ``spread`` standard deviations from the mean, and those off the centre have weights 1 / (2 spread^2).

    Returns
    -------
    increments : ndarray, shape (T,)
        Log predictive density of the readings of each row; NaN from the row on at which a covariance is not positive.
    predicted, filtered : ndarray, shape (T, D)
        Means before and after the readings of each row.
    predicted_covariance, covariance, gain : ndarray, shape (T, D, D)
        Covariances before and after the readings; and the smoother's gain, which turns a deviation at t + 1 into the
        expected one at t.
    """
    n_steps, size = reference.shape
    increments = np.full(n_steps, np.nan)
    predicted, filtered = np.zeros((n_steps, size)), np.zeros((n_steps, size))
    predicted_covariance, filtered_covariance = np.zeros((n_steps, size, size)), np.zeros((n_steps, size, size))
    gain = np.zeros((n_steps, size, size))
    mean, covariance, work = np.zeros(size), np.zeros((size, size)), np.zeros((size, size))
    jacobian, precision_of_noise, offset = np.zeros((size, size)), np.zeros((size, size)), np.zeros(size)
    noise, cross, new, root = (
        np.zeros((size, size)), np.zeros((size, size)), np.zeros((size, size)), np.zeros((size, size))
    )
    point, moved, deviation, residual = np.zeros(size), np.zeros(size), np.zeros(size), np.zeros(size)
    points, images = np.zeros((2 * size + 1, size)), np.zeros((2 * size + 1, size))
    linearise_start(start, reference[0], work, offset)
    for i in range(size):
        for j in range(i):
            work[j, i] = work[i, j]
    _invert(work, covariance)
    for i in range(size):
        mean[i] = reference[0, i]
        for j in range(size):
            mean[i] += covariance[i, j] * offset[j]
    for t in range(n_steps):
        if t > 0:
            _expected(motion, t, mean, jacobian, offset, precision_of_noise, moved)
            _invert(precision_of_noise, noise)
            if spread == 0.0:
                _product(covariance, jacobian, True, cross)
                _product(jacobian, cross, False, new)
            else:
                _root(covariance, root)
                for i in range(size):
                    for j in range(size):
                        new[i, j] = cross[i, j] = 0.0
                for k in range(2 * size + 1):
                    for d in range(size):
                        points[k, d] = 0.0
                        if k > 0:
                            points[k, d] = (spread if k % 2 else -spread) * root[d, (k - 1) // 2]
                        point[d] = mean[d] + points[k, d]
                    _expected(motion, t, point, jacobian, offset, precision_of_noise, images[k])
                for d in range(size):
                    moved[d] = 0.0
                    for k in range(2 * size + 1):
                        share = 0.5 / (spread * spread) if k > 0 else 1.0 - size / (spread * spread)
                        moved[d] += share * images[k, d]
                for k in range(2 * size + 1):
                    share = 0.5 / (spread * spread) if k > 0 else 1.0 - size / (spread * spread)
                    for i in range(size):
                        for j in range(size):
                            new[i, j] += share * (images[k, i] - moved[i]) * (images[k, j] - moved[j])
                            cross[i, j] += share * points[k, i] * (images[k, j] - moved[j])
            for i in range(size):
                mean[i] = moved[i]
                for j in range(size):
                    covariance[i, j] = new[i, j] + noise[i, j]
            _symmetric(covariance)
            # The gain is cross covariance^-1, so its transpose solves covariance x = cross^T.
            _copy(covariance, work)
            for i in range(size):
                for j in range(size):
                    new[i, j] = cross[j, i]
            _solve(work, new)
            for i in range(size):
                for j in range(size):
                    gain[t - 1, i, j] = new[j, i]
        _copy(covariance, predicted_covariance[t])
        # log of the integral of N(d; deviation, covariance) exp(shift'd - d' precision d / 2) over d.
        _product(covariance, precision[t], False, work)
        for i in range(size):
            work[i, i] += 1.0
            predicted[t, i] = mean[i]
            deviation[i] = mean[i] - reference[t, i]
        for i in range(size):
            residual[i] = shift[t, i]
            for j in range(size):
                residual[i] -= precision[t, i, j] * deviation[j]
        determinant = _solve(work, covariance)
        if not determinant > 0.0:
            return increments, predicted, filtered, predicted_covariance, filtered_covariance, gain
        _symmetric(covariance)
        value = log_reference[t] - 0.5 * math.log(determinant)
        for i in range(size):
            step = 0.0
            for j in range(size):
                step += covariance[i, j] * residual[j]
            mean[i] += step
            filtered[t, i] = mean[i]
            value += 0.5 * deviation[i] * (shift[t, i] + residual[i]) + 0.5 * residual[i] * step
        increments[t] = value
        _copy(covariance, filtered_covariance[t])
    return increments, predicted, filtered, predicted_covariance, filtered_covariance, gain
