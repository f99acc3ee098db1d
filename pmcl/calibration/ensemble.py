"""The ensemble: emcee's stretch move on the pseudo-marginal target, for comparison."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Final

from pmcl.calibration.method import CalibrationMethod
from pmcl.calibration.settings import setting

if TYPE_CHECKING:
    from typing import Self

    from pmcl.models.robot_model import BoundModel
    from pmcl.sampling.chains import Chains
    from pmcl.sampling.options import RunOptions

__all__ = ["Ensemble"]

# A run that the clock ends begins to draw after so many steps, or after half of its time.
_LEAST_BURN_IN: Final = 100


@dataclass(frozen=True)
class Ensemble(CalibrationMethod):
    """emcee's StretchMove on the particle filter's estimate of the evidence; every walker is returned as a chain.

    Chains are walkers here, of which the move needs many: there are at least 2 d + 2 for d parameters.

    Attributes
    ----------
    particles : int
        Particles of each estimate.
    burn_in : int, optional
        Steps before those that are kept; half of the draws, but at least 100, when left out.

    References
    ----------
    Goodman, Weare, Ensemble samplers with affine invariance, CAMCoS 5, 2010.
    Andrieu, Roberts, The pseudo-marginal approach for efficient Monte Carlo computations, Ann. Statist. 37, 2009.
    """

    name: ClassVar[str] = "ensemble"
    description: ClassVar[str] = "emcee's stretch move on the pseudo-marginal target"

    particles: int = setting(200, "Particles of the filter.", least=2, advice="25 to 1000 are usual")
    burn_in: int | None = setting(
        None,
        "Steps before the draws.",
        least=1,
        otherwise=f"half of the draws, at least {_LEAST_BURN_IN}",
    )

    def resolved(self, bound: BoundModel, options: RunOptions) -> Self:
        """Return the method with the length of its burn-in."""
        if self.burn_in is not None:
            return self
        return replace(self, burn_in=_LEAST_BURN_IN if options.limited else max(_LEAST_BURN_IN, options.draws // 2))

    def shortest(self) -> Self:
        """Return a run with few particles and one step of burn-in."""
        return replace(self, particles=10, burn_in=1)

    def run(self, bound: BoundModel, options: RunOptions) -> Chains:
        """Run the ensemble, see :meth:`CalibrationMethod.run`."""
        from pmcl.sampling.ensemble import run_ensemble

        method = self.resolved(bound, options)
        assert method.burn_in is not None
        options = replace(options, chains=max(options.chains, 2 * bound.dimension + 2))
        return run_ensemble(
            bound,
            particles=method.particles,
            burn_in=method.burn_in,
            options=options,
            settings=method.record(options),
        )
