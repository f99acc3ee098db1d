"""What landmark sightings are called in a robot log, and what such a log must hold."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from pmcl.errors import MapError
from pmcl.logs.arrays import landmark_names
from pmcl.logs.schema import Variable
from pmcl.logs.validation import ONE_TURN, check_readings, fail, positive_number, require_finite
from pmcl.maps.landmarks import LandmarkMap

__all__ = ["VARIABLES", "check_sightings", "count_sightings"]

_SIGHTING = ("time", "landmark")

VARIABLES = {
    "landmark_range": Variable(_SIGHTING, "m", "distance reading to a landmark; NaN not seen", True, 0.0),
    "landmark_bearing": Variable(_SIGHTING, "rad", "bearing reading in the sensor frame; NaN not seen", True),
    "landmark_size": Variable(_SIGHTING, "pixel", "apparent size; NaN not seen", True, 0.0),
    "landmark_time_offset": Variable(_SIGHTING, "s", "time of the reading minus time of its sample"),
    "landmark_position": Variable(("landmark", "xy"), "m", "landmark map"),
    "landmark_sensor_pose": Variable(("pose",), "m, m, rad", "where the landmark sensor sits on the robot"),
}
"""Variables of landmark sightings, by their names in a log."""


def check_sightings(dataset: xr.Dataset, where: str) -> None:
    """Check sightings and landmarks of a log; see :meth:`pmcl.models.sensor.Sensor.check`."""
    readings = [name for name, variable in VARIABLES.items() if variable.is_reading and name in dataset]
    if "landmark_position" in dataset:
        try:
            LandmarkMap(dataset["landmark_position"].values, landmark_names(dataset))
        except MapError as problem:
            raise MapError(f"{where}, 'landmark_position': {problem}") from None
    elif readings:
        fail(
            where,
            f"expected variable 'landmark_position' (landmark, xy) beside '{readings[0]}', got none: add the map",
        )
    check_readings(dataset, VARIABLES, where, also_finite=("landmark_time_offset",))
    if "landmark_bearing" in dataset:
        _check_bearings(dataset, where)
    if "landmark_size" in dataset and "size_at_one_metre" in dataset["landmark_size"].attrs:
        stated = dataset["landmark_size"].attrs["size_at_one_metre"]
        size = positive_number(stated)
        if size is None:
            fail(
                where,
                f"expected attribute size_at_one_metre > 0 [pixel] on 'landmark_size', got {stated!r}: correct it",
            )
        dataset["landmark_size"].attrs["size_at_one_metre"] = size
    if "landmark_sensor_pose" in dataset:
        require_finite(dataset, "landmark_sensor_pose", where)


def count_sightings(readings: Mapping[str, NDArray[np.float64]]) -> NDArray[np.int64]:
    """Return the number of sightings in each row; one counts once, however much of distance, bearing and size it says.

    Parameters
    ----------
    readings : mapping of str to ndarray, shape (T, J)
        Distances, bearings and sizes, those that the log has.

    Returns
    -------
    ndarray of int, shape (T,)
    """
    seen = np.any([~np.isnan(values) for values in readings.values()], axis=0)
    return np.asarray(np.count_nonzero(seen, axis=1), dtype=np.int64)


def _check_bearings(dataset: xr.Dataset, where: str) -> None:
    bad = np.argwhere(np.abs(dataset["landmark_bearing"].values) > ONE_TURN)
    if len(bad):
        row, j = (int(i) for i in bad[0])
        fail(
            where,
            f"expected 'landmark_bearing' within one turn (+-2 pi rad), got "
            f"{dataset['landmark_bearing'].values[row, j]:g} in row {row} (time {dataset['time'].values[row]:.9g} s), "
            f"landmark {j}: convert degrees to radians, or bring angles into one turn",
        )
