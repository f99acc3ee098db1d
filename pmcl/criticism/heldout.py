"""What a model is worth on data that its fit did not see: one-step-ahead log scores, compared row by row."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.filtering.one_step_ahead import Predictions
from pmcl.filtering.particle_filter import make_rng, run_filter
from pmcl.models.robot_model import BoundModel

__all__ = ["Gain", "Gap", "block_sums", "gap_of", "paired_gain", "row_scores"]

Float = NDArray[np.float64]

_BLOCK = 15


class Gain(NamedTuple):
    """Difference of two models' log scores [nat], with its standard error."""

    total: float
    se: float

    @property
    def significant(self) -> bool:
        """Whether it exceeds two standard errors."""
        return self.total > 2.0 * self.se


class Gap(NamedTuple):
    """How far a model is from held-out data.

    Attributes
    ----------
    log_score_per_reading : float
        Mean log predictive density [nat], one step ahead.
    pit_distance : float
        Greatest difference between the PITs' distribution and the uniform one, averaged over kinds of readings.
    coverage_90 : float
        Share of readings within their 90 % prediction interval.
    """

    log_score_per_reading: float
    pit_distance: float
    coverage_90: float


def row_scores(bound: BoundModel, theta: Float, *, particles: int, seed: int, passes: int = 2) -> Float:
    """Return the log predictive density of the readings of each row, (T,): mean over independent passes.

    The filter runs over the whole log, and each row is foreseen from all rows before it; what a fit did not see is
    decided by which rows are summed. A sum of logs of estimates lies below the truth, by half their variance: use some
    thousand particles.

    Raises
    ------
    FilterError
        When the filter loses the robot entirely.
    """
    tables, n_steps = bound.tables(theta)[0], bound.lengths[0]
    made = [
        run_filter(tables, n_steps, particles, make_rng(np.random.SeedSequence((seed, k)))).log_increments
        for k in range(passes)
    ]
    return np.asarray(np.mean(made, axis=0))


def paired_gain(new: Float, old: Float, rows: slice) -> Gain:
    """Compare two models on some rows; the standard error is that of a bootstrap of blocks of 15 rows.

    Parameters
    ----------
    new, old : ndarray, shape (T,)
        Row scores of the two models.
    rows : slice
        Rows to count.
    """
    difference = (new - old)[rows]
    sums = block_sums(difference)
    # Resampling blocks of equal weight has this standard error; there is no need to do it.
    return Gain(float(difference.sum()), float(np.sqrt(sums.size) * sums.std(ddof=1)))


def block_sums(rows: Float) -> Float:
    """Return the sums over blocks of 15 rows, at least two: so far apart rows are nearly independent."""
    count = max(2, rows.size // _BLOCK)
    return np.array([block.sum() for block in np.array_split(rows, count)])


def gap_of(made: Predictions, pit: Float, rows: slice) -> Gap:
    """Return the gap over some rows of a pass."""
    start, stop, _ = rows.indices(int(made.time.max()) + 1)
    mine = (made.time >= start) & (made.time < stop)
    inside = mine & ~np.isnan(pit)
    distances = [
        _distance(pit[inside & (made.kind == kind)]) for kind in np.unique(made.kind[inside])
    ]
    u = pit[inside]
    return Gap(
        float(made.log_score[mine].mean()) if mine.any() else float("nan"),
        float(np.mean(distances)) if distances else float("nan"),
        float(np.mean((u > 0.05) & (u < 0.95))) if u.size else float("nan"),
    )


def _distance(u: Float) -> float:
    ordered, n = np.sort(u), u.size
    steps = np.arange(n + 1) / n
    return float(max((steps[1:] - ordered).max(), (ordered - steps[:-1]).max()))
