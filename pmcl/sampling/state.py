"""The state of a chain, the report of a sweep, and the emcee blob that holds both."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.contract import state_size
from pmcl.models.robot_model import BoundModel

__all__ = ["ChainState", "SweepInfo", "blob_dtype", "from_blob", "into_blob", "mean_info", "state_dimension"]

Float = NDArray[np.float64]


class ChainState(NamedTuple):
    """The state of one chain: everything that the next sweep needs.

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
    failed_updates : int
        How many trajectory updates failed because every particle had weight zero, since the chain began.
    """

    theta: Float
    log_joint: float
    path: Float
    log_step: Float
    log_scale: float
    rows: int
    failed_updates: int


class SweepInfo(NamedTuple):
    """How a sweep went; for several sweeps, the mean. The names are those of ArviZ's group ``sample_stats``.

    What a sweep did not do is NaN; the mean is over the sweeps that did it.

    Attributes
    ----------
    acceptance_rate : ndarray, shape (d,)
        Share of accepted Metropolis proposals of each parameter.
    transport_walk_acceptance_rate, transport_jump_rate : float
        Shares of accepted transport moves, random walks and independent proposals; NaN when none was made.
    path_block_redraw_rate : float
        Share of rows that the block move redrew; NaN when there was no block move.
    log_evidence : float
        Estimate of log p(readings | theta) by the trajectory update's particles, summed over the logs [nat].
    particle_ess : float
        Mean effective sample size over rows with readings, as a share of the particles; mean over the logs.
    path_update_rate : float
        Share of states that the trajectory update changed; mean over the logs.
    """

    acceptance_rate: Float
    transport_walk_acceptance_rate: float
    transport_jump_rate: float
    path_block_redraw_rate: float
    log_evidence: float
    particle_ess: float
    path_update_rate: float


_WHOLE_NUMBERS = ("rows", "failed_updates")


def mean_info(infos: list[SweepInfo]) -> SweepInfo:
    """Return the mean of each field over those of several sweeps that have it; NaN where none has."""
    if len(infos) == 1:
        return infos[0]
    first, *others = (_known_mean(np.array(values)) for values in zip(*infos, strict=True))
    return SweepInfo(first, *(float(value) for value in others))


def _known_mean(values: Float) -> Float:
    known = ~np.isnan(values)
    count = known.sum(axis=0)
    return np.where(count, np.where(known, values, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)


def state_dimension(bound: BoundModel) -> int:
    """Return D, the number of components of a state."""
    return int(state_size(bound.tables(bound.prior_mean())[0].motion))


def blob_dtype(bound: BoundModel, size: int) -> np.dtype[Any]:
    """Return the dtype of a blob.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    size : int
        Components D of a state.

    Returns
    -------
    numpy.dtype
        A field for each field of :class:`ChainState` but theta, which emcee keeps itself, and of :class:`SweepInfo`.
        The path comes first, because backends that keep paths apart put them back there, and emcee assigns the fields
        by position.
    """
    parameters = (bound.dimension,)
    shapes = {"path": (sum(bound.lengths), size), "log_step": parameters, "acceptance_rate": parameters}
    names = ["path", *(name for name in ChainState._fields if name not in ("theta", "path")), *SweepInfo._fields]
    return np.dtype(
        [(name, np.int64 if name in _WHOLE_NUMBERS else np.float64, shapes.get(name, ())) for name in names]
    )


def into_blob(state: ChainState, info: SweepInfo, dtype: np.dtype[Any]) -> Any:
    """Return state and report as one structured record.

    Parameters
    ----------
    state : ChainState
        The state of a chain.
    info : SweepInfo
        The report of its last step.
    dtype : numpy.dtype
        As :func:`blob_dtype` returns it.

    Returns
    -------
    numpy.ndarray, shape ()
    """
    values: dict[str, Any] = {**state._asdict(), **info._asdict()}
    return np.array(tuple([values[name] for name in dtype.names or ()]), dtype=dtype)


def from_blob(theta: Float, blob: Any) -> ChainState:
    """Return the state that :func:`into_blob` made a record of.

    Parameters
    ----------
    theta : ndarray, shape (d,)
        Parameters, which emcee keeps as coordinates and not in the blob.
    blob : numpy.void
        The record.

    Returns
    -------
    ChainState
        Its arrays are copies.
    """
    # One call for all fields: asking for them by name takes five times as long.
    values = dict(zip(blob.dtype.names, blob.item(), strict=True))
    kept: dict[str, Any] = {
        name: np.array(values[name]) if isinstance(values[name], np.ndarray) else values[name]
        for name in ChainState._fields
        if name != "theta"
    }
    return ChainState(theta=np.array(theta, dtype=float), **kept)
