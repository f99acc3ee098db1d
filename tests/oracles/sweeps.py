"""Chains of plain sweeps, without emcee: fast, and with places to break them on purpose."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.models.robot_model import BoundModel
from pmcl.sampling.state import ChainState, SweepInfo
from pmcl.sampling.sweep import SweepSettings, step
from pmcl.sampling.transforms import Unconstrained
from pmcl.sampling.transport import Transport

Float = NDArray[np.float64]
Step = Callable[..., tuple[ChainState, SweepInfo]]


def first_state(bound: BoundModel, theta: Float, path: Float, log_step: Float | None = None) -> ChainState:
    """A state at `theta` and `path` whose proposals are a third of each parameter."""
    steps = np.log(0.35 * theta) if log_step is None else log_step
    return ChainState(
        theta=theta.copy(), log_joint=0.0, path=path.copy(), log_step=steps, log_scale=0.0, rows=max(bound.lengths),
        failed_updates=0,
    )  # fmt: skip


def run_chain(
    bound: BoundModel,
    settings: SweepSettings,
    transport: Transport | None,
    state: ChainState,
    draws: int,
    seed: int,
    step: Step = step,
) -> tuple[Float, Float]:
    """Return parameters (N, d) and trajectories (N, T, D) after each of `draws` steps."""
    transform = Unconstrained(bound.parameters)
    seeds = np.random.SeedSequence(seed).generate_state(draws, dtype=np.uint64)
    thetas, paths = np.empty((draws, bound.dimension)), np.empty((draws, *state.path.shape))
    for k in range(draws):
        state, _ = step(bound, settings, transport, transform, state, int(seeds[k]))
        thetas[k], paths[k] = state.theta, state.path
    return thetas, paths


_made_by: list[Callable[[int], Any]] = []


def _call(seed: int) -> Any:
    return _made_by[-1](seed)


def run_chains(make: Callable[[int], Any], seeds: list[int]) -> list[Any]:
    """Call `make` with each seed in processes of their own, two at a time; forked, so `make` is not pickled."""
    _made_by.append(make)
    with ProcessPoolExecutor(2, mp_context=get_context("fork")) as pool:
        return list(pool.map(_call, seeds))
