"""The ensemble variant: emcee's own moves on the pseudo-marginal target.

The target is theta -> log prior + log of a particle filter's estimate of p(readings | theta). The estimate's
exponential is unbiased, so the chain's theta has the exact posterior (Andrieu and Roberts 2009). The randomness of an
estimate is a function of theta and the seed: it is never drawn again for the current state, and no pool changes it.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from emcee.moves import DEMove, StretchMove
from emcee.state import State
from numpy.typing import NDArray

from pmcl.errors import SamplingError
from pmcl.filtering.not_a_number import check_density, parameters_told
from pmcl.filtering.particle_filter import make_rng
from pmcl.sampling.advance import StageRunner
from pmcl.sampling.chains import Chains
from pmcl.sampling.near_mode import NearMode
from pmcl.sampling.options import RunOptions, SettingValue
from pmcl.sampling.pseudo_marginal import EvidenceFilter, draw_numbers, paths_of
from pmcl.sampling.session import check_run_memory, collected, run_session
from pmcl.sampling.stages import BURN_IN_SHARE, INCLUSION_SHARE
from pmcl.sampling.state import state_dimension
from pmcl.sampling.stopwatch import Stopwatch
from pmcl.sampling.transforms import Unconstrained

__all__ = ["EstimateInfo", "PseudoMarginalTarget", "first_walkers", "run_ensemble"]

Float = NDArray[np.float64]

_MOVES = {"stretch": StretchMove, "de": DEMove}
# Walkers start this much wider than the posterior is thought to be.
_START_WIDTH = 1.5


class EstimateInfo(NamedTuple):
    """How an estimate of the evidence went. The names are those of ArviZ's group ``sample_stats``.

    Attributes
    ----------
    log_evidence : float
        Log of the unbiased estimate of p(readings | theta) [nat]; minus infinity for an impossible theta.
    particle_ess : float
        Mean effective sample size over rows with readings, as a share of the particles; mean over the logs.
    """

    log_evidence: float = -math.inf
    particle_ess: float = 0.0


class PseudoMarginalTarget:
    """The function that emcee samples; it can be pickled.

    Parameters
    ----------
    estimate : EvidenceFilter
        The filter, with a model that is bound to its logs.
    particles : int
        Number of particles n; the variance of the log estimate should be about 1 (Doucet, Pitt, Deligiannidis, Kohn
        2015).
    seed : int
        Part of every estimate's seed.

    Attributes
    ----------
    dtype : numpy.dtype
        That of a blob: the trajectory, the log joint density, and the fields of :class:`EstimateInfo`.
    """

    def __init__(self, estimate: EvidenceFilter, particles: int, seed: int) -> None:
        self.estimate, self.bound, self.particles, self.seed = estimate, estimate.bound, particles, seed
        self.path_shape = (sum(self.bound.lengths), state_dimension(self.bound))
        numbers: list[Any] = [(name, np.float64) for name in ("log_joint", *EstimateInfo._fields)]
        self.dtype = np.dtype([("path", np.float64, self.path_shape), *numbers])

    def __call__(self, theta: Float) -> tuple[Any, ...]:
        """Return the log target and, one by one as emcee needs them, the fields of the blob.

        Raises DensityError when a density is not a number.
        """
        bound = self.bound
        theta = np.ascontiguousarray(theta, dtype=float)
        path = np.zeros(self.path_shape)
        prior = bound.log_prior(theta)
        info, joint = EstimateInfo(), -math.inf
        if prior > -math.inf:
            key = hashlib.sha256(theta.tobytes() + str(self.seed).encode()).digest()[:16]
            numbers = draw_numbers(make_rng(np.random.SeedSequence(int.from_bytes(key, "little"))), 1)
            with parameters_told(bound, theta):
                found = self.estimate(theta, self.particles, numbers)
            if math.isfinite(found.log_evidence):
                info = EstimateInfo(
                    log_evidence=found.log_evidence,
                    particle_ess=float(np.mean([one.effective_share for one in found.passes])),
                )
                paths, joint = paths_of(found, int(numbers[-1]))
                path, joint = np.concatenate(paths), prior + check_density(joint, bound, theta, paths)
        return prior + info.log_evidence, path, joint, *info


def first_walkers(
    target: PseudoMarginalTarget,
    n_walkers: int,
    seed: int,
    pool: Any,
    stopwatch: Stopwatch | None = None,
    tries: int = 8,
    near: NearMode | None = None,
) -> State:
    """Start an ensemble: of ``tries * n_walkers`` draws, those with the greatest target.

    In a run of limited time there are fewer draws when they take too long, but enough to start.

    Parameters
    ----------
    target : PseudoMarginalTarget
        The function that emcee samples.
    n_walkers : int
        Size of the ensemble.
    seed : int
        Seed of the draws, and of emcee's own generator.
    pool : object with a `map` method, optional
        Evaluates the target.
    stopwatch : Stopwatch, optional
        The time of the run.
    tries : int
        Draws for each walker.
    near : NearMode, optional
        Where to draw; from the prior when left out.

    Returns
    -------
    emcee.State

    Raises
    ------
    SamplingError
        When fewer than `n_walkers` draws can explain the readings at all.
    """
    rng = make_rng(np.random.SeedSequence(seed))
    if near is None:
        coords = np.array([target.bound.draw_prior(rng) for _ in range(tries * n_walkers)])
    else:
        root, transform = _START_WIDTH * np.linalg.cholesky(near.covariance), Unconstrained(target.bound.parameters)
        normal = rng.standard_normal((tries * n_walkers, near.centre.size))
        coords = np.array([transform.from_line(u)[0] for u in near.centre + normal @ root.T])
    run = pool.map if pool is not None else map
    results: list[Any] = []
    values = np.array([])
    for part in np.array_split(coords, tries):
        results += run(target, part)
        values = np.array([result[0] for result in results])
        late = stopwatch is not None and stopwatch.now() >= INCLUSION_SHARE * stopwatch.limit
        if late and np.isfinite(values).sum() >= n_walkers:
            break
    best = np.argsort(-values, kind="stable")[:n_walkers]
    if not np.isfinite(values[best]).all():
        raise SamplingError(
            f"only {int(np.isfinite(values).sum())} of {values.size} draws can explain the readings, "
            f"but the ensemble needs {n_walkers}; use more particles, wider priors, or method particle-gibbs"
        )
    blobs = np.array([results[k][1:] for k in best], dtype=target.dtype)
    random_state = np.random.RandomState(seed % 2**32).get_state()
    return State(coords[best], log_prob=values[best], blobs=blobs, random_state=random_state)


def run_ensemble(
    estimate: EvidenceFilter,
    *,
    particles: int,
    burn_in: int,
    options: RunOptions,
    settings: Mapping[str, SettingValue],
    near: NearMode | None = None,
    move: str = "stretch",
) -> Chains:
    """Run emcee's ensemble moves on the pseudo-marginal target; every walker is returned as a chain.

    Parameters
    ----------
    estimate : EvidenceFilter
        The filter, with a model that is bound to its logs.
    particles : int
        Number of particles of each estimate of the evidence.
    burn_in : int
        Steps before those that are kept.
    options : RunOptions
        How the run is carried out; its chains are the walkers, at least 2 d.
    settings : mapping of str to scalar
        Every setting of the run; a checkpoint knows its run by them, and they become the result's.
    near : NearMode, optional
        Near where the walkers start; anywhere in the prior when left out.
    move : {"stretch", "de"}
        Which of emcee's moves is made.

    Returns
    -------
    Chains

    Raises
    ------
    SamplingError
        When there are too few walkers, the ensemble cannot start, or the checkpoint does not fit.
    """
    bound = estimate.bound
    if options.chains < 2 * bound.dimension:
        raise SamplingError(
            f"an ensemble needs at least twice as many walkers as parameters ({2 * bound.dimension}), but got "
            f"{options.chains}; ask for more chains"
        )
    check_run_memory(bound, options.chains, particles, options)
    target = PseudoMarginalTarget(estimate, particles, options.seed)
    state: State | None = None
    with run_session(bound, settings, options.chains, options) as session:
        backends = [
            session.backend("burn-in", burn_in),
            session.backend("draws", options.draws, keep_every=options.keep_every),
        ]
        if not any(backend.iteration for backend in backends):
            session.stopwatch.deadline = session.stopwatch.limit
            state = first_walkers(target, options.chains, options.seed, session.pool, session.stopwatch, near=near)
        for name, backend, time_share in zip(("burn-in", "draws"), backends, (BURN_IN_SHARE, 1.0), strict=True):
            if not backend.complete:
                runner = StageRunner(session, bound, options.chains, target, _MOVES[move](), backend)
                state = runner.advance(state, name, time_share)
            elif name == "burn-in" and not backends[1].iteration:
                state = backend.get_last_sample()
    outcome: dict[str, SettingValue] = {"dependent_chains": True}
    return collected(bound, backends, EstimateInfo._fields, {**settings, **outcome, **options.attributes})
