"""Whether a calibrated model fits its own log: the check that ends every calibration.

A filter with the posterior mean predicts each reading from all readings before it. When the model is right, the
probability integral transforms of the readings are independent and uniform. When it is not, they show what disagrees:
errors that last, a wrong spread, a biased channel. Convergence of the chains shows none of this. Beams of a scan share
their errors and are judged together (:mod:`pmcl.posterior.shared_errors`).

References
----------
Diebold, Gunther, Tay, Evaluating density forecasts, International Economic Review 39(4), 1998.
Westfall, Young, Resampling-based multiple testing, Wiley 1993: the joint test of all statistics.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from pmcl.engine.contract import reading_exponent
from pmcl.errors import FilterError
from pmcl.filtering.lost import lost_at
from pmcl.filtering.one_step_ahead import Predictions, predict_readings
from pmcl.filtering.particle_filter import make_rng
from pmcl.logs.robot_log import RobotLog
from pmcl.models.robot_model import BoundModel
from pmcl.models.tables import Tables
from pmcl.posterior.findings import Finding, lost_finding, named_finding
from pmcl.posterior.score_statistics import ScoreSeries, Statistic, score_statistics
from pmcl.posterior.shared_errors import sectors_of

__all__ = ["LEVEL", "ModelCheck", "ScoredPass", "check_model"]

Float = NDArray[np.float64]

LEVEL = 0.01
"""Rate at which the check wrongly objects to a correct model, all statistics and logs considered."""

# Simulated score series; the smallest p-value is one over this number plus one.
_SIMULATIONS = 499
# A shorter series is not tested.
_LEAST_READINGS = 30
# The predictions of a filter with few effective particles are too narrow. Particles are added until 95 % of the rows
# with readings have this many effective ones, from the first to the second of these limits.
_EFFECTIVE_PARTICLES = 50.0
_PARTICLES = (1000, 16000)
# A long log gets fewer particles, but never less than the first limit, so that a pass takes a few seconds: 1.2 s for
# eight beams (2.5 GHz Xeon).
_MOST_PARTICLE_ROWS = 10_000_000
# A filter that loses the robot is run again with this many times the particles.
_SECOND_CHANCE = 4


class ScoredPass(NamedTuple):
    """Predictions of a filter for one log.

    Attributes
    ----------
    predictions : Predictions or None
        Of N readings; None where every particle had weight zero.
    scores : ndarray, shape (N,)
        Normal scores of their probability integral transforms; NaN for a sensor without a distribution function.
    particles : int
        Particles of the filter.
    """

    predictions: Predictions | None
    scores: Float
    particles: int


class ModelCheck(NamedTuple):
    """The result of a model check.

    Attributes
    ----------
    adequate : bool or None
        Whether no statistic deviates at the level :data:`LEVEL`; None when nothing could be tested because there are
        too few readings, or sensors have no distribution function.
    findings : tuple of Finding
        The deviations, most serious first.
    p_value : float
        Probability of a greatest deviation like the one found when the model is right; NaN when not judged.
    passes : tuple of ScoredPass
        Predictions of the filter for each log.
    """

    adequate: bool | None
    findings: tuple[Finding, ...]
    p_value: float
    passes: tuple[ScoredPass, ...]


def check_model(bound: BoundModel, theta: Float, seed: int = 0) -> ModelCheck:
    """Check a model on the logs to which it is bound.

    Parameters
    ----------
    bound : BoundModel
        The model bound to L logs.
    theta : ndarray, shape (d,)
        Its parameters, usually the posterior mean. That they were estimated from the same logs makes the check a little
        conservative: what the parameters can absorb has been absorbed.
    seed : int
        Determines all random numbers.

    Returns
    -------
    ModelCheck
        Cost: one to three passes of a filter of 1000 to 16000 particles for each log, 0.3 to 2 s for 1500 rows.

    Raises
    ------
    DensityError
        When a density is not a number.
    """
    passes: list[ScoredPass] = []
    lost: list[Finding] = []
    judged: list[_Judged] = []
    for number, (log, tables, n_steps) in enumerate(zip(bound.logs, bound.tables(theta), bound.lengths, strict=True)):
        # One stream of random numbers for the filter, one for the randomised transforms, one for the simulated scores.
        for_filter, for_pit, for_scores = np.random.SeedSequence((seed, number)).spawn(3)
        predictions, n_particles, lost_row = _healthy_pass(tables, n_steps, for_filter)
        normal = np.empty(0) if predictions is None else special.ndtri(predictions.pit(make_rng(for_pit)))
        passes.append(ScoredPass(predictions, normal, n_particles))
        if lost_row is not None:
            lost.append(lost_finding(number, float(log.times[lost_row])))
        elif predictions is not None:
            rng = np.random.default_rng(for_scores)
            exponents = [float(reading_exponent(sensor)) for sensor in tables.sensors]
            for series in _series(predictions, normal, log.times, exponents):
                judged.append(_Judged(number, series, *score_statistics(series, _SIMULATIONS, rng)))
    findings, p_value = _deviations(judged, bound.logs) if judged else ((), np.nan)
    everything = (*lost, *findings)
    if not judged and not lost:
        return ModelCheck(None, (), np.nan, tuple(passes))
    return ModelCheck(not everything, everything, 0.0 if lost else p_value, tuple(passes))


class _HealthyPass(NamedTuple):
    """Predictions by enough particles, the number of particles, and the row at which the robot is lost, or None."""

    predictions: Predictions | None
    particles: int
    lost_row: int | None


def _healthy_pass(tables: Tables, n_steps: int, seed: np.random.SeedSequence) -> _HealthyPass:
    """Run a filter, again with more particles where these are too few or lose the robot."""
    n_particles, most = _PARTICLES
    most = max(n_particles, min(most, _MOST_PARTICLE_ROWS // n_steps))
    predictions: Predictions | None = None
    lost: int | None = None
    for attempt in seed.spawn(3):
        try:
            predictions = predict_readings(tables, n_steps, n_particles, make_rng(attempt), keep_particles=False)
            lost = lost_at(predictions, n_steps)
        except FilterError as error:
            if error.row is None:
                raise
            predictions, lost = None, error.row
        if predictions is not None and lost is None:
            needed = _particles_needed(predictions, n_particles)
        else:
            needed = _SECOND_CHANCE * n_particles
        if needed <= n_particles or n_particles == most:
            break
        n_particles = min(needed, most)
    return _HealthyPass(predictions, n_particles, lost)


def _particles_needed(predictions: Predictions, n_particles: int) -> int:
    """Return the number of particles with which 95 % of the rows with readings have enough effective ones."""
    effective = float(np.quantile(predictions.filtered.effective_size[np.unique(predictions.time)], 0.05))
    return int(np.ceil(n_particles * _EFFECTIVE_PARTICLES / max(effective, 1.0)))


def _series(predictions: Predictions, normal: Float, times: Float, exponents: Sequence[float]) -> list[ScoreSeries]:
    """Return the scores of each kind of reading that has enough of them; `exponents` are those of the sensors."""
    series = []
    for number, kind in enumerate(predictions.kinds):
        selected = np.flatnonzero((predictions.kind == number) & ~np.isnan(normal))
        if selected.size < _LEAST_READINGS:
            continue
        found = ScoreSeries(kind, times[predictions.time[selected]], predictions.channel[selected], normal[selected])
        exponent = exponents[predictions.sensor[selected[0]]]
        if exponent < 1.0:
            found = ScoreSeries(kind, *sectors_of(found.time, found.channel, found.score, exponent))
        if found.score.size >= _LEAST_READINGS:
            series.append(found)
    return series


class _Judged(NamedTuple):
    """A series of scores of log number `log` with its statistics, whose values have shape (F, 1 + M)."""

    log: int
    series: ScoreSeries
    statistics: tuple[Statistic, ...]
    values: Float


class _Deviation(NamedTuple):
    """A statistic beyond its critical value; `ratio` is the statistic divided by that value."""

    ratio: float
    z: float
    p_value: float
    channel: int


def _deviations(judged: Sequence[_Judged], logs: Sequence[RobotLog]) -> tuple[tuple[Finding, ...], float]:
    """Return the deviations, most serious first, and the p-value of the greatest one.

    Every statistic is measured by the value that it exceeds in one of a hundred simulations, so that none dominates by
    a long tail. The log's own value counts among the simulated ones: log and simulations are treated alike, and the
    rank of the greatest deviation is exactly uniform when the model is right.
    """
    size = np.abs(np.concatenate([judged_series.values for judged_series in judged]))
    ratio = size / np.maximum(np.quantile(size, 1.0 - LEVEL, axis=1, keepdims=True), 1e-300)
    greatest = ratio.max(axis=0)
    own = iter(ratio[:, 0])
    found: list[tuple[float, Finding]] = []
    for judged_series in judged:
        groups: dict[str, list[_Deviation]] = {}
        for statistic, z, beyond in zip(
            judged_series.statistics, judged_series.values[:, 0], own, strict=False
        ):
            p_value = float(np.mean(greatest >= beyond))
            if p_value <= LEVEL:
                deviation = _Deviation(float(beyond), float(z), p_value, statistic.channel)
                groups.setdefault(statistic.name, []).append(deviation)
        for name, members in groups.items():
            worst = max(members)
            channels = tuple(sorted(member.channel for member in members))
            number = judged_series.log
            finding = named_finding(
                name, judged_series.series, channels, worst.z, worst.p_value, number, logs[number]
            )
            found.append((worst.ratio, finding))
    found.sort(key=lambda pair: -pair[0])
    return tuple(finding for _, finding in found), float(np.mean(greatest >= greatest[0]))
