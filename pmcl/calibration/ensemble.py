"""The ensemble: emcee's moves on the pseudo-marginal target, for comparison."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Final, Literal

from pmcl.calibration.evidence import filter_setting, particles_setting
from pmcl.calibration.method import CalibrationMethod, Variant
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
    """emcee's StretchMove or DEMove on a particle filter's estimate of the evidence; every walker is a chain.

    Chains are walkers here, of which the moves need many: there are at least 2 d + 2 for d parameters. Walkers start
    near where some sweeps of particle Gibbs find the posterior.

    Attributes
    ----------
    particles : int, optional
        Particles of each estimate. When left out, as many as make the standard deviation of its logarithm 1.2 near the
        mode: with fewer, a walker whose estimate is too great by luck stays where it is.
    filter : {"guided", "bootstrap"}
        The filter: guided along the most probable path, so that few particles suffice, or drawing from the motion model
        as most filters do.
    move : {"stretch", "de"}
        The stretch move of Goodman and Weare, or differential evolution.
    burn_in : int, optional
        Steps before those that are kept; half of the draws, but at least 100, when left out.

    References
    ----------
    Goodman, Weare, Ensemble samplers with affine invariance, CAMCoS 5, 2010.
    ter Braak, A Markov chain Monte Carlo version of the genetic algorithm differential evolution, Statistics and
    Computing 16, 2006.
    Doucet, Pitt, Deligiannidis, Kohn, Efficient implementation of Markov chain Monte Carlo when using an unbiased
    likelihood estimator, Biometrika 102, 2015.
    Andrieu, Roberts, The pseudo-marginal approach for efficient Monte Carlo computations, Ann. Statist. 37, 2009.
    """

    name: ClassVar[str] = "ensemble"
    description: ClassVar[str] = "emcee's stretch move or differential evolution on the pseudo-marginal target"
    variants: ClassVar[Mapping[str, Variant]] = {
        "ensemble-de": Variant({"move": "de"}, "the same with differential evolution"),
        "bootstrap-ensemble": Variant({"filter": "bootstrap"}, "stretch moves on the estimates of a bootstrap filter"),
    }

    particles: int | None = particles_setting()
    filter: Literal["guided", "bootstrap"] = filter_setting()
    move: Literal["stretch", "de"] = setting(
        "stretch", "stretch: the stretch move. de: differential evolution.", choices=("stretch", "de")
    )
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
        from pmcl.sampling.near_posterior import near_posterior
        from pmcl.sampling.pseudo_marginal import chosen_particles, evidence_filter, redrawn_ratio
        from pmcl.sampling.transforms import Unconstrained

        near = near_posterior(bound, options.seed)
        estimate = evidence_filter(self.filter, bound, near, options.seed)
        particles = self.particles
        if particles is None:
            centre = Unconstrained(bound.parameters).from_line(near.centre)[0]
            particles = chosen_particles(redrawn_ratio(estimate, centre), options.seed)
        method = replace(self, particles=particles).resolved(bound, options)
        assert method.burn_in is not None
        options = replace(options, chains=max(options.chains, 2 * bound.dimension + 2))
        return run_ensemble(
            estimate,
            particles=particles,
            burn_in=method.burn_in,
            options=options,
            settings=method.record(options),
            near=near,
            move=method.move,
        )
