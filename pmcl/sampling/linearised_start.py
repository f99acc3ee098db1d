"""Where chains go on once all data are included: to the mode of the linearised posterior that their path belongs to.

While data are included, theta and path follow each other slowly: a noise that fits a poor path keeps it poor. The mode
of the linearised posterior is found at once (:func:`pmcl.sampling.near_mode.mode_around`), from each chain's own path,
so that chains that follow the robot to different places find different modes. A chain goes there if draws of the
linearised model do not show less evidence there than where it is: that of a model with heavy tails may be wrong by far.
What it draws later does not depend on the linearisation; how long it burns in does.

A bootstrap filter is not asked for the evidence: where readings are sharp, it prefers noise that is several times too
large, which keeps its few particles alive.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from pmcl.errors import FilterError, ModelError
from pmcl.filtering.kernels.linear import transport_trial
from pmcl.filtering.particle_filter import log_joint, make_rng
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.near_mode import NearMode, improved_paths, mode_around
from pmcl.sampling.schedule import Schedule
from pmcl.sampling.sweep import included
from pmcl.sampling.transforms import Unconstrained
from pmcl.sampling.transport import Proposal, Transport, linearised_at

__all__ = ["ChainAt", "LinearisedStart", "LinearisedStarter"]

Float = NDArray[np.float64]

# So many paths are drawn to compare the evidence at two theta, with the same random numbers at both. Between walls the
# evidence of one draw has a standard deviation of 300 nats, that of a difference one of 50.
_DRAWS = 8
# A chain that is in the bulk of the posterior already may have more evidence than the mode, by this at most [nat].
_NO_LOSS = 10.0


class ChainAt(NamedTuple):
    """Where a chain is when all data are included.

    Attributes
    ----------
    theta : ndarray, shape (d,)
        Mean of its parameters over the last sweeps.
    mean_path : ndarray, shape (sum of T_l, D)
        Mean of its trajectories.
    path : ndarray, shape (sum of T_l, D)
        Its last trajectories.
    seed : SeedSequence
        The random numbers of its start follow from it.
    """

    theta: Float
    mean_path: Float
    path: Float
    seed: np.random.SeedSequence


class LinearisedStart(NamedTuple):
    """What a chain goes on with.

    Attributes
    ----------
    transport : Transport
        Linearisation around the mode, with proposals of its curvature.
    theta : ndarray, shape (d,), optional
        A draw of the linearised posterior; None where the chain stays where it is.
    path : ndarray, shape (sum of T_l, D), optional
        The trajectories for it.
    log_joint : float
        log p(theta, trajectories, readings).
    """

    transport: Transport
    theta: Float | None = None
    path: Float | None = None
    log_joint: float = math.nan


class LinearisedStarter:
    """A picklable function :class:`ChainAt` -> :class:`LinearisedStart`, or None where the mode is no good.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    schedule : Schedule
        How often which transport move is made.
    """

    def __init__(self, bound: BoundModel, schedule: Schedule) -> None:
        self.bound, self.schedule = bound, schedule

    def __call__(self, chain: ChainAt) -> LinearisedStart | None:
        """Return what the chain goes on with."""
        bound, transform = self.bound, Unconstrained(self.bound.parameters)
        paths = [np.ascontiguousarray(path) for path in included(bound, chain.mean_path, max(bound.lengths))]
        near = mode_around(bound, chain.theta, paths)
        if near is None:
            return None
        transport = self._transport(near, transform)
        if transport is None:
            return None
        here = linearised_at(bound, chain.theta, improved_paths(bound, chain.theta, paths), transport.proposal)
        if here is None:
            return None
        rng = make_rng(chain.seed)
        noise = [[rng.standard_normal(path.shape) for path in paths] for _ in range(_DRAWS)]
        mode = transform.from_line(near.centre)[0]
        if not self._log_evidence(mode, transport, noise) > self._log_evidence(chain.theta, here, noise) - _NO_LOSS:
            return None
        spread = np.linalg.cholesky(near.covariance)
        theta, _ = transform.from_line(near.centre + spread @ rng.standard_normal(near.centre.size))
        prior = bound.log_prior(theta)
        if not prior > -math.inf:
            return LinearisedStart(transport)
        last = [np.ascontiguousarray(path) for path in included(bound, chain.path, max(bound.lengths))]
        try:
            bound.check(theta)
            best, value = self._likeliest(theta, [last, self._drawn(theta, transport, noise[0])[0]])
        except (FilterError, ModelError):
            return LinearisedStart(transport)
        if not value > -math.inf:
            return LinearisedStart(transport)
        return LinearisedStart(transport, theta, np.concatenate(best), prior + value)

    def _transport(self, near: NearMode, transform: Unconstrained) -> Transport | None:
        spread = np.asarray(np.linalg.cholesky(near.covariance), dtype=np.float64)
        proposal = Proposal(2.38 / math.sqrt(near.centre.size) * spread, near.centre, spread)
        return linearised_at(
            self.bound, transform.from_line(near.centre)[0], near.references, proposal, self.schedule
        )

    def _drawn(self, theta: Float, transport: Transport, noise: Sequence[Float]) -> tuple[list[Float], float]:
        """Return a trajectory of each log that the linearised model draws, and how much evidence it shows.

        The density of a draw over the density with which it was drawn is an unbiased estimate of the evidence, up to a
        factor that does not depend on theta. Where the linearised model is wrong, it is small.
        """
        paths, value, all_tables = [], 0.0, self.bound.tables(theta)
        for tables, geometry, reference, z in zip(
            all_tables, transport.geometries_at(all_tables), transport.references, noise, strict=True
        ):
            joint, log_determinant, path = transport_trial(tables, geometry, reference, z)
            value += joint - log_determinant + 0.5 * float(np.vdot(z, z)) if joint > -math.inf else -math.inf
            paths.append(path)
        return paths, value

    def _log_evidence(self, theta: Float, transport: Transport, noise: Sequence[Sequence[Float]]) -> float:
        """Return the log evidence that some draws show together, with the prior; -inf where there is none."""
        prior = self.bound.log_prior(theta)
        if not prior > -math.inf:
            return -math.inf
        values = np.array([self._drawn(theta, transport, each)[1] for each in noise])
        return prior + float(special.logsumexp(np.where(np.isnan(values), -np.inf, values)))

    def _likeliest(self, theta: Float, candidates: Sequence[Sequence[Float]]) -> tuple[list[Float], float]:
        """Return the likeliest trajectory of each log, and the log density of all.

        Trajectories can be compared at one theta: those that belong to another theta are much less likely than draws of
        the posterior, and so are draws of a linear model where it is wrong.
        """
        best, total = [], 0.0
        for number, tables in enumerate(self.bound.tables(theta)):
            values = [log_joint(tables, of_logs[number]) for of_logs in candidates]
            chosen = int(np.argmax(np.where(np.isnan(values), -np.inf, values)))
            best.append(candidates[chosen][number])
            total += values[chosen]
        return best, total
