"""The coefficient table of range beams against walls. T is the number of time steps, B of beams."""

from __future__ import annotations

import functools
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.tables import Axes, NoExtras

__all__ = ["OPEN_RAY", "RangeBeams", "RangeExtras", "extras_of", "ring_neighbours"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# A ray that meets no wall is infinitely long. The expected reading is never longer than this many times max_range:
# far enough that the reading is max_range in all likelihood, and finite, so that densities and slopes stay finite too.
OPEN_RAY = 2.0


def ring_neighbours(beam_pose: Float) -> Int:
    """Return the beams to the left and right of each one by direction, (B, 2); a single beam is its own neighbour."""
    # Tables are made for each proposal, and beams hardly ever move.
    return _neighbours_by_direction(tuple(beam_pose[:, 2].tolist())).copy()


@functools.lru_cache(maxsize=64)
def _neighbours_by_direction(directions: tuple[float, ...]) -> Int:
    order = np.argsort(np.mod(directions, 2.0 * np.pi), kind="stable")
    neighbours = np.empty((order.size, 2), dtype=np.int64)
    neighbours[order[:-1], 0], neighbours[order[-1], 0] = order[1:], order[0]
    neighbours[order[1:], 1], neighbours[order[0], 1] = order[:-1], order[-1]
    return neighbours


def _neighbours_of(table: RangeBeams) -> Int:
    return ring_neighbours(table.beam_pose)


class RangeExtras(NamedTuple):
    """Range readings that may be biased by the hour, blurred, late, or no echo of the wall at all.

    An echo is Gaussian (or Student t) around ``scale * length + bias + bias_at`` with standard deviation
    ``std * std_factor * (1 + growth * length)`` and is clipped to [0, max_range]; lengths beyond max_range count as
    max_range there. A reading is, in this order: uniform on [0, max_range] with probability `outlier_weight`; else
    max_range with `no_echo_weight`; else too short with `short_weight`; else a detour with `specular_weight`, at large
    incidence; else the echo of an obstacle in the way; else the echo of a neighbouring beam with `talk_weight`; else
    its own echo.

    Attributes
    ----------
    bias_at : ndarray, shape (T, B)
        Added to what is expected [m].
    std_factor : ndarray, shape (T,)
        Factor on the standard deviation.
    growth : ndarray, shape (B,)
        Growth of the standard deviation with the length of the ray [1/m].
    tail : float
        Inverse degrees of freedom of the noise; 0 is Gaussian.
    step : float
        Readings are rounded to multiples of this [m]; 0 not at all. Their density is constant over each cell.
    width : ndarray, shape (B,)
        Full angle of the cone whose nearest of five rays is what the beam sees [rad].
    short_weight : ndarray, shape (B,)
        Probability of an echo of something unknown before the wall.
    short_length : float
        Scale of its exponential distribution, which ends at the wall [m].
    no_echo_weight : ndarray, shape (B,)
        Probability that nothing comes back.
    specular_weight : ndarray, shape (B,)
        Probability, at grazing incidence, of an echo by a detour: uniform between the wall and max_range (nothing
        comes back when that is less than a tenth of the range).
    specular_angle : float
        Incidence at which half of that is reached [rad].
    talk_weight : ndarray, shape (B,)
        Probability of a neighbour's echo, either neighbour alike.
    neighbours : ndarray of int, shape (B, 2)
        The neighbouring beams.
    correlation : ndarray, shape (B,)
        Correlation of an echo's residual with that of the same beam in the row before. Unrelated where that was not
        measured, clipped, or off by more than four standard deviations.
    lag : ndarray, shape (T,)
        Readings are those of the pose this share of the last step ago; beyond 1 as if the robot had moved the same way
        before.
    obstacles : ndarray, shape (K, 4)
        Discs (x, y, radius [m], weight): a beam that meets one before the wall echoes from it with that probability.
    """

    bias_at: Annotated[Float, Axes("time", "beam", neutral=0.0)]
    std_factor: Annotated[Float, Axes("time", neutral=1.0)]
    growth: Annotated[Float, Axes("beam", neutral=0.0)]
    tail: Annotated[float, Axes(neutral=0.0)]
    step: Annotated[float, Axes(neutral=0.0)]
    width: Annotated[Float, Axes("beam", neutral=0.0)]
    short_weight: Annotated[Float, Axes("beam", neutral=0.0)]
    short_length: Annotated[float, Axes(neutral=1.0)]
    no_echo_weight: Annotated[Float, Axes("beam", neutral=0.0)]
    specular_weight: Annotated[Float, Axes("beam", neutral=0.0)]
    specular_angle: Annotated[float, Axes(neutral=1.0)]
    talk_weight: Annotated[Float, Axes("beam", neutral=0.0)]
    neighbours: Annotated[Int, Axes("beam", 2, neutral=_neighbours_of)]
    correlation: Annotated[Float, Axes("beam", neutral=0.0)]
    lag: Annotated[Float, Axes("time", neutral=0.0)]
    obstacles: Annotated[Float, Axes("obstacle", 4, neutral=0.0)]


class RangeBeams(NamedTuple):
    """Range readings against walls; a reading is Gaussian around the ray's length, clipped to [0, max_range].

    Attributes
    ----------
    reading : ndarray, shape (T, B)
        Ranges [m]; NaN where nothing was measured. 0 and max_range stand for "at or below" and "at or beyond".
    measured : ndarray of int, shape (T,)
        Number of readings at each time.
    beam_pose : ndarray, shape (B, 3)
        Where each beam sits on the robot [m, m, rad].
    bias, scale, std : ndarray, shape (B,)
        Expected reading = scale * length + bias [m]; standard deviation [m].
    outlier_weight : ndarray, shape (B,)
        Probability that a reading is uniform on [0, max_range] instead.
    max_range : float
        Longest range that the sensor reports [m].
    vertices : ndarray, shape (V, 2)
        Wall end points [m].
    wall_start, wall_stop : ndarray of int, shape (W,)
        Index of each wall's end points.
    extras : NoExtras or RangeExtras
        What only effects use.
    """

    reading: Annotated[Float, Axes("time", "beam")]
    measured: Annotated[Int, Axes("time")]
    beam_pose: Annotated[Float, Axes("beam", 3)]
    bias: Annotated[Float, Axes("beam")]
    scale: Annotated[Float, Axes("beam")]
    std: Annotated[Float, Axes("beam")]
    outlier_weight: Annotated[Float, Axes("beam")]
    max_range: Annotated[float, Axes()]
    vertices: Annotated[Float, Axes("vertex", 2)]
    wall_start: Annotated[Int, Axes("wall")]
    wall_stop: Annotated[Int, Axes("wall")]
    extras: NoExtras | RangeExtras = NoExtras()


def extras_of(table: RangeBeams) -> RangeExtras:
    """Return the extras of a table that has some."""
    assert isinstance(table.extras, RangeExtras)
    return table.extras
