"""Corenflos: marginal particle Gibbs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from pmcl.calibration.method import CalibrationMethod
from pmcl.calibration.settings import setting

if TYPE_CHECKING:
    from typing import Self

    from pmcl.models.robot_model import BoundModel
    from pmcl.sampling.chains import Chains
    from pmcl.sampling.options import RunOptions

__all__ = ["MarginalGibbs"]


@dataclass(frozen=True)
class MarginalGibbs(CalibrationMethod):
    """Conditional SMC on paths that belong to the present theta or to a proposed one: the exact posterior.

    Like transport moves it lets theta and path change together, but by particles and not by a linearised model. Where
    the paper leaves freedom: particles move by the mixture of both motions; trajectories are drawn backward; proposals
    are a random walk in unconstrained parameters, learnt in stages of burn-in and then frozen; theta is drawn out of
    the two by its odds. The loop over rows runs in Python, so the time of a sweep grows with the rows of the log and
    little with the particles.

    Attributes
    ----------
    particles : int
        Number of particles.
    tuning_steps : tuple of int
        Draws of each stage of burn-in.

    References
    ----------
    Corenflos, Particle Gibbs without the Gibbs bit, arXiv 2505.04611, 2025.
    """

    name: ClassVar[str] = "marginal-gibbs"
    description: ClassVar[str] = "marginal particle Gibbs (Corenflos), exact"

    particles: int = setting(100, "Particles of the filter.", least=2, advice="25 to 1000 are usual")
    tuning_steps: tuple[int, ...] = setting((100, 200, 300), "Draws of each stage of burn-in.", kind=tuple, least=4)

    def shortest(self) -> Self:
        """Return a run with few particles and short stages."""
        return replace(self, particles=10, tuning_steps=(4, 4))

    def run(self, bound: BoundModel, options: RunOptions) -> Chains:
        """Run the chains, see :meth:`CalibrationMethod.run`."""
        from pmcl.sampling.marginal_gibbs import marginal_gibbs_kit
        from pmcl.sampling.near_mode import near_mode
        from pmcl.sampling.random_walk import run_walk
        from pmcl.sampling.session import check_run_memory

        check_run_memory(bound, options.chains, self.particles, options)
        near = near_mode(bound, options.seed)
        kit = marginal_gibbs_kit(bound, near, self.particles)
        return run_walk(bound, kit, near, self.tuning_steps, options, self.record(options))
