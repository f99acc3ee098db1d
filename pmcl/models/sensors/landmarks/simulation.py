"""Draws of sightings, written again from the definition of the table: component by component, without kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.geometry import late_poses, wrap
from pmcl.models.sensors.landmarks.linearisation import ideal
from pmcl.models.sensors.landmarks.table import LandmarkExtras, LandmarkSightings

__all__ = ["simulate"]

Float = NDArray[np.float64]


def simulate(table: LandmarkSightings, path: Float, rng: np.random.Generator) -> LandmarkSightings:
    """Draw sightings along a path (T, >= 3); see :meth:`pmcl.models.sensor.Sensor.simulate`."""
    if isinstance(table.extras, LandmarkExtras):
        return _with_extras(table, path, rng)
    # A bearing is wrapped, while the density is a Gaussian of the wrapped residual: the same but for what a Gaussian
    # has beyond half a turn, 2e-7 at a noise of 0.6 rad.
    which, n = table.landmark, table.landmark.size
    distance, bearing = np.ascontiguousarray(ideal(table, path).T)
    noise = rng.standard_normal((3, n))
    ideal_size = table.size_constant[which] / distance**2
    plain = (
        table.range_scale[which] * distance + table.range_bias[which] + table.range_std[which] * noise[0],
        wrap(bearing + table.bearing_bias[which] + table.bearing_std[which] * noise[1]),
        ideal_size * (1.0 + table.size_std[which] * noise[2]),
    )
    anything = (
        table.max_range * rng.random(n),
        np.pi * (2.0 * rng.random(n) - 1.0),
        table.size_constant[which] * rng.random(n),
    )
    # One coin for the whole sighting: a wrong identity spoils distance, bearing and size together.
    gross = rng.random(n) < table.outlier_weight[which]
    measured = [~np.isnan(values) for values in (table.range, table.bearing, table.size)]
    new = [
        np.where(seen, np.where(gross, wild, sound), np.nan)
        for seen, wild, sound in zip(measured, anything, plain, strict=True)
    ]
    return table._replace(range=new[0], bearing=new[1], size=new[2])


def _with_extras(table: LandmarkSightings, path: Float, rng: np.random.Generator) -> LandmarkSightings:
    named, n, n_landmarks = table.landmark, table.landmark.size, table.position.shape[0]
    poses = late_poses(path, table.extras.lag)[table.time]
    which = named.copy()
    if n_landmarks > 1:
        misread = rng.random(n) < table.extras.misread_weight[named]
        another = (named + rng.integers(1, n_landmarks, n)) % n_landmarks
        which = np.where(misread, another, named)
    centre, std, distance = _expected_sightings(table, which, poses)
    noise = rng.standard_normal((3, n))
    ideal_size = table.size_constant[which] / distance**2
    sound = (
        centre[0] + std[0] * noise[0],
        wrap(centre[1] + std[1] * noise[1]),
        ideal_size * (1.0 + table.size_std[which] * noise[2]),
    )
    wild = (
        table.max_range * rng.random(n),
        np.pi * (2.0 * rng.random(n) - 1.0),
        table.size_constant[named] * rng.random(n),
    )
    gross = rng.random(n) < table.outlier_weight[named]
    new = [
        np.where(np.isnan(seen), np.nan, np.where(gross, strange, plain))
        for seen, strange, plain in zip((table.range, table.bearing, table.size), wild, sound, strict=True)
    ]
    before, spread, _ = _expected_sightings(table, named, late_poses(path, np.zeros(len(path)))[table.time])
    plain = (which == named) & ~gross
    for channel, correlation in enumerate((table.extras.range_correlation, table.extras.bearing_correlation)):
        if correlation.any():
            c = correlation[named]
            _remember(table, new[channel], channel == 1, c, plain, centre[channel], std[channel] * noise[channel],
                      before[channel], spread[channel])
    return table._replace(range=new[0], bearing=new[1], size=new[2])


def _expected_sightings(table: LandmarkSightings, which: Any, poses: Float) -> tuple[Float, Float, Float]:
    """Return centre and standard deviation (2, N) of distances and bearings of landmarks `which`; true distances."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    delta = table.position[which] - poses[:, :2]
    ahead = c * delta[:, 0] + s * delta[:, 1] - table.sensor_pose[0]
    aside = c * delta[:, 1] - s * delta[:, 0] - table.sensor_pose[1]
    distance, bearing = np.hypot(ahead, aside), np.arctan2(aside, ahead) - table.sensor_pose[2]
    told = distance * (1.0 - table.extras.depth + table.extras.depth * np.cos(bearing))
    centre = [table.range_scale[which] * told + table.range_bias[which], bearing + table.bearing_bias[which]]
    std = [
        table.range_std[which] * (1.0 + table.extras.range_growth[which] * distance),
        table.bearing_std[which] * (1.0 + table.extras.bearing_falloff[which] / np.maximum(distance, 0.1)),
    ]
    return np.array(centre), np.array(std), distance


def _remember(
    table: LandmarkSightings, reading: Float, is_angle: bool, correlation: Float, plain: Any, centre: Float, error: Float,
    before: Float, spread: Float,
) -> None:
    """Redraw, one after another and in place, readings whose landmark was read in the row before.

    `centre` and `error` are what was drawn without memory; `before` and `spread` what the state of its own row, not
    late, would have let one expect of each reading.
    """
    last: dict[tuple[int, int], int] = {}
    for k, where in enumerate(zip(table.time.tolist(), table.landmark.tolist(), strict=True)):
        earlier = last.get((where[0] - 1, where[1]))
        last[where] = k
        if earlier is None or not plain[k]:
            continue
        residual = reading[earlier] - before[earlier]
        residual = wrap(residual) if is_angle else residual
        if not abs(residual) < 4.0 * spread[earlier] or np.isnan(reading[k]):
            continue
        drawn = centre[k] + correlation[k] * residual + np.sqrt(1.0 - correlation[k] ** 2) * error[k]
        reading[k] = wrap(drawn) if is_angle else drawn
