"""Numbers that should be unremarkable when a model is right, one family after another.

All of them are sums over readings or rows, so nearly Gaussian; what is usual is learnt from replicated logs
(:mod:`pmcl.criticism.alarms`), never from asymptotic theory.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from pmcl.criticism.covariates import RowCovariates
from pmcl.filtering.one_step_ahead import Predictions

__all__ = ["FAMILIES", "Feature", "fluctuation_features", "residual_features"]

Float = NDArray[np.float64]

FAMILIES = ("uniformity", "serial", "covariate", "score", "fluctuation")
_WAVES = 4
_BINS_OF_TIME = 6


class Feature(NamedTuple):
    """What one number is about.

    Attributes
    ----------
    family : str
        One of :data:`FAMILIES`.
    kind : str
        Variable of the log, or name of the scored effect.
    channel : int
        Beam or landmark; -1 for all together.
    covariate : str
        What the residual is compared with; empty for none.
    moment : str
        "mean" (too long or too short), "spread" (too uncertain or too sure), or "wave 3" of the PIT histogram.
    one_sided : bool
        Whether only large values are remarkable.
    """

    family: str
    kind: str
    channel: int = -1
    covariate: str = ""
    moment: str = "mean"
    one_sided: bool = False


def residual_features(
    made: Predictions, pit: Float, of_readings: dict[str, Float], of_rows: RowCovariates
) -> tuple[list[Feature], Float]:
    """Return the families about PITs: uniformity, serial correlation, dependence on covariates.

    Parameters
    ----------
    made : Predictions
        N readings.
    pit : ndarray, shape (N,)
        Their PITs; NaN where a sensor has none.
    of_readings : dict
        Covariates of single readings, (N,).
    of_rows : RowCovariates
        Covariates of rows, (T,).
    """
    names: list[Feature] = []
    values: list[float] = []
    everything = {**of_readings, **{name: column[made.time] for name, column in of_rows._asdict().items()}}
    for number, kind in enumerate(made.kinds):
        mine = (made.kind == number) & ~np.isnan(pit)
        if np.count_nonzero(mine) < 20:
            continue
        u, channel, time = pit[mine], made.channel[mine], made.time[mine]
        xi = special.ndtri(u)
        spread = np.abs(xi) - np.sqrt(2.0 / np.pi)
        for moment, residual in (("mean", xi), ("spread", spread)):
            _uniformity(names, values, kind, channel, moment, residual)
            _serial(names, values, kind, channel, time, moment, residual)
            for covariate, column in everything.items():
                _dependence(names, values, kind, covariate, moment, residual, column[mine])
        for wave in range(3, 3 + _WAVES):
            names.append(Feature("uniformity", kind, -1, "", f"wave {wave}"))
            values.append(float(np.sqrt(2.0 / u.size) * np.cos(wave * np.pi * u).sum()))
    return names, np.array(values)


def _uniformity(
    names: list[Feature], values: list[float], kind: str, channel: NDArray[np.int64], moment: str, residual: Float
) -> None:
    groups = [(-1, np.ones(residual.size, dtype=bool))]
    groups += [(int(c), channel == c) for c in np.unique(channel)] if np.unique(channel).size > 1 else []
    for which, mine in groups:
        names.append(Feature("uniformity", kind, which, "", moment))
        values.append(float(residual[mine].sum() / np.sqrt(np.count_nonzero(mine))))


def _serial(
    names: list[Feature],
    values: list[float],
    kind: str,
    channel: NDArray[np.int64],
    time: NDArray[np.int64],
    moment: str,
    residual: Float,
) -> None:
    order = np.lexsort((time, channel))
    follows = (channel[order][1:] == channel[order][:-1]) & (np.diff(time[order]) <= 3)
    product = (residual[order][1:] * residual[order][:-1])[follows]
    names.append(Feature("serial", kind, -1, "time", moment))
    values.append(float(product.sum() / np.sqrt(max(product.size, 1))))
    order = np.lexsort((channel, time))
    beside = time[order][1:] == time[order][:-1]
    product = (residual[order][1:] * residual[order][:-1])[beside]
    names.append(Feature("serial", kind, -1, "neighbour", moment))
    values.append(float(product.sum() / np.sqrt(max(product.size, 1))))


def _dependence(
    names: list[Feature], values: list[float], kind: str, covariate: str, moment: str, residual: Float, column: Float
) -> None:
    known = np.isfinite(column)
    if np.count_nonzero(known) < 20:
        return
    column, residual = column[known], residual[known]
    if covariate in ("direction", "heading"):
        forms = {f"cos {covariate}": np.cos(column), f"sin {covariate}": np.sin(column)}
    elif covariate == "turn":
        forms = {"turn": column, "|turn|": np.abs(column)}
    elif covariate in ("time", "x", "y"):
        # Ends against the middle, too: a wall or a phase in between is no trend.
        middle = column - np.median(column)
        forms = {covariate: middle, f"|{covariate}|": np.abs(middle)}
    else:
        forms = {covariate: column}
    for name, form in forms.items():
        centred = form - form.mean()
        norm = np.sqrt(centred @ centred)
        if norm > 1e-9 * np.sqrt(form.size) * (np.abs(form).max() + 1e-300):
            names.append(Feature("covariate", kind, -1, name, moment))
            values.append(float(residual @ centred / norm))


def fluctuation_features(labels: list[str], rows: Float, of_rows: RowCovariates) -> tuple[list[Feature], Float]:
    """Return how unevenly scores come about along time, motion and place.

    Parameters
    ----------
    labels : list of str
        Names of the K scores.
    rows : ndarray, shape (K, T)
        Their shares of each row.
    of_rows : RowCovariates
        Covariates, (T,).

    Returns
    -------
    features, values
        Log of the greatest excursion of the cumulated score from its even course, in the order of each covariate
        (Zeileis and Hornik 2007), relative to the root of the sum of squares.
    """
    names, values = [], []
    n = rows.shape[1]
    even = np.arange(1, n + 1) / n
    scale = np.sqrt((rows**2).sum(axis=1)) + 1e-300
    for covariate, column in of_rows._asdict().items():
        if np.ptp(column) == 0.0:
            continue
        ordered = np.cumsum(rows[:, np.argsort(column, kind="stable")], axis=1)
        bridge = ordered - ordered[:, -1:] * even
        sup = np.abs(bridge).max(axis=1) / scale
        for label, value in zip(labels, sup, strict=True):
            names.append(Feature("fluctuation", label, -1, covariate, "mean", True))
            values.append(float(np.log(value + 1e-12)))
    return names, np.array(values)
