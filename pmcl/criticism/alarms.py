"""What is unusual about a log, judged by logs that the fitted model simulates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special, stats

from pmcl.criticism.evidence import Evidence
from pmcl.criticism.features import FAMILIES, Feature
from pmcl.criticism.scores import Direction
from pmcl.errors import CriticismError

__all__ = ["Alarm", "Judgement", "judge"]

Float = NDArray[np.float64]

# Of a score of one place whose squares, row by row, are this many times those of half of the simulated logs these know
# nothing: the robot was where it hardly ever is in them.
_ELSEWHERE = 1000.0


class Alarm(NamedTuple):
    """One family of numbers, taken together.

    Attributes
    ----------
    family : str
        One of :data:`pmcl.criticism.features.FAMILIES`.
    p_value : float
        Probability of a greatest deviation like this one when the model is right.
    raised : bool
        Whether it is an alarm, all families considered (Holm 1979).
    worst : Feature
        What deviates most.
    z : float
        By how much, as a standard normal.
    """

    family: str
    p_value: float
    raised: bool
    worst: Feature
    z: float


@dataclass(frozen=True)
class Judgement:
    """What alarms say about one log and model.

    Attributes
    ----------
    alarms : tuple of Alarm
        One for each family that the log offers.
    z : ndarray, shape (K,)
        Deviation of each candidate's score as a standard normal, parameters of the model projected out.
    p_values : ndarray, shape (K,)
        Of each candidate by itself.
    critical_z : float
        What the greatest |z| of all candidates exceeds in 5 % of logs without a missing effect.
    features : tuple of Feature
        All residual and fluctuation features,
    feature_z : ndarray, shape (F,)
        and their deviations.
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


def judge(
    found: Evidence, null: Sequence[Evidence], wanted: Sequence[Direction], *, level: float, rows: int | None = None
) -> Judgement:
    """Compare what a log tells with what simulated logs tell.

    Parameters
    ----------
    found : Evidence
        From the log.
    null : sequence of Evidence
        From logs simulated by the fitted model, at least ten more than it has parameters.
    wanted : sequence of Direction
        The K candidates that were scored.
    level : float
        Rate of false alarms.
    rows : int, optional
        Count only these first rows of the scores (the part that models are fitted on).

    Returns
    -------
    Judgement

    Raises
    ------
    CriticismError
        When a number is not finite.

    Notes
    -----
    Every number is regressed, over the simulated logs, on the scores of the model's own parameters: what refitting
    these would explain is thereby taken out (the one-step form of a refit of each simulated log). Residuals are
    studentised with the simulated log itself left out, so that log and simulations have the same t distribution. The
    greatest deviation of a family counts as that of K' independent ones, where K' fits the greatest deviations of the
    simulated logs; a family's size need not be known, and its tail need not be seen.

    A score is a martingale when the model is right, so the sum of its squared rows estimates its variance in this very
    log. Where that is very many times what it is in half of the simulated logs, as for a patch of floor that the robot
    hardly ever visits in them, their spread says nothing of this log, and the variance is no less than that sum.
    """
    score = np.array([one.scores[:, :rows].sum(axis=1) for one in (found, *null)])
    numbers = np.array([one.numbers for one in (found, *null)])
    base = np.array([one.base[:, :rows].sum(axis=1) for one in (found, *null)])
    base_all = np.array([one.base.sum(axis=1) for one in (found, *null)])
    if not all(np.isfinite(values).all() for values in (score, numbers, base, base_all)):
        raise CriticismError("a score or residual is not a number; check the model's tables and its effects")
    local = np.array([bool(one.effect.where) and "beams" not in one.effect.where for one in wanted], dtype=bool)
    squares = np.array([(one.scores[:, :rows] ** 2).sum(axis=1) for one in (found, *null)]) * local
    # The log's own scores of fitted parameters vanish but for Monte Carlo error: what counts is that they are known.
    score_z = _studentised(score, base, np.array([one.one_sided for one in wanted], dtype=bool), squares)
    number_z = _studentised(numbers, base_all, np.array([f.one_sided for f in found.features], dtype=bool))
    families = {name: [k for k, f in enumerate(found.features) if f.family == name] for name in FAMILIES}
    judged: list[tuple[str, float, Feature, float]] = []
    critical = np.inf
    for family in FAMILIES:
        members = list(range(len(wanted))) if family == "score" else families[family]
        if not members:
            continue
        deviations = score_z if family == "score" else number_z[:, members]
        p_value, worst, size = _family(deviations)
        if family == "score":
            direction = wanted[worst]
            feature = Feature("score", direction.effect.name, one_sided=direction.one_sided)
            critical = float(-special.ndtri(0.5 * -np.expm1(np.log1p(-0.05) / size)))
        else:
            feature = found.features[members[worst]]
        judged.append((family, p_value, feature, float(deviations[0, worst])))
    raised = _holm([p for _, p, _, _ in judged], level)
    alarms = tuple(
        Alarm(family, p_value, bool(yes), feature, z)
        for (family, p_value, feature, z), yes in zip(judged, raised, strict=True)
    )
    one_sided = np.array([one.one_sided for one in wanted], dtype=bool)
    return Judgement(alarms, score_z[0], _p_values(score_z[0], one_sided), critical, found.features, number_z[0])


def _studentised(values: Float, base: Float, one_sided: NDArray[np.bool_], own: Float | None = None) -> Float:
    """Return deviations (1 + N, F) as standard normals: the log first, then each simulated log by the others.

    `own`, (1 + N, F), are variances that logs tell by themselves; they count where others cannot know them.
    """
    n, d = values.shape[0] - 1, base.shape[1]
    scale = base[1:].std(axis=0) + 1e-300
    design = np.column_stack([np.ones(n + 1), (base - base[1:].mean(axis=0)) / scale])
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
    if own is not None:
        alone = own > _ELSEWHERE * np.median(own[1:], axis=0)
        bounded = np.abs(residual) / np.sqrt(own + floor)
        t = np.where(alone, np.sign(t) * np.minimum(np.abs(t), bounded), t)
    z = np.empty_like(t)
    z[0], z[1:] = _as_normal(t[0], freedom), _as_normal(t[1:], freedom - 1)
    # Where only large values are remarkable a small one is none: half the two-sided probability is given away.
    return np.where(one_sided, np.maximum(z, 0.0), z)


def _as_normal(t: Float, freedom: int) -> Float:
    log_tail = stats.t.logsf(np.abs(t), freedom)
    return np.sign(t) * -special.ndtri_exp(np.minimum(log_tail, np.log(0.5)))


def _p_values(z: Float, one_sided: NDArray[np.bool_]) -> Float:
    return np.where(one_sided, special.ndtr(-z), 2.0 * special.ndtr(-np.abs(z)))


def _family(deviations: Float) -> tuple[float, int, float]:
    """Return (p-value of the greatest deviation of row 0, its position, effective number of members)."""
    greatest = np.abs(deviations).max(axis=1)
    p = 2.0 * special.ndtr(-greatest)
    # p-values of the greatest of K' independent deviations are Beta(1, K'); K' by maximum likelihood.
    size = max(1.0, (p.size - 1) / max(-np.log1p(-np.minimum(p[1:], 1.0 - 1e-12)).sum(), 1e-12))
    return float(-np.expm1(size * np.log1p(-p[0]))) if p[0] < 1.0 else 1.0, int(
        np.abs(deviations[0]).argmax()
    ), float(size)


def _holm(p_values: list[float], level: float) -> list[bool]:
    raised = [False] * len(p_values)
    for rank, k in enumerate(np.argsort(p_values)):
        if p_values[k] > level / (len(p_values) - rank):
            break
        raised[k] = True
    return raised
