"""Lower bounds of the evidence of candidate effects, from trajectories that were drawn without them.

A score is a slope at "no effect". It tells little about a large effect: a beam that points elsewhere reads another
wall, and no slope leads there. But the density of the log along trajectories can be compared at any size of an effect.
By Jensen's inequality the log evidence of an effect of that size, over none, is at least the mean change of the log
density of trajectory and readings, over trajectories drawn given all readings without the effect.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.criticism.scoring.scores import ChangedDensity, inside_priors, probe_values
from pmcl.errors import DensityError, PmclError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.models.tables import Tables

__all__ = ["LowerBound", "lower_bounds"]

Float = NDArray[np.float64]

# The sizes, as shares of a clear effect: from just visible to larger than large. The prior is spread evenly over them.
_SIZES = (0.5, 1.0, 2.0, 4.0)
# Trajectories over which changes are averaged. They differ by some nats, and bounds matter that are far above that.
_PATHS = 5


class LowerBound(NamedTuple):
    """A lower bound of the evidence of one effect.

    Attributes
    ----------
    evidence : float
        The bound of the log evidence over no effect [nat]; it may be far below zero.
    values : ndarray, shape (k,)
        The values of the effect's parameters that have it.
    """

    evidence: float
    values: Float


def lower_bounds(tables: Tables, log: RobotLog, columns: Float, effects: Iterable[Effect]) -> list[LowerBound]:
    """Return lower bounds of the evidence of candidates.

    The strengths of an effect that has several are set one after the other.

    Parameters
    ----------
    tables : Tables
        Coefficient tables of the current model.
    log : RobotLog
        The log that they belong to.
    columns : ndarray, shape (M, D, T)
        Trajectories drawn given all readings; the first five are used.
    effects : iterable of Effect
        The candidates.

    Returns
    -------
    list of LowerBound
        In the order of the candidates. A row counts at most 50 nats for or against an effect, as it does for scores:
        the path would give way there. Cost at T=600, 8 beams, 80 candidates: 0.2 s.

    Raises
    ------
    DensityError
        When a density is not a number.
    """
    change = ChangedDensity(tables, log, columns[:_PATHS])
    return [_lower_bound(effect, change) for effect in effects]


def _lower_bound(effect: Effect, change: ChangedDensity) -> LowerBound:
    """Return the greatest bound of one effect at the sizes that are tried."""
    values, best = np.array(effect.null, dtype=float), 0.0
    for number, strength in enumerate(effect.strengths):
        two_sided = not (effect.squared or effect.one_sided(strength))
        tried = []
        for size in (*_SIZES, *(-size for size in _SIZES if two_sided)):
            other = values.copy()
            other[strength] = probe_values(effect, size, strength)[strength]
            other = inside_priors(effect, other)
            tried.append((_total(change, effect, other), other))
        greatest, at = max(tried, key=lambda one: one[0])
        # The first strength needs no gain of its own: an effect is there only if one of them is.
        if number == 0 or greatest > best:
            best, values = greatest, at
    return LowerBound(best - math.log(len(_SIZES)), values)


def _total(change: ChangedDensity, effect: Effect, values: Float) -> float:
    """Return the change of the log density of all rows; -inf where the effect cannot be so large."""
    try:
        return float(change(effect, values).sum())
    except DensityError:
        raise
    except PmclError:
        return -math.inf
