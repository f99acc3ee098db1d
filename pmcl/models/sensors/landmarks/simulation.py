"""Draws of sightings along a path, without any compiled kernel of their densities.

The draws of readings stand in :mod:`pmcl.models.sensors.landmarks.kernels.channels`, those of what a sighting is of in
:mod:`pmcl.models.sensors.landmarks.kernels.identities`, each beside its density.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.linear_readings import BEARING, RANGE
from pmcl.geometry import late_poses
from pmcl.models.sensors.landmarks.kernels.channels import draw_given_last, draw_sightings, expected_sightings
from pmcl.models.sensors.landmarks.kernels.identities import draw_gross_errors, draw_landmarks
from pmcl.models.sensors.landmarks.linearisation import ideal
from pmcl.models.sensors.landmarks.table import LandmarkExtras, LandmarkSightings, extras_of

__all__ = ["simulate"]

Float = NDArray[np.float64]


def simulate(table: LandmarkSightings, path: Float, rng: np.random.Generator) -> LandmarkSightings:
    """Draw sightings along a path (T, >= 3); see :meth:`pmcl.models.sensor.Sensor.simulate`."""
    readings = _with_extras(table, path, rng) if isinstance(table.extras, LandmarkExtras) else _plain(table, path, rng)
    measured = (table.range, table.bearing, table.size)
    new = [np.where(np.isnan(old), np.nan, drawn) for old, drawn in zip(measured, readings, strict=True)]
    return table._replace(range=new[0], bearing=new[1], size=new[2])


def _plain(table: LandmarkSightings, path: Float, rng: np.random.Generator) -> list[Float]:
    which = table.landmark
    distance, bearing = np.ascontiguousarray(ideal(table, path).T)
    expected_range = table.range_scale[which] * distance + table.range_bias[which]
    centre = np.stack([expected_range, bearing + table.bearing_bias[which]])
    std = np.stack([table.range_std[which], table.bearing_std[which]])
    sound = draw_sightings(table, which, centre, std, distance, rng.standard_normal((3, which.size)))
    gross, wild = draw_gross_errors(table, rng)
    return [np.where(gross, error, reading) for error, reading in zip(wild, sound, strict=True)]


def _with_extras(table: LandmarkSightings, path: Float, rng: np.random.Generator) -> list[Float]:
    extras, which = extras_of(table), draw_landmarks(table, rng)
    centre, std, distance = expected_sightings(table, which, late_poses(path, extras.lag)[table.time])
    noise = rng.standard_normal((3, which.size))
    sound = draw_sightings(table, which, centre, std, distance, noise)
    gross, wild = draw_gross_errors(table, rng)
    readings = [np.where(gross, error, reading) for error, reading in zip(wild, sound, strict=True)]
    # What was not measured must not be remembered.
    readings[RANGE][np.isnan(table.range)] = np.nan
    readings[BEARING][np.isnan(table.bearing)] = np.nan
    # The row before is looked back at from the pose of its own row, not late.
    prompt = late_poses(path, np.zeros(len(path)))[table.time]
    centre_before, std_before, _ = expected_sightings(table, table.landmark, prompt)
    own = (which == table.landmark) & ~gross
    for kind, correlation in ((RANGE, extras.range_correlation), (BEARING, extras.bearing_correlation)):
        if correlation.any():
            draw_given_last(
                table, kind, readings[kind], own, centre[kind], std[kind] * noise[kind], centre_before[kind],
                std_before[kind],
            )  # fmt: skip
    return readings
