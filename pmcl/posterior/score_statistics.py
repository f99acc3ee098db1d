"""Statistics of normal scores that show whether the predictions of a model are as good as they claim to be.

When the model is right, the sequential probability integral transforms of the readings are independent and uniform
(Rosenblatt, Annals of Mathematical Statistics 23(3), 1952), so their normal scores are independent standard normals,
whatever the pattern of the readings in time. The distribution of any statistic of them is therefore known exactly: it
is that of the same statistic of simulated standard normals at the same places.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from pmcl.posterior.shared_errors import MOST_ROWS, shared_normals

__all__ = ["ScoreSeries", "Statistic", "duration_of_errors", "score_statistics"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# Cosines of the PIT (Neyman's smooth test): the first shows shifted readings, the second a wrong spread, the third and
# fourth a wrong shape.
_WAVES = 4
# Errors that last this many times the usual interval between two readings of a channel are looked for.
_TIME_SCALES = (1.0, 4.0, 16.0, 64.0)
# The log holds at least this many of the longest time scale, so that chance similarities average out.
_LEAST_SPANS = 10.0
# Scores that are held at a time, so that memory does not grow with readings times simulations: 16 MB, in a few copies.
_MOST_VALUES = 2_000_000
# Time scales per octave when the duration of errors is estimated.
_PER_OCTAVE = 4


class ScoreSeries(NamedTuple):
    """Normal scores of one kind of reading of one log.

    Attributes
    ----------
    kind : str
        Variable of the log, e.g. ``"landmark_range"``.
    time : ndarray, shape (N,)
        Time of each reading [s]; not decreasing.
    channel : ndarray of int, shape (N,)
        Its beam or landmark.
    score : ndarray, shape (N,)
        Its normal score.
    sectors : tuple of tuple of int
        The beams of each channel, where channels are sectors of scans whose beams share their errors
        (:mod:`~pmcl.posterior.shared_errors`); else empty.
    """

    kind: str
    time: Float
    channel: Int
    score: Float
    sectors: tuple[tuple[int, ...], ...] = ()


class Statistic(NamedTuple):
    """The meaning of one statistic.

    Attributes
    ----------
    name : {"shift", "spread", "shape", "channel shift", "lasting", "lasting together"}
        "shift": readings are longer (positive) or shorter than predicted. "spread": they scatter more (positive) or
        less. "channel shift": as "shift", for one beam or landmark. "lasting": errors of a channel resemble its earlier
        ones (positive) or alternate. "lasting together": the same for the mean error of all channels of a row.
    channel : int
        Beam or landmark of a "channel shift"; -1 for other statistics.
    time_scale : float
        Decay time of the weight that earlier errors get [s]; 0 where there is none.
    """

    name: str
    channel: int = -1
    time_scale: float = 0.0


def score_statistics(
    series: ScoreSeries, simulations: int, rng: np.random.Generator
) -> tuple[tuple[Statistic, ...], Float]:
    """Compute all statistics of a series, and of simulated standard normals at the same places.

    Parameters
    ----------
    series : ScoreSeries
        N readings of C channels.
    simulations : int
        Number of simulated series M.
    rng : numpy.random.Generator
        Source of the simulated scores.

    Returns
    -------
    statistics : tuple of Statistic, length F
    values : ndarray, shape (F, 1 + M)
        Column 0 belongs to the readings, the others to the simulations. All have mean 0 and variance 1 for independent
        standard normal scores. Cost: O(N M). Of sectors, which may share less than simulated ones do, no shape is
        judged, a "spread" below 0 is 0, and those of the readings of a long log are what
        :data:`~pmcl.posterior.shared_errors.MOST_ROWS` rows like its own would show.
    """
    n = series.score.size
    channels = np.unique(series.channel)
    scales = _time_scales(series)
    waves, of_channels = np.zeros((_WAVES, 1 + simulations)), np.zeros((channels.size, 1 + simulations))
    lasting = _Lasting(series, scales, 1 + simulations)
    for begin, stop, scores in _blocks(series, simulations, rng):
        probability = special.ndtr(scores)
        for wave in range(_WAVES):
            waves[wave] += np.cos((wave + 1) * np.pi * probability).sum(axis=0)
        for number, channel in enumerate(channels):
            of_channels[number] += scores[series.channel[begin:stop] == channel].sum(axis=0)
        if scales.size:
            lasting.add(begin, stop, scores)
    # The cosine is positive for readings shorter than predicted.
    signs = (-1.0, 1.0, 1.0, 1.0)
    values = [sign * np.sqrt(2.0 / n) * wave for wave, sign in zip(waves, signs, strict=True)]
    names = [Statistic("shift"), Statistic("spread"), Statistic("shape"), Statistic("shape")]
    if series.sectors:
        names, values = names[:2], [values[0], np.maximum(values[1], 0.0)]
    if channels.size > 1:
        for channel, total in zip(channels, of_channels, strict=True):
            names.append(Statistic("channel shift", int(channel)))
            values.append(total / np.sqrt(np.count_nonzero(series.channel == channel)))
    if scales.size:
        names += [Statistic("lasting", -1, float(scale)) for scale in scales]
        values += list(lasting.single.standardised())
        if channels.size > 1:
            names += [Statistic("lasting together", -1, float(scale)) for scale in scales]
            values += list(lasting.together.standardised())
    found = np.array(values)
    if series.sectors:
        # What is shared scatters more; the simulations tell by how much.
        found /= np.sqrt(np.mean(found[:, 1:] ** 2, axis=1, keepdims=True))
        found[:, 0] /= np.sqrt(max(np.unique(series.time).size / MOST_ROWS, 1.0))
    return tuple(names), found


def _blocks(
    series: ScoreSeries, simulations: int, rng: np.random.Generator
) -> Iterator[tuple[int, int, Float]]:
    """Yield some readings after the others: the first, the one after the last, and their scores (m, 1 + M).

    Readings of one time stay together. Column 0 holds the scores of the readings, the others are simulated. What is
    simulated does not depend on the size of a block.
    """
    n = series.score.size
    shared = None
    if series.sectors:
        shared = shared_normals(series.time, series.channel, len(series.sectors), simulations, rng)
    edges = np.append(np.unique(series.time, return_index=True)[1], n)
    begin = 0
    while begin < n:
        # The last edge that is near enough, or the next one.
        place = np.searchsorted(edges, begin + _MOST_VALUES // (1 + simulations), side="right") - 1
        stop = int(edges[max(place, np.searchsorted(edges, begin, side="right"))])
        simulated = rng.standard_normal((stop - begin, simulations)) if shared is None else shared[begin:stop]
        yield begin, stop, np.concatenate([series.score[begin:stop, None], simulated], axis=1)
        begin = stop


def duration_of_errors(series: ScoreSeries, name: str) -> float:
    """Estimate how long the errors of a series last.

    Parameters
    ----------
    series : ScoreSeries
        The readings.
    name : {"lasting", "lasting together"}
        Whether errors of single channels or the mean errors of rows are meant.

    Returns
    -------
    float
        The decay time [s] of the exponential weight that shows the resemblance of errors most clearly. For errors whose
        correlation decays exponentially that weight is the matched filter, so that its decay time is theirs.
    """
    interval, longest = _interval(series), _longest(series)
    octaves = np.log2(max(longest / interval, 1.0))
    scales = 0.5 * interval * 2.0 ** (np.arange(int(octaves * _PER_OCTAVE) + _PER_OCTAVE + 1) / _PER_OCTAVE)
    lasting = _Lasting(series, scales, 1)
    lasting.add(0, series.score.size, series.score[:, None])
    sums = lasting.single if name == "lasting" else lasting.together
    return float(scales[int(sums.standardised()[:, 0].argmax())])


def _interval(series: ScoreSeries) -> float:
    """Return the usual time between two readings of a channel [s]; 0 where no channel was read twice."""
    order = np.lexsort((series.time, series.channel))
    steps = np.diff(series.time[order])[np.diff(series.channel[order]) == 0]
    return float(np.median(steps)) if steps.size else 0.0


def _longest(series: ScoreSeries) -> float:
    return float(series.time[-1] - series.time[0]) / _LEAST_SPANS


def _time_scales(series: ScoreSeries) -> Float:
    interval = _interval(series)
    scales = interval * np.array(_TIME_SCALES)
    return scales[scales <= _longest(series)] if interval > 0.0 else np.empty(0)


class _Lasting:
    """Weighted sums of products of two errors, of the same channel (`single`) or of the means of rows (`together`).

    The weight of a product is exp(-interval / scale). Products of different pairs are uncorrelated, so the variance of
    the sum, by which it is divided, is the sum of squared weights.

    Parameters
    ----------
    series : ScoreSeries
        The readings.
    scales : ndarray, shape (S,)
        Time scales [s].
    n_series : int
        Number of series at the same places, those of the readings and of the simulations.
    """

    def __init__(self, series: ScoreSeries, scales: Float, n_series: int) -> None:
        channels, self.channel = np.unique(series.channel, return_inverse=True)
        self.time = series.time
        self.single = _PairSums(scales, channels.size, n_series)
        self.together = _PairSums(scales, 1, n_series)

    def add(self, begin: int, stop: int, scores: Float) -> None:
        """Take the scores (stop - begin, M) of some readings, which follow those taken before and end with a row."""
        times, first = np.unique(self.time[begin:stop], return_index=True)
        row = np.zeros(1, dtype=np.int64)
        for time, low, high in zip(times, first, [*first[1:], stop - begin], strict=True):
            now = scores[low:high]
            self.single.add(float(time), self.channel[begin + low : begin + high], now)
            self.together.add(float(time), row, now.sum(axis=0, keepdims=True) / np.sqrt(high - low))


class _PairSums:
    """Sums over pairs of errors of a channel, by recursion: earlier errors get weights that decay with time."""

    def __init__(self, scales: Float, n_channels: int, n_series: int) -> None:
        self.scales = scales[:, None]
        self.memory = np.zeros((scales.size, n_channels, n_series))
        self.weight = np.zeros((scales.size, n_channels))
        self.time = np.full(n_channels, -np.inf)
        self.total = np.zeros((scales.size, n_series))
        self.variance = np.zeros(scales.size)

    def add(self, time: float, channel: Int, scores: Float) -> None:
        """Take the scores of some channels at one time.

        Parameters
        ----------
        time : float
            The time [s]; not earlier than the one before.
        channel : ndarray of int, shape (m,)
            The channels.
        scores : ndarray, shape (m, M)
            Their scores: those of the readings and of the simulations.
        """
        decay = np.exp(-(time - self.time[channel]) / self.scales)
        memory = decay[..., None] * self.memory[:, channel]
        weight = decay**2 * self.weight[:, channel]
        self.total += np.einsum("smk,mk->sk", memory, scores)
        self.variance += weight.sum(axis=1)
        self.memory[:, channel] = memory + scores
        self.weight[:, channel] = weight + 1.0
        self.time[channel] = time

    def standardised(self) -> Float:
        return np.asarray(self.total / np.sqrt(np.maximum(self.variance, 1e-300))[:, None])
