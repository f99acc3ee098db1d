"""Statistics of the user's own: numbers of residuals that become alarms, calibrated like the built-in ones.

A statistic is a function from the residuals of a log (:class:`Residuals`) to one number for each reading or each row.
Their sum is a number of the log; the same sum is computed from every log that the fitted model simulates, so that its
usual size need not be known. It is a family of tests of its own, and the correction for the number of families counts
it: a useless statistic makes the other alarms a little less sensitive.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from pmcl.checks import check_type
from pmcl.criticism.scoring.covariates import RowCovariates
from pmcl.criticism.scoring.features import FAMILIES, Feature
from pmcl.errors import CriticismError
from pmcl.filtering.one_step_ahead import Predictions
from pmcl.filtering.paired_scores import block_sums
from pmcl.models.effects.registry import told_by_line, values_in

__all__ = [
    "OWN", "Residuals", "Statistic", "checked_statistics", "residuals_of", "statistic_features", "statistics_in",
    "statistics_in_use", "use_statistics",
]  # fmt: skip

Float = NDArray[np.float64]
Int = NDArray[np.int64]

OWN = "statistic"
"""What :attr:`pmcl.criticism.scoring.features.Feature.moment` is for a statistic of the user's own."""

_in_use: list[Statistic] = []


@dataclass(frozen=True)
class Residuals:
    """The residuals of a log under a fitted model, with what they may depend on.

    All arrays have one entry for each of the N readings, in the order of the rows, shape (N,).

    Attributes
    ----------
    kind : ndarray of str
        Variable of the log: "range", "landmark_range", "landmark_bearing" and so on.
    channel : ndarray of int
        Beam or landmark, from 0.
    row : ndarray of int
        Row of the log.
    residual : ndarray
        Standard normal and independent of all others when the model is right; positive where a reading is greater than
        was predicted from the readings before it. NaN where the sensor has no distribution function.
    log_score : ndarray
        Log predictive density [nat].
    distance, direction, incidence : ndarray
        Of the ideal reading along the estimated path: distance [m], direction in the world frame [rad], angle to the
        wall's normal [rad]; NaN where a sensor has none.
    time, speed, turn_rate, heading, x, y : ndarray
        Of the reading's row: time [s], speed [m/s] and turn rate [rad/s] of the odometry, estimated heading [rad] and
        place [m].
    n_rows : int
        Number of rows T of the log.
    """

    kind: NDArray[np.str_]
    channel: Int
    row: Int
    residual: Float
    log_score: Float
    distance: Float
    direction: Float
    incidence: Float
    time: Float
    speed: Float
    turn_rate: Float
    heading: Float
    x: Float
    y: Float
    n_rows: int


@dataclass(frozen=True)
class Statistic:
    """A statistic of the user's own.

    Attributes
    ----------
    name : str
        Lower case with hyphens, e.g. "opposite-beams"; the alarm and its family are called so.
    summary : str
        What it is large for, in one sentence.
    of : callable
        ``of(residuals) -> ndarray``: the numbers that are summed, one for each reading, (N,), or for each row, (T,).
        NaN counts as nothing.
    per : {"reading", "row"}
        What the numbers belong to.
    one_sided : bool
        Whether only large sums are unusual.

    Raises
    ------
    CriticismError
        When the name is not usable or taken by a built-in family, or `per` is something else.
    """

    name: str
    summary: str
    of: Callable[[Residuals], Any]
    per: str = "reading"
    one_sided: bool = False

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", self.name) or self.name in FAMILIES:
            raise CriticismError(
                f"statistic {self.name!r}: expected a name in lower case with hyphens, other than "
                f"{', '.join(FAMILIES)}; write for example 'opposite-beams'"
            )
        if self.per not in ("reading", "row"):
            raise CriticismError(
                f"statistic {self.name}: expected per='reading' or per='row', but got {self.per!r}; choose one"
            )


@contextmanager
def use_statistics(statistics: Iterable[Statistic]) -> Iterator[None]:
    """Let the critic compute these statistics, too, inside a ``with`` block.

    Parameters
    ----------
    statistics : iterable of Statistic
        Of the user's own, for example from :func:`statistics_in`.

    Raises
    ------
    CriticismError
        When two have the same name.
    """
    before = list(_in_use)
    try:
        _in_use[:] = checked_statistics([*before, *statistics])
        yield
    finally:
        _in_use[:] = before


def statistics_in_use() -> tuple[Statistic, ...]:
    """Return the statistics of the ``with`` blocks around."""
    return tuple(_in_use)


def checked_statistics(statistics: Any) -> tuple[Statistic, ...]:
    """Return statistics as a tuple.

    Parameters
    ----------
    statistics : Any
        What should be a list of them.

    Raises
    ------
    CriticismError
        When it is something else, or two have the same name.
    """
    check_type("statistics", statistics, (list, tuple), error=CriticismError, advice="write a list, also around one")
    for statistic in statistics:
        advice = "make one with pmcl.criticism.Statistic"
        check_type("each of statistics", statistic, Statistic, error=CriticismError, advice=advice)
    names = [statistic.name for statistic in statistics]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise CriticismError(f"expected statistics of different names, but two are called {twice[0]}; rename one")
    return tuple(statistics)


def statistics_in(module: ModuleType, file: Path) -> tuple[Statistic, ...]:
    """Return the statistics that names at the top of a user's file stand for.

    Parameters
    ----------
    module : module
        From :func:`pmcl.models.effects.registry.run_file`.
    file : path
        The file, for messages: what goes wrong in a statistic later is told with file and line.
    """
    found = values_in(module, Statistic)
    return tuple(replace(statistic, of=told_by_line(statistic.of, file)) for statistic in found)


def residuals_of(
    predictions: Predictions, pit: Float, of_readings: dict[str, Float], of_rows: RowCovariates
) -> Residuals:
    """Return the residuals of a log.

    Parameters
    ----------
    predictions : Predictions
        One-step-ahead predictions of N readings.
    pit : ndarray, shape (N,)
        Their probability integral transforms; NaN where a sensor has no distribution function.
    of_readings : dict of str to ndarray, shape (N,)
        Covariates of the readings.
    of_rows : RowCovariates
        Covariates of the rows, (T,).
    """
    row = predictions.time
    return Residuals(
        kind=np.array(predictions.kinds)[predictions.kind],
        channel=predictions.channel,
        row=row,
        residual=special.ndtri(pit),
        log_score=predictions.log_score,
        distance=of_readings["distance"],
        direction=of_readings["direction"],
        incidence=of_readings["incidence"],
        time=of_rows.time[row],
        speed=of_rows.speed[row],
        turn_rate=of_rows.turn[row],
        heading=of_rows.heading[row],
        x=of_rows.x[row],
        y=of_rows.y[row],
        n_rows=of_rows.time.size,
    )


def statistic_features(statistics: Sequence[Statistic], residuals: Residuals) -> tuple[list[Feature], Float]:
    """Compute statistics of a log.

    Parameters
    ----------
    statistics : sequence of Statistic
        F statistics.
    residuals : Residuals
        The residuals of the log.

    Returns
    -------
    features : list of Feature
        What each number means.
    blocks : ndarray, shape (F, B)
        The numbers as sums over blocks of rows (:func:`pmcl.filtering.paired_scores.block_starts`).

    Raises
    ------
    CriticismError
        When a statistic does not return a finite number, or NaN, for each reading or row.
    """
    rows = np.zeros((len(statistics), residuals.n_rows))
    for sums, statistic in zip(rows, statistics, strict=True):
        terms = _terms(statistic, residuals)
        sums += terms if statistic.per == "row" else np.bincount(residuals.row, terms, residuals.n_rows)
    features = [
        Feature(statistic.name, statistic.name, moment=OWN, one_sided=statistic.one_sided) for statistic in statistics
    ]
    return features, block_sums(rows)


def _terms(statistic: Statistic, residuals: Residuals) -> Float:
    count = residuals.n_rows if statistic.per == "row" else residuals.row.size
    values = statistic.of(residuals)
    try:
        terms = np.array(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise CriticismError(
            f"statistic {statistic.name}: expected {count} numbers, but got {' '.join(str(error).split())}; return an "
            "array"
        ) from error
    if terms.shape != (count,):
        raise CriticismError(
            f"statistic {statistic.name}: expected one number for each {statistic.per}, shape ({count},), but got "
            f"shape {terms.shape}; return such an array, or change per"
        )
    infinite = np.flatnonzero(np.isinf(terms))
    if infinite.size:
        raise CriticismError(
            f"statistic {statistic.name}: expected finite numbers, or NaN for nothing, but got {terms[infinite[0]]} "
            f"for {statistic.per} {infinite[0]}; bound it"
        )
    return np.asarray(np.nan_to_num(terms, nan=0.0))
