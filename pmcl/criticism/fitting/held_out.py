"""How well a model predicts rows that a fit did not see, one step ahead."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.filtering.not_a_number import parameters_told
from pmcl.filtering.one_step_ahead import Predictions, pooled_increments
from pmcl.filtering.particle_filter import make_rng, run_filter
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.formula import portable
from pmcl.models.robot_model import BoundModel, RobotModel

__all__ = ["Gap", "RowScores", "bound_to_other", "gap_of", "row_scores"]

Float = NDArray[np.float64]


class Gap(NamedTuple):
    """How well a model predicts held-out data.

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


class RowScores(NamedTuple):
    """Log predictive densities of the rows of a log.

    Attributes
    ----------
    rows : ndarray, shape (T,)
        Log scores [nat].
    noise : float
        Standard deviation that their sum has because particles are random [nat]; NaN from a single pass, which cannot
        tell.
    """

    rows: Float
    noise: float


def row_scores(
    bound: BoundModel,
    theta: Float,
    *,
    particles: int,
    seed: int,
    passes: int = 2,
    others: Sequence[RobotLog] = (),
) -> RowScores:
    """Return the log predictive density of the readings of each row, mixed from independent filter passes.

    The filter runs over the whole log and predicts each row from all rows before it. The caller decides which rows are
    summed as held-out. The log of an estimate lies below the log of the density by half of its variance, on average:
    use some thousand particles. Densities are averaged, not their logs: one pass that misses what is read at some row
    would otherwise take more from a model than all other rows give.

    Parameters
    ----------
    bound : BoundModel
        The model bound to one log.
    theta : ndarray, shape (d,)
        Its parameters.
    particles : int
        Particles of each pass.
    seed : int
        Determines all random numbers.
    passes : int
        Number of passes.
    others : sequence of RobotLog
        Further logs of the robot; their rows follow those of the first one.

    Returns
    -------
    RowScores
        The noise is that of rows which are independent of each other, from the differences of the passes.

    Raises
    ------
    FilterError
        When the filter loses the robot entirely.
    DensityError
        When a density is not a number.
    """
    rows, variance = [], 0.0
    for number, each in enumerate((bound, *(bound_to_other(bound.model, log) for log in others))):
        tables, n_steps = each.tables(theta)[0], each.lengths[0]
        with parameters_told(each, theta):
            increments = [
                run_filter(tables, n_steps, particles, make_rng(_stream(seed, k, number))).log_increments
                for k in range(passes)
            ]
        rows.append(pooled_increments(increments))
        variance += float(np.var(increments, axis=0, ddof=1).sum() / passes) if passes > 1 else float("nan")
    return RowScores(np.concatenate(rows), math.sqrt(variance))


def _stream(seed: int, k: int, number: int) -> np.random.SeedSequence:
    return np.random.SeedSequence((seed, k, number) if number else (seed, k))


def bound_to_other(model: RobotModel, log: RobotLog) -> BoundModel:
    """Return a model bound to another log than the one on which its formulas were found.

    Parameters
    ----------
    model : RobotModel
        The model.
    log : RobotLog
        The other log; with an estimate of its path if the model has formulas that need one.
    """
    return replace(model, effects=tuple(portable(effect) for effect in model.effects)).bind(log)


def gap_of(predictions: Predictions, pit: Float, rows: slice) -> Gap:
    """Return how well some rows of a log are predicted.

    Parameters
    ----------
    predictions : Predictions
        One-step-ahead predictions of N readings.
    pit : ndarray, shape (N,)
        Their probability integral transforms; NaN where a sensor has no distribution function.
    rows : slice
        The rows that count.
    """
    start, stop, _ = rows.indices(int(predictions.time.max()) + 1)
    selected = (predictions.time >= start) & (predictions.time < stop)
    with_pit = selected & ~np.isnan(pit)
    distances = [
        _distance_from_uniform(pit[with_pit & (predictions.kind == kind)])
        for kind in np.unique(predictions.kind[with_pit])
    ]
    u = pit[with_pit]
    return Gap(
        float(predictions.log_score[selected].mean()) if selected.any() else float("nan"),
        float(np.mean(distances)) if distances else float("nan"),
        float(np.mean((u > 0.05) & (u < 0.95))) if u.size else float("nan"),
    )


def _distance_from_uniform(u: Float) -> float:
    ordered, n = np.sort(u), u.size
    steps = np.arange(n + 1) / n
    return float(max((steps[1:] - ordered).max(), (ordered - steps[:-1]).max()))
