"""Eliazar and Parr: motion and sensor noise by EM, with smoothed trajectories."""

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

__all__ = ["ExpectationMaximisation"]


@dataclass(frozen=True)
class ExpectationMaximisation(CalibrationMethod):
    """Maximum likelihood by EM: trajectories drawn by a particle smoother, then the parameters that fit them best.

    The E step of Eliazar and Parr keeps the surviving particles' histories of their mapping filter; here trajectories
    are drawn backward from a filter on a known map, which is the same with less degeneracy. Their M step is weighted
    least squares for a motion model of means and variances; here it is the maximum for whatever parameters the model
    has, those of its sensors included: the root mean square residual where a noise is Gaussian, a numerical search
    elsewhere. It is a point estimate and no posterior: the prior says only what values are allowed. Convergence is
    slow where path and parameters explain each other, as EM always is; iterations begin at a plausible multiple of
    the prior mean. Standard errors are from the information about the parameters with the path integrated out, by the
    model that is linearised along the smoothed path.

    Attributes
    ----------
    particles : int
        Particles of the smoother.
    iterations : int
        E and M steps, of which the second half is averaged.
    paths : int
        Trajectories of each E step.

    References
    ----------
    Eliazar, Parr, Learning probabilistic motion models for mobile robots, ICML 2004.
    """

    name: ClassVar[str] = "em"
    description: ClassVar[str] = "maximum likelihood by EM on smoothed trajectories (Eliazar, Parr), no posterior"

    particles: int = setting(300, "Particles of the filter.", least=2, advice="25 to 1000 are usual")
    iterations: int = setting(80, "Steps of an iterative estimate.", least=2)
    paths: int = setting(30, "Trajectories of each E step.", least=1)

    def shortest(self) -> Self:
        """Return a run of two iterations."""
        return replace(self, iterations=2, paths=2)

    def run(self, bound: BoundModel, options: RunOptions) -> PointEstimate:
        """Run EM, see :meth:`CalibrationMethod.run`."""
        from pmcl.sampling.chains import PointEstimate
        from pmcl.sampling.expectation import expectation_maximisation
        from pmcl.sampling.stopwatch import Stopwatch

        found = expectation_maximisation(
            bound,
            iterations=self.iterations,
            particles=self.particles,
            paths=self.paths,
            seed=options.seed,
            stopwatch=options.stopwatch or Stopwatch(),
        )
        settings = {**self.record(options), "iterations": found.iterations, **options.attributes}
        units = tuple(parameter.unit for parameter in bound.parameters)
        return PointEstimate(bound.names, units, found.theta, found.standard_error, settings=settings)
