"""Where the posterior of theta and path lies: the linearised model's mode, and some sweeps of particle Gibbs from it.

Between walls the linearised model alone finds far too much noise of the readings, since beams beyond an edge are no
part of it, and its path is not the middle of the paths that explain the log. Some sweeps mend both within a second.
Numbers that come from here decide how long a method needs, not what it finds.
"""

from __future__ import annotations

import math

import numpy as np

from pmcl.models.robot_model import BoundModel
from pmcl.sampling.near_mode import NearMode, near_mode
from pmcl.sampling.state import ChainState
from pmcl.sampling.sweep import SweepSettings, included, step
from pmcl.sampling.transforms import Unconstrained
from pmcl.sampling.transport import Proposal, linearised_at

__all__ = ["near_posterior"]

# Of so many sweeps the later half counts. With half as many the noise of guided evidence is the same (Amigobot, 300
# rows); before any it is three times as large, and the estimates are eight nats too small.
_SWEEPS = 200
_SETTINGS = SweepSettings("conditional", gain=0.05)


def near_posterior(bound: BoundModel, seed: int) -> NearMode:
    """Find the posterior roughly.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    seed : int
        All randomness follows from it.

    Returns
    -------
    NearMode
        Centre and paths are the means of some draws; the covariance is that of the linearised model.

    Raises
    ------
    FilterError
        When the filter loses the robot whatever the noise.
    """
    near, transform = near_mode(bound, seed), Unconstrained(bound.parameters)
    theta, rows = transform.from_line(near.centre)[0], max(bound.lengths)
    root = np.asarray(2.38 / math.sqrt(theta.size) * np.linalg.cholesky(near.covariance), dtype=np.float64)
    transport = linearised_at(bound, theta, near.references, Proposal(root))
    state = ChainState(
        theta=theta, log_joint=math.nan, path=np.concatenate(near.references),
        log_step=np.log(2.38 * np.maximum(np.abs(theta), 1e-6) * np.sqrt(np.diag(near.covariance))),
        log_scale=0.0, rows=rows, failed_updates=0,
    )  # fmt: skip
    centre, path, count = np.zeros_like(theta), np.zeros_like(state.path), _SWEEPS // 2
    for sweep, word in enumerate(np.random.SeedSequence((seed, 53)).generate_state(_SWEEPS, dtype=np.uint64)):
        state, _ = step(bound, _SETTINGS, transport, transform, state, int(word))
        if sweep >= _SWEEPS - count:
            centre += transform.to_line(state.theta) / count
            path += state.path / count
    return NearMode(centre, near.covariance, tuple(np.ascontiguousarray(each) for each in included(bound, path, rows)))
