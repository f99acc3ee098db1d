"""What a sighting may be of: its own landmark, another landmark, each alike, or nothing at all (a gross error).

Here stand the probability of each, the density and distribution function of a gross error, and the draws.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.compile import kernel
from pmcl.engine.linear_readings import BEARING, RANGE
from pmcl.models.sensors.landmarks.table import LandmarkSightings, extras_of

__all__ = [
    "draw_gross_errors", "draw_landmarks", "gross_below", "gross_density", "identity_weight", "log_gross_density",
    "may_be_misread",
]  # fmt: skip

Float = NDArray[np.float64]
Int = NDArray[np.int64]


@kernel
def may_be_misread(sensor, named):
    """Return whether a sighting said to be of landmark `named` may be of another one."""
    return sensor.extras.misread_weight[named] > 0.0 and sensor.position.shape[0] > 1


@kernel
def identity_weight(sensor, named, j):
    """Return the probability that a sighting said to be of landmark `named` is of j, if it is no gross error."""
    if not may_be_misread(sensor, named):
        return 1.0 if j == named else 0.0
    misread = sensor.extras.misread_weight[named]
    return 1.0 - misread if j == named else misread / (sensor.position.shape[0] - 1)


@kernel
def gross_density(sensor, kind, named):
    """Return the density of one reading of a gross error: uniform over what it may read."""
    if kind == RANGE:
        return 1.0 / sensor.max_range
    return 0.5 / math.pi if kind == BEARING else 1.0 / sensor.size_constant[named]


@kernel
def gross_below(kind, z, residual, density):
    """Return the probability that a gross error reads less, given that bearings are counted from half a turn off.

    `residual` is that of the reading from its own landmark.
    """
    share = 0.5 + residual * density if kind == BEARING else z * density
    return min(max(share, 0.0), 1.0)


@kernel
def log_gross_density(sensor, k, named):
    """Return the log density of all readings of sighting k if it is a gross error."""
    value = 0.0
    if not math.isnan(sensor.range[k]):
        value -= math.log(sensor.max_range)
    if not math.isnan(sensor.bearing[k]):
        value -= math.log(2.0 * math.pi)
    if not math.isnan(sensor.size[k]):
        value -= math.log(sensor.size_constant[named])
    return value


def draw_landmarks(table: LandmarkSightings, rng: np.random.Generator) -> Int:
    """Draw the landmark that each sighting (N,) is of, gross errors aside."""
    named, n, n_landmarks = table.landmark, table.landmark.size, table.position.shape[0]
    if n_landmarks == 1:
        return named
    misread = rng.random(n) < extras_of(table).misread_weight[named]
    another = (named + rng.integers(1, n_landmarks, n)) % n_landmarks
    return np.where(misread, another, named)


def draw_gross_errors(
    table: LandmarkSightings, rng: np.random.Generator
) -> tuple[NDArray[np.bool_], tuple[Float, Float, Float]]:
    """Return which sightings (N,) are gross errors, and what distances, bearings and sizes they then read.

    One draw decides for the whole sighting: a wrong identity spoils distance, bearing and size together.
    """
    named, n = table.landmark, table.landmark.size
    readings = (
        table.max_range * rng.random(n),
        np.pi * (2.0 * rng.random(n) - 1.0),
        table.size_constant[named] * rng.random(n),
    )
    return rng.random(n) < table.outlier_weight[named], readings
