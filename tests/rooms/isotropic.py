"""A motion model as another package would add it: an increment scatters alike along and across the heading."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pmcl import Parameter, RobotLog, engine
from pmcl.models import BoundPart, IncrementNoise, Motion, gamma_prior

Float = NDArray[np.float64]


@dataclass(frozen=True)
class IsotropicNoise(Motion):
    """Increments with noise ``sigma_step`` [m] in both directions of the floor and ``sigma_turn`` [rad]."""

    summary: ClassVar[str] = "increments scatter alike along and across the heading"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("sigma_step", "m", gamma_prior(0.05), "noise of an increment in either direction", role="noise"),
            Parameter("sigma_turn", "rad", gamma_prior(0.05), "noise of one increment's turn", role="noise"),
        )

    def bind(self, log: RobotLog) -> BoundIsotropicNoise:
        return BoundIsotropicNoise(IncrementNoise().bind(log))


@dataclass(frozen=True)
class BoundIsotropicNoise(BoundPart):
    """The same for one log; its table is that of noisy increments, so effects of the motion apply to it."""

    increments: BoundPart

    def table(self, theta: Float) -> Any:
        return self.increments.table(np.array([theta[0], theta[0], theta[1]]))

    def statistics(self, table: Any, path: Float, ideal: Any, index: Any, theta: Float) -> Any:
        alone = self.increments.statistics(table, path, ideal, np.array([-1, -1, -1]), np.ones(3))
        counts = np.array([2.0 * alone.counts[0], alone.counts[2]])
        squares = np.array([alone.squares[:2].sum(), alone.squares[2]])
        return engine.GaussianSums(index, np.array(theta), counts, squares)
