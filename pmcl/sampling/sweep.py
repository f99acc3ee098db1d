"""One whole sweep of Table 1 for one chain: trajectories given theta, theta given trajectories, both together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.checks import check_choice, check_number, check_whole
from pmcl.errors import FilterError, ModelError, SamplingError
from pmcl.filtering.not_a_number import check_density, parameters_told, values_of
from pmcl.filtering.particle_filter import Kernel, PathUpdate, log_joint, make_rng, update_path
from pmcl.interrupts import check_interrupt
from pmcl.models.robot_model import BoundModel
from pmcl.models.tables import Tables
from pmcl.sampling.metropolis import update_theta
from pmcl.sampling.schedule import Schedule
from pmcl.sampling.state import ChainState, SweepInfo, mean_info, state_dimension
from pmcl.sampling.transforms import Unconstrained
from pmcl.sampling.transport import Transport, transport_moves

__all__ = ["ChainStart", "SweepSettings", "included", "start_chain", "step"]

# Best acceptance of a Gaussian random walk in several dimensions (Roberts, Gelman, Gilks 1997).
WALK_ACCEPTANCE = 0.234

Float = NDArray[np.float64]


@dataclass(frozen=True)
class SweepSettings:
    """The settings of a sweep.

    Attributes
    ----------
    kernel : {"smoothing", "conditional"}
        How trajectories are drawn, see :func:`pmcl.filtering.particle_filter.update_path`.
    particles : int
        Number of particles n.
    metropolis_steps : int
        Rounds of one-dimensional updates per trajectory update (the paper's m).
    transport_moves : int, optional
        Transport moves per sweep, which need a linearisation; as many as the transport's schedule says when None.
    sweeps : int, optional
        Sweeps per emcee step, that is per stored draw; as many as the transport's schedule says when None.
    data_rate : int
        While data is being included, rows of each log that each sweep adds (the paper's r); 0: all rows at once.
    gain : float
        Adaptation of the Metropolis steps; 0 freezes them, as drawing needs.
    """

    kernel: Kernel = "conditional"
    particles: int = 25
    metropolis_steps: int = 5
    transport_moves: int | None = 6
    sweeps: int | None = 1
    data_rate: int = 0
    gain: float = 0.0

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_choice("kernel", self.kernel, ("conditional", "smoothing"), error=SamplingError)
        check_whole("particles", self.particles, 2, error=SamplingError, advice="25 to 1000 are usual")
        for name, least in (("metropolis_steps", 0), ("transport_moves", 0), ("sweeps", 1), ("data_rate", 0)):
            if name not in ("transport_moves", "sweeps") or getattr(self, name) is not None:
                check_whole(name, getattr(self, name), least, error=SamplingError)
        check_number("gain", self.gain, 0.0, 1.0, error=SamplingError, advice="0 freezes the steps")


def included(bound: BoundModel, path: Float, rows: int) -> list[Float]:
    """Return the first states of each log's trajectory.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    path : ndarray, shape (sum of T_l, D)
        Trajectories of all logs, one after the other.
    rows : int
        How many states of each log, or all where a log has fewer.

    Returns
    -------
    list of ndarray, shape (min(T_l, rows), D)
        Views into `path`.
    """
    paths, begin = [], 0
    for length in bound.lengths:
        paths.append(path[begin : begin + min(length, rows)])
        begin += length
    return paths


class ChainStart(NamedTuple):
    """How a chain begins.

    Attributes
    ----------
    state : ChainState
        The first state.
    info : SweepInfo
        How its trajectories were drawn.
    impossible_draws : int
        How many values of theta were drawn before that give the readings no probability.
    """

    state: ChainState
    info: SweepInfo
    impossible_draws: int


def start_chain(bound: BoundModel, settings: SweepSettings, seed: int, attempts: int = 200) -> ChainStart:
    """Start a chain as Table 1 does: theta from the prior, trajectories from a particle filter over the first rows.

    A theta under which every particle gets weight zero is impossible and is drawn again.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    settings : SweepSettings
        Its particles and data rate.
    seed : int
        Seed of this chain's start.
    attempts : int
        How often theta may be drawn.

    Returns
    -------
    ChainStart

    Raises
    ------
    SamplingError
        When no theta that the prior offers can explain the first rows.
    DensityError
        When a density is not a number.
    """
    rng = make_rng(np.random.SeedSequence(seed))
    rows = min(settings.data_rate or max(bound.lengths), max(bound.lengths))
    size = state_dimension(bound)
    for attempt in range(attempts):
        check_interrupt()
        theta = bound.draw_prior(rng)
        path = np.zeros((sum(bound.lengths), size))
        paths = included(bound, path, rows)
        try:
            bound.check(theta)
            tables = bound.tables(theta)
            with parameters_told(bound, theta):
                updates = [
                    update_path(table, log_path, len(log_path), settings.particles, rng, "smoothing")
                    for table, log_path in zip(tables, paths, strict=True)
                ]
        except (FilterError, ModelError):
            continue
        value = _log_joint(bound, theta, tables, paths)
        if all(update.succeeded for update in updates) and math.isfinite(value):
            log_step = np.log(np.maximum(0.2 * np.abs(theta), 1e-6))
            state = ChainState(
                theta=theta, log_joint=value, path=path, log_step=log_step, log_scale=0.0, rows=rows, failed_updates=0
            )
            return ChainStart(state, _sweep_info(updates, np.zeros(bound.dimension)), attempt)
    raise SamplingError(
        f"no start in {attempts} draws from the prior gives the first {rows} rows a positive probability; "
        "widen the priors or the start belief, or use more particles"
    )


def step(
    bound: BoundModel,
    settings: SweepSettings,
    transport: Transport | None,
    transform: Unconstrained,
    state: ChainState,
    seed: int,
) -> tuple[ChainState, SweepInfo]:
    """Make the sweeps of one stored draw; a pure function of its arguments.

    Each sweep draws the trajectories given the current theta, then theta given the new trajectories, then moves both
    together. Where the transport's schedule says so, some sweeps only do the last.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    settings : SweepSettings
        The settings of the sweeps.
    transport : Transport, optional
        The linearisation for transport moves; without it there are none.
    transform : Unconstrained
        The map to unconstrained parameters.
    state : ChainState
        Where the chain is; it is not changed.
    seed : int
        All randomness follows from it.

    Returns
    -------
    state : ChainState
        Where the chain is afterwards.
    info : SweepInfo
        How the sweeps went.

    Raises
    ------
    FilterError, DensityError
        When a transition has no density, or a density is not a number; the message holds the parameter values.
    """
    rng = make_rng(np.random.SeedSequence(seed))
    infos, before = [], state
    schedule = transport.schedule if transport is not None else Schedule()
    try:
        with parameters_told(bound, before.theta, near=True):
            for _ in range(settings.sweeps if settings.sweeps is not None else schedule.sweeps):
                state, info = _sweep(bound, settings, transport, transform, state, rng)
                infos.append(info)
    except FilterError as error:
        raise FilterError(f"{error} (parameters near {values_of(bound, before.theta)})") from None
    return state, mean_info(infos)


def _sweep(
    bound: BoundModel,
    settings: SweepSettings,
    transport: Transport | None,
    transform: Unconstrained,
    state: ChainState,
    rng: np.random.Generator,
) -> tuple[ChainState, SweepInfo]:
    """Make one sweep; the parameters are those of :func:`step`."""
    check_interrupt()
    all_rows = max(bound.lengths)
    rows = min(all_rows, state.rows + settings.data_rate) if settings.data_rate else all_rows
    theta, log_step, log_scale, failed_updates = state.theta, state.log_step, state.log_scale, state.failed_updates
    path = state.path.copy()
    paths = included(bound, path, rows)
    tables = bound.tables(theta)
    info, value = _sweep_info([], np.full(bound.dimension, math.nan)), math.nan
    moves, share = 0, 1.0
    if transport is not None:
        moves = settings.transport_moves if settings.transport_moves is not None else transport.schedule.moves
        if moves and rows == state.rows == all_rows:
            share = transport.schedule.path_share
    if share == 1.0 or rng.random() < share:
        # New rows have no trajectory yet, so only the smoothing kernel can add them.
        kernel: Kernel = settings.kernel if rows == state.rows else "smoothing"
        updates = [
            update_path(table, log_path, len(log_path), settings.particles, rng, kernel)
            for table, log_path in zip(tables, paths, strict=True)
        ]
        if not all(update.succeeded for update in updates):
            # Every particle died in some log: keep the old trajectories and rows, count it, and let theta move on.
            failed_updates += 1
            rows, path = state.rows, state.path.copy()
            paths = included(bound, path, rows)
        theta, log_step, accepted = update_theta(
            bound, theta, tables, paths, log_step, settings.metropolis_steps, settings.gain, rng
        )
        tables = bound.tables(theta)
        info = _sweep_info(updates, accepted)
    if transport is not None and moves and rows == all_rows:
        moved = transport_moves(
            bound, theta, tables, paths, transport, transform, moves, math.exp(log_scale), rng
        )
        theta, value = moved.theta, moved.log_joint
        if settings.gain > 0.0 and not math.isnan(moved.walk_acceptance_rate):
            log_scale += 4.0 * settings.gain * (moved.walk_acceptance_rate - WALK_ACCEPTANCE)
        path = np.concatenate(moved.paths)
        info = info._replace(
            transport_walk_acceptance_rate=moved.walk_acceptance_rate,
            transport_jump_rate=moved.jump_rate,
            path_block_redraw_rate=moved.redraw_rate,
        )
    if math.isnan(value):  # no move was made that evaluated it
        value = _log_joint(bound, theta, tables, paths)
    new = ChainState(
        theta=theta, log_joint=value, path=path, log_step=log_step, log_scale=log_scale, rows=rows,
        failed_updates=failed_updates,
    )  # fmt: skip
    return new, info


def _log_joint(bound: BoundModel, theta: Float, tables: Sequence[Tables], paths: Sequence[Float]) -> float:
    value = math.fsum(log_joint(table, path) for table, path in zip(tables, paths, strict=True))
    return bound.log_prior(theta) + check_density(value, bound, theta, paths)


def _sweep_info(updates: Sequence[PathUpdate], acceptance_rate: Float) -> SweepInfo:
    """Return the info of a sweep without transport moves, from the trajectory updates of its logs if any was made."""
    share = 1.0 / len(updates) if updates else math.nan
    return SweepInfo(
        acceptance_rate=acceptance_rate,
        transport_walk_acceptance_rate=math.nan,
        transport_jump_rate=math.nan,
        path_block_redraw_rate=math.nan,
        log_evidence=math.fsum(update.log_evidence for update in updates) if updates else math.nan,
        particle_ess=math.fsum(update.effective_share for update in updates) * share,
        path_update_rate=math.fsum(update.changed_share for update in updates) * share,
    )
