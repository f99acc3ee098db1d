"""When an effect acts: throughout the log, from some time on, until some time, or in between.

A window is told of an effect that was found; it is no part of the model, whose tables hold the effect throughout. Two
filters predict every row, one with the effect and one without. The difference of their log scores is positive, on
average, where the effect acts and negative where it does not, and its sum over a window is the gain of a model that has
the effect in the window only. (Each filter has its own past; they differ for the few rows in which the readings correct
the pose.) Sums over all windows cost next to nothing, so that change points are not sought but summed over: a plain
prior gives one half to "throughout" and shares the rest among the others, and each onset in them is as probable as any
other.

An effect that acts in a share of the log only was fitted throughout, and is too small by about that share. The
strength is therefore one more unknown: the differences are computed for several multiples of the fitted one. Then the
model is fitted again to the rows of the window alone, which also restores the noise that had absorbed the difference,
and the change points are computed once more with the parameters of that fit.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from pmcl.criticism.fitting.held_out import row_scores
from pmcl.criticism.fitting.quick_fit import BRIEF, Fit, quick_fit
from pmcl.errors import FilterError, PmclError
from pmcl.filtering.paired_scores import paired_gain
from pmcl.models.effects.effect import Effect
from pmcl.models.effects.formula import Formula
from pmcl.models.parameters import prior_support
from pmcl.models.robot_model import BoundModel

__all__ = ["Acting", "Moment", "WindowPosterior", "acting", "window_posterior"]

_logger = logging.getLogger("pmcl.criticism")
Float = NDArray[np.float64]
Int = NDArray[np.int64]

# Multiples of the fitted strength that are tried. One that acts in a share p of the log was fitted with about p times
# its strength. Chosen by hand: steps of the square root of two, to an eighth of the log.
_MULTIPLES = np.array([1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0])
# A window begins and ends at least this share of the log away from both ends of the log, and is at least as long: what
# leaves out less is throughout for all that anybody wants to know. Chosen by hand.
_LEAST_SHARE = 0.05
# Change points that are told apart; in longer logs they are so many, evenly among the rows. Chosen by hand: all pairs
# of them are summed over.
_MOST_POINTS = 400
# Prior probability that an effect which was found acts throughout the log.
_THROUGHOUT = 0.5
# The effect acts in a window when it acts throughout with at most this probability. Chosen by hand.
_LEAST_DOUBT = 0.05
# Score of every row under a strength with which no filter follows [nat]: it is impossible.
_NO_FILTER = -1000.0
# Probability that a change point lies in the interval that is told.
_COVERED = 0.9
# Rows outside of a window must speak against the effect by so much, without the block of rows that does most [nat]: one
# reading is no end. Chosen by hand.
_LEAST_GAIN = 3.0


class Moment(NamedTuple):
    """The time at which an effect begins or ends.

    Attributes
    ----------
    time : float
        Median of its posterior distribution [s].
    low, high : float
        It lies between these with a probability of 90 %, and so do two estimates with different strengths [s].
    """

    time: float
    low: float
    high: float


@dataclass(frozen=True)
class Acting:
    """When an effect acts in a log, if it does not act throughout.

    Attributes
    ----------
    begin, end : Moment or None
        The first row with it and the last one; None where it acts from the beginning, or to the end.
    probability : float
        Posterior probability that it does not act throughout.
    values : mapping of str to (float, float)
        Mean and standard deviation of its free parameters while it acts, from a fit of the rows in which it does; empty
        when there is none.
    """

    begin: Moment | None
    end: Moment | None
    probability: float
    values: Mapping[str, tuple[float, float]]


class WindowPosterior(NamedTuple):
    """Posterior probabilities of the windows in which an effect may act.

    Attributes
    ----------
    throughout, onward, until, between : float
        Probabilities of an effect that acts throughout, from some row on, until some row, and in between.
    points : ndarray of int, shape (K,)
        Rows that may be the first one of a window, or the first one after it.
    first, last : ndarray, shape (K,)
        Distributions of the first row of the window and of the first row after it, given the most probable of the three
        kinds of windows; NaN where that kind has no such row.
    multiple : int
        The most probable multiple of the strength, given that kind.
    """

    throughout: float
    onward: float
    until: float
    between: float
    points: Int
    first: Float
    last: Float
    multiple: int


def window_posterior(differences: Float) -> WindowPosterior:
    """Compute the probabilities of windows from log scores with and without an effect.

    Parameters
    ----------
    differences : ndarray, shape (M, T)
        Log score of each row with the effect less that without it [nat], for M strengths that are equally probable
        beforehand.

    Returns
    -------
    WindowPosterior
        Half of the prior is on "throughout". The three kinds of windows share the rest equally, and so do the windows
        of a kind. Cost: O(M K^2).
    """
    m, n_rows = differences.shape
    least = max(1, int(np.ceil(_LEAST_SHARE * n_rows)))
    points = np.unique(np.linspace(least, n_rows - least, min(_MOST_POINTS, n_rows - 2 * least + 1)).astype(int))
    sums = np.concatenate([np.zeros((m, 1)), np.cumsum(differences, axis=1)], axis=1)
    whole, before = sums[:, -1], sums[:, points]
    k = points.size
    pairs = points - points[:, None] >= least  # of the first row of the window and the first row after it
    between = np.full((m, k, k), -np.inf)
    between[:, pairs] = (before[:, None, :] - before[:, :, None])[:, pairs]
    kinds = [whole[:, None] - before, before, between]
    counts = [k, k, max(int(pairs.sum()), 1)]
    evidences = np.array(
        [
            special.logsumexp(whole) - np.log(m),
            *(special.logsumexp(gains) - np.log(m * count) for gains, count in zip(kinds, counts, strict=True)),
        ]
    )
    prior = np.log([_THROUGHOUT, *[(1.0 - _THROUGHOUT) / 3.0] * 3])
    probability = special.softmax(prior + evidences)
    best = int(np.argmax(probability[1:]))
    gains = kinds[best]
    multiple = int(special.logsumexp(gains.reshape(m, -1), axis=1).argmax())
    nothing = np.full(k, np.nan)
    if best == 2:
        joint = special.softmax(special.logsumexp(gains, axis=0))
        first, last = joint.sum(axis=1), joint.sum(axis=0)
    else:
        distribution = special.softmax(special.logsumexp(gains, axis=0))
        first, last = (distribution, nothing) if best == 0 else (nothing, distribution)
    throughout, onward, until, inside = (float(p) for p in probability)
    return WindowPosterior(throughout, onward, until, inside, points, first, last, multiple)


def acting(fit: Fit, effect: Effect, *, seed: int) -> Acting | None:
    """Return when an effect acts, or None where it acts throughout.

    Parameters
    ----------
    fit : Fit
        A fit of the model that has the effect to the whole log.
    effect : Effect
        The effect, one of ``fit.bound.effects``.
    seed : int
        Determines all random numbers.

    Returns
    -------
    Acting or None
        None also for an effect that may not begin or end, see
        :attr:`pmcl.models.effects.effect.Effect.may_begin`, and where no filter follows. Cost: some 16 filter passes of
        the log, and a short fit of the rows of the window if there is one.
    """
    strengths = _positions(fit.bound, effect)
    if not effect.may_begin or not strengths:
        return None
    try:
        rows = _differences(fit.bound, fit.theta, fit.paths, strengths, seed=seed)
        found = window_posterior(rows)
        if found.throughout > _LEAST_DOUBT or not _in_several_blocks(rows, found):
            return None
        inside = _fit_inside(fit, *_window(found, fit.bound.lengths[0]), seed=seed)
        if inside is None:
            return _as_times(found, fit.bound, {})
        again = _differences(fit.bound, inside.theta, fit.paths, strengths, seed=seed)
        better = window_posterior(again)
        if better.throughout > _LEAST_DOUBT or not _in_several_blocks(again, better):
            return None
    except PmclError as error:
        _logger.debug("no window of %s can be told: %s", effect.name, error)
        return None
    names = [parameter.name for parameter in effect.parameters]
    values = {
        parameter.name: (float(mean), float(sd))
        for parameter, mean, sd in zip(inside.bound.parameters, inside.theta, inside.std, strict=True)
        if parameter.name in names
    }
    return _with_wider_intervals(_as_times(better, fit.bound, values), _as_times(found, fit.bound, {}))


def _positions(bound: BoundModel, effect: Effect) -> dict[int, float]:
    """Return the null of each free strength of an effect by the parameter's position in theta."""
    strengths = {effect.parameters[k].name: effect.null[k] for k in effect.strengths}
    return {i: strengths[name] for i, name in enumerate(bound.names) if name in strengths}


def _differences(
    bound: BoundModel, theta: Float, paths: Sequence[Float], strengths: Mapping[int, float], *, seed: int
) -> Float:
    """Return the log score of each row with multiples of the strengths less that without the effect, (M, T) [nat]."""

    def rows(multiple: float) -> Float:
        return row_scores(bound, _with_multiple(bound, theta, strengths, multiple), paths, seed=seed).rows

    without, differences = rows(0.0), []
    for multiple in _MULTIPLES:
        try:
            differences.append(rows(float(multiple)) - without)
        except FilterError:
            differences.append(np.full(bound.lengths[0], _NO_FILTER))
    return np.array(differences)


def _with_multiple(bound: BoundModel, theta: Float, strengths: Mapping[int, float], multiple: float) -> Float:
    """Return theta with strengths that are a multiple as far from "no effect", inside their priors."""
    values = theta.copy()
    for i, null in strengths.items():
        low, high = prior_support(bound.parameters[i].prior)
        margin = 1e-6 * (high - low) if np.isfinite(high - low) else 0.0
        moved = np.clip(null + multiple * (theta[i] - null), low + margin, high - margin)
        values[i] = null if multiple == 0.0 else moved
    return values


def _window(found: WindowPosterior, n_rows: int) -> tuple[int, int]:
    """Return the medians of the first row of the window and of the first row after it."""
    first = 0 if np.isnan(found.first).any() else _quantile(found.points, found.first, 0.5)
    last = n_rows if np.isnan(found.last).any() else _quantile(found.points, found.last, 0.5)
    return first, last


def _quantile(points: Int, distribution: Float, level: float) -> int:
    return int(points[min(int(np.searchsorted(np.cumsum(distribution), level)), points.size - 1)])


def _in_several_blocks(differences: Float, found: WindowPosterior) -> bool:
    """Return whether the rows outside of the window speak against the effect without the block that does most."""
    outside = -differences[found.multiple]
    first, last = _window(found, outside.size)
    outside[first:last] = 0.0
    return paired_gain(outside, np.zeros_like(outside), slice(None)).without_largest > _LEAST_GAIN


def _fit_inside(fit: Fit, first: int, last: int, *, seed: int) -> Fit | None:
    """Fit the model to the rows of a window alone; None where another effect of it may know the whole log only."""
    model = fit.bound.model
    if any(isinstance(effect.change, Formula) or not effect.may_begin for effect in model.effects):
        return None
    # The belief about the first pose is that of the fit of all rows, with twice its spread: the effect was too small.
    piece = fit.bound.logs[0].select(
        first, last, start_mean=fit.path[first, :3], start_std=2.0 * fit.path_std[first, :3] + 1e-3
    )
    return quick_fit(model.bind(piece), seed, theta=fit.theta, path=fit.path[first:last], effort=BRIEF)


def _with_wider_intervals(acts: Acting, first: Acting) -> Acting:
    """Return a window whose intervals hold those of a first estimate, too, where that has the same ends.

    The two differ where the pose follows the effect: a filter without an effect of the motion lags behind at the end of
    it, and the more so the larger the effect is. Either distribution alone says nothing of that.
    """

    def wider(moment: Moment | None, other: Moment | None) -> Moment | None:
        if moment is None or other is None:
            return moment
        return moment._replace(low=min(moment.low, other.low), high=max(moment.high, other.high))

    return replace(acts, begin=wider(acts.begin, first.begin), end=wider(acts.end, first.end))


def _as_times(found: WindowPosterior, bound: BoundModel, values: Mapping[str, tuple[float, float]]) -> Acting:
    times = np.asarray(bound.logs[0].times)

    def moment(distribution: Float, shift: int) -> Moment | None:
        if np.isnan(distribution).any():
            return None
        levels = (0.5, 0.5 * (1.0 - _COVERED), 0.5 * (1.0 + _COVERED))
        return Moment(*(float(times[_quantile(found.points, distribution, level) - shift]) for level in levels))

    # The last row with the effect is the one before the first row after the window.
    return Acting(moment(found.first, 0), moment(found.last, 1), 1.0 - found.throughout, values)
