"""How far to temper the readings of a sensor whose errors are shared, by what a filter foresees of held-out rows.

Some sensors, such as a lidar, multiply the log density of each reading by an exponent, because readings of one time
err together. The exponent is no parameter of a density, so it has no posterior. Here it is chosen as the learning rate
of a generalised posterior is (Grünwald 2012), by the readings that come next. The model is calibrated with each
exponent on the first rows of each log. A filter with the posterior mean then foresees the readings of each later row
from the rows before it. The score of a reading is its own log density, untempered, averaged over the filter's belief
before that row, so that the scores of different exponents can be compared. A filter that trusts a scan too much is
surprised by the next one, and one that trusts it too little foresees little.

References
----------
P. Grünwald. The safe Bayesian. Algorithmic Learning Theory, 2012.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.calibration.particle_gibbs import ParticleGibbs
from pmcl.checks import check_seed
from pmcl.errors import FilterError, ModelError, SamplingError
from pmcl.filtering.estimated_path import with_estimated_path
from pmcl.filtering.one_step_ahead import predict_readings
from pmcl.filtering.paired_scores import block_sums
from pmcl.filtering.particle_filter import make_rng
from pmcl.logs.robot_log import RobotLog
from pmcl.models.robot_model import BoundModel, RobotModel, default_model, log_sequence
from pmcl.models.sensor import Sensor
from pmcl.posterior.convert import to_arviz
from pmcl.posterior.estimates import posterior_mean
from pmcl.sampling.options import RunOptions

__all__ = ["EXPONENTS", "Tempering", "held_out_exponent", "is_tempered", "with_exponent"]

Float = NDArray[np.float64]

EXPONENTS = tuple(0.5**k for k in range(8))
"""Exponents that are tried. The last makes a scan of 128 beams worth one of them; a finer grid would tell differences
that are within the errors of the scores."""

# Rows of each log that the model is calibrated on; the others are foreseen.
_FIT_SHARE = 0.6
# Rows that are foreseen must be at least so many, or a standard error of the score means nothing.
_LEAST_ROWS = 8
# A posterior mean is wanted, no posterior: its Monte Carlo error is then a tenth of the posterior's width.
_DRAWS, _CHAINS = 200, 2
# Filters of so many particles, as many times. On the recorded robot Jarvis the mean score of a reading differs by
# 0.005 nat between seeds of such a filter.
_PARTICLES, _PASSES = 2000, 2


class Tempering(NamedTuple):
    """How well a filter foresees readings with each exponent.

    Attributes
    ----------
    exponents : ndarray, shape (K,)
        Exponents that were tried, the greatest first.
    log_score : ndarray, shape (K,)
        Mean log predictive density of the held-out readings [nat]; minus infinity where the filter lost the robot.
    behind : ndarray, shape (K,)
        By how much each is behind the best [nat].
    behind_error : ndarray, shape (K,)
        Standard errors of that [nat], from sums over blocks of rows.
    chosen : float
        The least exponent that is not behind the best by more than one standard error: of two that foresee equally
        well, the smaller claims less (the one-standard-error rule of Breiman, Friedman, Olshen and Stone, 1984).
    readings : int
        Number of readings that were foreseen.
    """

    exponents: Float
    log_score: Float
    behind: Float
    behind_error: Float
    chosen: float
    readings: int


def is_tempered(model: RobotModel) -> bool:
    """Return whether a sensor of the model has an exponent."""
    return any(isinstance(sensor, Sensor) and sensor.with_exponent(1.0) is not None for sensor in model.sensors)


def with_exponent(model: RobotModel, exponent: float) -> RobotModel:
    """Return the model with another exponent in all sensors that have one.

    Parameters
    ----------
    model : RobotModel
        The model.
    exponent : float
        Exponent of the density of each reading, in (0, 1].

    Returns
    -------
    RobotModel
    """
    sensors = tuple(
        (sensor.with_exponent(exponent) if isinstance(sensor, Sensor) else None) or sensor for sensor in model.sensors
    )
    return dataclasses.replace(model, sensors=sensors)


def held_out_exponent(
    logs: RobotLog | Sequence[RobotLog],
    model: RobotModel | None = None,
    *,
    seed: int = 0,
    report: Callable[[str], None] = lambda message: None,
) -> Tempering:
    """Choose the exponent of tempered readings by how well a filter foresees rows that the fit did not see.

    Parameters
    ----------
    logs : RobotLog or sequence of RobotLog
        One or several logs of the same robot; of each the last two fifths of the rows are held out.
    model : RobotModel, optional
        The default model of the first log when left out.
    seed : int
        All randomness follows from it.
    report : callable
        Takes a line of progress.

    Returns
    -------
    Tempering
        Cost: a short calibration of each of :data:`EXPONENTS`, and some filters.

    Raises
    ------
    ModelError
        When no sensor of the model has an exponent, or a log has too few rows.
    SamplingError, FilterError
        When no chain can start, or the filter loses the robot with each exponent.
    """
    logs = log_sequence(logs)
    seed = check_seed(seed, error=SamplingError)
    model = default_model(logs[0]) if model is None else model
    if not is_tempered(model):
        raise ModelError(
            f"{logs[0].where}: expected a model with a sensor whose readings are tempered, such as a lidar, but this "
            "one has none; leave the tempering as it is"
        )
    splits = [int(_FIT_SHARE * log.n_steps) for log in logs]
    for log, split in zip(logs, splits, strict=True):
        if log.n_steps - split < _LEAST_ROWS:
            raise ModelError(
                f"{log.where}: expected at least {round(_LEAST_ROWS / (1.0 - _FIT_SHARE))} rows, of which some can be "
                f"held out to choose an exponent, but got {log.n_steps}; use a longer log, or fix the exponent"
            )
    fitted = [log.select(0, split) for log, split in zip(logs, splits, strict=True)]
    scores = []
    for number, exponent in enumerate(EXPONENTS):
        report(f"exponent {exponent:.3g} ({number + 1} of {len(EXPONENTS)})")
        tempered = with_exponent(model, exponent)
        theta = posterior_mean(_short_calibration(tempered, fitted, seed))
        scores.append([
            _row_scores(tempered.bind(with_estimated_path(log, tempered, theta, ahead=True, seed=seed)), theta, split,
                        seed)
            for log, split in zip(logs, splits, strict=True)
        ])  # fmt: skip
    return _compared(np.array(EXPONENTS), scores)


def _short_calibration(model: RobotModel, logs: Sequence[RobotLog], seed: int) -> object:
    bound = model.bind([with_estimated_path(log, model, seed=seed) for log in logs])
    options = RunOptions(draws=_DRAWS, chains=_CHAINS, seed=seed, trajectories=1)
    return to_arviz(ParticleGibbs().run(bound, options), bound.parameters, bound.logs)


def _row_scores(bound: BoundModel, theta: dict[str, float], split: int, seed: int) -> tuple[Float, int]:
    """Return the summed scores of the readings of each held-out row, and how many readings there are."""
    tables = bound.tables(np.array([theta[name] for name in bound.names]))[0]
    n_steps, total, count = bound.lengths[0], np.zeros(bound.lengths[0] - split), 0
    for k in range(_PASSES):
        rng = make_rng(np.random.SeedSequence((seed, 41, k)))
        try:
            found = predict_readings(tables, n_steps, _PARTICLES, rng, alone=True)
        except FilterError:
            return np.full(total.size, -np.inf), 0
        later = found.time >= split
        total += np.bincount(found.time[later] - split, found.log_score[later], total.size) / _PASSES
        count = int(later.sum())
    return total, count


def _compared(exponents: Float, scores: list[list[tuple[Float, int]]]) -> Tempering:
    """Compare exponents by their scores: for each of them and each log, of the held-out rows."""
    readings = max(sum(count for _, count in of_logs) for of_logs in scores)
    totals = np.array([sum(float(rows.sum()) for rows, _ in of_logs) for of_logs in scores])
    if not np.isfinite(totals).any():
        raise FilterError(
            "expected a filter that follows the robot with some exponent, but it lost it with each; look at the log "
            "with 'pmcl report', or start it where the robot is known"
        )
    best = int(np.argmax(totals))
    errors = np.zeros(totals.size)
    for k, of_logs in enumerate(scores):
        if k == best or not np.isfinite(totals[k]):
            continue
        differences = [new - old for (new, _), (old, _) in zip(of_logs, scores[best], strict=True)]
        sums = np.concatenate([block_sums(rows) for rows in differences])
        errors[k] = np.sqrt(sums.size) * sums.std(ddof=1)
    behind = totals[best] - totals
    chosen = exponents[behind <= errors].min()
    per_reading = 1.0 / max(readings, 1)
    return Tempering(
        exponents, totals * per_reading, behind * per_reading, errors * per_reading, float(chosen), readings
    )
