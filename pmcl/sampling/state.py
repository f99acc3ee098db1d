"""The state of a chain, and how it travels as an emcee blob."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.contract import state_size
from pmcl.models.robot_model import BoundModel

__all__ = ["ChainState", "blob_dtype", "from_blob", "into_blob", "state_dimension"]

Float = NDArray[np.float64]


class ChainState(NamedTuple):
    """What the next sweep of one chain needs, and how the last one went.

    Attributes
    ----------
    theta : ndarray, shape (d,)
        Parameters.
    log_joint : float
        log p(theta, trajectories, readings), eq. 16, over the rows included so far.
    path : ndarray, shape (sum of T_l, D)
        Trajectories of all logs, one after the other.
    log_step : ndarray, shape (d,)
        Logs of the Metropolis proposals' standard deviations.
    log_scale : float
        Log of the factor on the transport move's random walk.
    rows : int
        Rows of each log that are included (the paper's l); at the end of burn-in all of them.
    accepted : ndarray, shape (d,)
        Share of accepted Metropolis proposals of each parameter in the last step.
    walked, jumped, refreshed : float
        Shares of accepted transport moves, random walks and independent proposals, and of rows that the block move
        redrew; NaN when there are none.
    log_evidence, effective_size, changed : float
        See :class:`pmcl.filtering.particle_filter.SweepInfo`; means over the sweeps of the last step and the logs.
    dead : int
        How many trajectory updates failed because every particle got weight zero, since the stage began.
    """

    theta: Float
    log_joint: float
    path: Float
    log_step: Float
    log_scale: float
    rows: int
    accepted: Float
    walked: float
    jumped: float
    refreshed: float
    log_evidence: float
    effective_size: float
    changed: float
    dead: int


def state_dimension(bound: BoundModel) -> int:
    """Return D, the number of components of a state."""
    return int(state_size(bound.tables(bound.prior_mean())[0].motion))


def blob_dtype(bound: BoundModel, size: int) -> np.dtype[Any]:
    """Return the dtype of a blob: every field of :class:`ChainState` but theta, which emcee keeps itself."""
    d = bound.dimension
    return np.dtype(
        [
            # First, because backends that keep paths apart put them back there, and emcee assigns fields by position.
            ("path", float, (sum(bound.lengths), size)),
            ("log_joint", float),
            ("log_step", float, (d,)),
            ("log_scale", float),
            ("rows", np.int64),
            ("accepted", float, (d,)),
            ("walked", float),
            ("jumped", float),
            ("refreshed", float),
            ("log_evidence", float),
            ("effective_size", float),
            ("changed", float),
            ("dead", np.int64),
        ]
    )


def into_blob(state: ChainState, dtype: np.dtype[Any]) -> Any:
    """Return the state as one structured record."""
    record = np.zeros((), dtype=dtype)
    for name in dtype.names or ():
        record[name] = getattr(state, name)
    return record


def from_blob(theta: Float, blob: Any) -> ChainState:
    """Return the state that :func:`into_blob` made a record of; arrays are copies."""
    return ChainState(
        np.array(theta, dtype=float),
        float(blob["log_joint"]),
        np.array(blob["path"], dtype=float),
        np.array(blob["log_step"], dtype=float),
        float(blob["log_scale"]),
        int(blob["rows"]),
        np.array(blob["accepted"], dtype=float),
        float(blob["walked"]),
        float(blob["jumped"]),
        float(blob["refreshed"]),
        float(blob["log_evidence"]),
        float(blob["effective_size"]),
        float(blob["changed"]),
        int(blob["dead"]),
    )
