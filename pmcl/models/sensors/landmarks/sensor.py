"""Landmark sightings: how distances, bearings and sizes scatter around what the map predicts."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import xarray as xr

# The compiled functions of the table register themselves.
import pmcl.models.sensors.landmarks.kernels.full
import pmcl.models.sensors.landmarks.kernels.plain
import pmcl.models.sensors.landmarks.kernels.single_readings  # noqa: F401
from pmcl.engine.residuals import GaussianSums, sum_of_squares
from pmcl.engine.scalars import LOG_2PI
from pmcl.errors import ModelError
from pmcl.geometry import wrap
from pmcl.logs.arrays import LogArrays
from pmcl.logs.robot_log import RobotLog
from pmcl.models.outliers import outlier_prior
from pmcl.models.parameters import Parameter, gamma_prior
from pmcl.models.part import Float, Int, owned
from pmcl.models.sensor import ReadingIndex, Sensor
from pmcl.models.sensors.landmarks.kernels.residuals import SightingResiduals
from pmcl.models.sensors.landmarks.linearisation import (
    covariates,
    empty_like,
    fitted_linearisation,
    ideal,
    linearise,
    moved_linearisation,
)
from pmcl.models.sensors.landmarks.log_variables import LandmarkVariables
from pmcl.models.sensors.landmarks.quick import quick_sightings
from pmcl.models.sensors.landmarks.scoring import sightings_that_differ
from pmcl.models.sensors.landmarks.simulation import simulate
from pmcl.models.sensors.landmarks.table import LandmarkSightings

__all__ = ["LandmarkNoise"]


@dataclass(frozen=True)
class LandmarkNoise(LandmarkVariables, Sensor):
    """Distance, bearing and apparent size of known landmarks, each optional, with optional outliers.

    Attributes
    ----------
    range, bearing, size : bool
        Which readings to use.
    outliers : bool
        Whether a sighting may be a gross error (a wrong identity, a reflection): its distance is then uniform up to
        the greatest distance on the map and its bearing uniform on the circle.
    size_at_one_metre : float, optional
        Pixels that a landmark covers at a distance of one metre; an area, so it falls with the square of the distance.
        Taken from attribute ``size_at_one_metre`` of the log's ``landmark_size`` when left out.
    """

    range: bool = True
    bearing: bool = True
    size: bool = False
    outliers: bool = field(default=False, metadata={"comment": "whether sightings may be gross errors"})
    size_at_one_metre: float | None = field(default=None, metadata={"comment": "pixels"})

    table_type: ClassVar[type] = LandmarkSightings
    summary: ClassVar[str] = "sightings of known landmarks: which readings to use"
    ideal_readings = staticmethod(ideal)
    linearise = staticmethod(linearise)
    fitted_linearisation = staticmethod(fitted_linearisation)
    moved_linearisation = staticmethod(moved_linearisation)
    linearisation_like = staticmethod(empty_like)
    simulate = staticmethod(simulate)
    quick_readings = staticmethod(quick_sightings)
    covariates = staticmethod(covariates)
    parts_that_differ = staticmethod(sightings_that_differ)

    @classmethod
    def default(cls, log: LogArrays, *, outliers: bool = False) -> LandmarkNoise | None:
        """Return the model of a log's landmark readings, None when it has none."""
        has = [values is not None for values in (log.landmark_range, log.landmark_bearing, log.landmark_size)]
        return cls(range=has[0], bearing=has[1], size=has[2], outliers=outliers) if any(has) else None

    @staticmethod
    def store(table: LandmarkSightings, dataset: xr.Dataset) -> None:
        """Write the readings of a table into a log's dataset, in place."""
        for name in ("range", "bearing", "size"):
            values, into = getattr(table, name), f"landmark_{name}"
            seen = ~np.isnan(values)
            if into in dataset and seen.any():
                # A distance below zero, far out in the tail of the noise, is no reading that a log may hold.
                stored = values if name == "bearing" else np.maximum(values, 0.0)
                dataset[into].values[table.time[seen], table.landmark[seen]] = stored[seen]

    @staticmethod
    def index(table: LandmarkSightings, n_steps: int) -> ReadingIndex:
        """Return row, landmark and kind of each slot: distance, bearing and size of each sighting."""
        n = int(table.first[n_steps])
        sighting, kind = np.divmod(np.arange(3 * n, dtype=np.int64), 3)
        reading = np.stack([table.range[:n], table.bearing[:n], table.size[:n]], axis=-1).ravel()
        kinds = ("landmark_range", "landmark_bearing", "landmark_size")
        return ReadingIndex(kinds, kind, table.landmark[sighting], table.time[sighting], reading)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The noises of the readings that are used, then the outlier weight where there is one."""
        distance = Parameter("sigma_landmark_range", "m", gamma_prior(0.2), "noise of a landmark's distance", "noise")
        bearing = Parameter("sigma_bearing", "rad", gamma_prior(0.1), "noise of a landmark's bearing", "noise")
        size = Parameter("sigma_size", "1", gamma_prior(0.2), "noise of the ratio of observed to ideal pixels", "noise")
        weight = Parameter(
            "landmark_outlier_weight", "1", outlier_prior(), "share of sightings that are gross errors", "weight"
        )
        flags = (self.range, self.bearing, self.size, self.outliers)
        pairs = zip(flags, (distance, bearing, size, weight), strict=True)
        return tuple(parameter for used, parameter in pairs if used)

    def bind(self, log: RobotLog) -> BoundLandmarkNoise:
        """Take sightings and landmarks from the log; raises when a reading that the model uses is missing."""
        variables = {
            "landmark_range": (self.range, log.landmark_range),
            "landmark_bearing": (self.bearing, log.landmark_bearing),
            "landmark_size": (self.size, log.landmark_size),
        }
        for name, (used, values) in variables.items():
            if used and values is None:
                raise ModelError(
                    f"{log.where}: the model uses {name}, but the log has no such variable; leave it out of the model"
                )
        if not (self.range or self.bearing or self.size):
            raise ModelError(
                "a landmark sensor must use at least one of range, bearing and size, but none is switched on"
            )
        assert log.landmarks is not None
        used_values = [values for used, values in variables.values() if used and values is not None]
        seen = np.any([~np.isnan(values) for values in used_values], axis=0)
        time, landmark = np.nonzero(seen)
        nothing = np.full(time.size, np.nan)
        columns = [
            owned(values[time, landmark]) if used and values is not None else nothing.copy()
            for used, values in variables.values()
        ]
        n_landmarks = log.landmarks.positions.shape[0]
        zeros, ones = np.zeros(n_landmarks), np.ones(n_landmarks)
        table = LandmarkSightings(
            first=np.searchsorted(time, np.arange(log.n_steps + 1)).astype(np.int64),
            time=time.astype(np.int64),
            landmark=landmark.astype(np.int64),
            range=columns[0],
            bearing=columns[1],
            size=columns[2],
            position=owned(log.landmarks.positions),
            sensor_pose=owned(log.landmark_sensor_pose),
            range_scale=ones,
            range_bias=zeros,
            range_std=ones,
            bearing_bias=zeros,
            bearing_std=ones,
            size_constant=np.full(n_landmarks, self._size_constant(log)),
            size_std=ones,
            outlier_weight=zeros,
            max_range=_greatest_distance(log, columns[0]),
        )
        return BoundLandmarkNoise(table, self.range, self.bearing, self.size, self.outliers)

    def _size_constant(self, log: RobotLog) -> float:
        if not self.size:
            return 1.0
        value = self.size_at_one_metre
        if value is None:
            value = log.dataset["landmark_size"].attrs.get("size_at_one_metre")
        if value is None or not float(value) > 0.0:
            raise ModelError(
                f"{log.where}: landmark sizes need the pixels at one metre (size_at_one_metre > 0), but got {value}; "
                "set it in the model file or as an attribute of landmark_size"
            )
        return float(value)


def _greatest_distance(log: RobotLog, ranges: Float) -> float:
    assert log.landmarks is not None
    x_low, x_high, y_low, y_high = log.landmarks.bounds
    diagonal = float(np.hypot(x_high - x_low, y_high - y_low))
    return max(diagonal, float(np.nanmax(ranges, initial=0.0)) if np.isfinite(ranges).any() else 0.0, 1.0)


@dataclass(frozen=True)
class BoundLandmarkNoise:
    """:class:`LandmarkNoise` with a table in which only noises and outlier weight change."""

    base: LandmarkSightings
    range: bool
    bearing: bool
    size: bool
    outliers: bool

    def table(self, theta: Float) -> LandmarkSightings:
        """Return the table; theta holds the noises in use, then the outlier weight."""
        changes: dict[str, Any] = {}
        for name, value in zip(self._fields, theta.tolist(), strict=True):
            # Numbers of NumPy cost more than those of a few landmarks.
            changes[name] = column = np.empty(self.base.range_std.size)
            column.fill(value)
        return self.base._replace(**changes)

    @functools.cached_property
    def _fields(self) -> list[str]:
        flags = (
            (self.range, "range_std"),
            (self.bearing, "bearing_std"),
            (self.size, "size_std"),
            (self.outliers, "outlier_weight"),
        )
        return [name for used, name in flags if used]

    def statistics(
        self, table: LandmarkSightings, path: Float, ideal: Float, index: Int, theta: Float
    ) -> GaussianSums | SightingResiduals:
        """Return sums of squares, or with outliers the residuals themselves."""
        n = int(table.first[path.shape[0]])
        which = table.landmark[:n]
        distance, bearing = ideal[:n, 0], ideal[:n, 1]
        columns = []
        if self.range:
            columns.append(table.range[:n] - (table.range_scale[which] * distance + table.range_bias[which]))
        if self.bearing:
            turn = table.bearing[:n] - bearing - table.bearing_bias[which]
            columns.append(wrap(turn))
        if self.size:
            columns.append(table.size[:n] * distance**2 / table.size_constant[which] - 1.0)
        if not self.outliers:
            known = [column[column == column] for column in columns]  # NaN differs from itself
            count, squares = [float(column.size) for column in known], [sum_of_squares(column) for column in known]
            return GaussianSums(index, owned(theta), np.array(count), np.array(squares))
        positions = np.flatnonzero([self.range, self.bearing, self.size, True])
        full_index, value, residual = np.full(4, -1, dtype=np.int64), np.ones(4), np.full((n, 3), np.nan)
        full_index[positions], value[positions] = index, theta
        residual[:, positions[:-1]] = np.stack(columns, axis=-1)
        seen = ~np.isnan(residual)
        log_constant = np.log(table.size_constant[which])
        log_outlier = -(
            np.log(table.max_range) * seen[:, 0] + LOG_2PI * seen[:, 1] + log_constant * seen[:, 2]
        )
        log_scale = (2.0 * np.log(distance) - log_constant) * seen[:, 2]
        return SightingResiduals(full_index, value, residual, log_scale, log_outlier)
