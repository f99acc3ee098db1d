"""The stages of a run: include the data, tune, draw.

Within a stage every setting is frozen but the Metropolis steps and one scale, which travel in the blob. What a
stage needs beyond that (the linearisation, the proposal's shape, restarted chains) is a pure function of the stored
chain of the stage before, see :mod:`pmcl.sampling.tuning`. So a chain can be resumed at any step and goes on exactly as
if it had not been stopped.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from pmcl.sampling.sweep import SweepSettings

__all__ = ["BURN_IN_SHARE", "INCLUSION_SHARE", "Stage", "hurried_rate"]

# A run of limited time has all data included after the first share of it, and begins to draw after the second. Burn-in
# that is done sooner leaves more time to draw. Half for burn-in is where neither part starves the other.
INCLUSION_SHARE, BURN_IN_SHARE = 0.2, 0.5
# Of the time for inclusion, so many sweeps over all rows are set aside: the first linearisation is made from them.
_SETTLING_SWEEPS = 4


class Stage(NamedTuple):
    """One emcee run with frozen settings.

    Attributes
    ----------
    name : str
        Group name in the checkpoint file.
    steps : int
        emcee steps.
    settings : SweepSettings
        Settings of each step's sweeps.
    keep_every : int
        Every how many steps a trajectory is kept; 0: none is.
    window : int
        Steps at the end of the stage from which the next one is tuned.
    restart_lost : bool
        Whether chains that lie far below the others are restarted from the best one when the stage ends.
    time_share : float
        In a run of limited time, the share of the time after which the stage ends.
    """

    name: str
    steps: int
    settings: SweepSettings
    keep_every: int
    window: int
    restart_lost: bool
    time_share: float = 1.0


def hurried_rate(rate: int, rows: int, longest: int, pace: float, left: float) -> int:
    """Return how many rows each sweep has to include so that all are included in the time that is left.

    Parameters
    ----------
    rate : int
        The planned rate; never less is returned.
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
