"""The coefficient table of lidar scans on a grid map. T is the number of time steps, R of rays of all lasers."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.tables import Axes, NoExtras

__all__ = ["BEAM", "FIELD", "LONGEST_DISTANCE", "OPEN_RAY", "LidarExtras", "LidarTable", "cell_noise"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

FIELD, BEAM = 0, 1
"""The models of a reading: likelihood field, beam model."""

# A ray that meets nothing is expected to be this many times the longest range: long enough to have no echo for sure,
# and finite, so that densities stay finite too.
OPEN_RAY = 2.0

LONGEST_DISTANCE = 2.0
"""Distances to the nearest occupied cell count up to this one [m]: nav2's default of laser_likelihood_max_dist.

They go on outside the map. Walls often are the outermost cells of a map, and half of the readings of such a wall end
behind it. nav2 counts each of these as if it ended this far from any wall: on the recorded robot Jarvis, whose map ends
at its walls, that moves the estimated positions by 0.08 m."""


def cell_noise(resolution: float) -> float:
    """Return how far apart two points are that lie anywhere in one cell, across a wall, as a standard deviation [m].

    The likelihood field compares the cell in which a reading ends with the cell that holds the wall, and knows neither
    of the two points more closely. Both are uniform over the side of their cell.

    Parameters
    ----------
    resolution : float
        Side of a cell [m].
    """
    return resolution / math.sqrt(6.0)


class LidarExtras(NamedTuple):
    """What only effects use.

    Attributes
    ----------
    lag : ndarray, shape (T,)
        Readings are those of the pose this share of the last step ago; beyond 1 as if the robot had moved the same way
        before.
    obstacles : ndarray, shape (K, 4)
        Discs (x, y, radius [m], weight) that the map lacks: a ray that meets one before anything on the map ends there
        with that probability.
    """

    lag: Annotated[Float, Axes("time", neutral=0.0)]
    obstacles: Annotated[Float, Axes("obstacle", 4, neutral=0.0)]


class LidarTable(NamedTuple):
    """Scans of one or several lasers on a grid map.

    The log density of each reading is multiplied by `exponent`. Under the *beam model* (Thrun, Burgard, Fox 2005,
    section 6.3) a reading z below `max_range` has the density

        z_hit N(z; L, std) / Phi(L / std) + z_rand / max_range
        + z_short lambda exp(-lambda z) / (1 - exp(-lambda min(L, max_range))) [z <= L]

    around L = scale * ray length + bias, and no echo has the probability z_max + z_hit P(N(L, std) > max_range | > 0):
    together they are 1. Under the *likelihood field* (section 6.4) a reading below `max_range` counts as

        z_hit N(d; 0, std) + z_rand / max_range,

    where d is the distance from where it ends, (z - bias) / scale along the ray, to the nearest occupied cell; no echo
    says nothing.

    Attributes
    ----------
    reading : ndarray, shape (T, R)
        Ranges [m]; NaN where nothing was measured, `max_range` where no echo came back.
    measured : ndarray of int, shape (T,)
        Number of readings that say something at each time.
    beam_pose : ndarray, shape (R, 3)
        Where each ray begins on the robot, and its direction there [m, m, rad].
    bias, scale : ndarray, shape (R,)
        Expected reading = scale * length + bias [m].
    std : ndarray, shape (R,)
        Standard deviation of a hit [m]. Under the likelihood field it contains that of :func:`cell_noise`, and is the
        one of `level_log_density`.
    max_range : ndarray, shape (R,)
        Longest range that each ray's laser reports [m].
    laser, ray : ndarray of int, shape (R,)
        Which laser each ray belongs to, and its number in that laser's scans.
    names : ndarray of uint8, shape (N,)
        Names of the lasers' variables in the log as UTF-8, with line feeds between them.
    model : int
        :data:`FIELD` or :data:`BEAM`.
    exponent : float
        Of the density of each reading, see :mod:`~pmcl.models.sensors.lidar.tempering`.
    z_hit, z_short, z_max, z_rand : float
        Weights of the beam model's components; they sum to 1. Where `z_hit` is negative the density is 0.
    lambda_short : float
        Rate of the exponential distribution of what stands before the wall [1/m].
    level_log_density : ndarray, shape (lasers, K)
        Log density of a reading that ends at the k-th distance from an occupied cell.
    level_distance : ndarray, shape (K,)
        These distances [m], the distances between centres of cells, ascending; the last is the longest that counts.
    levels : ndarray of uint16, shape (H + 2, W + 2)
        Number k of each cell's distance, for the map of H x W cells with its margin. A border of cells around it stands
        for everything further outside.
    squares : ndarray of uint8, shape (4, H, W)
        See :func:`~pmcl.models.sensors.lidar.kernels.casting.free_squares`.
    resolution : float
        Side of a cell [m].
    origin : ndarray, shape (3,)
        Pose of the outer corner of cell [0, 0] of the map with its margin, in the map frame [m, m, rad].
    extras : NoExtras or LidarExtras
        What only effects use.
    """

    reading: Annotated[Float, Axes("time", "beam")]
    measured: Annotated[Int, Axes("time")]
    beam_pose: Annotated[Float, Axes("beam", 3)]
    bias: Annotated[Float, Axes("beam")]
    scale: Annotated[Float, Axes("beam")]
    std: Annotated[Float, Axes("beam")]
    max_range: Annotated[Float, Axes("beam")]
    laser: Annotated[Int, Axes("beam")]
    ray: Annotated[Int, Axes("beam")]
    names: Annotated[NDArray[np.uint8], Axes("letter")]
    model: Annotated[int, Axes()]
    exponent: Annotated[float, Axes()]
    z_hit: Annotated[float, Axes()]
    z_short: Annotated[float, Axes()]
    z_max: Annotated[float, Axes()]
    z_rand: Annotated[float, Axes()]
    lambda_short: Annotated[float, Axes()]
    level_log_density: Annotated[Float, Axes("laser", "level")]
    level_distance: Annotated[Float, Axes("level")]
    levels: Annotated[NDArray[np.uint16], Axes("padded row", "padded column")]
    squares: Annotated[NDArray[np.uint8], Axes(4, "row", "column")]
    resolution: Annotated[float, Axes()]
    origin: Annotated[Float, Axes(3)]
    extras: NoExtras | LidarExtras = NoExtras()
