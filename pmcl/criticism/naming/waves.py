"""Formulas that are periodic in time, such as a gyro whose bias follows its temperature.

There are too many waves of every period and phase to score each by itself. To first order, however, the score of a
change ``c f(t)`` is the sum over rows of f(t) times the score of a steady change. The row scores of three steady
changes therefore give the scores of all waves. The log chooses period and phase, simulated logs give
the critical value of the greatest of so many scores, and the wave is then a formula like any other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from pmcl.criticism.judging.alarms import family_critical_z
from pmcl.criticism.judging.deviations import BlockSums, OwnSpread, deviations
from pmcl.criticism.judging.judged_log import JudgedLog
from pmcl.criticism.naming.candidates import RankedEffect
from pmcl.criticism.naming.formulas import SteadyChange, steady_changes, wave
from pmcl.criticism.scoring.scores import directions_of, effect_scores
from pmcl.criticism.settings import Settings
from pmcl.filtering.paired_scores import block_sums
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.models.tables import Tables

__all__ = ["Waves", "remarkable_waves"]

Float = NDArray[np.float64]

# The log holds at least two periods, and a period at least eight rows. Neighbouring frequencies differ by half a
# period over the log, and neighbouring phases by a quarter of pi; a wave between two of them keeps 92 % of its
# score. All are chosen by hand.
_LEAST_PERIODS, _LEAST_ROWS = 2.0, 8.0
_PHASES = 4


class Waves(NamedTuple):
    """Waves whose scores are remarkable.

    Attributes
    ----------
    found : list of RankedEffect
        The best wave of each steady change as a formula, with its standardised score.
    critical_z : float
        Bound that the greatest standardised score of all waves exceeds in 5 % of logs without a missing effect.
    """

    found: list[RankedEffect]
    critical_z: float


def remarkable_waves(judged: JudgedLog, log: RobotLog, tables: Tables, settings: Settings) -> Waves:
    """Look for waves in the row scores of steady changes.

    Parameters
    ----------
    judged : JudgedLog
        The log and the simulated logs, scored under the fitted model.
    log : RobotLog
        The log.
    tables : Tables
        Coefficient tables of the fitted model.
    settings : Settings
        Settings of the run.
    """
    changes = steady_changes(tables, log.n_steps)
    times = log.times - log.times[0]
    frequencies = _frequencies(times)
    if not changes or frequencies.size == 0:
        return Waves([], np.inf)
    settings.tell(f"looking for waves of {1 / frequencies[-1]:.3g} to {1 / frequencies[0]:.3g} s")
    phases = np.pi * np.arange(_PHASES) / _PHASES
    profiles = np.cos(2.0 * np.pi * frequencies[:, None, None] * times + phases[:, None]).reshape(-1, log.n_steps)
    directions = directions_of([change.effect for change in changes])
    logs = [judged.scored, *judged.simulated]

    def score(k: int) -> Float:
        source = logs[k].source
        tables_of_log = source.bound.tables(source.theta)[0]
        return effect_scores(tables_of_log, source.bound.logs[0], source.columns, directions)

    steady_scores = settings.mapped(score, "looking for waves in logs", [""] * len(logs))
    deviation = deviations(
        [
            _sums_of_waves(scores, scored_log.parameter_scores, profiles)
            for scored_log, scores in zip(logs, steady_scores, strict=True)
        ],
        np.zeros(len(changes) * len(profiles), dtype=bool),
    ).z
    critical_z = family_critical_z(deviation)
    z = np.abs(deviation[0]).reshape(len(changes), frequencies.size, _PHASES)
    best = []
    for change, scores, of_change in zip(changes, steady_scores[0], z, strict=True):
        if of_change.max() > critical_z:
            k = int(of_change.max(axis=1).argmax())
            effect = _best_wave(change, scores, times, frequencies, k, log)
            best.append(RankedEffect(effect, float(of_change.max())))
    return Waves(sorted(best, key=lambda ranked: -ranked.z), critical_z)


def _frequencies(times: Float) -> Float:
    """Return the frequencies [1/s] that rows at these times [s] can show."""
    if times.size < 2:
        return np.empty(0)
    span = float(times[-1] - times[0])
    greatest = 1.0 / (_LEAST_ROWS * float(np.median(np.diff(times))))
    return np.arange(_LEAST_PERIODS / span, greatest, 0.5 / span)


def _sums_of_waves(scores: Float, parameters: Float, profiles: Float) -> BlockSums:
    """Return the scores of all waves of one log.

    Parameters
    ----------
    scores : ndarray, shape (C, T)
        Row scores of steady changes.
    parameters : ndarray, shape (d, T)
        Row scores of the model's own parameters.
    profiles : ndarray, shape (P, T)
        The waves.

    Returns
    -------
    BlockSums
        The waves of the first change come first.
    """
    blocks = np.concatenate([block_sums(change * profiles) for change in scores])
    # The rows of so many waves are not kept: the sum of squares of their residuals follows from these moments.
    squares = (scores**2 @ (profiles**2).T).ravel()
    mixed = np.concatenate([profiles @ (change * parameters).T for change in scores])
    own = parameters @ parameters.T

    def squares_without(slope: Float) -> Float:
        explained = np.einsum("df,fd->f", slope, mixed)
        return np.asarray(np.maximum(squares - 2.0 * explained + np.einsum("df,de,ef->f", slope, own, slope), 0.0))

    exposed = np.repeat(np.count_nonzero(scores, axis=1), len(profiles)).astype(float)
    return BlockSums(blocks, block_sums(parameters), OwnSpread(squares_without, exposed))


def _best_wave(
    change: SteadyChange, scores: Float, times: Float, frequencies: Float, k: int, log: RobotLog
) -> Effect:
    """Return the wave with the greatest score near a frequency of the grid, as a formula.

    Parameters
    ----------
    change : SteadyChange
        The change that oscillates.
    scores : ndarray, shape (T,)
        Its row scores.
    times : ndarray, shape (T,)
        Times of the rows since the start of the log [s].
    frequencies : ndarray
        The grid [1/s].
    k : int
        Position in the grid.
    log : RobotLog
        The log.
    """

    def amplitude(frequency: float) -> complex:
        return complex(scores @ np.exp(-2j * np.pi * frequency * times))

    step = frequencies[1] - frequencies[0] if frequencies.size > 1 else 0.1 * frequencies[0]
    near = (frequencies[k] - step, frequencies[k] + step)
    frequency = float(optimize.minimize_scalar(lambda f: -abs(amplitude(f)), bounds=near, method="bounded").x)
    # The score is greatest for cos(2 pi f t + phase), which is a sine that begins a quarter of a period earlier.
    begins = -(np.angle(amplitude(frequency)) / (2.0 * np.pi) + 0.25) / frequency
    return wave(change, log, 1.0 / frequency, float(log.times[0] + begins % (1.0 / frequency)))
