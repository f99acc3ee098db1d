"""What landmark sightings are called in a robot log, and what such a log must hold."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import ClassVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from pmcl.errors import MapError
from pmcl.logs.arrays import LogArrays, landmark_names
from pmcl.logs.finding import Finding
from pmcl.logs.schema import Variable
from pmcl.logs.sensor_variables import ReadingSeries, SensorVariables
from pmcl.logs.validation import ONE_TURN, fail, positive_number, require_finite
from pmcl.maps.landmarks import LandmarkMap

__all__ = ["LandmarkVariables"]

Float = NDArray[np.float64]

_SIGHTING = ("time", "landmark")

_VARIABLES = {
    "landmark_range": Variable(_SIGHTING, "m", "distance reading to a landmark; NaN not seen", True, 0.0),
    "landmark_bearing": Variable(_SIGHTING, "rad", "bearing reading in the sensor frame; NaN not seen", True),
    "landmark_size": Variable(
        _SIGHTING, "pixel", "apparent size; NaN not seen", True, 0.0, attributes=("size_at_one_metre",)
    ),
    "landmark_time_offset": Variable(_SIGHTING, "s", "time of the reading minus time of its sample"),
    "landmark_position": Variable(("landmark", "xy"), "m", "landmark map"),
    "landmark_sensor_pose": Variable(("pose",), "m, m, rad", "where the landmark sensor sits on the robot"),
}


class LandmarkVariables(SensorVariables):
    """Sightings of landmarks in a log."""

    variables: ClassVar[Mapping[str, Variable]] = _VARIABLES

    @classmethod
    def check(cls, dataset: xr.Dataset, where: str) -> None:
        """Check sightings and landmarks; see :meth:`pmcl.logs.sensor_variables.SensorVariables.check`."""
        _check(dataset, [name for name in cls.readings(dataset) if name in dataset], where)

    @classmethod
    def count(cls, readings: Mapping[str, Float]) -> NDArray[np.int64]:
        """Return the number of sightings in each row, (T,).

        One sighting counts once, however much of distance, bearing and size it has.

        Parameters
        ----------
        readings : mapping of str to ndarray, shape (T, J)
            Distances, bearings and sizes, those that the log has.
        """
        seen = np.any([~np.isnan(values) for values in readings.values()], axis=0)
        return np.asarray(np.count_nonzero(seen, axis=1), dtype=np.int64)

    @classmethod
    def settings(cls, log: LogArrays) -> dict[str, Float]:
        """Return where the sensor sits and the pixels at one metre."""
        size = np.nan if log.size_at_one_metre is None else log.size_at_one_metre
        return {"landmark_sensor_pose": log.landmark_sensor_pose, "size_at_one_metre": np.array(size)}

    @classmethod
    def series(cls, log: LogArrays) -> Iterator[ReadingSeries]:
        """Return the readings of each landmark; zero and the greatest distance, at which sensors clip, are NaN."""
        for name, table in _tables(log):
            clipped = (table == 0.0) | ((table == np.nanmax(table, initial=0.0)) & (name == "range"))
            for k, values in enumerate(np.where(clipped, np.nan, table).T):
                yield ReadingSeries(f"{name} of landmark {k}", values)

    @classmethod
    def implausible(cls, log: LogArrays) -> Iterator[Finding]:
        """Return whether zeros seem to stand for landmarks that were not seen."""
        yield from _zeros(log)


def _tables(log: LogArrays) -> Iterator[tuple[str, Float]]:
    """Yield those of distances, bearings and sizes, (T, J), that a log has."""
    for name in ("range", "bearing", "size"):
        values = log.variable(f"landmark_{name}")
        if values is not None:
            yield name, values


def _check(dataset: xr.Dataset, readings: list[str], where: str) -> None:
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


def _zeros(log: LogArrays) -> Iterator[Finding]:
    """Landmark readings of exactly zero, far more often than any other number: a continuous reading never does that."""
    for name, values in _tables(log):
        seen = values[~np.isnan(values)]
        n_zeros = int(np.count_nonzero(seen == 0.0))
        if n_zeros < 3 or n_zeros < 0.02 * seen.size:
            continue
        _, counts = np.unique(seen[seen != 0.0], return_counts=True)
        if counts.size and n_zeros < 10 * int(counts.max()):
            continue
        yield Finding(
            "zero-for-not-seen",
            "implausible",
            True,
            f"{n_zeros} of {seen.size} readings of landmark {name} are exactly 0: write NaN where nothing was seen",
        )
