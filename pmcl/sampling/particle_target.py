"""A particle filter's estimate of the evidence as the target of a random walk."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmcl.sampling.pseudo_marginal import EvidenceFilter, paths_of
from pmcl.sampling.random_walk import Evaluated

__all__ = ["ParticleTarget"]

Float = NDArray[np.float64]


class ParticleTarget:
    """An :class:`~pmcl.sampling.random_walk.EvidenceTarget` by a particle filter.

    Parameters
    ----------
    estimate : EvidenceFilter
        The filter, with a model that is bound to its logs.
    particles : int
        Number of particles.
    blocks : int
        Blocks of random numbers.
    """

    def __init__(self, estimate: EvidenceFilter, particles: int, blocks: int) -> None:
        self.estimate, self.particles, self.blocks = estimate, particles, blocks
        self.bound = estimate.bound

    def __call__(self, theta: Float, numbers: NDArray[np.uint64]) -> Evaluated:
        """Return the estimate with these random numbers, of which the last is that of the trajectory."""
        found = self.estimate(theta, self.particles, numbers)

        def finish() -> tuple[Float, float]:
            paths, joint = paths_of(found, int(numbers[-1]))
            return np.concatenate(paths), joint

        return Evaluated(found.log_evidence, finish)
