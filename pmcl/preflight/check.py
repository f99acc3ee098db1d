"""Is this log what it says it is? The findings of :mod:`pmcl.preflight` for one log."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from pmcl.errors import LogError
from pmcl.logs.finding import Finding, warn_of
from pmcl.logs.joined import joints_of
from pmcl.logs.plausibility import implausible
from pmcl.logs.robot_log import RobotLog
from pmcl.models.motions.increments.motion import IncrementNoise
from pmcl.models.quick import QuickReadings
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.models.sensor import sensors
from pmcl.preflight.evidence import LEVELS, Evidence, evidence_of
from pmcl.preflight.hypotheses import Hypothesis, hypotheses_of, start_elsewhere
from pmcl.preflight.stretch import stretch_of
from pmcl.preflight.unrelated import evidence_of_no_relation

__all__ = ["checked_logs", "disagreements", "preflight", "require_rows"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# Rows that are looked at, and particles for each way to read the log and each pair of noise levels. A robot that may
# be anywhere needs more particles, which its sensors choose, and then fewer rows do.
_ROWS, _PARTICLES = 160, 200
_ROWS_ANYWHERE = 100
# The best mistake and the log as it is are compared again, by so many times the particles.
_FINER = 5
# Particles at the stated start, and as many anywhere on the map, when the start itself may be wrong.
_PARTICLES_ELSEWHERE = 3000
# Chance of naming some mistake in a sound log that the model describes, by the union bound and Ville's inequality, on
# either half of the rows alone; both halves must tell the same.
_ERROR_RATE = 1e-3
# Real logs are never quite what the model describes: the gain of blocks of rows must also be this many standard errors.
_STANDARD_ERRORS = 3.0
_BLOCKS = 10
# Too few rows tell nothing.
_LEAST_ROWS = 10
# Odometry is too small to matter when the motion that the readings show is so many times as large.
_TOO_SMALL = 4.0


def preflight(log: RobotLog, model: RobotModel | None = None) -> tuple[Finding, ...]:
    """Look for plausible mistakes in a log, in about a second.

    Parameters
    ----------
    log : RobotLog
        The log. Its reference trajectory and true parameters are never read.
    model : RobotModel, optional
        Its priors tell how much noise is usual; the default model of the log when left out.

    Returns
    -------
    tuple of Finding
        Empty for a sound log. What is impossible is no finding: such a log cannot be built or read at all. Nothing is
        found in joined logs, which are looked at before they are joined.

    Notes
    -----
    Each mistake is a way to read the log, whose evidence is compared with that of the log as it is. A mistake is named
    when each half of the rows that are looked at (160 at most) speaks for it by more than log(number of mistakes /
    0.001) nats, the gains of ten blocks are three standard errors above zero, and both hold again with five times the
    particles. Where two ways to read a log explain it equally well, as in a symmetric room, nothing is said.
    """
    if joints_of(log):
        return ()
    found = implausible(log)
    return (*found, *disagreements(log, model, {finding.name for finding in found}))


def checked_logs(logs: Sequence[RobotLog], model: RobotModel | None = None) -> str:
    """Look for plausible mistakes in several logs, warn of them, and return them as a file keeps them.

    Parameters
    ----------
    logs : sequence of RobotLog
        Logs of one robot.
    model : RobotModel, optional
        As for :func:`preflight`.

    Returns
    -------
    str
        A JSON list of objects ``{"name", "level", "mistake", "message"}``, with the number of its log as ``"log"``
        where there are several.
    """
    entries: list[dict[str, str | bool | int]] = []
    for number, log in enumerate(logs):
        findings = preflight(log, model)
        warn_of(findings, log.where)
        place: dict[str, int] = {"log": number} if len(logs) > 1 else {}
        entries += [{**finding.as_dict(), **place} for finding in findings]
    return json.dumps(entries)


def require_rows(log: RobotLog) -> None:
    """Raise LogError for a log of a single row, in which nothing moves."""
    if log.n_steps < 2:
        raise LogError(
            f"{log.where}: expected at least two rows, between which the robot moves, but got {log.n_steps}; "
            "record longer"
        )


def disagreements(log: RobotLog, model: RobotModel | None = None, known: set[str] | None = None) -> tuple[Finding, ...]:
    """Return what readings, odometry and map show together: the second half of :func:`preflight`.

    Parameters
    ----------
    log : RobotLog
        The log.
    model : RobotModel, optional
        As for :func:`preflight`.
    known : set of str, optional
        Names of findings that are known already and need not be named again.
    """
    usual = _usual_values(log, model)
    readings = quick_readings_of(log, usual)
    anywhere = not np.isfinite(log.start_std).all()
    has_map = any(read.map_points() is not None for read in readings.values())
    if not readings or (anywhere and not has_map):
        return ()
    rows = stretch_of(log, readings.values(), _ROWS_ANYWHERE if anywhere else _ROWS)
    if rows.size < _LEAST_ROWS:
        return ()
    particles = min(read.particles_anywhere for read in readings.values()) if anywhere else _PARTICLES
    found = _mistake(_Case(log, readings, rows, _motion_noise(usual)), particles)
    return tuple(finding for finding in found if finding.name not in (known or set()))


def quick_readings_of(log: RobotLog, usual: Mapping[str, float]) -> dict[str, QuickReadings]:
    """Return the readings of all registered sensors that a quick filter can read, by the sensors' names.

    Parameters
    ----------
    log : RobotLog
        The log.
    usual : mapping of str to float
        Usual values of parameters by name.
    """
    found = {name: sensor.quick_readings(log, usual) for name, sensor in sensors().items()}
    return {name: read for name, read in found.items() if read is not None}


class _Case(NamedTuple):
    """What is looked at: readings by sensor, rows (K,), usual noise of an increment (3,)."""

    log: RobotLog
    readings: Mapping[str, QuickReadings]
    rows: Int
    motion_noise: Float

    def evidence(self, ways: Sequence[Hypothesis], particles: int, seed: int) -> Evidence:
        return evidence_of(self.log, self.readings, self.rows, ways, self.motion_noise, particles, seed)


def _mistake(case: _Case, particles: int) -> tuple[Finding, ...]:
    ways = hypotheses_of(case.log, case.readings)
    evidence = case.evidence(ways, particles, seed=0)
    gains = evidence.rows - evidence.rows[0]
    unrelated = evidence_of_no_relation(case.readings, case.rows)
    order = np.argsort(-np.where(np.isnan(gains).any(axis=1), -np.inf, gains.sum(axis=1)))
    best = int(order[0])
    found: list[_Explanation] = []
    told = best != 0 and _tells(gains[best], len(ways))
    elsewhere = _elsewhere(case, ways[0], len(ways))
    if told or (best != 0 and elsewhere.tells):
        again = case.evidence((ways[0], ways[best]), _FINER * particles, seed=1)
        found.append(_Explanation.of(ways[best], again, len(ways), _tells))
    found.append(elsewhere)
    # Where one of them tells, something is wrong; what it is, the better of them says.
    best_found = max(found, key=lambda one: one.total)
    if any(one.tells for one in found) and best_found.total > unrelated.sum():
        return (_named(best_found.way, best_found.gain, case.rows.size),)
    if _tells(unrelated - evidence.rows[0], len(ways)):
        finer = case.evidence(ways[:1], _FINER * particles, seed=1)
        if _tells(unrelated - finer.rows[0], len(ways)):
            return (_unrelated(float((unrelated - finer.rows[0]).sum()), case.rows.size),)
    if not np.isfinite(case.log.start_std).all():
        # A filter that has not found the robot shows any motion.
        return ()
    disagreeing = _disagreeing(case, evidence.levels, len(ways))
    if disagreeing:
        finer = case.evidence(ways[:1], _FINER * particles, seed=1)
        disagreeing = _disagreeing(case, finer.levels, len(ways))
    return disagreeing


class _Explanation(NamedTuple):
    """A way to read the log: its log evidence, how much more than the log's as it is that is, and whether it tells."""

    way: Hypothesis
    total: float
    gain: float
    tells: bool

    @classmethod
    def of(cls, way: Hypothesis, pair: Evidence, n_ways: int, tells: Callable[[Float, int], bool]) -> _Explanation:
        """Judge the second of two ways, `way`, against the first."""
        gain = pair.rows[1] - pair.rows[0]
        total = -math.inf if np.isnan(gain).any() else float(pair.rows[1].sum())
        return cls(way, total, float(gain.sum()), tells(gain, n_ways))


def _elsewhere(case: _Case, plain: Hypothesis, n_ways: int) -> _Explanation:
    """Judge whether the robot starts elsewhere on the map than the log says, where the sensors can show that."""
    way = start_elsewhere(plain)
    placed = np.isfinite(case.log.start_std).all()
    if not placed or not all(read.start_may_be_elsewhere for read in case.readings.values()):
        return _Explanation(way, -math.inf, -math.inf, False)
    # As many particles at the stated start as anywhere: else the finer of two filters wins on a sound log.
    pair = case.evidence((plain, way), _PARTICLES_ELSEWHERE, seed=1)
    return _Explanation.of(way, pair, n_ways + 1, _tells_at_first)


def _tells_at_first(gain: Float, n_ways: int) -> bool:
    """Tell the same where the explanation need only hold until a filter has found the robot (K,) [nat]."""
    if np.isnan(gain).any():
        return False
    bound = math.log(n_ways / _ERROR_RATE)
    first, rest = (part.sum() for part in np.array_split(gain, 2))
    return bool(first > bound and rest > -bound and first + rest > 2.0 * bound)


def _tells(gain: Float, n_ways: int) -> bool:
    """Tell whether the gains of each row (K,) [nat] speak for another explanation beyond doubt."""
    if np.isnan(gain).any():
        return False
    halves = np.array([part.sum() for part in np.array_split(gain, 2)])
    blocks = np.array([part.sum() for part in np.array_split(gain, _BLOCKS)])
    error = float(blocks.std(ddof=1)) / math.sqrt(_BLOCKS)
    return bool((halves > math.log(n_ways / _ERROR_RATE)).all() and blocks.mean() > _STANDARD_ERRORS * error)


def _named(way: Hypothesis, gain: float, n_rows: int) -> Finding:
    text = f"{way.finding}: so read, {n_rows} rows are explained better by {gain:.0f} nats; {way.advice}"
    return Finding(way.name, "implausible", True, text)


def _unrelated(gain: float, n_rows: int) -> Finding:
    return Finding(
        "readings-unrelated-to-map",
        "implausible",
        True,
        f"readings and map have nothing to do with each other, whatever the noise: that readings follow a distribution "
        f"of their own explains {n_rows} rows better by {gain:.0f} nats; check the map, which landmark is "
        "which, the start, and units and signs of readings and odometry",
    )


def _disagreeing(case: _Case, levels: Float, n_ways: int) -> tuple[Finding, ...]:
    """Tell when the readings show motion of another size than the odometry."""
    steps = np.asarray(case.log.odometry[1 : case.rows[-1] + 1])
    noise = case.motion_noise
    distance, turn = np.sqrt(np.mean(steps**2, axis=0) @ np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    moving = np.array(LEVELS)[:, None] * np.array([np.hypot(noise[0], noise[1]), noise[2]])
    larger = (moving > _TOO_SMALL * np.array([distance, turn])).all(axis=1)
    by_level = logsumexp(levels, axis=1)
    best = int(np.argmax(by_level))
    # Where every level is far above the odometry, the lowest one stands for a robot that hardly moves.
    small = ~larger if not larger.all() else np.arange(len(LEVELS)) == 0
    gain = float(by_level[best] - by_level[small].max())
    if not larger[best] or gain < 2.0 * math.log(n_ways / _ERROR_RATE):
        return ()
    return (
        Finding(
            "odometry-disagrees",
            "implausible",
            True,
            f"odometry says {distance:.2g} m and {turn:.2g} rad in a row, while readings show some "
            f"{moving[best, 0]:.2g} m and {moving[best, 1]:.2g} rad: check that odometry is recorded, its units, and "
            "that odometry, readings and map belong together",
        ),
    )


def _usual_values(log: RobotLog, model: RobotModel | None) -> dict[str, float]:
    """Return the prior means of all parameters of the log's default model, and of `model` where that says more."""
    # The quick filter moves its particles by increments, whatever the motion model is.
    parameters = (*IncrementNoise().parameters, *default_model(log).parameters)
    usual = {parameter.name: float(parameter.prior.mean()) for parameter in parameters}
    if model is not None:
        given = {parameter.name: float(parameter.prior.mean()) for parameter in model.parameters}
        given |= {name: float(value) for name, value in model.fixed.items()}
        usual |= {name: value for name, value in given.items() if 0.0 < value < math.inf}
    return usual


def _motion_noise(usual: Mapping[str, float]) -> Float:
    return np.array([usual["sigma_forward"], usual["sigma_left"], usual["sigma_turn"]])
