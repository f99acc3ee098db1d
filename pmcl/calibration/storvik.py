"""Storvik: sufficient statistics in the particles' state."""

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

__all__ = ["Storvik"]


@dataclass(frozen=True)
class Storvik(CalibrationMethod):
    """A particle filter whose particles carry sufficient statistics, from which parameters are drawn at every row.

    Each chain is one independent run. It serves models whose parameters are standard deviations of Gaussian residuals:
    their statistics are a number and a sum of squares. The priors need not be conjugate, since a conditional density
    of one parameter is inverted on a grid. Exact as the number of particles grows, but the statistics of long logs
    descend from few early particles: runs then lie apart, and R-hat says so.

    Attributes
    ----------
    particles : int
        Particles of each run.

    References
    ----------
    Storvik, Particle filters for state-space models with the presence of unknown static parameters, IEEE Transactions
    on Signal Processing 50, 2002.
    """

    name: ClassVar[str] = "storvik"
    description: ClassVar[str] = "sufficient statistics of the noises in the particles' state (Storvik)"

    particles: int = setting(1000, "Particles of the filter.", least=2, advice="25 to 1000 are usual")

    def shortest(self) -> Self:
        """Return a run with few particles."""
        return replace(self, particles=10)

    def run(self, bound: BoundModel, options: RunOptions) -> Chains:
        """Run the filters, see :meth:`CalibrationMethod.run`."""
        from functools import partial

        from pmcl.sampling.parameter_filters import clouds, storvik

        run = partial(storvik, bound, self.particles, options.stopwatch)
        return clouds(bound, options, self.record(options), run)
