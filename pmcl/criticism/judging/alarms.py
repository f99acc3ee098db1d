"""Tests of what is unusual about a log, compared with logs that the fitted model simulates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special, stats

from pmcl.criticism.scoring.features import FAMILIES, Feature
from pmcl.criticism.scoring.scored_log import ScoredLog
from pmcl.criticism.scoring.scores import Direction
from pmcl.errors import CriticismError

__all__ = ["Alarm", "Judgement", "judge"]

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]

# When the sum of squares of a score of one place exceeds the median of the simulated logs by this factor, the robot was
# at a place where it hardly ever is in these, and their spread does not apply to the log. Chosen by hand, after a robot
# in a corner that simulated robots never reached had raised an alarm.
_UNVISITED_FACTOR = 1000.0
# Share of logs without a missing effect in which the greatest score exceeds the critical value.
_CRITICAL_LEVEL = 0.05


class Alarm(NamedTuple):
    """The test of one family of numbers, taken together.

    Attributes
    ----------
    family : str
        One of :data:`pmcl.criticism.scoring.features.FAMILIES`.
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
    rows : int, optional
        Count only so many first rows of the scores (the part on which models are fitted).

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

    A score is a martingale when the model is right, so the sum of its squared rows estimates its variance in this very
    log. When this sum is far larger than in the median simulated log, as for a patch of floor that the robot hardly
    ever visits in these, the spread of the simulated logs does not apply, and the variance is at least this sum.
    """
    logs = (scored, *simulated)
    score = np.array([log.scores[:, :rows].sum(axis=1) for log in logs])
    numbers = np.array([log.feature_values for log in logs])
    parameters = np.array([log.parameter_scores[:, :rows].sum(axis=1) for log in logs])
    parameters_all_rows = np.array([log.parameter_scores.sum(axis=1) for log in logs])
    if not all(np.isfinite(values).all() for values in (score, numbers, parameters, parameters_all_rows)):
        raise CriticismError("a score or residual is not a number; check the model's tables and its effects")
    local = np.array(
        [bool(direction.effect.where) and "beams" not in direction.effect.where for direction in directions],
        dtype=bool,
    )
    squares = np.array([(log.scores[:, :rows] ** 2).sum(axis=1) for log in logs]) * local
    one_sided = np.array([direction.one_sided for direction in directions], dtype=bool)
    # Scores of the fitted parameters vanish in the log but for Monte Carlo error; those of the simulated logs do not.
    score_z = _studentised(score, parameters, one_sided, squares)
    features = scored.features
    number_z = _studentised(
        numbers, parameters_all_rows, np.array([feature.one_sided for feature in features], dtype=bool)
    )
    tests: list[tuple[str, _FamilyTest, Feature, float]] = []
    critical = np.inf
    for family in FAMILIES:
        members = [k for k, feature in enumerate(features) if feature.family == family]
        members = list(range(len(directions))) if family == "score" else members
        if not members:
            continue
        deviations = score_z if family == "score" else number_z[:, members]
        test = _test_family(deviations)
        if family == "score":
            direction = directions[test.worst]
            feature = Feature("score", direction.effect.name, one_sided=direction.one_sided)
            critical = float(-special.ndtri(0.5 * -np.expm1(np.log1p(-_CRITICAL_LEVEL) / test.size)))
        else:
            feature = features[members[test.worst]]
        tests.append((family, test, feature, float(deviations[0, test.worst])))
    raised = _holm([test.p_value for _, test, _, _ in tests], level)
    alarms = tuple(
        Alarm(family, test.p_value, bool(is_raised), feature, z)
        for (family, test, feature, z), is_raised in zip(tests, raised, strict=True)
    )
    return Judgement(alarms, score_z[0], _p_values(score_z[0], one_sided), critical, features, number_z[0])


def _studentised(values: Float, parameters: Float, one_sided: Bool, own_variance: Float | None = None) -> Float:
    """Return deviations as standard normals: of the log first, then of each simulated log.

    Parameters
    ----------
    values : ndarray, shape (1 + N, F)
        Numbers of the log and of the N simulated logs.
    parameters : ndarray, shape (1 + N, d)
        Scores of the model's own parameters, which are projected out.
    one_sided : ndarray of bool, shape (F,)
        Whether only large values are unusual.
    own_variance : ndarray, shape (1 + N, F), optional
        Variances estimated from each log alone; they count where the spread of the simulated logs does not apply.

    Returns
    -------
    ndarray, shape (1 + N, F)
    """
    n, d = values.shape[0] - 1, parameters.shape[1]
    scale = parameters[1:].std(axis=0) + 1e-300
    design = np.column_stack([np.ones(n + 1), (parameters - parameters[1:].mean(axis=0)) / scale])
    inverse = np.linalg.pinv(design[1:].T @ design[1:])
    slope = inverse @ design[1:].T @ values[1:]
    residual = values - design @ slope
    leverage = np.einsum("ij,jk,ik->i", design, inverse, design)
    squares = (residual[1:] ** 2).sum(axis=0)
    freedom = n - d - 1
    floor = 1e-12 * (np.abs(values[1:]).max(axis=0) ** 2 + 1e-300)
    t = np.empty_like(values)
    t[0] = residual[0] / np.sqrt((squares / freedom + floor) * (1.0 + leverage[0]))
    left = np.maximum(1.0 - leverage[1:, None], 1e-6)
    others = np.maximum(squares - residual[1:] ** 2 / left, 0.0) / (freedom - 1) + floor
    t[1:] = residual[1:] / np.sqrt(others * left)
    if own_variance is not None:
        unvisited = own_variance > _UNVISITED_FACTOR * np.median(own_variance[1:], axis=0)
        bounded = np.abs(residual) / np.sqrt(own_variance + floor)
        t = np.where(unvisited, np.sign(t) * np.minimum(np.abs(t), bounded), t)
    z = np.empty_like(t)
    z[0], z[1:] = _as_normal(t[0], freedom), _as_normal(t[1:], freedom - 1)
    # A small value of a one-sided number is not unusual. This wastes half of the two-sided probability.
    return np.where(one_sided, np.maximum(z, 0.0), z)


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
