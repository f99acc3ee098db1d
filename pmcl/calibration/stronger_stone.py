"""Stronger and Stone: the mean functions of motion and sensors, each from the other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from pmcl.calibration.method import CalibrationMethod
from pmcl.calibration.settings import setting

if TYPE_CHECKING:
    from typing import Self

    from pmcl.models.robot_model import BoundModel
    from pmcl.sampling.chains import PointEstimate
    from pmcl.sampling.options import RunOptions

__all__ = ["MeanFunctions"]


@dataclass(frozen=True)
class MeanFunctions(CalibrationMethod):
    """Polynomials of what odometry and sensors mean, by regression along the path that both tell; no posterior.

    The paper's robot learns at once how fast each command moves it and how far away a landmark of some height in the
    image is: polynomials, each fitted by weighted regression to where the other one says that the robot is, over and
    over. Noise is not learnt, and keeps its prior mean here. The coefficients are those parameters of the model in
    which its mean functions are linear, such as the effects odometry-forward-scale, odometry-turn-bias,
    landmark-range-bias and range-scale, and formulas of any degree, such as ``formula: turn += c*speed**2``; parameters
    that are none keep their prior mean, and the prior's standard deviation as standard error.

    Where the paper leaves freedom, or a plane is no line: one reading does not tell a pose there, so that no path is
    made of readings alone. Both regressions use the most probable path given odometry, readings and the present
    coefficients, in which each weighs as its noise has it; the paper draws its two paths towards each other by a
    constant instead. Priors count as a ridge on coefficients that the log cannot tell. The alternation would take
    hundreds of turns where the path absorbs what a coefficient does, and is accelerated (Anderson). With a linear model
    it ends exactly at the most probable coefficients, with the path integrated out. Standard errors are from the
    information about the coefficients with the path integrated out, by the linearised model, at that noise.

    Attributes
    ----------
    iterations : int
        Turns of path and regression, at most.

    References
    ----------
    Stronger, Stone, Simultaneous calibration of action and sensor models on a mobile robot, ICRA 2005.
    Anderson, Iterative procedures for nonlinear integral equations, J. ACM 12, 1965.
    """

    name: ClassVar[str] = "stronger-stone"
    description: ClassVar[str] = "polynomial mean functions of motion and sensors (Stronger, Stone), no posterior"

    iterations: int = setting(60, "Steps of an iterative estimate.", least=2)

    def shortest(self) -> Self:
        """Return a run of two turns."""
        return replace(self, iterations=2)

    def run(self, bound: BoundModel, options: RunOptions) -> PointEstimate:
        """Find the coefficients, see :meth:`CalibrationMethod.run`."""
        from pmcl.sampling.chains import PointEstimate
        from pmcl.sampling.mean_functions import mean_functions
        from pmcl.sampling.stopwatch import Stopwatch

        found = mean_functions(
            bound, iterations=self.iterations, seed=options.seed, stopwatch=options.stopwatch or Stopwatch()
        )
        units = tuple(parameter.unit for parameter in bound.parameters)
        settings = {**self.record(options), "estimated": ", ".join(found.names), "turns": found.turns}
        return PointEstimate(
            bound.names, units, found.theta, found.standard_error, settings={**settings, **options.attributes}
        )
