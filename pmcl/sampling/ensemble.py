"""The ensemble variant: emcee's own moves on the pseudo-marginal target.

The target is theta -> log prior + log of the particle filter's estimate of p(readings | theta). The estimate's
exponential is unbiased, so the chain's theta has the exact posterior (Andrieu and Roberts 2009). The randomness of an
estimate is a function of theta and the seed: it is never drawn again for the current state, and no pool changes it.
"""

from __future__ import annotations

import hashlib
import math
from typing import Any

import numpy as np
from emcee.state import State
from numpy.typing import NDArray

from pmcl.errors import FilterError, ModelError, SamplingError
from pmcl.filtering.particle_filter import log_joint, make_rng, sweep_path
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.stages import INCLUSION_SHARE
from pmcl.sampling.state import ChainState, blob_dtype, into_blob, state_dimension
from pmcl.sampling.stopwatch import Stopwatch
from pmcl.sampling.sweep import included

__all__ = ["PseudoMarginalTarget", "first_walkers"]

Float = NDArray[np.float64]


class PseudoMarginalTarget:
    """The function that emcee samples; it can be pickled.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    particles : int
        Number of particles n; the variance of the log estimate should be about 1 (Doucet, Pitt, Deligiannidis, Kohn
        2015).
    seed : int
        Part of every estimate's seed.
    """

    def __init__(self, bound: BoundModel, particles: int, seed: int) -> None:
        self.bound, self.particles, self.seed = bound, particles, seed
        self.size = state_dimension(bound)
        self.dtype = blob_dtype(bound, self.size)

    def __call__(self, theta: Float) -> tuple[Any, ...]:
        """Return the log target and, one by one as emcee wants them, the fields of the blob."""
        bound, d = self.bound, self.bound.dimension
        theta = np.ascontiguousarray(theta, dtype=float)
        path = np.zeros((sum(bound.lengths), self.size))
        value = bound.log_prior(theta)
        evidence, effective, joint = -math.inf, 0.0, -math.inf
        if value > -math.inf:
            key = hashlib.sha256(theta.tobytes() + str(self.seed).encode()).digest()[:16]
            rng = make_rng(np.random.SeedSequence(int.from_bytes(key, "little")))
            try:
                bound.check(theta)
                tables = bound.tables(theta)
                views = included(bound, path, max(bound.lengths))
                infos = [
                    sweep_path(table, view, len(view), self.particles, rng, "smoothing")
                    for table, view in zip(tables, views, strict=True)
                ]
            except (FilterError, ModelError):
                infos = []
            if infos and all(info.alive for info in infos):
                evidence = math.fsum(info.log_evidence for info in infos)
                effective = float(np.mean([info.effective_size for info in infos]))
                joint = value + math.fsum(log_joint(t, view) for t, view in zip(tables, views, strict=True))
        nothing = np.full(d, math.nan)
        rows = max(bound.lengths)
        state = ChainState(
            theta, joint, path, nothing, 0.0, rows, nothing, *(math.nan,) * 3, evidence, effective, math.nan, 0
        )
        return value + evidence, *into_blob(state, self.dtype).item()


def first_walkers(
    target: PseudoMarginalTarget,
    n_walkers: int,
    seed: int,
    pool: Any,
    clock: Stopwatch | None = None,
    tries: int = 8,
) -> State:
    """Start an ensemble: of ``tries * n_walkers`` draws from the prior, those with the greatest target.

    In a run of limited time there are fewer draws when they take too long, but enough to start.

    Raises
    ------
    SamplingError
        When fewer than `n_walkers` draws can explain the readings at all.
    """
    rng = make_rng(np.random.SeedSequence(seed))
    coords = np.array([target.bound.draw_prior(rng) for _ in range(tries * n_walkers)])
    run = pool.map if pool is not None else map
    results: list[Any] = []
    values = np.array([])
    for part in np.array_split(coords, tries):
        results += run(target, part)
        values = np.array([result[0] for result in results])
        late = clock is not None and clock.now() >= INCLUSION_SHARE * clock.limit
        if late and np.isfinite(values).sum() >= n_walkers:
            break
    best = np.argsort(-values, kind="stable")[:n_walkers]
    if not np.isfinite(values[best]).all():
        raise SamplingError(
            f"only {int(np.isfinite(values).sum())} of {values.size} draws from the prior can explain the readings, "
            f"but the ensemble needs {n_walkers}; use more particles, wider priors, or method particle-gibbs"
        )
    blobs = np.array([results[k][1:] for k in best], dtype=target.dtype)
    random_state = np.random.RandomState(seed % 2**32).get_state()
    return State(coords[best], log_prob=values[best], blobs=blobs, random_state=random_state)
