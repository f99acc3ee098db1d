"""Range beams against walls: how their readings scatter around what the map predicts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import xarray as xr

# The compiled functions of the table register themselves.
import pmcl.models.sensors.range_beams.kernels.full
import pmcl.models.sensors.range_beams.kernels.plain  # noqa: F401
from pmcl.engine.residuals import GaussianSums, sum_of_squares
from pmcl.errors import ModelError
from pmcl.logs.arrays import LogArrays
from pmcl.logs.robot_log import RobotLog
from pmcl.models.outliers import outlier_prior
from pmcl.models.parameters import Parameter, gamma_prior
from pmcl.models.part import Float, Int, owned
from pmcl.models.sensor import ReadingIndex, Sensor
from pmcl.models.sensors.range_beams.along_path import along, covariates
from pmcl.models.sensors.range_beams.kernels.residuals import RangeResiduals
from pmcl.models.sensors.range_beams.linearisation import (
    beam_lengths,
    empty_like,
    fitted_linearisation,
    linearise,
    moved_linearisation,
)
from pmcl.models.sensors.range_beams.log_variables import RangeVariables
from pmcl.models.sensors.range_beams.quick import quick_beams
from pmcl.models.sensors.range_beams.scoring import RayCache, beams_that_differ, scoring_calls
from pmcl.models.sensors.range_beams.simulation import simulate
from pmcl.models.sensors.range_beams.table import OPEN_RAY, RangeBeams

__all__ = ["RangeNoise"]


@dataclass(frozen=True)
class RangeNoise(RangeVariables, Sensor):
    """Gaussian range readings of any number of beams against walls, with optional outliers.

    Parameters are ``sigma_range`` [m] and, with `outliers`, ``range_outlier_weight`` [1].
    """

    outliers: bool = field(default=False, metadata={"comment": "whether readings may be gross errors"})

    table_type: ClassVar[type] = RangeBeams
    summary: ClassVar[str] = "range beams against the walls"
    ideal_readings = staticmethod(beam_lengths)
    linearise = staticmethod(linearise)
    fitted_linearisation = staticmethod(fitted_linearisation)
    moved_linearisation = staticmethod(moved_linearisation)
    linearisation_like = staticmethod(empty_like)
    simulate = staticmethod(simulate)
    quick_readings = staticmethod(quick_beams)
    along = staticmethod(along)
    covariates = staticmethod(covariates)
    parts_that_differ = staticmethod(beams_that_differ)
    score_cache = staticmethod(RayCache)
    scoring_calls = staticmethod(scoring_calls)

    @classmethod
    def default(cls, log: LogArrays, *, outliers: bool = False) -> RangeNoise | None:
        """Return the model of a log's range readings, None when it has none."""
        return None if log.ranges is None else cls(outliers=outliers)

    @staticmethod
    def store(table: RangeBeams, dataset: xr.Dataset) -> None:
        """Write the readings of a table into a log's dataset, in place."""
        dataset["range"].values[:] = table.reading

    @staticmethod
    def index(table: RangeBeams, n_steps: int) -> ReadingIndex:
        """Return row and beam of each slot: all beams of a row, then those of the next."""
        n_beams = table.reading.shape[1]
        time, beam = np.divmod(np.arange(n_steps * n_beams, dtype=np.int64), n_beams)
        return ReadingIndex(("range",), np.zeros_like(beam), beam, time, table.reading[:n_steps].ravel())

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The noise, then the outlier weight where there is one."""
        noise = Parameter("sigma_range", "m", gamma_prior(0.1), "noise of a range reading", "noise")
        weight = Parameter(
            "range_outlier_weight", "1", outlier_prior(), "share of range readings that are gross errors", "weight"
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
        expected = np.minimum(table.scale * ideal + table.bias, OPEN_RAY * table.max_range)
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
