"""Particle marginal Metropolis-Hastings, plain and correlated."""

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

__all__ = ["ParticleMetropolis"]

# The share of accepted proposals that is best for a noisy density (Sherlock, Thiery, Roberts, Rosenthal, On the
# efficiency of pseudo-marginal random walk Metropolis algorithms, Ann. Statist. 43, 2015: 7 % where the variance can be
# chosen, more where it is smaller than best).
_ACCEPTANCE: Final = 0.15


@dataclass(frozen=True)
class ParticleMetropolis(CalibrationMethod):
    """Adaptive random-walk Metropolis on a particle filter's estimate of the evidence: the exact posterior.

    With one block of random numbers it is particle marginal Metropolis-Hastings; with more it is the correlated
    pseudo-marginal method, whose proposals keep the random numbers of all blocks of rows but one. The filter resamples
    systematically, in the order of a Hilbert curve when it is correlated. Where the papers leave freedom: blocks
    instead of an autoregression, because motion models may draw any random numbers; proposals are adapted in stages
    of burn-in and then frozen; the number of particles is measured at a theta near the posterior's mode, which some
    sweeps of particle Gibbs find.

    Attributes
    ----------
    particles : int, optional
        Particles of each estimate; measured when left out.
    filter : {"guided", "bootstrap"}
        The filter: guided along the most probable path, so that few particles suffice, or drawing from the motion model
        as in the papers.
    blocks : int
        Blocks of random numbers.
    tuning_steps : tuple of int
        Draws of each stage of burn-in.
    proposals_per_draw : int
        Proposals from one stored draw to the next.

    References
    ----------
    Andrieu, Doucet, Holenstein, Particle Markov chain Monte Carlo methods, JRSS B 72, 2010.
    Deligiannidis, Doucet, Pitt, The correlated pseudo-marginal method, JRSS B 80, 2018.
    Tran, Kohn, Quiroz, Villani, The block pseudo-marginal sampler, arXiv 1603.02485, 2016.
    """

    name: ClassVar[str] = "pmmh"
    description: ClassVar[str] = "particle marginal Metropolis-Hastings by a guided filter, exact"
    variants: ClassVar[Mapping[str, Variant]] = {
        "correlated-pmmh": Variant({"blocks": 50}, "the same with correlated estimates of the evidence"),
        "bootstrap-pmmh": Variant({"filter": "bootstrap"}, "the same by a bootstrap filter, as in the paper"),
    }

    particles: int | None = particles_setting()
    filter: Literal["guided", "bootstrap"] = filter_setting()
    blocks: int = setting(
        1,
        "Blocks of random numbers, of which each proposal redraws one: 1 is the plain method, 50 the correlated one, "
        "which needs fewer particles.",
        least=1,
    )
    tuning_steps: tuple[int, ...] = setting((100, 200, 300), "Draws of each stage of burn-in.", kind=tuple, least=4)
    proposals_per_draw: int = setting(1, "Proposals from one stored draw to the next.", least=1)

    def shortest(self) -> Self:
        """Return a run with few particles and short stages."""
        return replace(self, particles=self.particles or 16, tuning_steps=(4, 4))

    def run(self, bound: BoundModel, options: RunOptions) -> Chains:
        """Run the chains, see :meth:`CalibrationMethod.run`."""
        from pmcl.sampling.near_posterior import near_posterior
        from pmcl.sampling.particle_target import ParticleTarget
        from pmcl.sampling.pseudo_marginal import chosen_particles, evidence_filter, redrawn_ratio
        from pmcl.sampling.random_walk import WalkPlan, run_random_walk
        from pmcl.sampling.session import check_run_memory
        from pmcl.sampling.transforms import Unconstrained

        near = near_posterior(bound, options.seed)
        estimate = evidence_filter(self.filter, bound, near, options.seed)
        particles = self.particles
        if particles is None:
            centre = Unconstrained(bound.parameters).from_line(near.centre)[0]
            particles = chosen_particles(redrawn_ratio(estimate, centre, self.blocks), options.seed)
        method = replace(self, particles=particles)
        check_run_memory(bound, options.chains, particles, options)
        target = ParticleTarget(estimate, particles, method.blocks)
        plan = WalkPlan(method.tuning_steps, method.proposals_per_draw, _ACCEPTANCE)
        return run_random_walk(target, near, plan, options, method.record(options))
