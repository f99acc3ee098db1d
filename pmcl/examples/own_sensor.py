"""A sensor of your own: a compass that reads the robot's heading, beside the landmarks that it sees.

A sensor is one class and one table with compiled functions. Packages name it in an entry point "pmcl.sensors".
"""

import math
from typing import Any, ClassVar, NamedTuple

import numpy as np

import pmcl
from pmcl import engine
from pmcl.geometry import wrap
from pmcl.logs import Variable
from pmcl.models import BoundPart, Sensor, gamma_prior, register_sensor
from pmcl.simulations import simulate_landmark_field


class CompassTable(NamedTuple):
    """What compiled code sees: headings (T,) [rad], NaN where there is none, and their standard deviation [rad]."""

    heading: Any
    std: float


@engine.scratch_rows.register(CompassTable)
def _no_scratch(table):
    return 0


@engine.looks_back.register(CompassTable)
def _only_the_current_pose_counts(sensor):
    return False


@engine.has_reading.register(CompassTable)
def _has_reading(sensor, t):
    return not math.isnan(sensor.heading[t])


@engine.reading_logpdf.register(CompassTable)
def _reading_logpdf(sensor, t, previous, current, logp, scratch):
    # The n columns of `current` are poses (x, y, heading).
    for i in range(logp.size):
        error = ((sensor.heading[t] - current[2, i] + math.pi) % (2.0 * math.pi) - math.pi) / sensor.std
        logp[i] -= 0.5 * error * error + math.log(sensor.std) + 0.5 * math.log(2.0 * math.pi)


@engine.linear_information.register(CompassTable)
def _linear_information(sensor, error, t, precision, shift):
    # For the transport move, which makes chains mix.
    if not math.isnan(sensor.heading[t]):
        precision[2, 2] += sensor.std**-2
        shift[2] += error.heading[t] * sensor.std**-2


@register_sensor("compass")
class Compass(Sensor):
    """A compass with unknown noise, for logs with a variable `compass` (time) [rad]."""

    table_type = CompassTable
    variables: ClassVar = {"compass": Variable(("time",), "rad", "heading; NaN not measured", is_reading=True)}
    parameters = (pmcl.Parameter("sigma_compass", "rad", gamma_prior(0.1), "noise of a heading", role="noise"),)

    def bind(self, log: pmcl.RobotLog) -> Any:  # noqa: D102
        return BoundCompass(np.array(log.variable("compass")))

    @staticmethod
    def linearise(table: Any, reference: Any) -> Any:  # noqa: D102
        return table._replace(heading=wrap(table.heading[: len(reference)] - reference[:, 2]))


class BoundCompass(BoundPart):
    """The compass of one log."""

    def __init__(self, heading: Any) -> None:
        self.heading = heading

    def table(self, theta: Any) -> CompassTable:  # noqa: D102
        return CompassTable(self.heading, float(theta[0]))


def record() -> pmcl.RobotLog:
    """Add a compass with noise of 0.04 rad to the log of a simulated robot."""
    field = simulate_landmark_field(200, seed=3)
    heading = field.dataset["true_pose"].values[:, 2] + np.random.default_rng(4).normal(0.0, 0.04, 200)
    return pmcl.RobotLog.from_dataset(field.dataset.assign(compass=("time", heading)))


def main(draws: int = 1000) -> None:
    """Calibrate the robot with all its sensors."""
    data = pmcl.calibrate(record(), draws=draws)
    sigma = data.posterior["sigma_compass"]
    print(f"sigma_compass = {float(sigma.mean()):.4f} +- {float(sigma.std()):.4f} rad; simulated with 0.04")
    print(pmcl.verdict(data).message)


if __name__ == "__main__":
    main()
