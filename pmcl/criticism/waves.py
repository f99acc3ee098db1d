"""Formulas that are periodic in time: a gyro that swings with its temperature, a range finder that breathes.

Waves of every period and phase are too many to be scored one by one. But to first order the score of a change
``c f(t)`` is the sum, over rows, of f(t) times the score of a steady change; so three steady changes tell of all waves.
The fit part of the log chooses period and phase, simulated logs say what the greatest of so many scores is worth, and
the wave is then a formula like any other.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from pmcl.criticism.alarms import judge
from pmcl.criticism.evidence import Evidence
from pmcl.criticism.formulas import Steady, steady_changes, wave
from pmcl.criticism.passes import Judged, Settings
from pmcl.criticism.scores import directions, effect_rows
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.models.tables import Tables

__all__ = ["Waves", "remarkable_waves"]

Float = NDArray[np.float64]

# The fit part holds two periods at least, and a period eight rows; frequencies are as far apart as half a period in the
# whole part, phases an eighth of a turn (a wave between two of them keeps 92 % of its score).
_LEAST_PERIODS, _LEAST_ROWS = 2.0, 8.0
_PHASES = 4


class Waves(NamedTuple):
    """Waves whose scores are remarkable.

    Attributes
    ----------
    found : list of (Effect, float)
        The best of each steady change as a formula, with the deviation of its score.
    critical_z : float
        What the greatest deviation of all waves exceeds in 5 % of logs without a missing effect.
    """

    found: list[tuple[Effect, float]]
    critical_z: float


def remarkable_waves(
    judged: Judged, log: RobotLog, tables: Tables, split: int, settings: Settings, beyond: float = 0.0
) -> Waves:
    """Look for waves in the scores of steady changes.

    Parameters
    ----------
    judged : Judged
        The log's evidence, and that of simulated logs.
    log : RobotLog
        The log.
    tables : Tables
        Of the fitted model.
    split : int
        First row of the held-out part, of which nothing is looked at.
    settings : Settings
        Of the run.
    beyond : float
        Return only waves of a greater deviation than this.
    """
    changes = steady_changes(tables, log.n_steps)
    times = log.times[:split] - log.times[0]
    frequencies = _frequencies(times)
    if not changes or frequencies.size == 0:
        return Waves([], np.inf)
    settings.tell(f"looking for waves of {1 / frequencies[-1]:.3g} to {1 / frequencies[0]:.3g} s")
    phases = np.pi * np.arange(_PHASES) / _PHASES
    profiles = np.cos(2.0 * np.pi * frequencies[:, None, None] * times + phases[:, None]).reshape(-1, split)
    wanted = directions([one.effect for one in changes])
    logs = [judged.evidence, *judged.null]

    def rows_of(k: int) -> Float:
        bound, theta, columns, _ = logs[k].source
        return effect_rows(bound.tables(theta)[0], bound.logs[0], columns, wanted)[:, :split]

    rows = settings.mapped(rows_of, "looking for waves in logs", [""] * len(logs))
    found, *null = [_of_waves(one, scores @ profiles.T, split) for one, scores in zip(logs, rows, strict=True)]
    judgement = judge(found, null, [one for one in wanted for _ in profiles], level=settings.level)
    z = np.abs(judgement.z).reshape(len(changes), frequencies.size, _PHASES)
    best = []
    for change, scores, deviations in zip(changes, rows[0], z, strict=True):
        if deviations.max() > max(judgement.critical_z, beyond):
            k = int(deviations.max(axis=1).argmax())
            best.append((_refined(change, scores, times, frequencies, k, log), float(deviations.max())))
    return Waves(sorted(best, key=lambda one: -one[1]), judgement.critical_z)


def _frequencies(times: Float) -> Float:
    """Return the frequencies [1/s] that so many rows can show."""
    if times.size < 2:
        return np.empty(0)
    span = float(times[-1] - times[0])
    most = 1.0 / (_LEAST_ROWS * float(np.median(np.diff(times))))
    return np.arange(_LEAST_PERIODS / span, most, 0.5 / span)


def _of_waves(one: Evidence, scores: Float, split: int) -> Evidence:
    """Return evidence whose candidates are waves; their sums over the fit part stand for the rows."""
    base = one.base[:, :split].sum(axis=1, keepdims=True)
    return replace(one, scores=scores.reshape(-1, 1), base=base, features=(), numbers=np.empty(0))


def _refined(change: Steady, scores: Float, times: Float, frequencies: Float, k: int, log: RobotLog) -> Effect:
    """Return the wave near a frequency of the grid that the score likes best, as a formula."""

    def amplitude(frequency: float) -> complex:
        return complex(scores @ np.exp(-2j * np.pi * frequency * times))

    step = frequencies[1] - frequencies[0] if frequencies.size > 1 else 0.1 * frequencies[0]
    near = (frequencies[k] - step, frequencies[k] + step)
    frequency = float(optimize.minimize_scalar(lambda f: -abs(amplitude(f)), bounds=near, method="bounded").x)
    # The score likes cos(2 pi f t + phase) best, which is a sine that begins a quarter of a period earlier.
    begins = -(np.angle(amplitude(frequency)) / (2.0 * np.pi) + 0.25) / frequency
    return wave(change, log, 1.0 / frequency, float(log.times[0] + begins % (1.0 / frequency)))
