"""Liu and West: parameters in the particles' state, with kernel shrinkage."""

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

__all__ = ["LiuWest"]


@dataclass(frozen=True)
class LiuWest(CalibrationMethod):
    """A particle filter on state and parameters, whose parameters are drawn anew from a shrunken kernel density.

    Each chain is one independent run, whose last cloud of parameters is returned. Biased by construction: the kernel
    density stands for the posterior of the parameters at each resampling, and shrinkage keeps only its mean and
    covariance. With a long log the cloud grows from few early particles, runs lie apart, and R-hat says so. Where the
    paper leaves freedom: the bootstrap filter in place of the auxiliary one, because a model need not know the mean of
    its next state; parameters move when the particles are resampled, which happens when half of them are worth
    nothing; kernels are Gaussian in unconstrained parameters.

    Attributes
    ----------
    particles : int
        Particles of each run.
    discount : float
        The discount factor delta: the kernel's variance is 1 - ((3 delta - 1) / (2 delta))^2 of the cloud's.

    References
    ----------
    Liu, West, Combined parameter and state estimation in simulation-based filtering, in Sequential Monte Carlo Methods
    in Practice, 2001.
    """

    name: ClassVar[str] = "liu-west"
    description: ClassVar[str] = "parameters in the particles' state with kernel shrinkage (Liu, West), biased"

    particles: int = setting(1000, "Particles of the filter.", least=2, advice="25 to 1000 are usual")
    discount: float = setting(
        0.98, "Liu and West's discount factor.", kind=float, least=0.5, most=0.9999, advice="0.95 to 0.99 are usual"
    )

    def shortest(self) -> Self:
        """Return a run with few particles."""
        return replace(self, particles=10)

    def run(self, bound: BoundModel, options: RunOptions) -> Chains:
        """Run the filters, see :meth:`CalibrationMethod.run`."""
        from functools import partial

        from pmcl.sampling.parameter_filters import clouds, liu_west

        run = partial(liu_west, bound, self.particles, self.discount, options.stopwatch)
        return clouds(bound, options, self.record(options), run)
