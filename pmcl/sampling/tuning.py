"""Results of a stage that the next one uses: restarted chains, and the linearisation of the transport move."""

from __future__ import annotations

import logging
import math

import numpy as np
from emcee.state import State
from numpy.typing import NDArray

from pmcl.errors import SamplingError
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.backends import StageBackend
from pmcl.sampling.stages import Stage
from pmcl.sampling.sweep import included
from pmcl.sampling.transforms import Unconstrained
from pmcl.sampling.transport import Proposal, Transport, linearised_at

__all__ = ["lost_chains", "restarted", "tuned_transports"]

_logger = logging.getLogger("pmcl.sampling")
Float = NDArray[np.float64]

# A chain is lost when its log evidence estimates lie below the best chain's by more than this many of their own
# standard deviations and by this many nats: well mixed chains differ by a few nats, a lost robot by hundreds.
_LOST_SPREADS, _LOST_NATS = 8.0, 40.0
# Proposals in the first tuning stage, before draws tell better: 10 % of each positive parameter.
_FIRST_PROPOSAL = 0.1
# The independent proposal has this times the covariance of the draws: estimated from few, it is better too wide.
_JUMP_WIDTH = 1.2


def lost_chains(backend: StageBackend, stage: Stage, longest: int) -> dict[int, int]:
    """Return {lost chain: chain to restart it from} at the end of a finished stage.

    A chain that could not include all rows, because every particle died again and again, is always lost; with
    ``stage.restart_lost`` also one whose log evidence lies far below the best chain's.

    Parameters
    ----------
    backend : StageBackend
        The steps of the stage.
    stage : Stage
        The stage.
    longest : int
        Rows of the longest log.

    Raises
    ------
    SamplingError
        When no chain could include all rows.
    """
    blobs = backend.get_blobs()
    complete = blobs["rows"][-1] >= longest
    if not complete.any():
        reached = int(blobs["rows"][-1].max())
        raise SamplingError(
            f"no chain got past row {reached} of {longest}: every particle dies there; "
            "use more particles, wider priors, or a model with outliers"
        )
    log_evidence = np.where(complete, blobs["log_evidence"][backend.window], -np.inf)
    centre = np.median(log_evidence, axis=0)
    best = int(np.argmax(centre))
    gap = centre[best] - centre
    limit = np.inf
    if stage.restart_lost:
        spread = 1.4826 * float(np.median(np.abs(log_evidence[:, best] - centre[best])))
        limit = max(_LOST_NATS, _LOST_SPREADS * spread)
    lost = np.flatnonzero(~complete | ~(gap <= limit))
    for chain in lost:
        why = (
            f"its log evidence lies {gap[chain]:.0f} nats below"
            if complete[chain]
            else "it could not include all rows, unlike"
        )
        _logger.warning("chain %d is lost: %s that of chain %d; restarted from there", chain, why, best)
    return {int(chain): best for chain in lost}


def restarted(state: State, lost: dict[int, int]) -> State:
    """Return the state with lost chains replaced by copies of the best one.

    Parameters
    ----------
    state : emcee.State
        States of all chains.
    lost : dict of int to int
        The chain that replaces each lost one.

    Returns
    -------
    emcee.State
    """
    source = np.array([lost.get(k, k) for k in range(state.coords.shape[0])])
    return State(
        state.coords[source],
        log_prob=state.log_prob[source],
        blobs=state.blobs[source].copy(),
        random_state=state.random_state,
    )


def tuned_transports(
    bound: BoundModel, backend: StageBackend, stage: Stage, lost: dict[int, int]
) -> list[Transport | None]:
    """Return a linearisation for each chain from the last steps of a finished stage.

    The reference is the chain's own mean trajectory. The random walk's covariance is pooled within the chains, so that
    chains that have not met do not widen it; the independent proposal covers the draws of all chains.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    backend : StageBackend
        The steps of the stage.
    stage : Stage
        The stage.
    lost : dict of int to int
        Lost chains, and the chains that they are restarted from.

    Returns
    -------
    list of Transport or None
        None where the model offers no usable linearisation.
    """
    thetas, paths = backend.get_chain()[backend.window], backend.window_mean()
    transform = Unconstrained(bound.parameters)
    source = np.array([lost.get(k, k) for k in range(thetas.shape[1])])
    d = thetas.shape[2]
    if stage.settings.data_rate:
        # Draws made while data was being included say nothing about the shape of the posterior.
        proposal = Proposal(_FIRST_PROPOSAL * np.eye(d))
    else:
        u = transform.to_line(thetas)[:, np.unique(source)]
        within = (u - u.mean(axis=0)).reshape(-1, d)
        overall = (u - u.mean(axis=(0, 1))).reshape(-1, d)
        jitter = 1e-8 * np.eye(d)
        root = 2.38 / math.sqrt(d) * np.linalg.cholesky(within.T @ within / within.shape[0] + jitter)
        spread = math.sqrt(_JUMP_WIDTH) * np.linalg.cholesky(overall.T @ overall / overall.shape[0] + jitter)
        proposal = Proposal(root, u.mean(axis=(0, 1)), spread)
    transports = []
    for k in source:
        reference = included(bound, paths[k], max(bound.lengths))
        transports.append(linearised_at(bound, thetas[:, k].mean(axis=0), reference, proposal))
    return transports
