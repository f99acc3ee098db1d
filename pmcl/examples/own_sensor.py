"""A sensor of your own: a compass that reads the robot's heading, beside the landmarks that it sees.

Its parts: a table, functions of that table for numba (pmcl.engine.contract), classes (pmcl.models.part).
"""

import math
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

import pmcl
from pmcl.engine import contract
from pmcl.filtering.predict import reading_geometry
from pmcl.models import LandmarkNoise, RobotModel
from pmcl.simulations import simulate_landmark_field


class CompassReadings(NamedTuple):
    """All that compiled code sees: headings (T,) [rad], NaN where there is none, and their standard deviation [rad]."""

    heading: Any
    std: float


@contract.scratch_rows.register(CompassReadings)
def _no_scratch(table):
    return 0


@contract.looks_back.register(CompassReadings)
def _only_the_current_pose_counts(sensor):
    return False


@contract.has_reading.register(CompassReadings)
def _has_reading(sensor, t):
    return not math.isnan(sensor.heading[t])


@contract.reading_logpdf.register(CompassReadings)
def _reading_logpdf(sensor, t, previous, current, logp, scratch):
    # The n columns of `current` are poses (x, y, heading). The log density of each is added to `logp`.
    for i in range(logp.size):
        error = ((sensor.heading[t] - current[2, i] + math.pi) % (2.0 * math.pi) - math.pi) / sensor.std
        logp[i] -= 0.5 * error * error + math.log(sensor.std) + 0.5 * math.log(2.0 * math.pi)


# The next two are for the transport move, which makes the chains mix. Without them calibration works, only slower.
@reading_geometry.register
def _(table: CompassReadings, reference: Any) -> CompassReadings:
    return CompassReadings(np.remainder(table.heading - reference[:, 2] + np.pi, 2.0 * np.pi) - np.pi, table.std)


@contract.linear_information.register(CompassReadings)
def _linear_information(sensor, geometry, t, precision, shift):
    if not math.isnan(sensor.heading[t]):
        precision[2, 2] += sensor.std**-2
        shift[2] += geometry.heading[t] * sensor.std**-2


class Compass(NamedTuple):
    """A compass with unknown noise, for logs with a variable `compass` (time) [rad]."""

    parameters: tuple[pmcl.Parameter, ...] = (pmcl.Parameter("sigma_compass", "rad", stats.gamma(2.0, scale=0.05)),)

    def bind(self, log: pmcl.RobotLog) -> Any:  # noqa: D102
        return BoundCompass(np.array(log.dataset["compass"], dtype=float))


class BoundCompass(NamedTuple):
    """The compass of one log: makes the table for values of the parameters, `theta` (1,)."""

    heading: Any

    def table(self, theta: Any) -> CompassReadings:  # noqa: D102
        return CompassReadings(self.heading, float(theta[0]))

    def statistics(self, table: Any, path: Any, ideal: Any, index: Any, theta: Any) -> None:
        """Offer no sums of squares: each Metropolis step then evaluates the density."""


def record() -> pmcl.RobotLog:
    """Add a compass with noise of 0.04 rad to the log of a simulated robot."""
    field = simulate_landmark_field(200, seed=3)
    heading = field.dataset["true_pose"].values[:, 2] + np.random.default_rng(4).normal(0.0, 0.04, 200)
    return pmcl.RobotLog.from_dataset(field.dataset.assign(compass=("time", heading)))


def main(draws: int = 1000) -> None:
    """Calibrate the robot with its compass."""
    data = pmcl.calibrate(record(), RobotModel(sensors=(LandmarkNoise(bearing=False), Compass())), draws=draws)
    sigma = data.posterior["sigma_compass"]
    print(f"sigma_compass = {float(sigma.mean()):.4f} +- {float(sigma.std()):.4f} rad; simulated with 0.04")
    print(pmcl.verdict(data).message)


if __name__ == "__main__":
    main()
