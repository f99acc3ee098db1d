"""Andrews: MCMC with sets of trajectories."""

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

__all__ = ["TrajectorySets"]


@dataclass(frozen=True)
class TrajectorySets(CalibrationMethod):
    """Metropolis on theta with acceptance ratios averaged over sets of smoothed trajectories: the exact posterior.

    Andrews draws a set of trajectories by particle smoothing for each step of a Markov chain on the parameters. How the
    set enters the step is left free here, and so is the smoother. Chosen was what makes the chain exact with any number
    of trajectories and particles: trajectories of one conditional SMC pass with backward sampling, at a theta halfway
    between the present and the proposed one, and the averaged acceptance ratio of Andrieu, Yildirim, Doucet and Chopin,
    which averages forward in one half of the steps and backward in the other. A plain average, forward in each step, is
    not reversible, and what it draws from is the posterior only for large sets; on the short log of the tests the
    difference is too small to see. Each sweep begins with a conditional SMC update of the trajectory at the present
    theta. Proposals are a random walk in unconstrained parameters, learnt in stages of burn-in and then frozen.

    A set lets theta move farther than one trajectory does, but how far grows with little more than the logarithm of its
    size: where odometry is noisy the path ties theta down, and the chain mixes slowly on long logs.

    Attributes
    ----------
    set_size : int
        Trajectories of each set.
    particles : int
        Particles of each conditional SMC pass; at most 32, because with more backward sampling begins at a particle's
        ancestor, and the trajectories of a set are no longer exchangeable with the chain's own.
    tuning_steps : tuple of int
        Draws of each stage of burn-in.

    References
    ----------
    Andrews, Bayesian learning in nonlinear state-space models, 2005, as cited by Kaboli, Bowling, Musilek, Bayesian
    Calibration for Monte Carlo Localization, AAAI 2006.
    Andrieu, Yildirim, Doucet, Chopin, Metropolis-Hastings with averaged acceptance ratios, arXiv 2101.01253, 2020.
    """

    name: ClassVar[str] = "andrews"
    description: ClassVar[str] = "Metropolis with sets of trajectories (Andrews), exact"

    set_size: int = setting(20, "Trajectories over which each acceptance ratio is averaged.", least=1)
    particles: int = setting(25, "Particles of the filter.", least=2, most=32, advice="25 are usual, at most 32")
    tuning_steps: tuple[int, ...] = setting((100, 200, 300), "Draws of each stage of burn-in.", kind=tuple, least=4)

    def shortest(self) -> Self:
        """Return a run with few particles and short stages."""
        return replace(self, set_size=2, particles=10, tuning_steps=(4, 4))

    def run(self, bound: BoundModel, options: RunOptions) -> Chains:
        """Run the chains, see :meth:`CalibrationMethod.run`."""
        from pmcl.sampling.near_mode import near_mode
        from pmcl.sampling.random_walk import run_walk
        from pmcl.sampling.session import check_run_memory
        from pmcl.sampling.trajectory_sets import trajectory_set_kit

        check_run_memory(bound, options.chains, self.particles + self.set_size, options)
        near = near_mode(bound, options.seed)
        kit = trajectory_set_kit(bound, near, self.set_size, self.particles)
        return run_walk(bound, kit, near, self.tuning_steps, options, self.record(options))
