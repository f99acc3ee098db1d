"""The coefficient table of sightings of known landmarks.

T is the number of time steps, N of sightings, J of landmarks.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.tables import Axes, NoExtras

__all__ = ["LandmarkExtras", "LandmarkSightings", "extras_of"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]


def _no_lag(table: LandmarkSightings) -> Float:
    return np.zeros(table.first.size - 1)


class LandmarkExtras(NamedTuple):
    """Sightings that may be late, of the wrong landmark, noisier near or far, or wrong as they were just before.

    Attributes
    ----------
    lag : ndarray, shape (T,)
        As for :class:`~pmcl.models.sensors.range_beams.table.RangeExtras`.
    range_growth : ndarray, shape (J,)
        The standard deviation of a distance d is ``range_std * (1 + range_growth * d)`` [1/m].
    bearing_falloff : ndarray, shape (J,)
        That of a bearing is ``bearing_std * (1 + bearing_falloff / d)`` [m]; below 0.1 m, d counts as 0.1 m.
    depth : float
        Distances are read as ``d * (1 - depth + depth * cos(bearing))``: 1 is the depth along the optical axis.
    misread_weight : ndarray, shape (J,)
        Probability that a sighting said to be of this landmark is of another one, each alike.
    range_correlation, bearing_correlation : ndarray, shape (J,)
        Correlation of the residual of a distance, or bearing, with that of the same landmark in the row before.
        Unrelated where that was not measured, off by more than four standard deviations, or where the sighting now
        is of another landmark or a gross error. Sizes have no memory.
    """

    lag: Annotated[Float, Axes("time", neutral=_no_lag)]
    range_growth: Annotated[Float, Axes("landmark", neutral=0.0)]
    bearing_falloff: Annotated[Float, Axes("landmark", neutral=0.0)]
    depth: Annotated[float, Axes(neutral=0.0)]
    misread_weight: Annotated[Float, Axes("landmark", neutral=0.0)]
    range_correlation: Annotated[Float, Axes("landmark", neutral=0.0)]
    bearing_correlation: Annotated[Float, Axes("landmark", neutral=0.0)]


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
    extras : NoExtras or LandmarkExtras
        What only effects use.
    """

    first: Annotated[Int, Axes("row_bound")]
    time: Annotated[Int, Axes("sighting")]
    landmark: Annotated[Int, Axes("sighting")]
    range: Annotated[Float, Axes("sighting")]
    bearing: Annotated[Float, Axes("sighting")]
    size: Annotated[Float, Axes("sighting")]
    position: Annotated[Float, Axes("landmark", 2)]
    sensor_pose: Annotated[Float, Axes(3)]
    range_scale: Annotated[Float, Axes("landmark")]
    range_bias: Annotated[Float, Axes("landmark")]
    range_std: Annotated[Float, Axes("landmark")]
    bearing_bias: Annotated[Float, Axes("landmark")]
    bearing_std: Annotated[Float, Axes("landmark")]
    size_constant: Annotated[Float, Axes("landmark")]
    size_std: Annotated[Float, Axes("landmark")]
    outlier_weight: Annotated[Float, Axes("landmark")]
    max_range: Annotated[float, Axes()]
    extras: NoExtras | LandmarkExtras = NoExtras()


def extras_of(table: LandmarkSightings) -> LandmarkExtras:
    """Return the extras of a table that has some."""
    assert isinstance(table.extras, LandmarkExtras)
    return table.extras
