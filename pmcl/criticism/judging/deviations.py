"""How unusual the numbers of a log are, compared with those of logs that the fitted model simulates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special, stats

from pmcl.errors import CriticismError
from pmcl.filtering.paired_scores import block_sums

__all__ = ["BlockSums", "Deviations", "OwnSpread", "deviations", "sums_of_rows"]

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]

# The largest block of a number counts at most this share of what all the others add up to (chosen by hand): it is at
# most a third of the number then, and one row cannot make an alarm.
_OF_THE_OTHERS = 0.5


class OwnSpread(NamedTuple):
    """What the rows of one log say of the spread of its numbers.

    Attributes
    ----------
    squares : callable
        ``squares(slope) -> (F,)``: sums of the squared rows of the numbers less ``slope.T @ parameter scores``, for a
        slope of shape (d, F).
    exposed : ndarray, shape (F,)
        In how many rows each number is not zero; a place counts only where the robot is there.
    """

    squares: Callable[[Float], Float]
    exposed: Float


class BlockSums(NamedTuple):
    """Numbers of one log as sums over blocks of rows.

    Attributes
    ----------
    blocks : ndarray, shape (F, B)
        The numbers; a single block says that they are no sums.
    parameters : ndarray, shape (d, B)
        Scores of the model's own parameters.
    spread : OwnSpread, optional
        Without it the rows say nothing of the spread.
    """

    blocks: Float
    parameters: Float
    spread: OwnSpread | None = None


def sums_of_rows(numbers: Float, parameters: Float) -> BlockSums:
    """Return the block sums of numbers (F, T) and of the parameters' scores (d, T) of one log, with their spread."""

    def squares(slope: Float) -> Float:
        return np.asarray(((numbers - slope.T @ parameters) ** 2).sum(axis=1))

    exposed = np.count_nonzero(numbers, axis=1).astype(float)
    return BlockSums(block_sums(numbers), block_sums(parameters), OwnSpread(squares, exposed))


class Deviations(NamedTuple):
    """How unusual numbers are.

    Attributes
    ----------
    z : ndarray, shape (1 + N, F)
        Deviations as standard normals, of the log first, then of each simulated log.
    value, std : ndarray, shape (F,)
        The log's numbers, from which `z` follows, and their standard deviation when the model is right. Of one-sided
        numbers the mean is not subtracted: a rise that never happens has a score without spread, and far below zero.
    """

    z: Float
    value: Float
    std: Float


def deviations(logs: Sequence[BlockSums], one_sided: Bool, rare: Bool | None = None) -> Deviations:
    """Return how unusual the numbers of a log are, and those of each simulated log.

    Parameters
    ----------
    logs : sequence of BlockSums
        The log, then the N simulated logs, each with F numbers.
    one_sided : ndarray of bool, shape (F,)
        Whether only large values are unusual.
    rare : ndarray of bool, shape (F,), optional
        Which numbers are scores of a mixture's weight; none where left out.

    Returns
    -------
    Deviations

    Raises
    ------
    CriticismError
        When a number is not finite.

    Notes
    -----
    Every number is regressed, over the simulated logs, on the scores of the model's own parameters. This removes what a
    refit of these parameters would explain; it is one Newton step of a refit of each simulated log. Residuals of a
    simulated log are studentised by the other simulated logs, so that log and simulations have a t distribution.

    Two further rules let no few rows decide. They never make a deviation larger. First, the largest block of fifteen
    rows is at most a third of a number of the log. The simulated logs' numbers are whole, so that p-values can only
    become larger by this rule. Fluctuations are no sums, but relative to the root of their sum of squares, which bounds
    what a single row can do. Second, the variance of a score grows with the squares of its own rows, where these are
    larger than in the simulated logs. This holds for the log and for the simulated logs alike. A score is a martingale
    when the model is right, and some tens of simulated logs say nothing of rare rows: with an ideal filter, the spread
    of other logs gave the weight of a gross error a p-value below 1e-5 in one log of a hundred. Let V be a third of the
    sum of the squared steps of a martingale M and two thirds of its expectation. Whatever the distribution of the
    steps, M exceeds x while V is at most v with a probability of at most exp(-x^2 / (2 v)) (Delyon 2009). The variance
    used here is that of the simulated logs times V over their mean of it, since the path absorbs much of most scores.
    It absorbs no weight of a mixture: the variance of its score is at least V. Such a score loses the same at nearly
    every reading and wins at few, and simulated logs in which it never wins are all alike.

    References
    ----------
    Delyon, Exponential inequalities for sums of weakly dependent variables, Electronic J. Probability 14, 2009.
    """
    values = np.array([log.blocks.sum(axis=1) for log in logs])
    parameters = np.array([log.parameters.sum(axis=1) for log in logs])
    if not (np.isfinite(values).all() and np.isfinite(parameters).all()):
        raise CriticismError("a score or residual is not a number; check the model's tables and its effects")
    n, d = values.shape[0] - 1, parameters.shape[1]
    scale = parameters[1:].std(axis=0) + 1e-300
    design = np.column_stack([np.ones(n + 1), (parameters - parameters[1:].mean(axis=0)) / scale])
    inverse = np.linalg.pinv(design[1:].T @ design[1:])
    coefficients = inverse @ design[1:].T @ values[1:]
    slope = coefficients[1:] / scale[:, None]
    residual = values - design @ coefficients
    leverage = np.einsum("ij,jk,ik->i", design, inverse, design)
    squares = (residual[1:] ** 2).sum(axis=0)
    freedom = n - d - 1
    floor = 1e-12 * np.abs(values).max(axis=0, initial=0.0) ** 2 + 1e-300
    left = np.maximum(1.0 - leverage[1:, None], 1e-6)
    others = np.maximum(squares - residual[1:] ** 2 / left, 0.0) / (freedom - 1)
    variance = np.concatenate([(squares / freedom * (1.0 + leverage[0]))[None], others * left]) + floor
    spreads = [log.spread for log in logs if log.spread is not None]
    if len(spreads) == len(logs):
        larger, least = _larger_spread(spreads, slope, floor)
        variance *= larger
        if rare is not None:
            variance = np.where(rare, np.maximum(variance, least), variance)
    constant = values[0] - residual[0] - parameters[0] @ slope
    if logs[0].blocks.shape[1] > 1:
        blocks = logs[0].blocks - slope.T @ logs[0].parameters - constant[:, None] / logs[0].blocks.shape[1]
        residual[0] = _with_bounded_block(blocks)
    t = residual / np.sqrt(variance)
    z = np.concatenate([_as_normal(t[:1], freedom), _as_normal(t[1:], freedom - 1)])
    # A small value of a one-sided number is not unusual. This wastes half of the two-sided probability.
    z = np.where(one_sided, np.maximum(z, 0.0), z)
    value = residual[0] + np.where(one_sided, constant, 0.0)
    return Deviations(z, value, np.sqrt(variance[0]))


def _larger_spread(spreads: Sequence[OwnSpread], slope: Float, floor: Float) -> tuple[Float, Float]:
    """Return by what factor the variance of each number grows for its own rows, at least one, and V, both (1 + N, F).

    See the notes of :func:`deviations`. The expected squares of a log are those of the rows of the other simulated
    logs, for as many rows as count in this one: a robot may stay at a place that the simulated ones hardly visit.
    """
    own = np.array([spread.squares(slope) for spread in spreads])
    rows = np.array([spread.exposed for spread in spreads])
    n = len(spreads) - 1

    def of_other_simulated_logs(numbers: Float) -> Float:
        return np.asarray(numbers[1:].sum(axis=0) - np.vstack([np.zeros_like(numbers[:1]), numbers[1:]]))

    others = of_other_simulated_logs(own)
    usual = others / np.array([n, *[n - 1] * n])[:, None]
    expected = np.maximum(usual, others * rows / np.maximum(of_other_simulated_logs(rows), 1.0))
    larger = np.maximum(1.0, (2.0 * expected + own + floor) / (3.0 * usual + floor))
    return np.asarray(larger), np.asarray((2.0 * expected + own) / 3.0)


def _with_bounded_block(blocks: Float) -> Float:
    """Return sums over blocks (F, B) in which the largest block counts at most half of what the others add up to.

    The result is zero where the others say nothing, or the opposite.
    """
    total = blocks.sum(axis=1)
    sign = np.where(total > 0.0, 1.0, -1.0)
    largest = np.maximum((sign[:, None] * blocks).max(axis=1), 0.0)
    others = np.maximum(sign * total - largest, 0.0)
    return np.asarray(sign * (others + np.minimum(largest, _OF_THE_OTHERS * others)))


def _as_normal(t: Float, freedom: int) -> Float:
    log_tail = stats.t.logsf(np.abs(t), freedom)
    return np.sign(t) * -special.ndtri_exp(np.minimum(log_tail, np.log(0.5)))
