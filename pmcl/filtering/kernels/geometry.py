"""Readings linearised once around a reference trajectory, for the Gaussian transport move."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["BEARING", "RANGE", "SIZE", "ReadingGeometry", "pack_geometry"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

RANGE, BEARING, SIZE = 0, 1, 2


class ReadingGeometry(NamedTuple):
    """What each usable reading would ideally be at the reference trajectory, and its slope there.

    Only geometry: biases, scales and noise come from the sensor's table, so that the same linearisation serves every theta.

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
    """

    first: Int
    channel: Int
    kind: Int
    reading: Float
    value: Float
    jacobian: Float
    weight: Float


def pack_geometry(
    n_steps: int, time: Int, channel: Int, kind: Int, reading: Float, value: Float, jacobian: Float, weight: Float
) -> ReadingGeometry:
    """Sort readings by time into a :class:`ReadingGeometry`; `time` (M,) is the step of each reading."""
    order = np.argsort(time, kind="stable")
    first = np.searchsorted(time[order], np.arange(n_steps + 1)).astype(np.int64)
    return ReadingGeometry(
        first,
        np.ascontiguousarray(channel[order], dtype=np.int64),
        np.ascontiguousarray(kind[order], dtype=np.int64),
        np.ascontiguousarray(reading[order], dtype=float),
        np.ascontiguousarray(value[order], dtype=float),
        np.ascontiguousarray(jacobian[order], dtype=float),
        np.ascontiguousarray(weight[order], dtype=float),
    )
