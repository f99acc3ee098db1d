"""Numbers that are close to zero or stable when a model is right, in families of related tests.

Those of residuals are sums over readings, so they are nearly Gaussian; they are kept as sums over blocks of rows. Their
usual size is estimated from logs that the fitted model simulates (:mod:`pmcl.criticism.judging.alarms`), never from
asymptotic theory.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from pmcl.criticism.scoring.covariates import RowCovariates
from pmcl.filtering.one_step_ahead import Predictions
from pmcl.filtering.paired_scores import block_starts

__all__ = ["FAMILIES", "Feature", "fluctuation_features", "residual_features"]

Float = NDArray[np.float64]

FAMILIES = ("uniformity", "serial", "covariate", "score", "fluctuation")
"""Families of tests; alarms are corrected for their number (Holm 1979)."""
# Cosines of order 3 to 6 of the PIT histogram are tested: mean and spread stand for orders 1 and 2 (smooth test of
# Neyman 1937; the number of orders was chosen by hand).
_PIT_COSINES = 4
# Fewer readings than this give no nearly Gaussian sum (chosen by hand).
_LEAST_READINGS = 20
# Readings of a channel up to this many rows apart count as consecutive (chosen by hand).
_CONSECUTIVE_ROWS = 3
# A covariate that varies by less than this, relative to its largest value, is constant but for rounding errors.
_VARIES = 1e-9


class Feature(NamedTuple):
    """The meaning of one number.

    Attributes
    ----------
    family : str
        One of :data:`FAMILIES`, or the name of a statistic of the user's own.
    kind : str
        Variable of the log, or name of the scored parameter or effect, or of the statistic.
    channel : int
        Beam or landmark; -1 for all together.
    covariate : str
        The covariate that the residual is compared with; empty for none.
    moment : str
        "mean" (readings too long or too short), "spread" (predictions too uncertain or too sure), or "wave 3" to
        "wave 6" for cosines of the PIT histogram; "statistic" for a statistic of the user's own.
    one_sided : bool
        Whether only large values are unusual.
    """

    family: str
    kind: str
    channel: int = -1
    covariate: str = ""
    moment: str = "mean"
    one_sided: bool = False


class _Residuals(NamedTuple):
    """Residuals of one kind of readings, all (N,): values, with the channel and the row of each."""

    kind: str
    moment: str
    values: Float
    channel: NDArray[np.int64]
    time: NDArray[np.int64]


class _Numbers:
    """Features and their sums over blocks of rows, collected one by one."""

    def __init__(self, n_rows: int) -> None:
        self.features: list[Feature] = []
        self.blocks: list[Float] = []
        self._starts = block_starts(n_rows)

    def add(self, feature: Feature, terms: Float, time: NDArray[np.int64]) -> None:
        """Add a feature by the terms that are summed, with the row of each."""
        block = np.searchsorted(self._starts, time, side="right") - 1
        self.features.append(feature)
        self.blocks.append(np.asarray(np.bincount(block, terms, self._starts.size), dtype=np.float64))

    def sums(self) -> Float:
        """Return the sums over blocks, (F, B)."""
        return np.array(self.blocks).reshape(len(self.blocks), self._starts.size)


def residual_features(
    predictions: Predictions,
    pit: Float,
    reading_covariates: dict[str, Float],
    row_covariates: RowCovariates,
    tempered: Collection[int] = (),
) -> tuple[list[Feature], Float]:
    """Return the families that test PITs: uniformity, serial correlation, dependence on covariates.

    Parameters
    ----------
    predictions : Predictions
        One-step-ahead predictions of N readings.
    pit : ndarray, shape (N,)
        Their probability integral transforms; NaN where a sensor has no distribution function.
    reading_covariates : dict of str to ndarray, shape (N,)
        Covariates of the readings.
    row_covariates : RowCovariates
        Covariates of the rows, (T,).
    tempered : collection of int
        Sensors whose readings of a row share errors in a way that the model leaves open: whether neighbouring channels
        resemble each other is not tested.

    Returns
    -------
    features : list of Feature
        What each number means.
    blocks : ndarray, shape (F, B)
        The numbers as sums over blocks of rows (:func:`pmcl.filtering.paired_scores.block_starts`).
    """
    numbers = _Numbers(row_covariates.time.size)
    of_rows = {name: column[predictions.time] for name, column in row_covariates._asdict().items()}
    covariates = {**reading_covariates, **of_rows}
    for number, kind in enumerate(predictions.kinds):
        selected = (predictions.kind == number) & ~np.isnan(pit)
        if np.count_nonzero(selected) < _LEAST_READINGS:
            continue
        u, channel, time = pit[selected], predictions.channel[selected], predictions.time[selected]
        xi = special.ndtri(u)
        spread = np.abs(xi) - np.sqrt(2.0 / np.pi)
        for moment, values in (("mean", xi), ("spread", spread)):
            residuals = _Residuals(kind, moment, values, channel, time)
            _add_uniformity(numbers, residuals)
            _add_serial(numbers, residuals, neighbours=int(predictions.sensor[selected][0]) not in tempered)
            for covariate, column in covariates.items():
                _add_dependence(numbers, residuals, covariate, column[selected])
        for order in range(3, 3 + _PIT_COSINES):
            terms = np.sqrt(2.0 / u.size) * np.cos(order * np.pi * u)
            numbers.add(Feature("uniformity", kind, -1, "", f"wave {order}"), terms, time)
    return numbers.features, numbers.sums()


def _add_uniformity(numbers: _Numbers, residuals: _Residuals) -> None:
    """Add the mean residual of all channels and of each channel."""
    channels = np.unique(residuals.channel)
    groups = [(-1, np.ones(residuals.values.size, dtype=bool))]
    groups += [(int(c), residuals.channel == c) for c in channels] if channels.size > 1 else []
    for channel, selected in groups:
        terms = residuals.values[selected] / np.sqrt(np.count_nonzero(selected))
        feature = Feature("uniformity", residuals.kind, channel, "", residuals.moment)
        numbers.add(feature, terms, residuals.time[selected])


def _add_serial(numbers: _Numbers, residuals: _Residuals, neighbours: bool) -> None:
    """Add the correlation of consecutive readings of a channel, and of neighbouring channels if these count."""
    values, channel, time = residuals.values, residuals.channel, residuals.time
    order = np.lexsort((time, channel))
    pairs = (channel[order][1:] == channel[order][:-1]) & (np.diff(time[order]) <= _CONSECUTIVE_ROWS)
    product = (values[order][1:] * values[order][:-1])[pairs] / np.sqrt(max(int(np.count_nonzero(pairs)), 1))
    numbers.add(Feature("serial", residuals.kind, -1, "time", residuals.moment), product, time[order][1:][pairs])
    if not neighbours:
        return
    order = np.lexsort((channel, time))
    pairs = time[order][1:] == time[order][:-1]
    product = (values[order][1:] * values[order][:-1])[pairs] / np.sqrt(max(int(np.count_nonzero(pairs)), 1))
    numbers.add(Feature("serial", residuals.kind, -1, "neighbour", residuals.moment), product, time[order][1:][pairs])


def _add_dependence(numbers: _Numbers, residuals: _Residuals, covariate: str, column: Float) -> None:
    """Add the correlation of residuals with a covariate, in each form that the covariate has."""
    known = np.isfinite(column)
    if np.count_nonzero(known) < _LEAST_READINGS:
        return
    column, values = column[known], residuals.values[known]
    if covariate in ("direction", "heading"):
        forms = {f"cos {covariate}": np.cos(column), f"sin {covariate}": np.sin(column)}
    elif covariate == "turn":
        forms = {"turn": column, "|turn|": np.abs(column)}
    elif covariate in ("time", "x", "y"):
        # The distance from the median shows a wall or a phase in the middle of the range, which has no trend.
        middle = column - np.median(column)
        forms = {covariate: middle, f"|{covariate}|": np.abs(middle)}
    else:
        forms = {covariate: column}
    for name, form in forms.items():
        centred = form - form.mean()
        norm = np.sqrt(centred @ centred)
        if norm > _VARIES * np.sqrt(form.size) * (np.abs(form).max() + 1e-300):
            feature = Feature("covariate", residuals.kind, -1, name, residuals.moment)
            numbers.add(feature, values * centred / norm, residuals.time[known])


def fluctuation_features(
    labels: list[str], scores: Float, row_covariates: RowCovariates
) -> tuple[list[Feature], Float]:
    """Return how unevenly scores accumulate along time, motion and place.

    Parameters
    ----------
    labels : list of str
        Names of the K scores.
    scores : ndarray, shape (K, T)
        The scores, row by row.
    row_covariates : RowCovariates
        Covariates of the rows, (T,).

    Returns
    -------
    features : list of Feature
        What each number means.
    values : ndarray, shape (F,)
        Log of the greatest distance of the cumulated score from a straight line, in the order of each covariate
        (Zeileis and Hornik 2007), relative to the root of the sum of squares.
    """
    features, values = [], []
    n = scores.shape[1]
    even = np.arange(1, n + 1) / n
    scale = np.sqrt((scores**2).sum(axis=1)) + 1e-300
    for covariate, column in row_covariates._asdict().items():
        if np.ptp(column) == 0.0:
            continue
        cumulated = np.cumsum(scores[:, np.argsort(column, kind="stable")], axis=1)
        bridge = cumulated - cumulated[:, -1:] * even
        greatest = np.abs(bridge).max(axis=1) / scale
        for label, value in zip(labels, greatest, strict=True):
            features.append(Feature("fluctuation", label, -1, covariate, "mean", True))
            values.append(float(np.log(value + 1e-12)))
    return features, np.array(values)
