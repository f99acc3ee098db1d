"""One scored pass over a log: predictions, residuals, scores, and the numbers that alarms are computed from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.criticism.scoring.covariates import RowCovariates, reading_covariates, row_covariates
from pmcl.criticism.scoring.features import Feature, fluctuation_features, residual_features
from pmcl.criticism.scoring.scores import Direction, effect_scores, parameter_scores
from pmcl.criticism.scoring.statistics import Statistic, residuals_of, statistic_features
from pmcl.engine.contract import reading_exponent
from pmcl.filtering.not_a_number import parameters_told
from pmcl.filtering.one_step_ahead import Predictions, predict_by_passes
from pmcl.filtering.particle_filter import draw_paths_beside, make_rng
from pmcl.models.robot_model import BoundModel

__all__ = ["ScoredLog", "Source", "rescored", "score_log"]

Float = NDArray[np.float64]


class Source(NamedTuple):
    """What is needed to score further candidates along the same trajectories.

    Attributes
    ----------
    bound : BoundModel
        The model bound to the log.
    theta : ndarray, shape (d,)
        Its parameters.
    columns : ndarray, shape (M, D, T)
        Trajectories drawn given all readings.
    residual_features : tuple of Feature
        Features of the residuals, which do not depend on candidates.
    """

    bound: BoundModel
    theta: Float
    columns: Float
    residual_features: tuple[Feature, ...]


@dataclass(frozen=True)
class ScoredLog:
    """A log scored under a model with one theta.

    Attributes
    ----------
    predictions : Predictions
        Log scores and distribution functions of all N readings.
    pit : ndarray, shape (N,)
        Their probability integral transforms.
    path : ndarray, shape (T, D)
        Mean of the drawn trajectories.
    row_covariates : RowCovariates
        Covariates of the rows.
    reading_covariates : dict of str to ndarray, shape (N,)
        Covariates of the readings.
    parameter_scores : ndarray, shape (d, T)
        Score of each parameter of the model, row by row.
    scores : ndarray, shape (K, T)
        Score of each candidate direction, row by row.
    features : tuple of Feature
        Meaning of each residual number, then of each fluctuation.
    residual_blocks : ndarray, shape (R, B)
        The R residual numbers as sums over blocks of rows.
    fluctuations : ndarray, shape (F,)
        The F fluctuations.
    source : Source
        What further candidates are scored from.
    """

    predictions: Predictions
    pit: Float
    path: Float
    row_covariates: RowCovariates
    reading_covariates: dict[str, Float]
    parameter_scores: Float
    scores: Float
    features: tuple[Feature, ...]
    residual_blocks: Float
    fluctuations: Float
    source: Source


def score_log(
    bound: BoundModel,
    theta: Float,
    directions: Sequence[Direction],
    *,
    path: Float,
    particles: int,
    paths: int,
    seed: int | np.random.SeedSequence,
    statistics: Sequence[Statistic] = (),
) -> ScoredLog:
    """Compute the residuals and scores of a log from several passes of the filter.

    Residuals come from independent passes that are mixed (:func:`pmcl.filtering.one_step_ahead.predict_by_passes`).
    Scores are means over trajectories drawn beside a given one
    (:func:`pmcl.filtering.particle_filter.draw_paths_beside`). At a row where all particles of one pass miss what was
    read, neither the residuals nor the trajectories depend on that pass alone.

    Parameters
    ----------
    bound : BoundModel
        The model bound to one log.
    theta : ndarray, shape (d,)
        Its parameters.
    directions : sequence of Direction
        Candidates to score.
    path : ndarray, shape (T, D)
        A trajectory drawn given all readings, headings not wrapped.
    particles : int
        Particles n of each pass.
    paths : int
        Number of trajectories over which scores are averaged.
    seed : int or SeedSequence
        Determines all random numbers.
    statistics : sequence of Statistic
        Statistics of the user's own.

    Returns
    -------
    ScoredLog
        Cost at T=600, 8 beams, n=500, 15 paths, 50 candidates: 0.1 to 0.2 s.

    Raises
    ------
    FilterError
        When the filter loses the robot entirely.
    DensityError
        When a density is not a number.
    CriticismError
        When a statistic returns something else than numbers.
    """
    log, tables = bound.logs[0], bound.tables(theta)[0]
    rng = make_rng(seed)
    with parameters_told(bound, theta):
        predictions = predict_by_passes(tables, bound.lengths[0], particles, rng)
        drawn = draw_paths_beside(tables, path, particles, paths, rng)
    columns = np.ascontiguousarray(drawn.transpose(0, 2, 1))
    mean = drawn.mean(axis=0)
    of_rows = row_covariates(log, mean)
    of_readings = reading_covariates(
        tables, mean, predictions.sensor, predictions.channel, predictions.time, predictions.kind
    )
    pit = predictions.pit(rng)
    tempered = [number for number, sensor in enumerate(tables.sensors) if reading_exponent(sensor) != 1.0]
    features, blocks = residual_features(predictions, pit, of_readings, of_rows, tempered)
    if statistics:
        own, its_blocks = statistic_features(statistics, residuals_of(predictions, pit, of_readings, of_rows))
        features, blocks = [*features, *own], np.concatenate([blocks, its_blocks])
    no_scores = np.empty((0, bound.lengths[0]))
    without_candidates = ScoredLog(
        predictions, pit, mean, of_rows, of_readings, parameter_scores(bound, theta, columns), no_scores, (),
        blocks, np.empty(0), Source(bound, theta, columns, tuple(features)),
    )  # fmt: skip
    return rescored(without_candidates, directions)


def rescored(scored: ScoredLog, directions: Sequence[Direction]) -> ScoredLog:
    """Score other candidates along the trajectories of a scored log.

    Parameters
    ----------
    scored : ScoredLog
        The log.
    directions : sequence of Direction
        The candidates.

    Returns
    -------
    ScoredLog
        A copy with other scores and the features computed from them.
    """
    bound, theta, columns, features = scored.source
    scores = effect_scores(bound.tables(theta)[0], bound.logs[0], columns, directions)
    ordered = [k for k, direction in enumerate(directions) if not direction.one_sided and not direction.effect.where]
    labels = [*bound.names, *(_label(directions[k]) for k in ordered)]
    fluctuations, values = fluctuation_features(
        labels, np.concatenate([scored.parameter_scores, scores[ordered]]), scored.row_covariates
    )
    return replace(scored, scores=scores, features=(*features, *fluctuations), fluctuations=values)


def _label(direction: Direction) -> str:
    return direction.effect.parameters[direction.strength].name
