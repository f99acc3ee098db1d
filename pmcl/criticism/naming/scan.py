"""A filter pass with each candidate at a clear magnitude, for effects that scores do not show.

Scores rank small effects. A large effect, or one that the path absorbs, may have a small score and gain much all the
same.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pmcl.criticism.naming.shortlist import REMARKABLE, SCAN_GAIN, distinct
from pmcl.criticism.scoring.scores import Direction, probe_values
from pmcl.errors import DensityError, PmclError
from pmcl.filtering.particle_filter import make_rng, run_filter
from pmcl.models.robot_model import BoundModel
from pmcl.models.tables import Tables, uniform
from pmcl.streams import stream

__all__ = ["scan"]

Float = NDArray[np.float64]

# Candidates are scanned only when the greatest standardised score exceeds this (chosen by hand): a large effect always
# gives some candidate a large score.
_LEAST_Z = 6.0
# Share of the rows after which a candidate is dropped when it has lost much. Most absent effects are far behind by
# then (measured on block 4 of analyses/hidden_effects).
_FIRST_SHARE = 0.25


def scan(
    bound: BoundModel, theta: Float, directions: Sequence[Direction], z: Float, seed: int, particles: int
) -> dict[int, float]:
    """Run the filter with each candidate at a clear magnitude, to both sides if it has two.

    Only candidates of the whole robot and those with a remarkable score are scanned, the latter at their likeliest
    places and on the side that the score points to. Nothing is scanned when all scores are small.

    Parameters
    ----------
    bound : BoundModel
        The current model bound to the fit part of the log.
    theta : ndarray, shape (d,)
        Its parameters.
    directions : sequence of Direction
        K candidates.
    z : ndarray, shape (K,)
        Their standardised scores on the fit part.
    seed : int
        Determines all random numbers.
    particles : int
        Particles of each pass.

    Returns
    -------
    dict of int to float
        Gain in log evidence of the fit part [nat] by position of the direction. For a candidate that loses much in the
        first quarter of the rows it is the loss there.
    """
    if np.abs(z).max(initial=0.0) < _LEAST_Z:
        return {}
    log, tables, n_steps = bound.logs[0], bound.tables(theta)[0], bound.lengths[0]

    def increments(edited: Tables, rows: int) -> Float:
        rng = make_rng(stream(seed, "scan"))
        try:
            return run_filter(edited, rows, particles, rng).log_increments
        except DensityError:
            raise
        except PmclError:
            return np.full(rows, -np.inf)

    base, n_first = increments(tables, n_steps), int(_FIRST_SHARE * n_steps)

    def gain(edited: Tables) -> float:
        first = float(increments(edited, n_first).sum()) - float(base[:n_first].sum())
        return first if first < -SCAN_GAIN else float(increments(edited, n_steps).sum()) - float(base.sum())

    order = [int(k) for k in np.argsort(-np.abs(z))]
    likely = [k for k in order if directions[k].effect.where and abs(z[k]) > REMARKABLE]
    likeliest_places, gains = set(distinct(directions, likely)), {}
    for k, direction in enumerate(directions):
        if direction.effect.where and k not in likeliest_places:
            continue
        if direction.one_sided:
            sides: tuple[float, ...] = (1.0,)
        else:
            sides = (float(np.sign(z[k])),) if abs(z[k]) > REMARKABLE else (1.0, -1.0)
        probes = [probe_values(direction.effect, side, direction.strength) for side in sides]
        gains[k] = max(gain(uniform(direction.effect.edit(tables, values, log))) for values in probes)
    return gains
