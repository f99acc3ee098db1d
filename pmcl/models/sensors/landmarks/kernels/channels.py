"""The readings of one sighting of a landmark: a distance, a bearing, an apparent size, each may be missing (NaN).

Each is Gaussian around what the landmark's place lets one expect, and may be related to the reading of the same
landmark in the row before. Here stand their density, distribution function and draw.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.compile import kernel
from pmcl.engine.linear_readings import BEARING, RANGE, SIZE
from pmcl.engine.scalars import wrap_angle
from pmcl.geometry import wrap
from pmcl.models.sensors.landmarks.kernels.rows import AHEAD, ANGLE, ASIDE, DISTANCE
from pmcl.models.sensors.landmarks.linearisation import relative_positions
from pmcl.models.sensors.landmarks.table import LandmarkSightings, extras_of

__all__ = [
    "NEAREST", "RELATED", "correlation_of", "draw_given_last", "draw_sightings", "expected_sightings", "given_last",
    "last_sighting", "reading_of", "residual_and_std",
]  # fmt: skip

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# A reading that was off by more standard deviations than this was no reading of its landmark, and is unrelated to the
# next one.
RELATED = 4.0
# Nearer landmarks count as this far for the noise of their bearing [m].
NEAREST = 0.1


@kernel
def reading_of(sensor, kind, k):
    """Return one reading of sighting k; NaN where it was not measured."""
    return sensor.range[k] if kind == RANGE else (sensor.bearing[k] if kind == BEARING else sensor.size[k])


@kernel
def residual_and_std(sensor, kind, k, j, ahead, aside, distance, angle):
    """Return residual and standard deviation of one reading, were it of landmark j; `angle` is the bearing there."""
    if kind == RANGE:
        seen = distance + sensor.extras.depth * (ahead - distance)
        std = sensor.range_std[j] * (1.0 + sensor.extras.range_growth[j] * distance)
        return sensor.range[k] - sensor.range_scale[j] * seen - sensor.range_bias[j], std
    if kind == BEARING:
        residual = wrap_angle(sensor.bearing[k] - sensor.bearing_bias[j] - angle)
        return residual, sensor.bearing_std[j] * (1.0 + sensor.extras.bearing_falloff[j] / max(distance, NEAREST))
    ideal = sensor.size_constant[j] / (distance * distance)
    return sensor.size[k] - ideal, sensor.size_std[j] * ideal


@kernel
def correlation_of(sensor, kind, j):
    """Return the correlation of a residual with that of the same landmark in the row before; sizes have none."""
    if kind == SIZE:
        return 0.0
    return sensor.extras.range_correlation[j] if kind == RANGE else sensor.extras.bearing_correlation[j]


@kernel
def last_sighting(sensor, t, j):
    """Return the sighting of landmark j in the row before t; -1 without one, or where errors of j do not last."""
    found = -1
    if t > 0 and (sensor.extras.range_correlation[j] != 0.0 or sensor.extras.bearing_correlation[j] != 0.0):
        for k in range(sensor.first[t - 1], sensor.first[t]):
            if sensor.landmark[k] == j:
                found = k
    return found


@kernel
def given_last(sensor, kind, last, residual, std, before, i):
    """Return residual and standard deviation of a reading of its own landmark given sighting `last` of it.

    `before` holds where the landmark lay from the state before, column `i`.
    """
    j = sensor.landmark[last]
    error, spread = residual_and_std(
        sensor, kind, last, j, before[AHEAD, i], before[ASIDE, i], before[DISTANCE, i], before[ANGLE, i]
    )
    correlation = correlation_of(sensor, kind, j)
    # What was not measured is NaN, and as unrelated as a gross error.
    if not abs(error) < RELATED * spread:
        return residual, std
    residual -= correlation * error
    if kind == BEARING:
        residual = wrap_angle(residual)
    return residual, std * math.sqrt(1.0 - correlation * correlation)


def expected_sightings(table: LandmarkSightings, which: Int, poses: Float) -> tuple[Float, Float, Float]:
    """Return what sightings of landmarks `which` (N,) from `poses` (N, 3) should read.

    Returns
    -------
    centre, std : ndarray, shape (2, N)
        Expected distances [m] and bearings [rad], and their standard deviations.
    distance : ndarray, shape (N,)
        The true distances [m].
    """
    ahead, aside = relative_positions(table, which, poses)
    distance, bearing = np.hypot(ahead, aside), np.arctan2(aside, ahead) - table.sensor_pose[2]
    extras = extras_of(table)
    seen = distance * (1.0 - extras.depth + extras.depth * np.cos(bearing))
    centre = [table.range_scale[which] * seen + table.range_bias[which], bearing + table.bearing_bias[which]]
    std = [
        table.range_std[which] * (1.0 + extras.range_growth[which] * distance),
        table.bearing_std[which] * (1.0 + extras.bearing_falloff[which] / np.maximum(distance, NEAREST)),
    ]
    return np.array(centre), np.array(std), distance


def draw_sightings(
    table: LandmarkSightings, which: Int, centre: Float, std: Float, distance: Float, noise: Float
) -> tuple[Float, Float, Float]:
    """Return distances, bearings and sizes (N,) of landmarks `which` (N,), unrelated to those before.

    `centre` and `std` (2, N) are of distances and bearings, `distance` (N,) the true distances; `noise` (3, N) are
    standard normals.

    A bearing is wrapped, while its density is a Gaussian of the wrapped residual: the same but for what a Gaussian has
    beyond half a turn, 2e-7 at a noise of 0.6 rad.
    """
    ideal_size = table.size_constant[which] / distance**2
    return (
        centre[0] + std[0] * noise[0],
        wrap(centre[1] + std[1] * noise[1]),
        ideal_size * (1.0 + table.size_std[which] * noise[2]),
    )


def draw_given_last(
    table: LandmarkSightings, kind: int, reading: Float, own: NDArray[np.bool_], centre: Float, error: Float,
    centre_before: Float, std_before: Float,
) -> None:  # fmt: skip
    """Redraw, in place and one after another, readings whose landmark was read in the row before.

    Parameters
    ----------
    table : LandmarkSightings
        The table, with extras.
    kind : int
        RANGE or BEARING.
    reading : ndarray, shape (N,)
        The readings, drawn without memory; changed in place.
    own : ndarray of bool, shape (N,)
        Which readings are of their own landmark.
    centre, error : ndarray, shape (N,)
        What was expected of them, and by how much they were drawn off it.
    centre_before, std_before : ndarray, shape (N,)
        What the pose of its own row, not late, lets one expect of each reading, and its standard deviation.
    """
    extras = extras_of(table)
    correlation = (extras.bearing_correlation if kind == BEARING else extras.range_correlation)[table.landmark]
    last: dict[tuple[int, int], int] = {}
    for k, (t, j) in enumerate(zip(table.time.tolist(), table.landmark.tolist(), strict=True)):
        earlier = last.get((t - 1, j))
        last[t, j] = k
        if earlier is None or not own[k]:
            continue
        residual = reading[earlier] - centre_before[earlier]
        residual = wrap(residual) if kind == BEARING else residual
        if not abs(residual) < RELATED * std_before[earlier] or np.isnan(reading[k]):
            continue
        drawn = centre[k] + correlation[k] * residual + np.sqrt(1.0 - correlation[k] ** 2) * error[k]
        reading[k] = wrap(drawn) if kind == BEARING else drawn
