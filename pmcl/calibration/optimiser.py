"""People's own way: an optimiser on the filter's evidence."""

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

__all__ = ["EvidenceOptimiser"]


@dataclass(frozen=True)
class EvidenceOptimiser(CalibrationMethod):
    """Nelder and Mead's simplex on the particle filter's evidence, with the same random numbers at every theta.

    This is what people do to tune a filter such as AMCL: run it again and again and keep what foresees the log best.
    It is a point estimate and no posterior, and its maximum is that of one set of random numbers. The prior says only
    what values are allowed. Standard errors are from a quadratic that is fitted to evidences around the maximum.

    Attributes
    ----------
    particles : int
        Particles of the filter.
    evaluations : int
        Runs of the filter that the search may use.

    References
    ----------
    Nelder, Mead, A simplex method for function minimization, Computer Journal 7, 1965.
    """

    name: ClassVar[str] = "optimiser"
    description: ClassVar[str] = "a simplex search on the particle filter's evidence, no posterior"

    particles: int = setting(500, "Particles of the filter.", least=2, advice="25 to 1000 are usual")
    evaluations: int = setting(400, "Runs of the filter that a search may use.", least=10)

    def shortest(self) -> Self:
        """Return a search of a few evaluations."""
        return replace(self, particles=20, evaluations=10)

    def run(self, bound: BoundModel, options: RunOptions) -> PointEstimate:
        """Search, see :meth:`CalibrationMethod.run`."""
        from pmcl.sampling.chains import PointEstimate
        from pmcl.sampling.evidence_search import most_evident
        from pmcl.sampling.stopwatch import Stopwatch

        theta, error = most_evident(
            bound,
            particles=self.particles,
            evaluations=self.evaluations,
            seed=options.seed,
            stopwatch=options.stopwatch or Stopwatch(),
        )
        units = tuple(parameter.unit for parameter in bound.parameters)
        return PointEstimate(
            bound.names, units, theta, error, settings={**self.record(options), **options.attributes}
        )
