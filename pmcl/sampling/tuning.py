"""Results of a stage that the next one uses: restarted chains, and the linearisation of the transport move."""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Callable, Iterable

import numpy as np
from emcee.autocorr import integrated_time
from emcee.state import State
from numpy.typing import NDArray

from pmcl.errors import SamplingError
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.backends import StageBackend
from pmcl.sampling.linearised_start import ChainAt, LinearisedStart, LinearisedStarter
from pmcl.sampling.marginals import marginals_of
from pmcl.sampling.schedule import Schedule, schedule_of_rates
from pmcl.sampling.stages import Stage
from pmcl.sampling.sweep import included
from pmcl.sampling.transforms import Unconstrained
from pmcl.sampling.transport import Proposal, Transport, linearised_at, sharing_doubts
from pmcl.streams import stream

__all__ = ["lost_chains", "near_their_modes", "restarted", "tuned_schedule", "tuned_transports"]

_logger = logging.getLogger("pmcl.sampling")
Float = NDArray[np.float64]

# One sweep makes a draw, where it is worth this many independent ones by the autocorrelation of the sweeps before: a
# thousand draws of four chains are then worth a thousand or more. Elsewhere two do. More are not made: a chain that
# needs more has mostly not met the others, and three times the time would not change that (Create 3 of MRCLAM, gross
# errors).
_EFFECTIVE_DRAWS = 0.25
# So many steps are enough to measure an autocorrelation; 15 of four chains gave numbers without meaning.
_ENOUGH_STEPS = 50
# The share of a stage's steps that such a measurement leaves out at its beginning.
_SETTLING = 0.25
# A chain is lost when its log evidence estimates lie below the best chain's by more than this many of their standard
# deviations and by this many nats: well mixed chains differ by a few nats, a lost robot by hundreds.
_LOST_SPREADS, _LOST_NATS = 8.0, 40.0
# Proposals in the first tuning stage where no curvature is known: 10 % of each positive parameter.
_FIRST_PROPOSAL = 0.1


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
    centre = _known_median(log_evidence)
    # A chain whose few sweeps made no estimate is not called lost.
    best = int(np.argmax(np.where(np.isnan(centre), -np.finfo(float).max, centre)))
    gap = np.where(np.isnan(centre), 0.0, centre[best] - centre)
    limit = max(_LOST_NATS, _LOST_SPREADS * _spread(log_evidence[:, complete])) if stage.restart_lost else np.inf
    lost = np.flatnonzero(~complete | ~(gap <= limit))
    for chain in lost:
        why = (
            f"its log evidence lies {gap[chain]:.0f} nats below"
            if complete[chain]
            else "it could not include all rows, unlike"
        )
        _logger.warning("chain %d is lost: %s that of chain %d; restarted from there", chain, why, best)
    return {int(chain): best for chain in lost}


def _known_median(values: Float) -> Float:
    """Return the median over steps; sweeps that drew no trajectories have no estimate (NaN)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of a chain without any
        return np.asarray(np.nanmedian(values, axis=0))


def _spread(log_evidence: Float) -> float:
    """Return the standard deviation of estimates (steps, chains) around each chain's own centre; infinite if unknown.

    That of all chains together: a chain may have two estimates that are alike by accident.
    """
    known = np.isfinite(log_evidence).sum(axis=0)
    several = log_evidence[:, known > 1]
    if not several.size:
        return math.inf
    # Around its own centre a chain's few estimates vary less than they do.
    own = np.abs(several - _known_median(several)) * np.sqrt(known[known > 1] / (known[known > 1] - 1.0))
    return 1.4826 * float(np.nanmedian(own))


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
    bound: BoundModel, backend: StageBackend, stage: Stage, lost: dict[int, int], schedule: Schedule
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
    schedule : Schedule
        How often which move is made.

    Returns
    -------
    list of Transport or None
        None where the model offers no usable linearisation.
    """
    thetas, paths = backend.get_chain()[backend.window], backend.window_mean()
    transform = Unconstrained(bound.parameters)
    source = np.array([lost.get(k, k) for k in range(thetas.shape[1])])
    d = thetas.shape[2]
    u = transform.to_line(thetas)[:, np.unique(source)]
    within = (u - u.mean(axis=0)).reshape(-1, d)
    marginals = marginals_of(u.reshape(-1, d))
    normal = marginals.to_normal(u.reshape(-1, d))
    overall = normal - normal.mean(axis=0)
    jitter = 1e-8 * np.eye(d)
    root = 2.38 / math.sqrt(d) * np.linalg.cholesky(within.T @ within / within.shape[0] + jitter)
    spread = np.linalg.cholesky(overall.T @ overall / overall.shape[0] + jitter)
    proposal = Proposal(root, normal.mean(axis=0), spread, marginals)
    transports, drawn = [], backend.window_paths()
    for k in source:
        reference = included(bound, paths[k], max(bound.lengths))
        of_logs = [np.stack(of_log) for of_log in zip(*(_of_logs(bound, path) for path in drawn[:, k]), strict=True)]
        transports.append(linearised_at(bound, thetas[:, k].mean(axis=0), reference, proposal, schedule, of_logs))
    return sharing_doubts(transports)


def _of_logs(bound: BoundModel, path: Float) -> list[Float]:
    return included(bound, path, max(bound.lengths))


def near_their_modes(
    bound: BoundModel,
    backend: StageBackend,
    state: State,
    source: NDArray[np.int64],
    schedule: Schedule,
    seed: int,
    run: Callable[..., Iterable[LinearisedStart | None]],
) -> tuple[State, list[Transport | None]]:
    """Return where chains go on when all data are included, and a linearisation for each.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    backend : StageBackend
        The steps of the inclusion.
    state : emcee.State
        States of all chains, lost ones replaced.
    source : ndarray of int, shape (chains,)
        The chain whose steps each chain goes on from.
    schedule : Schedule
        How often which move is made.
    seed : int
        Seed of the run.
    run : callable
        ``map``, or that of a pool.

    Returns
    -------
    state : emcee.State
    transports : list of Transport or None
        None where the model offers no usable linearisation.
    """
    thetas, paths = backend.get_chain()[backend.window], backend.window_mean()
    chains = [
        ChainAt(
            thetas[:, k].mean(axis=0), paths[k], state.blobs["path"][number],
            stream(seed, "start near the mode", number),
        )
        for number, k in enumerate(source)
    ]
    starts = list(run(LinearisedStarter(bound, schedule), chains))
    coords, log_prob, blobs = state.coords.copy(), state.log_prob.copy(), state.blobs.copy()
    transports: list[Transport | None] = []
    for number, (start, chain) in enumerate(zip(starts, chains, strict=True)):
        if start is None:
            # Draws made while data was being included say nothing about the shape of the posterior.
            proposal = Proposal(_FIRST_PROPOSAL * np.eye(bound.dimension))
            reference = included(bound, chain.mean_path, max(bound.lengths))
            transports.append(linearised_at(bound, chain.theta, reference, proposal, schedule))
            continue
        transports.append(start.transport)
        if start.theta is not None:
            coords[number], log_prob[number] = start.theta, start.log_joint
            blobs["path"][number], blobs["log_joint"][number] = start.path, start.log_joint
    return State(coords, log_prob=log_prob, blobs=blobs, random_state=state.random_state), transports


def tuned_schedule(backend: StageBackend, used: Schedule) -> Schedule:
    """Return how often which move is made, from how often they were accepted at the end of a finished stage.

    It follows from the stored draws alone, never from measured times, so that a run can be repeated and resumed.

    Parameters
    ----------
    backend : StageBackend
        The steps of the stage.
    used : Schedule
        The schedule of the stage.

    Returns
    -------
    Schedule
    """
    blobs = backend.get_blobs()
    rates = (blobs[name][backend.window] for name in ("transport_jump_rate", "path_block_redraw_rate"))
    jumps, blocks = (float(rate[~np.isnan(rate)].mean()) if not np.isnan(rate).all() else 0.0 for rate in rates)
    schedule = schedule_of_rates(jumps, blocks, used)
    draws = backend.get_chain()
    draws = draws[int(_SETTLING * draws.shape[0]) :]
    if draws.shape[0] >= _ENOUGH_STEPS:
        with np.errstate(invalid="ignore"):  # a parameter that did not move has none
            time = np.nanmax(integrated_time(draws, tol=0, quiet=True), initial=1.0)
        schedule = schedule._replace(sweeps=1 if _EFFECTIVE_DRAWS * time <= 1.0 else 2)
    return schedule
