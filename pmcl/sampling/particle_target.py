"""The particle filter's estimate of the evidence as the target of a random walk."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmcl.models.robot_model import BoundModel
from pmcl.sampling.pseudo_marginal import estimate_evidence, paths_of
from pmcl.sampling.random_walk import Evaluated

__all__ = ["ParticleTarget"]

Float = NDArray[np.float64]


class ParticleTarget:
    """An :class:`~pmcl.sampling.random_walk.EvidenceTarget` by the bootstrap filter.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    particles : int
        Number of particles.
    blocks : int
        Blocks of random numbers.
    """

    def __init__(self, bound: BoundModel, particles: int, blocks: int) -> None:
        self.bound, self.particles, self.blocks = bound, particles, blocks

    def __call__(self, theta: Float, numbers: NDArray[np.uint64]) -> Evaluated:
        """Return the estimate with these random numbers, of which the last is that of the trajectory."""
        estimate = estimate_evidence(self.bound, theta, self.particles, numbers)

        def finish() -> tuple[Float, float]:
            paths, joint = paths_of(estimate, int(numbers[-1]))
            return np.concatenate(paths), joint

        return Evaluated(estimate.log_evidence, finish)
