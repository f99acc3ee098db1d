"""Tests of what is unusual about a log, compared with logs that the fitted model simulates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from pmcl.criticism.judging.deviations import BlockSums, deviations, sums_of_rows
from pmcl.criticism.scoring.features import FAMILIES, Feature
from pmcl.criticism.scoring.scored_log import ScoredLog
from pmcl.criticism.scoring.scores import Direction
from pmcl.filtering.paired_scores import block_sums

__all__ = ["Alarm", "Judgement", "family_critical_z", "judge"]

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]

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
    plain_z, plain_std : ndarray, shape (K,)
        The same as `z` and `score_std` without the rules by which no few rows decide. They raise no alarm.
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
    plain_z: Float
    plain_std: Float
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
    Deviations are those of :func:`pmcl.criticism.judging.deviations.deviations`. The greatest deviation of a family is
    treated as that of K' independent ones, where K' is fitted to the greatest deviations of the simulated logs. The
    size of a family and the tail of its distribution need not be known.
    """
    logs = (scored, *simulated)
    one_sided = np.array([direction.one_sided for direction in directions], dtype=bool)
    # Scores of the fitted parameters vanish in the log but for Monte Carlo error; those of the simulated logs do not.
    rare = np.array([direction.of_weight for direction in directions], dtype=bool)
    of_scores = deviations([sums_of_rows(log.scores, log.parameter_scores) for log in logs], one_sided, rare)
    score_z = of_scores.z
    plain = deviations([BlockSums(_whole(log.scores), _whole(log.parameter_scores)) for log in logs], one_sided)
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
        alarms, score_z[0], p_values, of_scores.value, of_scores.std, plain.z[0], plain.std, critical, features,
        number_z[0],
    )  # fmt: skip


def _whole(rows: Float) -> Float:
    """Return sums over all rows (F, T) as a single block."""
    return np.asarray(rows.sum(axis=1, keepdims=True))


def family_critical_z(z: Float) -> float:
    """Return the bound that the greatest deviation of a family exceeds in 5 % of logs without a missing effect.

    Parameters
    ----------
    z : ndarray, shape (1 + N, F)
        Deviations, see :func:`pmcl.criticism.judging.deviations.deviations`.
    """
    return _critical_z(_test_family(z).size)


def _critical_z(size: float) -> float:
    return float(-special.ndtri(0.5 * -np.expm1(np.log1p(-_CRITICAL_LEVEL) / size)))


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
