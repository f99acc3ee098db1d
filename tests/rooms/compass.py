"""A sensor as another package would add it: a compass, and the effect that it is mounted askew.

It uses public names of pmcl only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from pmcl import Parameter, RobotLog, engine
from pmcl.geometry import wrap
from pmcl.logs import Variable
from pmcl.models import BoundPart, ReadingIndex, Sensor, gamma_prior
from pmcl.models.effects import Effect, edit_sensors

Float = NDArray[np.float64]


class CompassTable(NamedTuple):
    """What compiled code sees: headings (T,) [rad], NaN where there is none; constant offset and noise [rad]."""

    heading: Annotated[Float, engine.Axes("time")]
    offset: Annotated[float, engine.Axes()]
    std: Annotated[float, engine.Axes()]


class CompassSlopes(NamedTuple):
    error: Float  # heading read minus reference heading, (T,) [rad]


@engine.scratch_rows.register(CompassTable)
def _scratch_rows(table):
    return 0


@engine.looks_back.register(CompassTable)
def _looks_back(sensor):
    return False


@engine.has_reading.register(CompassTable)
def _has_reading(sensor, t):
    return not math.isnan(sensor.heading[t])


@engine.kernel
def _z(sensor, t, heading):
    """Return the error of the reading for one heading, wrapped, in standard deviations."""
    error = sensor.heading[t] - sensor.offset - heading
    return (error - 2.0 * math.pi * math.floor(error / (2.0 * math.pi) + 0.5)) / sensor.std


@engine.reading_logpdf.register(CompassTable)
def _reading_logpdf(sensor, t, previous, current, logp, scratch):
    constant = -math.log(sensor.std) - 0.5 * math.log(2.0 * math.pi)
    for i in range(logp.size):
        z = _z(sensor, t, current[2, i])
        logp[i] += constant - 0.5 * z * z


@engine.one_reading.register(CompassTable)
def _one_reading(sensor, t, slot, previous, current, logp, low, high, memory, scratch):
    if math.isnan(sensor.heading[t]):
        return False
    for i in range(logp.size):
        z = _z(sensor, t, current[2, i])
        logp[i] = -0.5 * z * z - math.log(sensor.std) - 0.5 * math.log(2.0 * math.pi)
        low[i] = high[i] = 0.5 * math.erfc(-z / math.sqrt(2.0))
    return True


@engine.linear_information.register(CompassTable)
def _linear_information(sensor, linearisation, t, precision, shift):
    if not math.isnan(sensor.heading[t]):
        precision[2, 2] += sensor.std**-2
        shift[2] += (linearisation.error[t] - sensor.offset) * sensor.std**-2


@dataclass(frozen=True)
class Compass(Sensor):
    """Absolute heading with Gaussian noise; the parameter is ``sigma_compass`` [rad]."""

    table_type: ClassVar[type] = CompassTable
    variables: ClassVar[Mapping[str, Variable]] = {
        "compass": Variable(("time",), "rad", "heading; NaN not read", is_reading=True, plural="compass headings")
    }
    summary: ClassVar[str] = "absolute headings"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("sigma_compass", "rad", gamma_prior(0.1), "noise of a heading", role="noise"),)

    def bind(self, log: RobotLog) -> BoundCompass:
        return BoundCompass(np.array(log.variable("compass")))

    @staticmethod
    def linearise(table: CompassTable, reference: Float) -> CompassSlopes:
        return CompassSlopes(wrap(table.heading[: len(reference)] - reference[:, 2]))

    @classmethod
    def simulate(cls, table: CompassTable, path: Float, rng: np.random.Generator) -> CompassTable:
        reading = wrap(path[:, 2] + table.offset + table.std * rng.standard_normal(len(path)))
        return table._replace(heading=np.where(np.isnan(table.heading), np.nan, reading))

    @classmethod
    def store(cls, table: CompassTable, dataset: Any) -> None:
        dataset["compass"].values[:] = table.heading

    @staticmethod
    def index(table: CompassTable, n_steps: int) -> ReadingIndex:
        zeros = np.zeros(n_steps, dtype=np.int64)
        return ReadingIndex(("compass",), zeros, zeros, np.arange(n_steps), table.heading[:n_steps])


@dataclass(frozen=True)
class BoundCompass(BoundPart):
    """The compass of one log."""

    heading: Float

    def table(self, theta: Float) -> CompassTable:
        return CompassTable(self.heading, 0.0, float(theta[0]))

    def statistics(self, table: CompassTable, path: Float, ideal: Any, index: Any, theta: Float) -> Any:
        error = wrap(table.heading[: len(path)] - table.offset - path[:, 2])
        error = error[~np.isnan(error)]
        sums = np.array([float(error.size)]), np.array([engine.sum_of_squares(error)])
        return engine.GaussianSums(index, np.array(theta), *sums)


COMPASS_OFFSET = Effect(
    name="compass-offset",
    summary="The compass is mounted askew: all its headings are off by the same angle.",
    finding="the compass is off by {0}, to the {0:left|right}",
    parameters=(Parameter("compass_offset", "rad", stats.norm(scale=0.3), "angle by which all headings are off"),),
    null=(0.0,),
    change=lambda tables, values, log, where: edit_sensors(
        tables, CompassTable, lambda compass: {"offset": compass.offset + values[0]}, "compass-offset", "a compass"
    ),
    typical={"just visible": (0.02,), "clear": (0.1,), "large": (0.3,)},
    means_only=True,
    needs=lambda log: log.variable("compass") is not None,
)
