"""Tests of what is unusual about a log, compared with logs that the fitted model simulates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special, stats

from pmcl.criticism.scoring.features import FAMILIES, Feature
from pmcl.criticism.scoring.scored_log import ScoredLog
from pmcl.criticism.scoring.scores import Direction
from pmcl.errors import CriticismError
from pmcl.filtering.paired_scores import block_sums

__all__ = [
    "Alarm", "BlockSums", "Deviations", "Judgement", "OwnSpread", "deviations", "family_critical_z", "judge",
    "sums_of_rows",
]  # fmt: skip

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]

# The largest block of a number counts at most this share of what all the others add up to (chosen by hand): it is at
# most a third of the number then, and one row cannot make an alarm.
_OF_THE_OTHERS = 0.5
# Share of logs without a missing effect in which the greatest score exceeds the critical value.
_CRITICAL_LEVEL = 0.05


class Alarm(NamedTuple):
    """The test of one family of numbers, taken together.

    Attributes
    ----------
    family : str
        One of :data:`pmcl.criticism.scoring.features.FAMILIES`, or the name of a statistic of the user's own.
    p_value : float
        Probability of a greatest deviation at least this large when the model is right.
    raised : bool
        Whether it is an alarm, all families considered (Holm 1979).
    worst : Feature
        The feature that deviates most.
    z : float
        Its deviation, as a standard normal.
    """

    family: str
    p_value: float
    raised: bool
    worst: Feature
    z: float


@dataclass(frozen=True)
class Judgement:
    """The tests of one log and model.

    Attributes
    ----------
    alarms : tuple of Alarm
        One for each family for which the log has numbers.
    z : ndarray, shape (K,)
        Deviation of each candidate's score as a standard normal, after the model's parameters are projected out.
    p_values : ndarray, shape (K,)
        P-value of each candidate, not corrected for their number.
    score, score_std : ndarray, shape (K,)
        Each candidate's score, after the model's parameters are projected out and its largest block is bounded, and its
        standard deviation when the model is right [nat].
    critical_z : float
        Bound that the greatest |z| of all candidates exceeds in 5 % of logs without a missing effect.
    features : tuple of Feature
        All residual and fluctuation features.
    feature_z : ndarray, shape (F,)
        Deviations of the features.
    """

    alarms: tuple[Alarm, ...]
    z: Float
    p_values: Float
    score: Float
    score_std: Float
    critical_z: float
    features: tuple[Feature, ...]
    feature_z: Float

    @property
    def raised(self) -> tuple[Alarm, ...]:
        """The alarms, most significant first."""
        return tuple(sorted((alarm for alarm in self.alarms if alarm.raised), key=lambda alarm: alarm.p_value))

    @property
    def raised_p_values(self) -> tuple[float, ...]:
        """P-values of :attr:`raised`, all families considered: adjusted by Holm's rule (1979).

        An alarm is raised where its adjusted p-value is at most the rate of false alarms that was asked for, and the
        smallest one is :attr:`p_value`.
        """
        ordered = np.sort([alarm.p_value for alarm in self.alarms])
        adjusted = np.maximum.accumulate(np.minimum(ordered * np.arange(ordered.size, 0, -1), 1.0))
        return tuple(float(p) for p in adjusted[: len(self.raised)])

    @property
    def p_value(self) -> float:
        """Probability of any such alarm when the model is right."""
        return min((min(1.0, alarm.p_value * len(self.alarms)) for alarm in self.alarms), default=1.0)


class _FamilyTest(NamedTuple):
    """The greatest deviation of a family: its p-value, its position, and the family's effective size."""

    p_value: float
    worst: int
    size: float


def judge(
    scored: ScoredLog,
    simulated: Sequence[ScoredLog],
    directions: Sequence[Direction],
    *,
    level: float,
    rows: int | None = None,
) -> Judgement:
    """Compare the numbers of a log with those of simulated logs.

    Parameters
    ----------
    scored : ScoredLog
        The log.
    simulated : sequence of ScoredLog
        Logs simulated by the fitted model, at least ten more than it has parameters.
    directions : sequence of Direction
        The K candidates that were scored.
    level : float
        Rate of false alarms.

    Returns
    -------
    Judgement

    Raises
    ------
    CriticismError
        When a number is not finite.

    Notes
    -----
    Every number is regressed, over the simulated logs, on the scores of the model's own parameters. This removes what a
    refit of these parameters would explain; it is one Newton step of a refit of each simulated log. Residuals of a
    simulated log are studentised by the other simulated logs, so that log and simulations have a t distribution. The
    greatest deviation of a family is treated as that of K' independent ones, where K' is fitted to the greatest
    deviations of the simulated logs. The size of a family and the tail of its distribution need not be known.

    Two further rules let no few rows decide. They never make a deviation larger. First, the largest block of fifteen
    rows is at most a third of a number of the log. The simulated logs' numbers are whole, so that p-values can only
    become larger by this rule. Fluctuations are no sums, but relative to the root of their sum of squares, which bounds
    what a single row can do. Second, the variance of a score grows with the squares of its own rows, where these are
    larger than in the simulated logs. This holds for the log and for the simulated logs alike. A score is a martingale
    when the model is right, and some tens of simulated logs say nothing of rare rows: with an ideal filter, the spread
    of other logs gave the weight of a gross error a p-value below 1e-5 in one log of a hundred. Let V be a third of the
    sum of the squared steps of a martingale M and two thirds of its expectation. Whatever the distribution of the
    steps, M exceeds x while V is at most v with a probability of at most exp(-x^2 / (2 v)) (Delyon 2009). The variance
    used here is V, or that of the simulated logs where this is larger.

    References
    ----------
    Delyon, Exponential inequalities for sums of weakly dependent variables, Electronic J. Probability 14, 2009.
    """
    logs = (scored, *simulated)
    one_sided = np.array([direction.one_sided for direction in directions], dtype=bool)
    # Scores of the fitted parameters vanish in the log but for Monte Carlo error; those of the simulated logs do not.
    of_scores = deviations(
        [sums_of_rows(log.scores, log.parameter_scores) for log in logs], one_sided
    )
    score_z = of_scores.z
    features = scored.features
    feature_sides = np.array([feature.one_sided for feature in features], dtype=bool)
    n_residuals = scored.residual_blocks.shape[0]
    parameters = [block_sums(log.parameter_scores) for log in logs]
    number_z = np.hstack(
        [
            deviations(
                [BlockSums(log.residual_blocks, own) for log, own in zip(logs, parameters, strict=True)],
                feature_sides[:n_residuals],
            ).z,
            deviations(
                [
                    BlockSums(log.fluctuations[:, None], own.sum(axis=1, keepdims=True))
                    for log, own in zip(logs, parameters, strict=True)
                ],
                feature_sides[n_residuals:],
            ).z,
        ]
    )
    tests: list[tuple[str, _FamilyTest, Feature, float]] = []
    critical = np.inf
    own = dict.fromkeys(feature.family for feature in features if feature.family not in FAMILIES)
    for family in (*FAMILIES, *own):
        members = [k for k, feature in enumerate(features) if feature.family == family]
        members = list(range(len(directions))) if family == "score" else members
        if not members:
            continue
        of_family = score_z if family == "score" else number_z[:, members]
        test = _test_family(of_family)
        if family == "score":
            direction = directions[test.worst]
            feature = Feature("score", direction.effect.name, one_sided=direction.one_sided)
            critical = _critical_z(test.size)
        else:
            feature = features[members[test.worst]]
        tests.append((family, test, feature, float(of_family[0, test.worst])))
    raised = _holm([test.p_value for _, test, _, _ in tests], level)
    alarms = tuple(
        Alarm(family, test.p_value, bool(is_raised), feature, z)
        for (family, test, feature, z), is_raised in zip(tests, raised, strict=True)
    )
    p_values = _p_values(score_z[0], one_sided)
    return Judgement(
        alarms, score_z[0], p_values, of_scores.value, of_scores.std, critical, features, number_z[0]
    )


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


def deviations(logs: Sequence[BlockSums], one_sided: Bool) -> Deviations:
    """Return how unusual the numbers of a log are, and those of each simulated log.

    Parameters
    ----------
    logs : sequence of BlockSums
        The log, then the N simulated logs, each with F numbers.
    one_sided : ndarray of bool, shape (F,)
        Whether only large values are unusual.

    Returns
    -------
    Deviations
        See the notes of :func:`judge`.

    Raises
    ------
    CriticismError
        When a number is not finite.
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
        variance *= _larger_spread(spreads, slope, floor)
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


def _larger_spread(spreads: Sequence[OwnSpread], slope: Float, floor: Float) -> Float:
    """Return by what factor the variance of each number grows for its own rows, (1 + N, F): at least one.

    See the notes of :func:`judge`. The expected squares of a log are those of the rows of the other simulated logs, for
    as many rows as count in this one: a robot may stay at a place that the simulated ones hardly visit.
    """
    own = np.array([spread.squares(slope) for spread in spreads])
    rows = np.array([spread.exposed for spread in spreads])
    n = len(spreads) - 1

    def of_other_simulated_logs(numbers: Float) -> Float:
        return np.asarray(numbers[1:].sum(axis=0) - np.vstack([np.zeros_like(numbers[:1]), numbers[1:]]))

    others = of_other_simulated_logs(own)
    usual = others / np.array([n, *[n - 1] * n])[:, None]
    expected = np.maximum(usual, others * rows / np.maximum(of_other_simulated_logs(rows), 1.0))
    return np.asarray(np.maximum(1.0, (2.0 * expected + own + floor) / (3.0 * usual + floor)))


def _with_bounded_block(blocks: Float) -> Float:
    """Return sums over blocks (F, B) in which the largest block counts at most half of what the others add up to.

    The result is zero where the others say nothing, or the opposite.
    """
    total = blocks.sum(axis=1)
    sign = np.where(total > 0.0, 1.0, -1.0)
    largest = np.maximum((sign[:, None] * blocks).max(axis=1), 0.0)
    others = np.maximum(sign * total - largest, 0.0)
    return np.asarray(sign * (others + np.minimum(largest, _OF_THE_OTHERS * others)))


def family_critical_z(z: Float) -> float:
    """Return the bound that the greatest deviation of a family exceeds in 5 % of logs without a missing effect.

    Parameters
    ----------
    z : ndarray, shape (1 + N, F)
        Deviations, see :func:`deviations`.
    """
    return _critical_z(_test_family(z).size)


def _critical_z(size: float) -> float:
    return float(-special.ndtri(0.5 * -np.expm1(np.log1p(-_CRITICAL_LEVEL) / size)))


def _as_normal(t: Float, freedom: int) -> Float:
    log_tail = stats.t.logsf(np.abs(t), freedom)
    return np.sign(t) * -special.ndtri_exp(np.minimum(log_tail, np.log(0.5)))


def _p_values(z: Float, one_sided: Bool) -> Float:
    return np.where(one_sided, special.ndtr(-z), 2.0 * special.ndtr(-np.abs(z)))


def _test_family(deviations: Float) -> _FamilyTest:
    """Test the greatest deviation of row 0, (1 + N, F), by those of the other rows."""
    greatest = np.abs(deviations).max(axis=1)
    p = 2.0 * special.ndtr(-greatest)
    # The p-value of the greatest of K' independent deviations has the distribution Beta(1, K'); K' is estimated by
    # maximum likelihood.
    size = max(1.0, (p.size - 1) / max(-np.log1p(-np.minimum(p[1:], 1.0 - 1e-12)).sum(), 1e-12))
    p_value = float(-np.expm1(size * np.log1p(-p[0]))) if p[0] < 1.0 else 1.0
    return _FamilyTest(p_value, int(np.abs(deviations[0]).argmax()), float(size))


def _holm(p_values: list[float], level: float) -> list[bool]:
    """Return which hypotheses the step-down rule of Holm (1979) rejects."""
    raised = [False] * len(p_values)
    for rank, k in enumerate(np.argsort(p_values)):
        if p_values[k] > level / (len(p_values) - rank):
            break
        raised[k] = True
    return raised
