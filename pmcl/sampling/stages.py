"""The stages of a calibration: include the data, tune, draw.

Within a stage every setting is frozen but the Metropolis steps and one scale, which travel in the blob. What a
stage needs beyond that (the linearisation, the proposal's shape, restarted chains) is a pure function of the stored
chain of the stage before. So a chain can be resumed at any step and goes on exactly as if it had not been stopped.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from emcee.state import State
from numpy.typing import NDArray

from pmcl import defaults
from pmcl.errors import SamplingError
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.backends import StageBackend
from pmcl.sampling.sweep import SweepSettings, included
from pmcl.sampling.transforms import Unconstrained
from pmcl.sampling.transport import Proposal, Transport, linearised_at

__all__ = [
    "BURN_IN_SHARE",
    "INCLUSION_SHARE",
    "Plan",
    "Stage",
    "hurried_rate",
    "lost_chains",
    "plan_stages",
    "restarted",
    "tuned_transports",
]

_logger = logging.getLogger("pmcl.sampling")
Float = NDArray[np.float64]

# A chain is lost when its log evidence estimates lie below the best chain's by more than this many of their own
# standard deviations and by this many nats: well mixed chains differ by a few nats, a lost robot by hundreds.
_LOST_SPREADS, _LOST_NATS = 8.0, 40.0
# Proposals in the first tuning stage, before draws tell better: 10 % of each positive parameter.
_FIRST_PROPOSAL = 0.1
_GAIN = 0.05
# The independent proposal has this times the covariance of the draws: estimated from few, it is better too wide.
_JUMP_WIDTH = 1.2

# A run of limited time has all data included after the first share of it, and begins to draw after the second. Burn-in
# that is done sooner leaves more time to draw. Half for burn-in is where neither part starves the other.
INCLUSION_SHARE, BURN_IN_SHARE = 0.2, 0.5
# Of the time for inclusion, so many sweeps over all rows are set aside: the first linearisation is made from them.
_SETTLING_SWEEPS = 4


class Stage(NamedTuple):
    """One emcee run.

    Attributes
    ----------
    name : str
        Group name in the checkpoint file.
    steps : int
        emcee steps.
    settings : SweepSettings
        What each step does.
    keep_every : int
        Every how many steps a trajectory is kept; 0: none is.
    window : int
        Steps at the end of the stage from which the next one is tuned.
    restart_lost : bool
        Whether chains that lie far below the others are restarted from the best one when the stage ends.
    share : float
        In a run of limited time, the share of the time after which the stage ends.
    """

    name: str
    steps: int
    settings: SweepSettings
    keep_every: int
    window: int
    restart_lost: bool
    share: float = 1.0


@dataclass(frozen=True)
class Plan:
    """Sizes of a particle Gibbs run.

    Attributes
    ----------
    kernel, particles, metropolis_steps, transport_moves
        As in :class:`~pmcl.sampling.sweep.SweepSettings`, for tuning and drawing.
    burn_in_particles : int
        Particles while data is being included: many, because a robot that is lost once stays lost.
    data_rate : int
        Rows per sweep that are included (the paper's r).
    settle : int
        Sweeps with all data before tuning.
    tuning : tuple of int
        Sweeps of each tuning stage.
    draws, sweeps_per_draw : int
        Draws per chain, and sweeps between them.
    trajectories : int
        Trajectories per chain that are kept.
    """

    kernel: Any = "conditional"
    particles: int = defaults.CALIBRATION_PARTICLES["conditional"]
    metropolis_steps: int = defaults.METROPOLIS_STEPS
    transport_moves: int = 6
    burn_in_particles: int = defaults.BURN_IN_PARTICLES
    data_rate: int = 1
    settle: int = 20
    tuning: tuple[int, ...] = (60, 80, 120)
    draws: int = defaults.DRAWS
    sweeps_per_draw: int = defaults.SWEEPS_PER_DRAW
    trajectories: int = 100


def plan_stages(plan: Plan, longest: int) -> list[Stage]:
    """Return the stages for logs of which the longest has `longest` rows."""
    moves = plan.transport_moves
    inclusion = SweepSettings(
        "smoothing", plan.burn_in_particles, max(plan.metropolis_steps, 10), 0, 1, plan.data_rate, _GAIN
    )
    steps = math.ceil(longest / plan.data_rate) + plan.settle
    stages = [Stage("inclusion", steps, inclusion, 0, max(1, plan.settle // 2), False, INCLUSION_SHARE)]
    tuning = SweepSettings(plan.kernel, plan.particles, plan.metropolis_steps, moves, 1, 0, _GAIN)
    for number, length in enumerate(plan.tuning):
        share = INCLUSION_SHARE + (BURN_IN_SHARE - INCLUSION_SHARE) * (number + 1) / len(plan.tuning)
        stages.append(
            Stage(f"tuning-{number + 1}", length, tuning, 0, (length + 1) // 2, number < len(plan.tuning) - 1, share)
        )
    drawing = SweepSettings(plan.kernel, plan.particles, plan.metropolis_steps, moves, plan.sweeps_per_draw)
    stages.append(Stage("draws", plan.draws, drawing, max(1, plan.draws // max(plan.trajectories, 1)), 0, False))
    return stages


def hurried_rate(rate: int, rows: int, longest: int, pace: float, left: float) -> int:
    """Return how many rows each sweep has to include so that all are included in the time that is left.

    Parameters
    ----------
    rate : int
        What was planned; never less is returned.
    rows, longest : int
        Rows included so far, and rows in all.
    pace : float
        Seconds that a sweep of all chains takes for each included row.
    left : float
        Seconds left for including the data.

    Returns
    -------
    int
        Sweeps that grow from l to T rows by r each pass over (T^2 - l^2) / (2 r) rows in all.
    """
    left -= _SETTLING_SWEEPS * longest * pace
    rows_passed = left / pace if pace > 0.0 else math.inf
    if rows_passed <= longest:
        return max(rate, longest - rows)
    return max(rate, math.ceil((longest**2 - rows**2) / (2.0 * rows_passed)))


def lost_chains(backend: StageBackend, stage: Stage, longest: int) -> dict[int, int]:
    """Return {lost chain: chain to restart it from} at the end of a finished stage.

    A chain that could not include all rows, because every particle died again and again, is always lost; with
    ``stage.restart_lost`` also one whose log evidence lies far below the best chain's.

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
    evidence = np.where(complete, blobs["log_evidence"][backend.window], -np.inf)
    centre = np.median(evidence, axis=0)
    best = int(np.argmax(centre))
    gap = centre[best] - centre
    limit = np.inf
    if stage.restart_lost:
        spread = 1.4826 * float(np.median(np.abs(evidence[:, best] - centre[best])))
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
    """Return the state with lost chains replaced by copies of the best one."""
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
        around = (u - u.mean(axis=(0, 1))).reshape(-1, d)
        jitter = 1e-8 * np.eye(d)
        root = 2.38 / math.sqrt(d) * np.linalg.cholesky(within.T @ within / within.shape[0] + jitter)
        spread = math.sqrt(_JUMP_WIDTH) * np.linalg.cholesky(around.T @ around / around.shape[0] + jitter)
        proposal = Proposal(root, u.mean(axis=(0, 1)), spread)
    transports = []
    for k in source:
        reference = included(bound, paths[k], max(bound.lengths))
        transports.append(linearised_at(bound, thetas[:, k].mean(axis=0), reference, proposal))
    return transports
