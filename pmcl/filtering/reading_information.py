"""Readings of any sensor as Gaussian information about the path, by differences of their log density.

A sensor's room may have no linearisation. The log density of its readings is then expanded at each row to second order
around the reference: the gradient is the shift, the negative curvature the precision. Directions in which the density
is not concave count as without information.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine import contract
from pmcl.filtering.kernels.smc import sensor_terms

__all__ = ["RowInformation", "information_of"]

Float = NDArray[np.float64]

# Half the distance of the differences [m, m, rad]: about how well a path is known, so that the curvature is that over
# the region that counts.
_STEP = 0.01


class RowInformation(NamedTuple):
    """What the readings of each row say about the deviation from the reference.

    Attributes
    ----------
    precision : ndarray, shape (T, D, D)
        Inverse covariance.
    shift : ndarray, shape (T, D)
        Precision times mean deviation.
    """

    precision: Float
    shift: Float


@contract.linear_information.register(RowInformation)
def _linear_information(sensor, linear, t, precision, shift):  # type: ignore[no-untyped-def]
    for i in range(shift.size):
        shift[i] += linear.shift[t, i]
        for j in range(i + 1):
            precision[i, j] += linear.precision[t, i, j]


def information_of(table: Any, reference: Float) -> RowInformation:
    """Expand the readings of a sensor around a reference.

    Parameters
    ----------
    table : NamedTuple
        A table of any sensor.
    reference : ndarray, shape (T, D)
        The path.

    Returns
    -------
    RowInformation
        Cost: that of 2 D^2 + 1 densities of the whole log.
    """
    n_steps, size = reference.shape
    basis = _STEP * np.eye(size)
    pairs = [(i, j) for i in range(size) for j in range(i)]
    shifts = [np.zeros(size)]
    shifts += [sign * basis[i] for i in range(size) for sign in (1.0, -1.0)]
    signs = ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0))
    shifts += [first * basis[i] + second * basis[j] for i, j in pairs for first, second in signs]
    columns = np.ascontiguousarray(reference.T[None] + np.array(shifts)[:, :, None])
    with np.errstate(invalid="ignore"):
        logp = sensor_terms(table, columns)
        straight = logp[1 : 1 + 2 * size].reshape(size, 2, n_steps)
        crossed = logp[1 + 2 * size :].reshape(len(pairs), 4, n_steps)
        shift = (straight[:, 0] - straight[:, 1]).T / (2.0 * _STEP)
        curvature = np.zeros((n_steps, size, size))
        for i in range(size):
            curvature[:, i, i] = -(straight[i, 0] + straight[i, 1] - 2.0 * logp[0]) / _STEP**2
        for (i, j), (both, first, second, neither) in zip(pairs, crossed, strict=True):
            curvature[:, i, j] = curvature[:, j, i] = -(both - first - second + neither) / (4.0 * _STEP**2)
    usable = np.isfinite(curvature).all(axis=(1, 2)) & np.isfinite(shift).all(axis=1)
    values, vectors = np.linalg.eigh(np.where(usable[:, None, None], curvature, 0.0))
    concave = values > 0.0
    precision = np.einsum("tik,tk,tjk->tij", vectors, np.where(concave, values, 0.0), vectors)
    # A direction without precision must not pull either.
    along = np.einsum("tik,ti->tk", vectors, np.where(usable[:, None], shift, 0.0))
    shift = np.einsum("tik,tk->ti", vectors, np.where(concave, along, 0.0))
    return RowInformation(np.ascontiguousarray(precision), np.ascontiguousarray(shift))
