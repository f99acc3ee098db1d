"""One whole sweep of Table 1 for one chain: trajectories given theta, theta given trajectories, both together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmcl.checks import check_choice, check_number, check_whole
from pmcl.errors import FilterError, ModelError, SamplingError
from pmcl.filtering.particle_filter import Kernel, SweepInfo, log_joint, make_rng, sweep_path
from pmcl.interrupts import check_interrupt
from pmcl.models.robot_model import BoundModel
from pmcl.models.tables import Tables
from pmcl.sampling.metropolis import update_theta
from pmcl.sampling.state import ChainState, state_dimension
from pmcl.sampling.transforms import Unconstrained
from pmcl.sampling.transport import Transport, transport_moves

__all__ = ["SweepSettings", "included", "start_chain", "step"]

# Best acceptance of a Gaussian random walk in several dimensions (Roberts, Gelman, Gilks 1997).
WALK_ACCEPTANCE = 0.234

Float = NDArray[np.float64]


@dataclass(frozen=True)
class SweepSettings:
    """How a sweep is made.

    Attributes
    ----------
    kernel : {"smoothing", "conditional"}
        How trajectories are drawn, see :func:`pmcl.filtering.particle_filter.sweep_path`.
    particles : int
        Number of particles n.
    metropolis_steps : int
        Rounds of one-dimensional updates per trajectory update (the paper's m).
    transport_moves : int
        Transport moves per sweep; they need a linearisation.
    sweeps : int
        Sweeps per emcee step, that is per stored draw.
    data_rate : int
        While data is being included, rows of each log that each sweep adds (the paper's r); 0: all rows at once.
    gain : float
        Adaptation of the Metropolis steps; 0 freezes them, as drawing needs.
    """

    kernel: Kernel = "conditional"
    particles: int = 25
    metropolis_steps: int = 5
    transport_moves: int = 6
    sweeps: int = 1
    data_rate: int = 0
    gain: float = 0.0

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_choice("kernel", self.kernel, ("conditional", "smoothing"), error=SamplingError)
        check_whole("particles", self.particles, 2, error=SamplingError, advice="25 to 1000 are usual")
        for name, least in (("metropolis_steps", 0), ("transport_moves", 0), ("sweeps", 1), ("data_rate", 0)):
            check_whole(name, getattr(self, name), least, error=SamplingError)
        check_number("gain", self.gain, 0.0, 1.0, error=SamplingError, advice="0 freezes the steps")


def included(bound: BoundModel, path: Float, rows: int) -> list[Float]:
    """Return views of the first `rows` states of each log's trajectory in the stacked `path` (sum of T_l, D)."""
    views, begin = [], 0
    for length in bound.lengths:
        views.append(path[begin : begin + min(length, rows)])
        begin += length
    return views


def _joint(bound: BoundModel, theta: Float, tables: Sequence[Tables], paths: Sequence[Float]) -> float:
    return bound.log_prior(theta) + math.fsum(log_joint(table, path) for table, path in zip(tables, paths, strict=True))


def start_chain(bound: BoundModel, settings: SweepSettings, seed: int, attempts: int = 200) -> tuple[ChainState, int]:
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
    state : ChainState
        The first state.
    redrawn : int
        How many impossible values of theta were drawn before.

    Raises
    ------
    SamplingError
        When no theta that the prior offers can explain the first rows.
    """
    rng = make_rng(np.random.SeedSequence(seed))
    rows = min(settings.data_rate or max(bound.lengths), max(bound.lengths))
    size = state_dimension(bound)
    for attempt in range(attempts):
        check_interrupt()
        theta = bound.draw_prior(rng)
        path = np.zeros((sum(bound.lengths), size))
        views = included(bound, path, rows)
        try:
            bound.check(theta)
            tables = bound.tables(theta)
            infos = [
                sweep_path(table, view, len(view), settings.particles, rng, "smoothing")
                for table, view in zip(tables, views, strict=True)
            ]
        except (FilterError, ModelError):
            continue
        value = _joint(bound, theta, tables, views)
        if all(info.alive for info in infos) and math.isfinite(value):
            zeros = np.zeros(bound.dimension)
            log_step = np.log(np.maximum(0.2 * np.abs(theta), 1e-6))
            evidence = math.fsum(info.log_evidence for info in infos)
            effective = float(np.mean([info.effective_size for info in infos]))
            state = ChainState(
                theta, value, path, log_step, 0.0, rows, zeros, *(math.nan,) * 3, evidence, effective, 1.0, 0
            )
            return state, attempt
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
) -> ChainState:
    """Make ``settings.sweeps`` sweeps; a pure function of its arguments.

    Each sweep draws the trajectories given the current theta, then theta given the new trajectories, then moves both
    together.

    Raises
    ------
    FilterError
        When a density is not a number, or a transition has no density; the message holds the parameter values.
    """
    rng = make_rng(np.random.SeedSequence(seed))
    try:
        made = [_sweep(bound, settings, transport, transform, state, rng)]
        for _ in range(settings.sweeps - 1):
            made.append(_sweep(bound, settings, transport, transform, made[-1], rng))
    except FilterError as error:
        values = ", ".join(f"{name}={value:.6g}" for name, value in zip(bound.names, state.theta, strict=True))
        raise FilterError(f"{error} (parameters near {values})") from None
    last = made[-1]
    if len(made) == 1:
        return last
    return last._replace(
        accepted=np.mean([one.accepted for one in made], axis=0),
        walked=float(np.mean([one.walked for one in made])),
        jumped=float(np.mean([one.jumped for one in made])),
        refreshed=float(np.mean([one.refreshed for one in made])),
        log_evidence=float(np.mean([one.log_evidence for one in made])),
        effective_size=float(np.mean([one.effective_size for one in made])),
        changed=float(np.mean([one.changed for one in made])),
    )


def _sweep(
    bound: BoundModel,
    settings: SweepSettings,
    transport: Transport | None,
    transform: Unconstrained,
    state: ChainState,
    rng: np.random.Generator,
) -> ChainState:
    check_interrupt()
    everything = max(bound.lengths)
    rows = min(everything, state.rows + settings.data_rate) if settings.data_rate else everything
    # New rows have no trajectory yet, so only the smoothing kernel can add them.
    kernel: Kernel = settings.kernel if rows == state.rows else "smoothing"
    path = state.path.copy()
    paths = included(bound, path, rows)
    tables = bound.tables(state.theta)
    infos = [
        sweep_path(table, view, len(view), settings.particles, rng, kernel)
        for table, view in zip(tables, paths, strict=True)
    ]
    dead = state.dead
    if not all(info.alive for info in infos):
        # Every particle died in some log: keep the old trajectories and rows, count it, and let theta move on.
        dead += 1
        rows, path = state.rows, state.path.copy()
        paths = included(bound, path, rows)
    theta, log_step, accepted = update_theta(
        bound, state.theta, tables, paths, state.log_step, settings.metropolis_steps, settings.gain, rng
    )
    tables = bound.tables(theta)
    value = walked = jumped = refreshed = math.nan
    log_scale = state.log_scale
    if transport is not None and settings.transport_moves > 0 and rows == everything:
        theta, moved, value, walked, jumped, refreshed = transport_moves(
            bound, theta, tables, paths, transport, transform, settings.transport_moves, math.exp(log_scale), rng
        )
        if settings.gain > 0.0:
            log_scale += 4.0 * settings.gain * (walked - WALK_ACCEPTANCE)
        path = np.concatenate(moved)
    if math.isnan(value):  # no move was made that would know it
        value = _joint(bound, theta, tables, paths)
    new = ChainState(
        theta, value, path, log_step, log_scale, rows, accepted, walked, jumped, refreshed, 0.0, 0.0, 0.0, dead
    )
    return _told(new, infos)


def _told(state: ChainState, infos: Sequence[SweepInfo]) -> ChainState:
    return state._replace(
        log_evidence=math.fsum(info.log_evidence for info in infos),
        effective_size=math.fsum(info.effective_size for info in infos) / len(infos),
        changed=math.fsum(info.changed for info in infos) / len(infos),
    )
