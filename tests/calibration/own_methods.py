"""Two calibration methods as a user would write them: one module each would be enough."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pmcl.calibration import CalibrationMethod, Chains, PointEstimate, setting


@dataclass(frozen=True)
class PriorDraws(CalibrationMethod):
    """Draws from the prior, which needs no readings."""

    name: ClassVar[str] = "own-draws"
    description: ClassVar[str] = "independent draws from the prior"

    scale: float = setting(1.0, "Factor on each draw.", kind=float, least=0.5, most=4.0)
    reverse: bool = setting(False, "Whether the last draw comes first.", kind=bool)
    order: str = setting("plain", "How draws are ordered.", choices=("plain", "sorted"))

    def run(self, bound, options):
        rng = np.random.default_rng(options.seed)
        shape = (options.chains, min(options.draws, 400))
        theta = self.scale * np.array([[bound.draw_prior(rng) for _ in range(shape[1])] for _ in range(shape[0])])
        theta = theta[:, ::-1] if self.reverse else theta
        units = tuple(parameter.unit for parameter in bound.parameters)
        return Chains(bound.names, units, theta, settings={**self.record(options), **options.attributes})


@dataclass(frozen=True)
class PriorMean(CalibrationMethod):
    """The mean of the prior, with its standard deviation as the standard error."""

    name: ClassVar[str] = "own-mean"
    description: ClassVar[str] = "the mean of the prior"

    particles: int = setting(7, "Particles, of which it makes no use.", least=3)

    def run(self, bound, options):
        units = tuple(parameter.unit for parameter in bound.parameters)
        spread = np.array([parameter.prior.std() for parameter in bound.parameters])
        settings = {**self.record(options), **options.attributes}
        return PointEstimate(bound.names, units, bound.prior_mean(), spread, settings=settings)
