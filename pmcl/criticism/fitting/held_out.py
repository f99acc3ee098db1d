"""How well a model predicts rows that a fit did not see, one step ahead."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from pmcl.criticism.fitting.quick_fit import BRIEF, Fit, quick_fit
from pmcl.filtering.guided_filter import GuidedFilter
from pmcl.filtering.not_a_number import parameters_told
from pmcl.filtering.one_step_ahead import Predictions, predict_by_passes
from pmcl.filtering.particle_filter import make_rng
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.formula import portable
from pmcl.models.robot_model import BoundModel, RobotModel

__all__ = [
    "HELD_OUT_SHARE", "PARTICLES", "Gap", "HeldOut", "RowScores", "bound_to_other", "gap_of", "held_out", "mixed_rows",
    "noise_of_rows", "predicted_log", "row_scores",
]  # fmt: skip

Float = NDArray[np.float64]

HELD_OUT_SHARE = 0.4
"""Share of the rows, the last ones, on which gaps are shown; parameters are then fitted to the others only."""

PARTICLES = 200
"""Particles of a row in passes that score a log. Two passes have a noise of one to two nats where sonars read some
hundred rows between walls, and of half a nat in a field of landmarks."""


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
        Standard deviation that their sum has because particles are random [nat], to first order; NaN from a single
        pass, which cannot tell.
    of_passes : ndarray, shape (K, T)
        The same of each pass.
    """

    rows: Float
    noise: float
    of_passes: Float


def row_scores(
    bound: BoundModel, theta: Float, paths: Sequence[Float], *, seed: int, passes: int = 4
) -> RowScores:
    """Return log scores of the rows, which sum to the log evidence, from passes of a filter that a path guides.

    Densities are averaged, not their logs: one pass that misses what is read at some row would otherwise take more from
    a model than all other rows give.

    Parameters
    ----------
    bound : BoundModel
        The model bound to one log.
    theta : ndarray, shape (d,)
        Its parameters.
    paths : sequence of ndarray, shape (T, D)
        Paths that explain the log under these parameters, or nearly do; the best of them counts.
    seed : int
        Determines all random numbers.
    passes : int
        Number of passes.

    Returns
    -------
    RowScores
        The noise is that of rows which are independent of each other, from the differences of the passes.

    See Also
    --------
    pmcl.filtering.guided_filter.GuidedFilter : What the score of a row is.

    Raises
    ------
    FilterError
        When the path is impossible, or every particle that it leads to.
    DensityError
        When a density is not a number.
    """
    with parameters_told(bound, theta):
        increments = GuidedFilter(bound, theta, *paths).log_scores(PARTICLES, passes, seed)
    return RowScores(mixed_rows(increments), noise_of_rows(increments), increments)


def mixed_rows(increments: Float) -> Float:
    """Return the logs of the mean densities of the rows, (T,), from those of each pass, (K, T) [nat]."""
    return np.asarray(special.logsumexp(increments, axis=0) - np.log(increments.shape[0]))


def noise_of_rows(increments: Float) -> float:
    """Return the noise of a mixture of passes, from how much they differ row by row.

    Parameters
    ----------
    increments : ndarray, shape (K, T)
        Log scores of the rows by each pass [nat].

    Returns
    -------
    float
        Standard deviation of the sum of the mixture's log scores, to first order and as if rows were independent of
        each other [nat]; NaN from a single pass.
    """
    passes = increments.shape[0]
    if passes == 1:
        return float("nan")
    # Of densities, not of their logs: the mean of densities hardly depends on a pass that misses what is read.
    relative = np.exp(increments - special.logsumexp(increments, axis=0)) * passes
    return float(np.sqrt(np.var(relative, axis=0, ddof=1).sum() / passes))


class HeldOut(NamedTuple):
    """How well a model predicts the last part of a log, when its parameters are fitted to the first part.

    Attributes
    ----------
    gap : Gap
        How well it predicts the held-out readings.
    rows : ndarray, shape (H,)
        Log scores of the held-out rows [nat].
    """

    gap: Gap
    rows: Float


def held_out(fit: Fit, split: int, *, particles: int, seed: int) -> HeldOut:
    """Fit a model to the first part of a log, and let it predict the rest.

    Parameters
    ----------
    fit : Fit
        A fit of the model to the whole log, from which this one starts.
    split : int
        First row of the held-out part.
    particles : int
        Particles of each pass of the filter.
    seed : int
        Determines all random numbers.

    Raises
    ------
    FilterError
        When the filter loses the robot entirely.
    """
    bound = fit.bound
    part = quick_fit(
        bound.restricted(split), seed, theta=fit.theta, path=fit.path[:split], draws=fit.draws, effort=BRIEF
    )
    return _predicted(bound, part.theta, split, particles, seed)


def predicted_log(fit: Fit, log: RobotLog, *, particles: int, seed: int) -> HeldOut:
    """Let a fitted model predict another log of the robot.

    Parameters
    ----------
    fit : Fit
        A fit of the model.
    log : RobotLog
        The other log; with an estimate of its path if the model has formulas that need one.
    particles : int
        Particles of each pass of the filter.
    seed : int
        Determines all random numbers.

    Raises
    ------
    FilterError
        When the filter loses the robot entirely.
    """
    return _predicted(bound_to_other(fit.bound.model, log), fit.theta, 0, particles, seed)


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


def _predicted(bound: BoundModel, theta: Float, first: int, particles: int, seed: int) -> HeldOut:
    """Predict the rows of a log from one on."""
    rng = make_rng(np.random.SeedSequence(seed))
    with parameters_told(bound, theta):
        predictions = predict_by_passes(bound.tables(theta)[0], bound.lengths[0], particles, rng)
    rows = np.zeros(bound.lengths[0])
    np.add.at(rows, predictions.time, predictions.log_score)
    return HeldOut(gap_of(predictions, predictions.pit(rng), slice(first, None)), rows[first:])


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
