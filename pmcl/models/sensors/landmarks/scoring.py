"""How the critic scores effects of landmark sightings cheaply: only the landmarks that differ."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.tables import axes_of, channels_that_differ, field_of, same_extras
from pmcl.models.sensors.landmarks.table import LandmarkSightings

__all__ = ["sightings_that_differ"]


def sightings_that_differ(
    table: LandmarkSightings, other: LandmarkSightings
) -> tuple[LandmarkSightings, LandmarkSightings]:
    """Keep the sightings of landmarks that are not the same in two tables; see :class:`pmcl.models.sensor.Sensor`."""
    first, second = same_extras(table, other)
    differ = channels_that_differ(first, second, "landmark")
    # A sighting that may be of any landmark cannot be judged without the others.
    misread = any((field_of(each, "misread_weight") > 0.0).any() for each in (first, second))
    if differ is None or differ.all() or misread:
        return table, other
    return _some_sightings(first, differ), _some_sightings(second, differ)


def _some_sightings(seen: LandmarkSightings, landmarks: NDArray[np.bool_]) -> LandmarkSightings:
    """Return a table of the sightings of some landmarks only."""
    kept = landmarks[seen.landmark]
    before = np.concatenate([[0], np.cumsum(kept)])
    of_sightings = [name for name, axes in axes_of(type(seen)).items() if axes == ("sighting",)]
    return seen._replace(first=before[seen.first], **{name: getattr(seen, name)[kept] for name in of_sightings})
