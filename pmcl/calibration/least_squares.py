"""Khosoussi and Shames: least squares for the path, closed-form covariances for the noise."""

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

__all__ = ["LeastSquares"]


@dataclass(frozen=True)
class LeastSquares(CalibrationMethod):
    """The joint mode of path and noise, by turns: the likeliest path, then the noise that its residuals have.

    Biased by construction and no posterior: the path is fitted to the readings and then taken for the truth, so noise
    is found too small, and one that is small beside another may vanish. The paper keeps eigenvalues of covariances
    between limits for that reason; here a parameter is kept between the 0.5 and the 99.5 per cent quantile of its
    prior, and the result's setting ``held`` names those that end there. The path is found by Gauss and Newton's method
    on pmcl's linearisations with a block tridiagonal factorisation; a factor graph library such as gtsam would do the
    same with sensors of its own. Standard errors are those of a known path, and too small.

    Attributes
    ----------
    iterations : int
        Turns, at most.

    References
    ----------
    Khosoussi, Shames, Joint state and noise covariance estimation, arXiv 2502.04584, 2025.
    """

    name: ClassVar[str] = "least-squares"
    description: ClassVar[str] = "least squares and closed-form covariances (Khosoussi, Shames), biased, no posterior"

    iterations: int = setting(60, "Steps of an iterative estimate.", least=2)

    def shortest(self) -> Self:
        """Return a run of two turns."""
        return replace(self, iterations=2)

    def run(self, bound: BoundModel, options: RunOptions) -> PointEstimate:
        """Find the mode, see :meth:`CalibrationMethod.run`."""
        from pmcl.sampling.chains import PointEstimate
        from pmcl.sampling.joint_mode import joint_mode
        from pmcl.sampling.stopwatch import Stopwatch

        theta, error, held, _ = joint_mode(
            bound, iterations=self.iterations, seed=options.seed, stopwatch=options.stopwatch or Stopwatch()
        )
        units = tuple(parameter.unit for parameter in bound.parameters)
        settings = {**self.record(options), "held": ", ".join(held), **options.attributes}
        return PointEstimate(bound.names, units, theta, error, settings=settings)
