"""Where a disagreement is: which channel, over which values of a covariate, and when."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import special

from pmcl.criticism.alarms import Alarm
from pmcl.criticism.evidence import Evidence
from pmcl.criticism.result import Unexplained

__all__ = ["locate"]

Float = NDArray[np.float64]

_BINS = 8


def locate(
    alarm: Alarm, found: Evidence, labels: tuple[str, ...], scores: Float, p_value: float | None = None
) -> Unexplained:
    """Return where an alarm comes from.

    Parameters
    ----------
    alarm : Alarm
        The alarm.
    found : Evidence
        Of the log.
    labels : tuple of str
        Names of scores, as features of the family "score" or "fluctuation" are called;
    scores : ndarray, shape (L, T)
        and their rows.
    p_value : float, optional
        Of the alarm, all families considered; that of its own family when left out.
    """
    feature = alarm.worst
    name = feature.covariate.strip("|").removeprefix("cos ").removeprefix("sin ")
    if alarm.family in ("score", "fluctuation"):
        residual = scores[labels.index(feature.kind)]
        residual = residual - residual.mean() if alarm.family == "fluctuation" else residual
        time = np.arange(residual.size)
        column = found.of_rows._asdict().get(name)
        channel, beams = feature.kind, tuple[int, ...]()
    else:
        made = found.predictions
        mine = (made.kind == made.kinds.index(feature.kind)) & ~np.isnan(found.pit)
        if feature.channel >= 0:
            mine &= made.channel == feature.channel
        xi = special.ndtri(found.pit[mine])
        residual = np.abs(xi) - np.sqrt(2.0 / np.pi) if feature.moment == "spread" else xi
        time = made.time[mine]
        everything = {**found.of_readings, **{k: v[made.time] for k, v in found.of_rows._asdict().items()}}
        column = everything[name][mine] if name in everything else None
        channel, beams = feature.kind, _worst_channels(made.channel[mine], residual, feature.channel)
    if column is not None and feature.covariate.startswith("|"):
        column = np.abs(column)
    interval = _worst_interval(column, residual) if column is not None else (float("nan"), float("nan"))
    when = _worst_interval(time.astype(float), residual)
    p_value = alarm.p_value if p_value is None else p_value
    return Unexplained(
        channel, beams, feature.covariate, feature.moment, interval, (int(when[0]), int(when[1])), p_value
    )


def _worst_channels(channel: NDArray[np.int64], residual: Float, given: int) -> tuple[int, ...]:
    """Return the channels that deviate by themselves, none when nearly all do."""
    if given >= 0:
        return (given,)
    which = np.unique(channel)
    z = np.array([residual[channel == c].sum() / np.sqrt(np.count_nonzero(channel == c)) for c in which])
    found = which[np.abs(z) > 3.0]
    return tuple(int(c) for c in found) if found.size <= max(1, which.size // 2) else ()


def _worst_interval(column: Float, residual: Float) -> tuple[float, float]:
    """Return the one of eight quantile intervals in which the residual deviates most.

    An interval holds at least two values. Fewer than sixteen values therefore give fewer intervals, and fewer than four
    give one that spans them all. Without any finite value of the column there is no interval: both ends are NaN.
    """
    known = np.isfinite(column)
    column, residual = column[known], residual[known]
    if column.size == 0:
        return float("nan"), float("nan")
    parts = np.array_split(np.argsort(column, kind="stable"), min(_BINS, max(1, column.size // 2)))
    worst = max(parts, key=lambda part: abs(float(residual[part].sum())))
    return float(column[worst[0]]), float(column[worst[-1]])
