"""Readings linearised once around a reference trajectory, for the Gaussian transport move.

A sensor's Python side makes :class:`LinearReadings` with :func:`pack_readings`, its function
:func:`~pmcl.engine.contract.linear_information` reads them. Like a table they have ``extras``: none for plain tables,
:class:`LinearExtras` for tables with extras.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.compile import kernel
from pmcl.engine.tables import NoExtras

__all__ = [
    "BEARING",
    "NOTHING",
    "RANGE",
    "SIZE",
    "LinearExtras",
    "LinearReadings",
    "add_information",
    "add_linear_extras",
    "add_sums",
    "earlier_part",
    "empty_readings",
    "fitted_readings",
    "inlier_share",
    "pack_readings",
    "same_fields",
    "times_of",
    "with_reading",
]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# A regression needs so many paths. Beyond their own scatter, slopes at the reference count as this share of the paths.
_FEWEST_PATHS, _SHARE_OF_REFERENCE = 10, 1e-3

RANGE, BEARING, SIZE = 0, 1, 2


class LinearExtras(NamedTuple):
    """What only tables with extras need to know of linearised readings.

    Attributes
    ----------
    velocity : ndarray, shape (M,)
        Change of the ideal value over the last step of the reference.
    distance : ndarray, shape (M,)
        Distance to what is seen [m].
    depth : ndarray, shape (M,)
        Cosine of the angle between it and the optical axis.
    """

    velocity: Float
    distance: Float
    depth: Float


class LinearReadings(NamedTuple):
    """What each usable reading would ideally be at the reference trajectory, and its slope there.

    Only geometry: biases, scales and noise come from the sensor's table, so that the same linearisation serves every
    theta.

    Attributes
    ----------
    first : ndarray of int, shape (T + 1,)
        Readings of time t are ``first[t] : first[t + 1]``.
    channel, kind : ndarray of int, shape (M,)
        Beam or landmark index, and RANGE, BEARING or SIZE.
    reading, value : ndarray, shape (M,)
        What was measured, and the ideal value at the reference.
    jacobian : ndarray, shape (M, D)
        Derivative of the ideal value by the state.
    weight : ndarray, shape (M,)
        Share of the information that is used (the probability that the reading is no gross error, at the reference).
    extras : NoExtras or LinearExtras
        What only tables with extras need.
    """

    first: Int
    channel: Int
    kind: Int
    reading: Float
    value: Float
    jacobian: Float
    weight: Float
    extras: NoExtras | LinearExtras = NoExtras()


def pack_readings(
    n_steps: int, time: Int, channel: Int, kind: Int, reading: Float, value: Float, jacobian: Float, weight: Float
) -> LinearReadings:
    """Sort readings by time into :class:`LinearReadings`; `time` (M,) is the step of each reading."""
    order = np.argsort(time, kind="stable")
    first = np.searchsorted(time[order], np.arange(n_steps + 1)).astype(np.int64)
    return LinearReadings(
        first,
        np.ascontiguousarray(channel[order], dtype=np.int64),
        np.ascontiguousarray(kind[order], dtype=np.int64),
        np.ascontiguousarray(reading[order], dtype=float),
        np.ascontiguousarray(value[order], dtype=float),
        np.ascontiguousarray(jacobian[order], dtype=float),
        np.ascontiguousarray(weight[order], dtype=float),
    )


def empty_readings(*, extras: bool) -> LinearReadings:
    """Return linearised readings without meaning, with or without extras, for which kernels can be compiled."""
    number, index = np.empty(1), np.empty(1, dtype=np.int64)
    plain = LinearReadings(index, index, index, number, number, np.empty((1, 3)), number)
    return plain._replace(extras=LinearExtras(number, number, number)) if extras else plain


def fitted_readings(readings: LinearReadings, reference: Float, paths: Float, offset: Float) -> LinearReadings:
    """Return linearised readings with the values and slopes that fit some paths best.

    A slope at the reference alone says nothing of a corner or an edge beside it. A regression over paths of the
    posterior does (Garcia-Fernandez, Svensson, Sarkka, IEEE Transactions on Signal Processing 65, 2017, linearise a
    smoother so).

    Parameters
    ----------
    readings : LinearReadings
        The readings, linearised at the reference.
    reference : ndarray, shape (T, D)
        The reference trajectory.
    paths : ndarray, shape (N, T, D)
        Paths near it.
    offset : ndarray, shape (N, M)
        Ideal value of each reading along each path, less that at the reference; not finite where there is none.

    Returns
    -------
    LinearReadings
        `readings` itself where there are too few paths. Cost: O(N M).
    """
    if len(paths) < _FEWEST_PATHS or not readings.value.size:
        return readings
    deviation = (paths - reference)[:, times_of(readings), :3]
    with np.errstate(invalid="ignore"):
        rest = offset - np.einsum("nmi,mi->nm", deviation, readings.jacobian[:, :3])
    known = np.isfinite(rest)
    rest, weight = np.where(known, rest, 0.0), known.astype(float)
    regressors = np.concatenate([np.ones((*rest.shape, 1)), deviation], axis=-1)
    normal = np.einsum("nm,nmi,nmj->mij", weight, regressors, regressors)
    prior = len(paths) * np.mean(regressors**2, axis=0) * _SHARE_OF_REFERENCE
    prior[:, 1:] += np.finfo(float).tiny ** 0.25  # where the paths are all alike
    normal[:, range(4), range(4)] += prior
    change = np.linalg.solve(normal, np.einsum("nmi,nm->mi", regressors, rest)[..., None])[..., 0]
    change[known.sum(axis=0) < _FEWEST_PATHS] = 0.0
    jacobian = readings.jacobian.copy()
    jacobian[:, :3] += change[:, 1:]
    return readings._replace(value=readings.value + change[:, 0], jacobian=jacobian)


def times_of(readings: Any) -> Int:
    """Return the row of each reading, (M,)."""
    return np.repeat(np.arange(readings.first.size - 1), np.diff(readings.first))


def earlier_part(table: Any, linearisation: Any) -> Float | float:
    """Return lag times velocity of each reading, (M,), that the values of late readings have too much; 0 without lag.

    Parameters
    ----------
    table : NamedTuple
        Table of the sensor, with the latency at which the readings were linearised.
    linearisation : NamedTuple
        The linearised readings, with or without a velocity in their extras.
    """
    lag = getattr(table.extras, "lag", None)
    if lag is None or not np.any(lag):
        return 0.0
    extras = getattr(linearisation, "extras", linearisation)
    return np.asarray(lag[times_of(linearisation)] * extras.velocity)


def add_linear_extras(
    readings: LinearReadings, table: Any, reference: Float, distance: Float, depth: Float
) -> LinearReadings:
    """Add what tables with extras need to know of readings that are linearised at the poses where they were taken.

    Parameters
    ----------
    readings : LinearReadings
        The readings.
    table : NamedTuple
        Table of the sensor.
    reference : ndarray, shape (T, D)
        The reference trajectory.
    distance, depth : ndarray, shape (M,)
        As in :class:`LinearExtras`.

    Returns
    -------
    LinearReadings
        `value` less lag times `velocity` is the ideal value at the table's own latency: kernels subtract that product.
    """
    step = np.diff(reference, axis=0, prepend=reference[:1])[times_of(readings)]
    velocity = np.einsum("kd,kd->k", readings.jacobian, step)
    readings = readings._replace(extras=LinearExtras(velocity, distance, depth))
    return readings._replace(value=np.ascontiguousarray(readings.value + earlier_part(table, readings)))


def same_fields(table: Any, other: Any, names: Iterable[str]) -> bool:
    """Return whether some fields of two tables have equal values."""
    return all(
        getattr(table, name) is getattr(other, name) or np.array_equal(getattr(table, name), getattr(other, name))
        for name in names
    )


def inlier_share(log_inlier: Float, outlier_weight: Float, log_outlier: Float | float) -> Float:
    """Return the probability that each reading is no gross error."""
    with np.errstate(divide="ignore", over="ignore"):
        odds = np.log(outlier_weight) - np.log1p(-outlier_weight) + log_outlier - log_inlier
        return np.asarray(1.0 / (1.0 + np.exp(odds)))


NOTHING = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""The sums of :func:`with_reading` before any reading."""


@kernel
def with_reading(sums, jacobian, k, scale, weight, residual):
    """Return the sums of a row's readings with one more, as :func:`add_information` would add it.

    Sums in registers do not wait for memory from reading to reading; :func:`add_sums` adds them once.
    """
    s0, s1, s2, p00, p10, p11, p20, p21, p22 = sums
    j0, j1, j2 = scale * jacobian[k, 0], scale * jacobian[k, 1], scale * jacobian[k, 2]
    w0, w1, w2 = weight * j0, weight * j1, weight * j2
    return (
        s0 + w0 * residual, s1 + w1 * residual, s2 + w2 * residual,
        p00 + w0 * j0, p10 + w1 * j0, p11 + w1 * j1, p20 + w2 * j0, p21 + w2 * j1, p22 + w2 * j2,
    )  # fmt: skip


@kernel
def add_sums(sums, precision, shift):
    """Add the sums of a row's readings to its precision (its lower triangle) and shift."""
    shift[0] += sums[0]
    shift[1] += sums[1]
    shift[2] += sums[2]
    precision[0, 0] += sums[3]
    precision[1, 0] += sums[4]
    precision[1, 1] += sums[5]
    precision[2, 0] += sums[6]
    precision[2, 1] += sums[7]
    precision[2, 2] += sums[8]


@kernel
def add_information(jacobian, k, scale, weight, residual, precision, shift):
    """Add one scalar reading of a pose: slope ``scale * jacobian[k]``, inverse variance `weight`, and its residual."""
    j0, j1, j2 = scale * jacobian[k, 0], scale * jacobian[k, 1], scale * jacobian[k, 2]
    w0, w1, w2 = weight * j0, weight * j1, weight * j2
    shift[0] += w0 * residual
    shift[1] += w1 * residual
    shift[2] += w2 * residual
    precision[0, 0] += w0 * j0
    precision[1, 0] += w1 * j0
    precision[1, 1] += w1 * j1
    precision[2, 0] += w2 * j0
    precision[2, 1] += w2 * j1
    precision[2, 2] += w2 * j2
