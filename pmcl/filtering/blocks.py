"""Smoothing and conditional draws of long trajectories: a filter's history is held one block of rows at a time.

The filter runs over the log once and leaves, before each block, the last particles and its generator. Then it runs over
each block again, the last one first, with the same random numbers, and the trajectory is drawn backward through that
block. So each row is filtered twice, and memory grows with T / B + B instead of T, for blocks of B rows (checkpoints as
in Griewank and Walther, Algorithm 799: revolve, ACM TOMS 26, 2000).
"""

from __future__ import annotations

import copy
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.filtering.kernels import smc
from pmcl.interrupts import check_interrupt
from pmcl.models.tables import Tables

__all__ = ["redraw_in_blocks"]

Float = NDArray[np.float64]


class _Checkpoint(NamedTuple):
    """What the filter needs to begin a block: the row before it, and the generator."""

    particles: Float
    log_weights: Float
    weighted: bool
    rng: np.random.Generator


def redraw_in_blocks(
    tables: Tables,
    rng: np.random.Generator,
    n_steps: int,
    n_particles: int,
    conditional: bool,
    path: Float,
    rows: int,
) -> tuple[int, int, float, float, int]:
    """Draw the trajectory that :func:`pmcl.filtering.kernels.smc.redraw_path` would, to the last bit.

    Parameters
    ----------
    tables, rng, n_steps, n_particles, conditional, path
        As for that function; `path` (T, D) is changed in place.
    rows : int
        Rows of a block; at least the root of T are taken, so that the checkpoints are not more than a block.

    Returns
    -------
    tuple
        Status, row, log evidence, mean effective sample size, and number of states changed, as of that function.
    """
    block = max(rows, math.isqrt(n_steps), 1)
    kept = block + 1  # the row before a block as well
    history = smc.History(
        np.empty((kept, path.shape[1], n_particles)), np.empty((kept, n_particles)),
        np.empty((kept, n_particles), np.uint32),
    )  # fmt: skip
    steps, begins = np.empty((n_steps, 2)), range(0, n_steps, block)
    log_evidence, weighted, checkpoints = 0.0, False, []
    for begin in begins:
        check_interrupt()
        last = (begin - 1) % kept
        checkpoints.append(
            _Checkpoint(
                history.particles[last].copy(), history.log_weights[last].copy(), weighted, copy.deepcopy(rng)
            )
        )
        stop = min(begin + block, n_steps)
        status, t, gained, weighted = smc.filter_block(
            tables, rng, begin, stop, weighted, conditional, path, history, steps
        )
        if status != smc.FINE:
            return status, t, gained, 0.0, 0
        log_evidence += gained
    new, changed, ancestor = path.copy(), 0, -1
    for begin, before in zip(reversed(begins), reversed(checkpoints), strict=True):
        check_interrupt()
        stop = min(begin + block, n_steps)
        if stop < n_steps:  # the history still holds the last block
            last = (begin - 1) % kept
            history.particles[last], history.log_weights[last] = before.particles, before.log_weights
            smc.filter_block(tables, before.rng, begin, stop, before.weighted, conditional, path, history, steps)
        status, t, different, ancestor = smc.draw_block(tables, rng, begin, stop, ancestor, history, new)
        if status != smc.FINE:
            return status, t, log_evidence, 0.0, 0
        changed += different
    path[:n_steps] = new[:n_steps]
    effective = steps[steps[:, 0] != 0.0, 1]
    return smc.FINE, 0, log_evidence, float(effective.mean()) if effective.size else 0.0, changed
