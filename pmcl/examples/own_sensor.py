"""A sensor of your own: a compass that reads the robot's heading, beside the landmarks that it sees.

A sensor has three parts: a table of arrays, all that compiled code sees; kernels, plain functions that numba compiles
and that pmcl finds by the type of the table (pmcl.filtering.kernels.contract describes them); and classes that name the
parameters and make the table. A motion model of your own is written in the same way.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

import pmcl
from pmcl.filtering.kernels import contract
from pmcl.filtering.predict import reading_geometry
from pmcl.models import LandmarkNoise, RobotModel
from pmcl.robots import simulate_landmark_field


class CompassReadings(NamedTuple):
    """Headings (T,) [rad], NaN where there is none, and their standard deviation [rad]."""

    heading: Any
    std: float


@contract.scratch_rows.register(CompassReadings, allocates=False)
def _no_scratch(table):
    return 0


@contract.looks_back.register(CompassReadings, allocates=False)
def _only_the_current_pose_counts(sensor):
    return False


@contract.has_reading.register(CompassReadings, allocates=False)
def _has_reading(sensor, t):
    return not math.isnan(sensor.heading[t])


@contract.reading_logpdf.register(CompassReadings, allocates=False)
def _reading_logpdf(sensor, t, previous, current, logp, scratch):
    # The n columns of `current` are poses (x, y, heading). The log density of each is added to `logp`.
    for i in range(logp.size):
        error = ((sensor.heading[t] - current[2, i] + math.pi) % (2.0 * math.pi) - math.pi) / sensor.std
        logp[i] -= 0.5 * error * error + math.log(sensor.std) + 0.5 * math.log(2.0 * math.pi)


# The next two are for the transport move, which makes the chains mix. Without them calibration works, only slower.
@reading_geometry.register
def _(table: CompassReadings, reference: Any) -> CompassReadings:
    error = np.remainder(table.heading - reference[:, 2] + np.pi, 2.0 * np.pi) - np.pi
    return CompassReadings(error, table.std)


@contract.linear_information.register(CompassReadings, allocates=False)
def _linear_information(sensor, geometry, t, precision, shift):
    if not math.isnan(sensor.heading[t]):
        precision[2, 2] += sensor.std**-2
        shift[2] += geometry.heading[t] * sensor.std**-2


class Compass(NamedTuple):
    """A compass with unknown noise, for logs with a variable `compass` (time) [rad]."""

    parameters: tuple[pmcl.Parameter, ...] = (
        pmcl.Parameter("sigma_compass", "rad", stats.gamma(2.0, scale=0.05), "noise of a compass reading"),
    )

    def bind(self, log: pmcl.RobotLog) -> Any:  # noqa: D102
        return BoundCompass(np.array(log.dataset["compass"], dtype=float))


class BoundCompass(NamedTuple):
    """The compass of one log: makes the table for values of the parameters, `theta` (1,)."""

    heading: Any

    def table(self, theta: Any) -> CompassReadings:  # noqa: D102
        return CompassReadings(self.heading, float(theta[0]))

    def statistics(self, table: Any, path: Any, ideal: Any, index: Any, theta: Any) -> None:
        """Offer no sums of squares: each Metropolis step then evaluates the density."""


def main(n_steps: int = 200, draws: int = 1000) -> None:
    """Add a compass with noise of 0.04 rad to a simulated robot, and calibrate it."""
    field = simulate_landmark_field(n_steps, seed=3)
    heading = field.dataset["true_pose"].values[:, 2] + np.random.default_rng(4).normal(0.0, 0.04, n_steps)
    log = pmcl.RobotLog.from_dataset(field.dataset.assign(compass=("time", heading)))
    data = pmcl.calibrate(log, RobotModel(sensors=(LandmarkNoise(bearing=False), Compass())), draws=draws)
    print(f"sigma_compass = {float(data.posterior['sigma_compass'].mean()):.4f} rad; simulated with 0.04")
    print(pmcl.verdict(data).message)


if __name__ == "__main__":
    main()
