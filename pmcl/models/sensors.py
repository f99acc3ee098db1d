"""Sensor models: how readings scatter around what the map predicts."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from pmcl.errors import ModelError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.parameters import Parameter, gamma_prior
from pmcl.models.parts import Float, Int, owned
from pmcl.models.statistics import GaussianSums, RangeResiduals, SightingResiduals, sum_of_squares
from pmcl.models.tables import LandmarkSightings, RangeBeams

__all__ = ["LandmarkNoise", "RangeNoise", "outlier_prior"]

_HALF_LOG_2PI = 0.5 * np.log(2.0 * np.pi)


def outlier_prior() -> Any:
    """Return the default prior of an outlier weight: beta(1, 30), mean 3 %, 95 % below 10 %.

    It makes outliers rare on purpose: with a flat prior a chain can lock into the mode in which the robot is lost and
    every reading is an outlier.
    """
    return stats.beta(1.0, 30.0)


@dataclass(frozen=True)
class RangeNoise:
    """Gaussian range readings of any number of beams against walls, with optional outliers.

    Parameters are ``sigma_range`` [m] and, with `outliers`, ``range_outlier_weight`` [1].
    """

    outliers: bool = False

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The noise, then the outlier weight where there is one."""
        noise = Parameter("sigma_range", "m", gamma_prior(0.1), "noise of a range reading")
        weight = Parameter(
            "range_outlier_weight", "1", outlier_prior(), "share of range readings that are gross errors"
        )
        return (noise, weight) if self.outliers else (noise,)

    def bind(self, log: RobotLog) -> BoundRangeNoise:
        """Take readings, beams and walls from the log; raises when one is missing."""
        if log.ranges is None or log.beam_poses is None:
            raise ModelError(
                f"{log.where}: the model has range beams, but the log has no variable 'range'; use a landmark model"
            )
        log.require_map()
        assert log.walls is not None
        vertices, wall_start, wall_stop = log.walls.vertices_and_edges()
        n_beams = log.ranges.shape[1]
        zeros, ones = np.zeros(n_beams), np.ones(n_beams)
        table = RangeBeams(
            reading=owned(log.ranges),
            measured=np.count_nonzero(~np.isnan(log.ranges), axis=1).astype(np.int64),
            beam_pose=owned(log.beam_poses),
            bias=zeros,
            scale=ones,
            std=ones,
            outlier_weight=zeros,
            max_range=float(log.max_range),
            vertices=owned(vertices),
            wall_start=np.array(wall_start, dtype=np.int64),
            wall_stop=np.array(wall_stop, dtype=np.int64),
        )
        return BoundRangeNoise(table, self.outliers)


@dataclass(frozen=True)
class BoundRangeNoise:
    """:class:`RangeNoise` with a table in which only noise and outlier weight change."""

    base: RangeBeams
    outliers: bool

    def table(self, theta: Float) -> RangeBeams:
        """Return the table; theta = (sigma_range [m], range_outlier_weight [1] if modelled)."""
        n_beams = self.base.bias.size
        weight = np.full(n_beams, theta[1]) if self.outliers else self.base.outlier_weight
        return self.base._replace(std=np.full(n_beams, theta[0]), outlier_weight=weight)

    def statistics(
        self, table: RangeBeams, path: Float, ideal: Float, index: Int, theta: Float
    ) -> GaussianSums | RangeResiduals:
        """Return a sum of squares where every reading is plainly Gaussian, the residuals otherwise."""
        z = table.reading[: path.shape[0]]
        expected = np.minimum(table.scale * ideal + table.bias, 2.0 * table.max_range)
        measured = ~np.isnan(z)
        low, high = measured & (z <= 0.0), measured & (z >= table.max_range)
        residual = (z - expected)[measured & ~low & ~high]
        if not self.outliers and not (low.any() or high.any()):
            squares = sum_of_squares(residual)
            return GaussianSums(index, owned(theta), np.array([float(residual.size)]), np.array([squares]))
        tail = np.concatenate([expected[low], (table.max_range - expected)[high]])
        if not self.outliers:
            index, theta = np.append(index, -1), np.append(theta, 0.0)
        return RangeResiduals(index, owned(theta), residual, tail, 1.0 / table.max_range)


@dataclass(frozen=True)
class LandmarkNoise:
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
    outliers: bool = False
    size_at_one_metre: float | None = None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The noises of the readings that are used, then the outlier weight where there is one."""
        all_four = (
            (self.range, Parameter("sigma_landmark_range", "m", gamma_prior(0.2), "noise of a landmark's distance")),
            (self.bearing, Parameter("sigma_bearing", "rad", gamma_prior(0.1), "noise of a landmark's bearing")),
            (
                self.size,
                Parameter("sigma_size", "1", gamma_prior(0.2), "noise of the ratio of observed to ideal pixels"),
            ),
            (
                self.outliers,
                Parameter("landmark_outlier_weight", "1", outlier_prior(), "share of sightings that are gross errors"),
            ),
        )
        return tuple(parameter for used, parameter in all_four if used)

    def bind(self, log: RobotLog) -> BoundLandmarkNoise:
        """Take sightings and landmarks from the log; raises when a reading that the model uses is missing."""
        wanted = {
            "landmark_range": (self.range, log.landmark_range),
            "landmark_bearing": (self.bearing, log.landmark_bearing),
            "landmark_size": (self.size, log.landmark_size),
        }
        for name, (used, values) in wanted.items():
            if used and values is None:
                raise ModelError(
                    f"{log.where}: the model uses {name}, but the log has no such variable; leave it out of the model"
                )
        if not (self.range or self.bearing or self.size):
            raise ModelError(
                "a landmark sensor must use at least one of range, bearing and size, but none is switched on"
            )
        assert log.landmarks is not None
        used_values = [values for used, values in wanted.values() if used and values is not None]
        seen = np.any([~np.isnan(values) for values in used_values], axis=0)
        time, landmark = np.nonzero(seen)
        nothing = np.full(time.size, np.nan)
        columns = [
            owned(values[time, landmark]) if used and values is not None else nothing.copy()
            for used, values in wanted.values()
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
        columns = np.empty((len(self._fields), self.base.range_std.size))
        columns.T[:] = theta
        changes: dict[str, Any] = dict(zip(self._fields, columns, strict=True))
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
            columns.append(turn - 2.0 * np.pi * np.floor(turn / (2.0 * np.pi) + 0.5))
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
            np.log(table.max_range) * seen[:, 0] + 2.0 * _HALF_LOG_2PI * seen[:, 1] + log_constant * seen[:, 2]
        )
        log_scale = (2.0 * np.log(distance) - log_constant) * seen[:, 2]
        return SightingResiduals(full_index, value, residual, log_scale, log_outlier)
