"""Where a disagreement is: the channel, the values of the covariate, and the rows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from pmcl.criticism.judging.alarms import Alarm
from pmcl.criticism.scoring.features import Feature
from pmcl.criticism.scoring.scored_log import ScoredLog
from pmcl.criticism.scoring.statistics import OWN
from pmcl.filtering.paired_scores import block_starts

__all__ = ["Location", "locate"]

Float = NDArray[np.float64]

# Number of quantile intervals of a covariate, and the standard normal deviation from which on a channel is named; both
# chosen by hand, for the report only.
_INTERVALS, _CHANNEL_Z = 8, 3.0


class Location(NamedTuple):
    """Where an alarm comes from.

    Attributes
    ----------
    channel : str
        Variable of the log, or the name of a score or of a statistic of the user's own.
    beams : tuple of int
        Beams or landmarks; empty for all.
    covariate, moment : str
        As in :class:`pmcl.criticism.scoring.features.Feature`.
    interval : tuple of float
        Values of the covariate between which the deviation is greatest; NaN without a covariate.
    time : tuple of int
        First and last row of the interval of rows in which the deviation is greatest.
    """

    channel: str
    beams: tuple[int, ...]
    covariate: str
    moment: str
    interval: tuple[float, float]
    time: tuple[int, int]


def locate(alarm: Alarm, scored: ScoredLog, scores: Mapping[str, Float]) -> Location:
    """Return where an alarm comes from.

    Parameters
    ----------
    alarm : Alarm
        The alarm.
    scored : ScoredLog
        The log.
    scores : mapping of str to ndarray, shape (T,)
        Scores, row by row, by the names that features of the families "score" and "fluctuation" have.
    """
    feature = alarm.worst
    if feature.moment == OWN:
        return _of_statistic(feature, scored)
    name = feature.covariate.strip("|").removeprefix("cos ").removeprefix("sin ")
    of_rows = scored.row_covariates._asdict()
    if alarm.family in ("score", "fluctuation"):
        residual = scores[feature.kind]
        residual = residual - residual.mean() if alarm.family == "fluctuation" else residual
        time = np.arange(residual.size)
        column = of_rows.get(name)
        beams = tuple[int, ...]()
    else:
        predictions = scored.predictions
        selected = (predictions.kind == predictions.kinds.index(feature.kind)) & ~np.isnan(scored.pit)
        if feature.channel >= 0:
            selected &= predictions.channel == feature.channel
        xi = special.ndtri(scored.pit[selected])
        residual = np.abs(xi) - np.sqrt(2.0 / np.pi) if feature.moment == "spread" else xi
        time = predictions.time[selected]
        covariates = {**scored.reading_covariates, **{k: v[predictions.time] for k, v in of_rows.items()}}
        column = covariates[name][selected] if name in covariates else None
        beams = _worst_channels(predictions.channel[selected], residual, feature.channel)
    if column is not None and feature.covariate.startswith("|"):
        column = np.abs(column)
    interval = _worst_interval(column, residual) if column is not None else (float("nan"), float("nan"))
    first, last = _worst_interval(time.astype(float), residual)
    return Location(feature.kind, beams, feature.covariate, feature.moment, interval, (int(first), int(last)))


def _of_statistic(feature: Feature, scored: ScoredLog) -> Location:
    """Return where a statistic of the user's own is greatest; only its sums over blocks of rows are known."""
    blocks = scored.residual_blocks[scored.features.index(feature)]
    starts = block_starts(scored.row_covariates.time.size)
    first, last = _worst_interval(np.arange(blocks.size, dtype=float), blocks)
    ends = np.append(starts[1:], scored.row_covariates.time.size) - 1
    nothing = (float("nan"), float("nan"))
    return Location(feature.kind, (), "", OWN, nothing, (int(starts[int(first)]), int(ends[int(last)])))


def _worst_channels(channel: NDArray[np.int64], residual: Float, given: int) -> tuple[int, ...]:
    """Return the channels that deviate by themselves, none when most of them do.

    Parameters
    ----------
    channel : ndarray of int, shape (N,)
        Channel of each residual.
    residual : ndarray, shape (N,)
        The residuals.
    given : int
        The channel that the feature is about, or -1 for all.
    """
    if given >= 0:
        return (given,)
    channels = np.unique(channel)
    z = np.array([residual[channel == c].sum() / np.sqrt(np.count_nonzero(channel == c)) for c in channels])
    deviating = channels[np.abs(z) > _CHANNEL_Z]
    return tuple(int(c) for c in deviating) if deviating.size <= max(1, channels.size // 2) else ()


def _worst_interval(column: Float, residual: Float) -> tuple[float, float]:
    """Return the one of eight quantile intervals of a column in which the residual deviates most.

    An interval holds at least two values. Fewer than sixteen values therefore give fewer intervals, and fewer than four
    give one that spans them all. Without any finite value of the column there is no interval: both ends are NaN.

    Parameters
    ----------
    column : ndarray, shape (N,)
        Values of the covariate.
    residual : ndarray, shape (N,)
        The residuals.
    """
    known = np.isfinite(column)
    column, residual = column[known], residual[known]
    if column.size == 0:
        return float("nan"), float("nan")
    parts = np.array_split(np.argsort(column, kind="stable"), min(_INTERVALS, max(1, column.size // 2)))
    worst = max(parts, key=lambda part: abs(float(residual[part].sum())))
    return float(column[worst[0]]), float(column[worst[-1]])
