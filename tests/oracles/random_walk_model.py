"""A motion model and a sensor of one's own, in one file: a cart on a rail.

The cart's position x [m] is one number, so a state has one component instead of the three of a pose:

    x[t] = coefficient * x[t-1] + control[t] + process_std * normal,        control = forward odometry
    z[t] = x[t] + reading_std * normal,                                     z = distance to the landmark at 0

Both standard deviations are unknown. The model is linear and Gaussian, so everything that pmcl estimates about it
can also be computed exactly. A model needs three things, in this order below:

1. Coefficient tables: NamedTuples of arrays and numbers, all that compiled code sees.
2. Kernels: one plain function for each part of :mod:`pmcl.engine.contract`, registered for the table's
   type. numba compiles them; they loop over the n particles in the columns of `current` (D, n) and add to `logp`.
3. Parts: classes that name the parameters with their priors, and turn parameters into tables.

Use it as ``RobotModel(RailMotion(), (RailSensor(),), RailStart())``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from pmcl.engine import contract
from pmcl.engine.residuals import GaussianSums
from pmcl.logs.robot_log import RobotLog
from pmcl.models.parameters import Parameter
from pmcl.models.robot_model import RobotModel
from pmcl.models.sensor import Sensor
from pmcl.models.starts.table import GaussianStart

Float = NDArray[np.float64]

# mypy: disable-error-code="no-untyped-def"


# 1. Tables


class RandomWalk(NamedTuple):
    """x[t] = coefficient * x[t-1] + control[t] + std[t] * normal; `control` [m] and `std` [m] have shape (T,)."""

    coefficient: float
    control: Float
    std: Float


class PositionReadings(NamedTuple):
    """Readings [m] of the position, shape (T,), NaN where there is none; `std` [m] is one number."""

    reading: Float
    std: float


class ReferencePositions(NamedTuple):
    """Positions (T,) [m] around which the readings are linearised: all that a linear sensor needs."""

    value: Float


# 2. Kernels. None of them makes an array; one that does says so (allocates=True) and runs slower.

_HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)


@contract.state_size.register(RandomWalk)
def _one_component(motion):
    return 1


@contract.scratch_rows.register(RandomWalk)
def _motion_needs_no_scratch(table):
    return 0


@contract.propagate.register(RandomWalk)
def _propagate(motion, t, rng, previous, current, scratch):
    for i in range(current.shape[1]):
        mean = motion.coefficient * previous[0, i] + motion.control[t]
        current[0, i] = mean + motion.std[t] * rng.standard_normal()


@contract.transition_logpdf.register(RandomWalk)
def _transition_logpdf(motion, t, previous, current, logp, scratch):
    constant = -math.log(motion.std[t]) - _HALF_LOG_2PI
    for i in range(logp.size):
        r = (current[0] - motion.coefficient * previous[0, i] - motion.control[t]) / motion.std[t]
        logp[i] += constant - 0.5 * r * r


@contract.scratch_rows.register(PositionReadings)
def _sensor_needs_no_scratch(table):
    return 0


@contract.looks_back.register(PositionReadings)
def _looks_back(sensor):
    return False


@contract.has_reading.register(PositionReadings)
def _has_reading(sensor, t):
    return not math.isnan(sensor.reading[t])


@contract.reading_logpdf.register(PositionReadings)
def _reading_logpdf(sensor, t, previous, current, logp, scratch):
    constant = -math.log(sensor.std) - _HALF_LOG_2PI
    for i in range(logp.size):
        r = (sensor.reading[t] - current[0, i]) / sensor.std
        logp[i] += constant - 0.5 * r * r


# Optional: with a distribution function, criticism can ask how well each reading was foreseen.


@contract.one_reading.register(PositionReadings)
def _one_reading(sensor, t, slot, previous, current, logp, low, high, memory, scratch):
    if math.isnan(sensor.reading[t]):
        return False
    for i in range(logp.size):
        r = (sensor.reading[t] - current[0, i]) / sensor.std
        logp[i] = -math.log(sensor.std) - _HALF_LOG_2PI - 0.5 * r * r
        low[i] = 0.5 * math.erfc(-r * math.sqrt(0.5))
        high[i] = low[i]
    return True


# Optional: the Gaussian transport move needs motion and readings linearised around a reference. With d = x - reference,
# d[t] = jacobian d[t-1] + offset + noise; and a reading adds its precision, and precision times residual.


@contract.linearise_transition.register(RandomWalk)
def _linearise_transition(motion, t, before, after, jacobian, offset, precision):
    jacobian[0, 0] = motion.coefficient
    offset[0] = motion.coefficient * before[0] + motion.control[t] - after[0]
    precision[0, 0] = motion.std[t] ** -2


@contract.linear_information.register(PositionReadings)
def _linear_information(sensor, geometry, t, precision, shift):
    if not math.isnan(sensor.reading[t]):
        precision[0, 0] += sensor.std**-2
        shift[0] += (sensor.reading[t] - geometry.value[t]) * sensor.std**-2


# 3. Parts


@dataclass(frozen=True)
class RailStart:
    """Gaussian belief about the first position, from the log's start along x."""

    parameters: tuple[Parameter, ...] = ()

    def bind(self, log: RobotLog) -> BoundRailStart:
        return BoundRailStart(GaussianStart(np.array(log.start_mean[:1]), np.array(log.start_std[:1])))


@dataclass(frozen=True)
class BoundRailStart:
    fixed: GaussianStart

    def table(self, theta: Float) -> GaussianStart:
        return self.fixed

    def statistics(self, table: Any, path: Float, ideal: Any, index: Any, theta: Float) -> None:
        return None


@dataclass(frozen=True)
class RailMotion:
    """Motion along the rail with unknown noise `process_std` [m]."""

    coefficient: float = 0.9
    parameters: tuple[Parameter, ...] = (
        Parameter("process_std", "m", stats.gamma(3.0, scale=0.2), "noise of one step along the rail"),
    )

    def bind(self, log: RobotLog) -> BoundRailMotion:
        return BoundRailMotion(self.coefficient, np.array(log.odometry[:, 0]))


@dataclass(frozen=True)
class BoundRailMotion:
    coefficient: float
    control: Float

    def table(self, theta: Float) -> RandomWalk:
        return RandomWalk(self.coefficient, self.control, np.full(self.control.size, theta[0]))

    def statistics(self, table: RandomWalk, path: Float, ideal: Any, index: Any, theta: Float) -> GaussianSums:
        """Return a sum of squares: with it a Metropolis step costs nothing. Returning None works too, only slower."""
        x = path[:, 0]
        return _sum_of_squares(x[1:] - self.coefficient * x[:-1] - self.control[1 : x.size], index, theta)


@dataclass(frozen=True)
class RailSensor(Sensor):
    """Distance to the landmark at the end of the rail with unknown noise `reading_std` [m]."""

    table_type: ClassVar[type] = PositionReadings

    parameters: tuple[Parameter, ...] = (
        Parameter("reading_std", "m", stats.gamma(3.0, scale=0.2), "noise of a distance reading"),
    )

    @staticmethod
    def linearise(table: PositionReadings, reference: Float) -> ReferencePositions:
        return ReferencePositions(reference[:, 0].copy())

    def bind(self, log: RobotLog) -> BoundRailSensor:
        assert log.landmark_range is not None
        return BoundRailSensor(np.array(log.landmark_range[:, 0]))


@dataclass(frozen=True)
class BoundRailSensor:
    reading: Float

    def table(self, theta: Float) -> PositionReadings:
        return PositionReadings(self.reading, float(theta[0]))

    def statistics(self, table: PositionReadings, path: Float, ideal: Any, index: Any, theta: Float) -> GaussianSums:
        residual = self.reading[: path.shape[0]] - path[:, 0]
        return _sum_of_squares(residual[~np.isnan(residual)], index, theta)


def _sum_of_squares(residual: Float, index: Any, theta: Float) -> GaussianSums:
    return GaussianSums(
        index, np.array(theta), np.array([float(residual.size)]), np.array([float(residual @ residual)])
    )


def rail_model(**fixed: float) -> RobotModel:
    """The cart's whole model; parameters given by name are known."""
    return RobotModel(RailMotion(), (RailSensor(),), RailStart(), fixed=fixed)


# Where the cart rests: far enough from the landmark at 0 that no distance reading is ever negative.
REST = 50.0


def rail_log(
    n_steps: int, seed: int, process_std: float = 0.5, reading_std: float = 0.4, missing: tuple[int, ...] = ()
) -> RobotLog:
    """Simulate the cart: it is pushed so that it keeps near REST; rows in `missing` have no reading."""
    rng = np.random.default_rng(seed)
    coefficient = RailMotion.coefficient
    control = np.full(n_steps, (1.0 - coefficient) * REST) + 0.3 * np.sin(np.arange(n_steps))
    x = np.empty(n_steps)
    x[0] = REST + rng.standard_normal()
    for t in range(1, n_steps):
        x[t] = coefficient * x[t - 1] + control[t] + process_std * rng.standard_normal()
    reading = x + reading_std * rng.standard_normal(n_steps)
    reading[list(missing)] = np.nan
    return RobotLog.build(
        time=np.arange(n_steps, dtype=float),
        odometry=np.column_stack([control, np.zeros((n_steps, 2))]),
        landmark_range=reading[:, None],
        landmarks=[[0.0, 0.0]],
        start_mean=[REST, 0.0, 0.0],
        start_std=[1.0, 1.0, 1.0],
    )
