"""Coefficient tables: what a model hands to the compiled kernels for one value of its parameters.

A model turns theta into plain arrays once per sweep; the kernels see only these NamedTuples and choose their code by
the tuple's type. A missing effect is then a function that edits a table. T is the number of time steps, B the number
of beams, N the number of landmark sightings, J the number of landmarks. Headings are not wrapped inside the kernels
(they live on the real line, so that the noise of a turn is exactly Gaussian); only differences of bearings are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["GaussianStart", "IncrementMotion", "LandmarkSightings", "PoseStart", "RangeBeams", "Tables"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]


class GaussianStart(NamedTuple):
    """Independent Gaussian belief about each component of the first state.

    Attributes
    ----------
    mean, std : ndarray, shape (D,)
        Mean and standard deviation of each component.
    """

    mean: Float
    std: Float


class PoseStart(NamedTuple):
    """Belief about the first pose in which position, heading or both may be unknown.

    Attributes
    ----------
    mean, std : ndarray, shape (3,)
        Gaussian part [m, m, rad]. ``std[0] = inf``: the position is uniform over the map;
        ``std[2] = inf``: the heading is uniform over the circle.
    low, high : ndarray, shape (2,)
        Bounding box of the map [m].
    segments : ndarray, shape (W, 4)
        Closed outline (x1, y1, x2, y2) [m] inside which the position lies; W = 0 means the whole box.
    log_density : float
        Log density of the uniform parts: minus the log of area and circle, where they apply.
    """

    mean: Float
    std: Float
    low: Float
    high: Float
    segments: Float
    log_density: float


class IncrementMotion(NamedTuple):
    """Motion by noisy increments in the robot frame: x[t] = x[t-1] (+) (mean[t] + std[t] * standard normal).

    Attributes
    ----------
    mean, std : ndarray, shape (T, 3)
        Forward [m], left [m], turn [rad]; row 0 is not used.
    """

    mean: Float
    std: Float


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
    """

    reading: Float
    measured: Int
    beam_pose: Float
    bias: Float
    scale: Float
    std: Float
    outlier_weight: Float
    max_range: float
    vertices: Float
    wall_start: Int
    wall_stop: Int


class LandmarkSightings(NamedTuple):
    """Sightings of known landmarks: distance, bearing and apparent size, each may be missing (NaN).

    Attributes
    ----------
    first : ndarray of int, shape (T + 1,)
        Sightings of time t are ``first[t] : first[t + 1]``.
    time, landmark : ndarray of int, shape (N,)
        When and which landmark was seen; sorted by time.
    range, bearing, size : ndarray, shape (N,)
        Distance [m], bearing in the sensor frame [rad], size [pixel].
    position : ndarray, shape (J, 2)
        The landmark map [m].
    sensor_pose : ndarray, shape (3,)
        Where the sensor sits on the robot [m, m, rad].
    range_scale, range_bias, range_std : ndarray, shape (J,)
        Expected distance = scale * distance + bias [m]; standard deviation [m].
    bearing_bias, bearing_std : ndarray, shape (J,)
        [rad].
    size_constant, size_std : ndarray, shape (J,)
        Pixels at one metre (ideal size = constant / distance^2, an area); standard deviation of the ratio observed /
        ideal [1].
    outlier_weight : ndarray, shape (J,)
        Probability that a sighting is a gross error: distance uniform on [0, max_range], bearing uniform on the circle.
    max_range : float
        Greatest distance of a gross error [m].
    """

    first: Int
    time: Int
    landmark: Int
    range: Float
    bearing: Float
    size: Float
    position: Float
    sensor_pose: Float
    range_scale: Float
    range_bias: Float
    range_std: Float
    bearing_bias: Float
    bearing_std: Float
    size_constant: Float
    size_std: Float
    outlier_weight: Float
    max_range: float


class Tables(NamedTuple):
    """Everything the kernels need to know about one log under one theta.

    Attributes
    ----------
    start : NamedTuple
        Belief about the first state.
    motion : NamedTuple
        Transition from each state to the next.
    sensors : tuple of NamedTuple
        One table for each sensor.
    """

    start: NamedTuple
    motion: NamedTuple
    sensors: tuple[NamedTuple, ...]
