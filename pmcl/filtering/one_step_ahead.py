"""How well a filter foresees each single reading: one pass, and for every reading its score and its PIT."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from pmcl.engine.contract import reading_exponent
from pmcl.filtering.kernels import smc
from pmcl.filtering.kernels.resampling import SCHEMES, AnyScheme
from pmcl.filtering.particle_filter import FilterPass, check_particles, raise_outcome
from pmcl.interrupts import check_interrupt
from pmcl.models.sensor import sensor_of
from pmcl.models.tables import Tables

__all__ = ["Predictions", "pooled_increments", "predict_by_passes", "predict_readings"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# A pass counts by what it has foreseen in so many rows. Over all rows the evidences of two sound passes differ by some
# 8 nats with 500 particles, so that one of them would count alone; over a single row, one that is lost would count too.
_REMEMBERED = 20


@dataclass(frozen=True)
class Predictions:
    """What a filter foresaw of every single reading that was measured, N of them, in the order it took them.

    Attributes
    ----------
    filtered : FilterPass
        The pass itself; with the particles of the last two rows only where they were not to be kept.
    sensor, kind, channel, time : ndarray of int, shape (N,)
        Sensor in the model; position in `kinds`; beam or landmark; row.
    kinds : tuple of str
        Names of the kinds of readings, as in a log.
    reading : ndarray, shape (N,)
        The readings.
    log_score : ndarray, shape (N,)
        Log predictive density of each reading given all before it; they sum to the log evidence [nat] where no sensor
        tempers its readings and none is taken alone.
    low, high : ndarray, shape (N,)
        Predictive probability of a smaller, and of a smaller or equal reading; NaN for a sensor whose table registers
        no distribution function.
    """

    filtered: FilterPass
    sensor: Int
    kind: Int
    channel: Int
    time: Int
    kinds: tuple[str, ...]
    reading: Float
    log_score: Float
    low: Float
    high: Float

    def pit(self, rng: np.random.Generator) -> Float:
        """Return probability integral transforms, (N,): uniform and independent when the model is right.

        Where a reading has a probability of its own, a clipped one for instance, the value is drawn between `low` and
        `high`; it always lies strictly inside (0, 1).
        """
        drawn = self.low + (self.high - self.low) * rng.random(self.low.size)
        tiny = np.finfo(float).tiny
        return np.asarray(np.clip(drawn, tiny, 1.0 - np.finfo(float).epsneg))


def predict_readings(
    tables: Tables,
    n_steps: int,
    n_particles: int,
    rng: np.random.Generator,
    *,
    scheme: str = "multinomial",
    threshold: float = 1.0,
    alone: bool = False,
    keep_particles: bool = True,
) -> Predictions:
    """Run a bootstrap particle filter that takes the readings of a row one after another.

    Parameters
    ----------
    tables, n_steps, n_particles, rng, scheme, threshold
        As for :func:`pmcl.filtering.particle_filter.run_filter`; the evidence estimate has the same distribution.
    alone : bool
        Whether each reading of a sensor is foreseen as if the sensor had read nothing else at that time: from the rows
        before only. Log scores then do not sum to the log evidence.
    keep_particles : bool
        Whether the particles of all rows are kept, 36 bytes for each particle and row where states are poses; without
        it those of the last two rows are, and memory does not grow with n times T.

    Returns
    -------
    Predictions
        Cost: about twice that of a plain pass; seven times with the likelihood field of a lidar.

    Raises
    ------
    FilterError
        When every particle gets weight zero, or n < 2.
    DensityError
        When a density is not a number.
    """
    check_interrupt()
    check_particles(n_particles)
    rows = n_steps if keep_particles else min(2, n_steps)
    status, t, evidence, particles, log_weights, steps, ancestors, score, low, high = smc.predictive_pass(
        tables, rng, n_steps, n_particles, AnyScheme(SCHEMES[scheme]), float(threshold), alone, rows
    )
    raise_outcome(status, t, "particle filter")
    filtered = FilterPass(evidence, particles, log_weights, steps[:, 0], steps[:, 1], ancestors)
    indices = [sensor_of(sensor).index(sensor, n_steps) for sensor in tables.sensors]
    kinds = tuple(name for index in indices for name in index.kinds)
    before = np.cumsum([0, *(len(index.kinds) for index in indices)])
    seen = np.flatnonzero(~np.isnan(score))
    columns = [
        np.concatenate([np.full(index.time.size, number) for number, index in enumerate(indices)]),
        np.concatenate([index.kind + shift for index, shift in zip(indices, before[:-1], strict=True)]),
        np.concatenate([index.channel for index in indices]),
        np.concatenate([index.time for index in indices]),
    ]
    reading = np.concatenate([index.reading for index in indices])
    order = seen[np.argsort(columns[3][seen], kind="stable")]
    sensor, kind, channel, time = (np.asarray(column[order], dtype=np.int64) for column in columns)
    return Predictions(
        filtered, sensor, kind, channel, time, kinds, reading[order], score[order], low[order], high[order]
    )


def predict_by_passes(
    tables: Tables, n_steps: int, n_particles: int, rng: np.random.Generator, passes: int = 2
) -> Predictions:
    """Predict each reading by several independent passes, whose predictive distributions are mixed.

    A filter whose particles all miss what is read at some row says that the reading was next to impossible, whatever
    the model says. In the mixture such a pass takes part with its share at that row, and with next to nothing
    afterwards, until it follows the robot again.

    Parameters
    ----------
    tables, n_steps, n_particles, rng
        As for :func:`predict_readings`.
    passes : int
        Number of passes.

    Returns
    -------
    Predictions
        The densities and distribution functions are mixtures with weights that depend on earlier readings only; the
        increments and the evidence are those of the mixture too. Particles are left out.

    Raises
    ------
    FilterError
        When every particle of a pass gets weight zero, or n < 2.
    DensityError
        When a density is not a number.
    """
    found = [predict_readings(tables, n_steps, n_particles, rng, keep_particles=False) for _ in range(passes)]
    first = found[0]
    if passes == 1:
        return first
    exponent = np.array([float(reading_exponent(sensor)) for sensor in tables.sensors])
    score = np.array([one.log_score for one in found])
    log_weight = _log_weights(score * exponent[first.sensor], first.time)
    weight = np.exp(log_weight)
    increments = pooled_increments([one.filtered.log_increments for one in found])
    filtered = replace(
        first.filtered, log_evidence=float(increments.sum()), log_increments=increments,
        effective_size=np.sum([one.filtered.effective_size for one in found], axis=0),
    )  # fmt: skip
    return replace(
        first,
        filtered=filtered,
        log_score=np.asarray(special.logsumexp(log_weight + score, axis=0)),
        low=(weight * [one.low for one in found]).sum(axis=0),
        high=(weight * [one.high for one in found]).sum(axis=0),
    )


def pooled_increments(increments: Float | Sequence[Float]) -> Float:
    """Return the log predictive density of each row's readings, mixed from independent passes of a filter.

    Parameters
    ----------
    increments : ndarray, shape (K, T), or sequence of K ndarray, shape (T,)
        Log predictive densities of the rows by each pass [nat].

    Returns
    -------
    ndarray, shape (T,)
        Logs of the mean densities. A pass counts by what it foresaw in the twenty rows before.
    """
    score = np.array(increments)
    return np.asarray(special.logsumexp(_log_weights(score, np.arange(score.shape[1])) + score, axis=0))


def _log_weights(score: Float, time: Int) -> Float:
    """Return the log weight of each pass (M, N) at each reading, from its scores of the readings before.

    Parameters
    ----------
    score : ndarray, shape (M, N)
        Log predictive densities [nat], in the order in which readings were taken.
    time : ndarray of int, shape (N,)
        Rows of the readings, ascending.
    """
    # Differences of cumulated sums need finite terms.
    total = np.cumsum(np.maximum(score, -1e9), axis=1)
    total = np.concatenate([np.zeros((score.shape[0], 1)), total], axis=1)
    begin = np.searchsorted(time, time - _REMEMBERED)
    earlier = total[:, :-1] - total[:, begin]
    return np.asarray(earlier - special.logsumexp(earlier, axis=0))
