"""Whether a calibrated model fits its own log: the check that ends every calibration.

A filter with the posterior mean foresees each reading from all before it. Where the model is right, the probability
integral transforms of the readings are independent and uniform; where it is not, they show what disagrees: errors that
last, a wrong spread, a channel that is off. That chains have converged says nothing of the kind.

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

from pmcl.errors import FilterError
from pmcl.filtering.lost import lost_at
from pmcl.filtering.particle_filter import make_rng
from pmcl.filtering.predictive import Predictions, predict_readings
from pmcl.logs.robot_log import RobotLog
from pmcl.models.robot_model import BoundModel
from pmcl.models.tables import Tables
from pmcl.posterior.score_statistics import ScoreSeries, Statistic, duration_of_errors, score_statistics

__all__ = ["LEVEL", "Finding", "ModelCheck", "ScoredPass", "check_model", "kind_label"]

Float = NDArray[np.float64]

LEVEL = 0.01
"""Rate at which the check wrongly objects to a correct model, all statistics and logs considered."""

# Simulated score series; the smallest p-value is one over this number plus one.
_SIMULATIONS = 499
# A shorter series tells nothing by itself.
_LEAST_READINGS = 30
# A filter with few effective particles is too sure of what it foresees. Particles are added until 95 % of the rows with
# readings have this many effective ones, from the first to the second of these limits.
_EFFECTIVE_PARTICLES = 50.0
_PARTICLES = (1000, 16000)
# A pass keeps 36 bytes for each particle and row: no more than some 400 MB for a long log.
_MOST_PARTICLE_ROWS = 10_000_000
# A filter that loses the robot is given another chance with this times as many particles.
_SECOND_CHANCE = 4


class Finding(NamedTuple):
    """One way in which readings and model disagree.

    Attributes
    ----------
    name : str
        "lost", or the name of a :class:`~pmcl.posterior.score_statistics.Statistic`.
    log : int
        Which log, from 0.
    kind : str
        Variable of the log, e.g. "landmark_range"; empty for "lost".
    channels : tuple of int
        Beams or landmarks of a "channel shift"; empty for all together.
    z : float
        The statistic: standard normal when the model is right, but for a longer tail of "lasting".
    p_value : float
        Probability of any deviation as great as this in any statistic when the model is right.
    seconds : float
        How long errors last, for "lasting" and "lasting together"; time at which the robot is lost, for "lost"; else 0.
    message : str
        The finding in words, without the log's number.
    """

    name: str
    log: int
    kind: str
    channels: tuple[int, ...]
    z: float
    p_value: float
    seconds: float
    message: str


class ScoredPass(NamedTuple):
    """What a filter foresaw of one log.

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
    """What the readings say of a model.

    Attributes
    ----------
    adequate : bool or None
        Whether no statistic deviates at the level :data:`LEVEL`; None when there was nothing to judge by: too few
        readings, or sensors without a distribution function.
    findings : tuple of Finding
        What deviates, most serious first.
    p_value : float
        Probability of a greatest deviation like the one found when the model is right; NaN when not judged.
    passes : tuple of ScoredPass
        What the filter foresaw, for each log.
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
        All randomness follows from it.

    Returns
    -------
    ModelCheck
        Cost: one to three passes of a filter of 1000 to 16000 particles for each log, 0.3 to 2 s for 1500 rows.

    Raises
    ------
    FilterError
        When a density is not a number.
    """
    passes: list[ScoredPass] = []
    lost: list[Finding] = []
    judged: list[_Judged] = []
    for number, (log, tables, n_steps) in enumerate(zip(bound.logs, bound.tables(theta), bound.lengths, strict=True)):
        # One stream of random numbers for the filter, one for the randomised transforms, one for the simulated scores.
        for_filter, for_pit, for_scores = np.random.SeedSequence((seed, number)).spawn(3)
        made, n_particles, row = _healthy_pass(tables, n_steps, for_filter)
        normal = np.empty(0) if made is None else special.ndtri(made.pit(make_rng(for_pit)))
        passes.append(ScoredPass(made, normal, n_particles))
        if row is not None:
            time = float(log.times[row])
            message = f"the filter loses the robot at t={time:g} s"
            lost.append(Finding("lost", number, "", (), np.inf, 0.0, time, message))
        elif made is not None:
            rng = np.random.default_rng(for_scores)
            for series in _series(made, normal, log.times):
                judged.append(_Judged(number, series, *score_statistics(series, _SIMULATIONS, rng)))
    findings, p_value = _deviations(judged, bound.logs) if judged else ((), np.nan)
    everything = (*lost, *findings)
    if not judged and not lost:
        return ModelCheck(None, (), np.nan, tuple(passes))
    return ModelCheck(not everything, everything, 0.0 if lost else p_value, tuple(passes))


def _healthy_pass(
    tables: Tables, n_steps: int, seed: np.random.SeedSequence
) -> tuple[Predictions | None, int, int | None]:
    """Return a pass with enough particles, their number, and the row at which it loses the robot, if it does."""
    n_particles, most = _PARTICLES
    most = max(n_particles, min(most, _MOST_PARTICLE_ROWS // n_steps))
    made: Predictions | None = None
    lost: int | None = None
    for attempt in seed.spawn(3):
        try:
            made = predict_readings(tables, n_steps, n_particles, make_rng(attempt)).without_particles()
            lost = lost_at(made, n_steps)
        except FilterError as error:
            if error.row is None:
                raise
            made, lost = None, error.row
        if made is not None and lost is None:
            needed = _particles_needed(made, n_particles)
        else:
            needed = _SECOND_CHANCE * n_particles
        if needed <= n_particles or n_particles == most:
            break
        n_particles = min(needed, most)
    return made, n_particles, lost


def _particles_needed(made: Predictions, n_particles: int) -> int:
    """Return how many particles give nearly all rows with readings enough effective ones."""
    effective = float(np.quantile(made.filtered.effective_size[np.unique(made.time)], 0.05))
    return int(np.ceil(n_particles * _EFFECTIVE_PARTICLES / max(effective, 1.0)))


def _series(made: Predictions, normal: Float, times: Float) -> list[ScoreSeries]:
    """Return the scores of each kind of reading that has enough of them."""
    found = []
    for number, kind in enumerate(made.kinds):
        mine = np.flatnonzero((made.kind == number) & ~np.isnan(normal))
        if mine.size >= _LEAST_READINGS:
            found.append(ScoreSeries(kind, times[made.time[mine]], made.channel[mine], normal[mine]))
    return found


class _Judged(NamedTuple):
    """A series of scores of log number `log` with its statistics, whose values have shape (F, 1 + M)."""

    log: int
    series: ScoreSeries
    statistics: tuple[Statistic, ...]
    values: Float


class _Deviation(NamedTuple):
    """A statistic beyond its critical value; `ratio` says how far beyond."""

    ratio: float
    z: float
    p_value: float
    channel: int


def _deviations(judged: Sequence[_Judged], logs: Sequence[RobotLog]) -> tuple[tuple[Finding, ...], float]:
    """Return what deviates, most serious first, and the p-value of the greatest deviation of all.

    Every statistic is measured by the value that it exceeds in one of a hundred simulations, so that none dominates by
    a long tail. The log's own value counts among the simulated ones: log and simulations are treated alike, and the
    rank of the greatest deviation is exactly uniform when the model is right.
    """
    size = np.abs(np.concatenate([one.values for one in judged]))
    ratio = size / np.maximum(np.quantile(size, 1.0 - LEVEL, axis=1, keepdims=True), 1e-300)
    greatest = ratio.max(axis=0)
    own = iter(ratio[:, 0])
    found: list[tuple[float, Finding]] = []
    for one in judged:
        groups: dict[str, list[_Deviation]] = {}
        for statistic, z, beyond in zip(one.statistics, one.values[:, 0], own, strict=False):
            p_value = float(np.mean(greatest >= beyond))
            if p_value <= LEVEL:
                deviation = _Deviation(float(beyond), float(z), p_value, statistic.channel)
                groups.setdefault(statistic.name, []).append(deviation)
        for name, members in groups.items():
            found.append((max(members).ratio, _finding(name, members, one, logs[one.log])))
    found.sort(key=lambda pair: -pair[0])
    return tuple(finding for _, finding in found), float(np.mean(greatest >= greatest[0]))


def _finding(name: str, members: Sequence[_Deviation], judged: _Judged, log: RobotLog) -> Finding:
    worst, kind = max(members), judged.series.kind
    channels = tuple(sorted(member.channel for member in members)) if name == "channel shift" else ()
    lasts = name.startswith("lasting") and worst.z > 0.0
    seconds = duration_of_errors(judged.series, name) if lasts else 0.0
    message = _sentence(name, kind, worst.z, seconds, _channel_names(channels, kind, log))
    return Finding(name, judged.log, kind, channels, worst.z, worst.p_value, seconds, message)


def kind_label(kind: str) -> str:
    """Name a kind of reading in the plural, e.g. "landmark bearings"."""
    return f"{kind.replace('_', ' ')}s"


def _channel_names(channels: Sequence[int], kind: str, log: RobotLog) -> str:
    """Name beams or landmarks, landmarks as the log names them."""
    dimension = "landmark" if kind.startswith("landmark") else "beam"
    known = log.dataset.coords[dimension].values if dimension in log.dataset.coords else None
    names = ", ".join(str(channel if known is None else known[channel]) for channel in channels)
    return f"{dimension}{'s' if len(channels) > 1 else ''} {names}"


def _sentence(name: str, kind: str, z: float, seconds: float, channels: str) -> str:
    label = kind_label(kind)
    if name == "lasting":
        return f"errors of {label} " + (f"last about {_rounded(seconds)} s" if z > 0.0 else "alternate in sign")
    if name == "lasting together":
        what = f"the errors that {label} of one time share"
        return f"{what} last about {_rounded(seconds)} s" if z > 0.0 else f"{what} alternate in sign"
    if name == "spread":
        return f"{label} scatter {'more' if z > 0.0 else 'less'} than the model says"
    if name == "shape":
        return f"the errors of {label} have another distribution than the model says"
    if name == "channel shift":
        return f"{label} of {channels} are off on average"
    return f"{label} are on average {'larger' if z > 0.0 else 'smaller'} than the model says"


def _rounded(seconds: float) -> str:
    return f"{seconds:.0f}" if seconds >= 10.0 else f"{seconds:.2g}"
