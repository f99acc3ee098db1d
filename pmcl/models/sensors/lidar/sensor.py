"""Scans of lidars on a grid map: how their readings scatter around what the map predicts."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import stats

# The compiled functions of the table register themselves.
import pmcl.models.sensors.lidar.kernels.scans  # noqa: F401
from pmcl.checks import check_choice, check_number, check_whole
from pmcl.engine.scalars import HALF_LOG_2PI
from pmcl.errors import ModelError
from pmcl.logs.arrays import LogArrays
from pmcl.logs.robot_log import RobotLog
from pmcl.models.parameters import Parameter, gamma_prior
from pmcl.models.part import Float, Int, owned
from pmcl.models.sensor import ReadingIndex, Sensor
from pmcl.models.sensors.lidar.along_path import along, covariates
from pmcl.models.sensors.lidar.geometry import end_points_along, lengths_along
from pmcl.models.sensors.lidar.grid_arrays import grid_arrays
from pmcl.models.sensors.lidar.kernels.statistics import BeamReadings, FieldCounts
from pmcl.models.sensors.lidar.linearisation import empty_like, linearise, moved_linearisation
from pmcl.models.sensors.lidar.log_variables import LidarVariables
from pmcl.models.sensors.lidar.quick import quick_scans
from pmcl.models.sensors.lidar.scoring import rays_that_differ
from pmcl.models.sensors.lidar.simulation import replicate, simulate
from pmcl.models.sensors.lidar.table import BEAM, FIELD, OPEN_RAY, LidarTable, cell_noise
from pmcl.models.sensors.lidar.tempering import usual_exponent

__all__ = ["MODELS", "USUAL_BEAMS", "Lidar"]

MODELS = {"likelihood-field": FIELD, "beam": BEAM}
"""The models of a reading by their names in model files."""

USUAL_BEAMS = {"likelihood-field": 60, "beam": 20}
"""Beams of a scan that are read when nothing is said. nav2 reads 60. A cast ray costs some seventy times as much as a
look into the field; beams are not independent, so a third of them says nearly as much."""


@dataclass(frozen=True)
class Lidar(LidarVariables, Sensor):
    """Scans of all lasers of a robot on a grid map; the lasers share their parameters.

    Parameters of the model, named as in nav2, are ``sigma_hit`` [m], ``z_rand`` and, under the beam model, ``z_short``,
    ``z_max`` and ``lambda_short`` [1/m]. The weight ``z_hit`` is what is left of 1.

    Attributes
    ----------
    model : {"likelihood-field", "beam"}
        How one reading is judged, see :class:`~pmcl.models.sensors.lidar.table.LidarTable`.
    exponent : float, optional
        Exponent of each reading's density, in (0, 1]; by default :func:`.usual_exponent` of the beams of a scan.
    max_beams : int, optional
        Greatest number of beams of each laser that are read, spread evenly over its scan; by default
        :data:`USUAL_BEAMS`.

    Notes
    -----
    The beam model is a density of the reading. The likelihood field is the product of nav2's ``likelihood_field_prob``
    with a normalised hit, as beluga has it: a density of how far a reading ends from a wall that is met square on, plus
    the uniform density of an unrelated one. It does not ask what stands between, and no echo says nothing. The variance
    of a hit is ``sigma_hit**2 + cell**2 / 6``: where in its cell a reading ends is not asked, nor where in its cell a
    wall is. Without the second term the density of readings that end in an occupied cell would grow without bound as
    sigma_hit goes to 0, and so would the posterior: on a map with cells of 0.1 m chains then end at 1e-23 m.
    Readings at or below the laser's `min_range` count as not measured.

    Where single readings are foreseen, one under the likelihood field is less than z with probability
    ``z_hit Phi(s / sigma_hit) + z_rand z / max_range``. Before the ray meets something, -s is the distance of the
    reading's end from the nearest occupied cell; behind it, s is that of the mirror image before it. As distances are
    known to within half a cell, the distribution function is given for s less and plus half a cell, and the variance
    is that of the distances of cells, ``sigma_hit^2``, plus that of a place within a cell, a twelfth of its side
    squared.
    """

    model: str = field(default="likelihood-field", metadata={"comment": 'or "beam"', "choices": tuple(MODELS)})
    exponent: float | None = field(
        default=None, metadata={"comment": "of each beam's density: beams of a scan are not independent"}
    )
    max_beams: int | None = field(
        default=None, metadata={"comment": "beams of each laser that are read", "whole": True}
    )

    table_type: ClassVar[type] = LidarTable
    summary: ClassVar[str] = "scans of lidars on the grid map"
    linearise = staticmethod(linearise)
    moved_linearisation = staticmethod(moved_linearisation)
    linearisation_like = staticmethod(empty_like)
    simulate = staticmethod(simulate)
    replicate = staticmethod(replicate)
    quick_readings = staticmethod(quick_scans)
    along = staticmethod(along)
    covariates = staticmethod(covariates)
    parts_that_differ = staticmethod(rays_that_differ)

    def __post_init__(self) -> None:
        """Check the settings."""
        check_choice("model of the lidar", self.model, tuple(MODELS), error=ModelError)
        if self.max_beams is not None:
            beams = int(self.max_beams) if self.max_beams == np.floor(self.max_beams) else self.max_beams
            check_whole("max_beams", beams, 1, error=ModelError, advice="60 are usual")
            object.__setattr__(self, "max_beams", beams)
        if self.exponent is not None:
            advice = "1 takes beams as independent; leave it out for the usual exponent"
            exponent = check_number("exponent", self.exponent, 0.0, 1.0, error=ModelError, advice=advice)
            object.__setattr__(self, "exponent", float(exponent))
            if exponent == 0.0:
                raise ModelError(f"expected exponent > 0, but got 0, with which no reading says anything; {advice}")

    @classmethod
    def default(cls, log: LogArrays, *, outliers: bool = False) -> Lidar | None:
        """Return the model of a log's scans, None when it has none.

        Readings that nothing explains are part of it, whatever `outliers` says.
        """
        return cls() if log.lidars else None

    def usual_settings(self, log: LogArrays) -> dict[str, object]:
        """Return the number of beams and the exponent that a log's scans usually get, where none was chosen."""
        if not log.lidars:
            return {}
        beams = max(rays.size for rays in self._rays(log).values())
        usual = {"exponent": usual_exponent(beams), "max_beams": USUAL_BEAMS[self.model]}
        return {name: value for name, value in usual.items() if getattr(self, name) is None}

    def with_exponent(self, exponent: float) -> Lidar:
        """Return the sensor with another exponent; see :meth:`pmcl.models.sensor.Sensor.with_exponent`."""
        return replace(self, exponent=exponent)

    def _rays(self, log: LogArrays) -> dict[str, Int]:
        most = USUAL_BEAMS[self.model] if self.max_beams is None else self.max_beams
        return {name: chosen_rays(laser.angles.size, most) for name, laser in log.lidars.items()}

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters in the order of the table function: sigma_hit, then weights and the rate of short readings."""
        # A laser's own noise is 0.01 to 0.03 m; with the errors of maps it is 0.05 to 0.2 m.
        sigma = Parameter("sigma_hit", "m", gamma_prior(0.1), "noise of a reading that ends at the wall", "noise")
        # Weights that sum to more than 1 have no density; priors make that rare. Tuned z_rand are 0.05 to 0.5.
        rand = Parameter("z_rand", "1", stats.beta(1.0, 4.0), "share of readings that nothing explains", "weight")
        if self.model == "likelihood-field":
            return (sigma, rand)
        short = Parameter("z_short", "1", stats.beta(1.0, 9.0), "share of readings of what stands before the wall",
                          "weight")  # fmt: skip
        no_echo = Parameter("z_max", "1", stats.beta(1.0, 19.0), "share of readings without echo", "weight")
        # People and furniture stand 0.3 to 10 m away; nav2's default is 0.1 / m.
        rate = Parameter("lambda_short", "1/m", stats.lognorm(1.0, scale=0.5), "rate of such readings along the ray")
        return (sigma, short, no_echo, rand, rate)

    def bind(self, log: RobotLog) -> BoundLidar:
        """Take scans and map from the log; raises when one is missing."""
        if not log.lidars:
            raise ModelError(
                f"{log.where}: the model has a lidar, but the log has no variable 'scan'; use a model without it"
            )
        arrays = grid_arrays(log.require_grid_map())
        rays = self._rays(log)
        readings, poses, reach, laser_of = [], [], [], []
        for number, (name, laser) in enumerate(log.lidars.items()):
            chosen = rays[name]
            values = laser.ranges[:, chosen]
            with np.errstate(invalid="ignore"):
                values = np.where(values <= laser.min_range, np.nan, np.minimum(values, laser.max_range))
            x, y, yaw = laser.pose
            readings.append(values)
            poses.append([(x, y, yaw + angle) for angle in laser.angles[chosen]])
            reach.append(np.full(chosen.size, laser.max_range))
            laser_of.append(np.full(chosen.size, number, dtype=np.int64))
        reading, max_range, laser_numbers = np.hstack(readings), np.concatenate(reach), np.concatenate(laser_of)
        says = ~np.isnan(reading) if self.model == "beam" else reading < max_range
        zeros, ones = np.zeros(max_range.size), np.ones(max_range.size)
        settings = {"exponent": self.exponent, **self.usual_settings(log)}
        table = LidarTable(
            reading=owned(reading),
            measured=np.count_nonzero(says, axis=1).astype(np.int64),
            beam_pose=owned(np.vstack(poses)),
            bias=zeros,
            scale=ones,
            std=ones,
            max_range=owned(max_range),
            laser=laser_numbers,
            ray=np.concatenate(list(rays.values())),
            names=_encoded(rays),
            model=MODELS[self.model],
            exponent=float(settings["exponent"]),  # type: ignore[arg-type]
            z_hit=1.0,
            z_short=0.0,
            z_max=0.0,
            z_rand=0.0,
            lambda_short=1.0,
            level_log_density=np.zeros((len(rays), arrays.level_distance.size)),
            **arrays._asdict(),
        )
        return BoundLidar(table)

    @staticmethod
    def ideal_readings(table: LidarTable, path: Float) -> Any:
        """Return ray lengths [m] (beam model), or the levels at which readings end (likelihood field), (T, R)."""
        return lengths_along(table, path) if table.model == BEAM else end_points_along(table, path)

    @staticmethod
    def store(table: LidarTable, dataset: xr.Dataset) -> None:
        """Write the readings of a table into a log's dataset, in place; rays that the table leaves out become NaN."""
        for number, name in enumerate(_decoded(table.names)):
            mine = table.laser == number
            values = dataset[name].values
            values[:] = np.nan
            values[:, table.ray[mine]] = table.reading[:, mine]

    @staticmethod
    def index(table: LidarTable, n_steps: int) -> ReadingIndex:
        """Return row, laser and ray of each slot: all rays of a row, then those of the next."""
        n_rays = table.ray.size
        time, beam = np.divmod(np.arange(n_steps * n_rays, dtype=np.int64), n_rays)
        return ReadingIndex(
            _decoded(table.names), table.laser[beam], table.ray[beam], time, table.reading[:n_steps].ravel()
        )

    @classmethod
    def independent_readings(cls, table: LidarTable, n_steps: int) -> Float:
        """Return the rays of each row that say something, times the exponent with which they count."""
        return np.asarray(table.exponent * table.measured[:n_steps])


def chosen_rays(count: int, most: int) -> Int:
    """Return at most `most` rays of a scan of `count`, spread evenly from the first to the last."""
    if count <= most:
        return np.arange(count, dtype=np.int64)
    return np.unique(np.rint(np.linspace(0, count - 1, most)).astype(np.int64))


def _encoded(lasers: Any) -> NDArray[np.uint8]:
    """Return the names of the lasers' variables as numbers, which a table can hold."""
    text = "\n".join(f"scan_{name}" if name else "scan" for name in lasers)
    return np.array(list(text.encode()), dtype=np.uint8)


def _decoded(names: NDArray[np.uint8]) -> tuple[str, ...]:
    return tuple(bytes(names).decode().split("\n"))


@dataclass(frozen=True)
class BoundLidar:
    """:class:`Lidar` with a table in which only noise and weights change."""

    base: LidarTable

    def table(self, theta: Float) -> LidarTable:
        """Return the table; theta is in the order of :attr:`Lidar.parameters`."""
        n_rays = self.base.ray.size
        if self.base.model == FIELD:
            sigma, z_rand = (float(value) for value in theta)
            # A noise below zero has no meaning and gives NaN, which whoever proposed it is told.
            std = math.hypot(sigma, cell_noise(self.base.resolution)) if sigma >= 0.0 else math.nan
            return self.base._replace(
                std=np.full(n_rays, std), z_hit=1.0 - z_rand, z_rand=z_rand,
                level_log_density=self._level_log_density(std, z_rand),
            )  # fmt: skip
        sigma, z_short, z_max, z_rand, rate = (float(value) for value in theta)
        return self.base._replace(
            std=np.full(n_rays, sigma), z_hit=1.0 - z_short - z_max - z_rand, z_short=z_short, z_max=z_max,
            z_rand=z_rand, lambda_short=rate,
        )  # fmt: skip

    def _level_log_density(self, std: float, z_rand: float) -> Float:
        """Return the log density at each distance for each laser, (lasers, K)."""
        _, first = np.unique(self.base.laser, return_index=True)
        uniform = z_rand / self.base.max_range[first, None]
        # Numbers without meaning give NaN, which whoever proposed them is told.
        with np.errstate(divide="ignore", invalid="ignore"):
            log_hit = np.log1p(-z_rand) - 0.5 * (self.base.level_distance / std) ** 2 - np.log(std) - HALF_LOG_2PI
            return owned(np.logaddexp(log_hit, np.log(uniform)))

    def statistics(
        self, table: LidarTable, path: Float, ideal: Any, index: Int, theta: Float
    ) -> FieldCounts | BeamReadings:
        """Return how many readings end at which distance (likelihood field), or all readings (beam model)."""
        if table.model == FIELD:
            return _field_counts(table, ideal, index, theta)
        reading = table.reading[: path.shape[0]]
        expected = np.clip(table.scale * ideal + table.bias, 1e-3, OPEN_RAY * table.max_range)
        measured = ~np.isnan(reading)
        reach = np.broadcast_to(table.max_range, reading.shape)[measured]
        return BeamReadings(
            index, owned(theta), owned(reading[measured]), owned(expected[measured]), owned(reach), table.exponent
        )


def _field_counts(table: LidarTable, levels: Int, index: Int, theta: Float) -> FieldCounts:
    n_levels = table.level_distance.size
    n_lasers = table.level_log_density.shape[0]
    slots = (levels + table.laser * n_levels)[levels >= 0]
    counts = np.bincount(slots, minlength=n_lasers * n_levels)
    found = np.flatnonzero(counts)
    laser, level = np.divmod(found, n_levels)
    _, first = np.unique(table.laser, return_index=True)
    return FieldCounts(
        index, owned(theta), table.level_distance[level], counts[found].astype(float),
        1.0 / table.max_range[first][laser], cell_noise(table.resolution), table.exponent,
    )  # fmt: skip
