"""How probable each explanation of a log is: nothing, an effect that was tried, or something that nobody has named.

The posterior probability of an explanation is its prior probability times its evidence, over the sum of these. The
evidence of an effect is :attr:`pmcl.criticism.fitting.trials.Trial.evidence`. It comes from particles and from a chain
of some length, so that it is a random number itself; probabilities are means over this noise, and two effects whose
evidences differ by less than their noise share the probability. These probabilities decide everything about a name:
what is worth a longer fit, when the search ends, which name is told, and which others with it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from pmcl.criticism.findings.parts import Alternative, FoundEffect
from pmcl.criticism.fitting.quick_fit import BRIEF, GLANCE, THOROUGH
from pmcl.criticism.fitting.trials import Trial
from pmcl.criticism.judging.alarms import Judgement
from pmcl.criticism.scoring.scores import Direction, instance_key
from pmcl.filtering.particle_filter import make_rng
from pmcl.models.effects.effect import Effect
from pmcl.models.effects.formula import PREFIX

__all__ = [
    "CREDIBLE", "LEAST_LISTED", "NOTHING_PRIOR", "Explanations", "evidence_of_scores", "explanations",
    "log_prior_odds", "nothing_without_refits", "suspects", "unknown_without_refits", "with_probabilities",
]  # fmt: skip

Float = NDArray[np.float64]

NOTHING_PRIOR = 0.5
"""Prior probability that the model lacks nothing. The other half is shared alike by the families of effects that the
log can show, by formulas, and by what no catalogue has; each family shares its part alike among its places."""
CREDIBLE = 0.9
"""Explanations that have this probability together are the answer: one name, or the few that may be meant. What can
have the rest of it is worth a longer fit."""
LEAST_LISTED = 0.01
"""Explanations below this probability are not listed."""
# What the length of a fit adds to the noise of an evidence: a standard deviation [nat], and a share of the evidence,
# because a short chain leaves in the path what the path can absorb. Sixty fits of ten logs of analyses/hidden_effects
# (block 105), each continued twice: a brief fit differs from a thorough one by less than a nat up to 9000 nats, and two
# thorough ones by as much; a glance by 2 nats, or by 2 to 8 % above 200 nats.
_FIT_NOISE = {GLANCE: (3.0, 0.04), BRIEF: (1.0, 0.005), THOROUGH: (0.7, 0.0)}
# Draws of the noise over which probabilities are averaged; their own error is then below a per cent.
_NOISE_DRAWS = 4000
_UNKNOWN = "unknown effect"
_NONE_SAME: Mapping[str, str] = {}


class Explanations(NamedTuple):
    """Posterior probabilities of the explanations of a log, over the current model; they sum to one.

    Attributes
    ----------
    nothing : float
        Probability that the model lacks nothing.
    unknown : float
        Probability that it lacks what is neither an effect that was tried nor a formula: an upper bound.
    effects : tuple of Effect
        The effects that were tried, the most probable first.
    probabilities : tuple of float
        Their probabilities, whether or not something unknown is there besides.
    may_be_right : tuple of Effect
        Those that would belong to the answer if their evidence were a standard deviation of its noise greater.
    """

    nothing: float
    unknown: float
    effects: tuple[Effect, ...]
    probabilities: tuple[float, ...]
    may_be_right: tuple[Effect, ...] = ()

    @property
    def named(self) -> float:
        """Probability of all effects that were tried."""
        return sum(self.probabilities)

    @property
    def explained(self) -> bool:
        """Whether the log is explained: little is left for nothing and for something unknown."""
        return self.named >= CREDIBLE

    @property
    def likely(self) -> bool:
        """Whether it is more probable that one of the effects is right than that none is."""
        return self.named > 0.5

    @property
    def credible(self) -> tuple[Effect, ...]:
        """The fewest effects that have together the share :data:`CREDIBLE` of what all effects have."""
        before = np.cumsum(self.probabilities) - self.probabilities
        return tuple(
            effect for effect, share in zip(self.effects, before, strict=True) if share < CREDIBLE * self.named
        )

    def of(self, effect: Effect) -> float:
        """Return the probability of an effect at its place; zero if it was not tried."""
        key = instance_key(effect)
        return next(
            (p for other, p in zip(self.effects, self.probabilities, strict=True) if instance_key(other) == key), 0.0
        )

    def beside(self, effect: Effect) -> tuple[Alternative, ...]:
        """Return what else may explain the log, the most probable first; what has less than a per cent is left out."""
        others = [
            Alternative(other.name, other.where, p)
            for other, p in zip(self.effects, self.probabilities, strict=True)
            if instance_key(other) != instance_key(effect)
        ]
        others += [Alternative(_UNKNOWN, {}, self.unknown), Alternative("nothing", {}, self.nothing)]
        listed = [one for one in others if one.probability >= LEAST_LISTED]
        return tuple(sorted(listed, key=lambda one: -one.probability))


def explanations(
    current: Trial,
    trials: Sequence[Trial],
    directions: Sequence[Direction],
    formulas: int,
    p_value: float,
    seed: int,
    p_value_with: float | None = None,
    same: Mapping[str, str] = _NONE_SAME,
) -> Explanations:
    """Return the posterior probabilities of nothing, of each effect that was refitted, and of something unknown.

    Parameters
    ----------
    current : Trial
        The current model.
    trials : sequence of Trial
        Refitted effects and formulas. Of one instance that occurs more than once, the one with more evidence counts.
    directions : sequence of Direction
        All candidates of the catalogue, from which families and places are counted.
    formulas : int
        Number of formulas that were compared.
    p_value : float
        P-value of the log's alarms under the current model.
    seed : int
        Determines the draws of the noise.
    p_value_with : float, optional
        P-value of the log's alarms under the model with the most probable effect, once it is known: what an effect does
        not explain, something unknown may explain besides.
    same : mapping of str to str
        Names of effects that are another in this log: both have the evidence that is known better.

    Notes
    -----
    The evidence of something unknown is not known. A p-value bounds it: whatever the alternative, a Bayes factor
    against the null is at most -1 / (e p ln p) under mild conditions (Sellke, Bayarri and Berger 2001, Calibration of p
    values for testing precise null hypotheses, The American Statistician 55). The bound is used.
    """
    best: dict[object, Trial] = {}
    for trial in trials:
        assert trial.effect is not None
        key = instance_key(trial.effect)
        if key not in best or trial.evidence > best[key].evidence:
            best[key] = trial
    ranked = list(best.values())
    effects = [trial.effect for trial in ranked if trial.effect is not None]
    prior = np.log(_priors(effects, directions, max(formulas, 1)))
    none = prior[:2] + np.array([0.0, _evidence_bound(p_value)])
    besides = 0.0
    if p_value_with is not None:
        besides = float(np.logaddexp(0.0, prior[1] - prior[0] + _evidence_bound(p_value_with)))
    known = [_known_best(k, ranked, same) for k in range(len(ranked))]
    some = prior[2:] + besides + np.array([ranked[k].evidence for k in known])
    noise = np.array([_noise(ranked[k]) for k in known])
    rng = make_rng(seed)
    # What the current model's own score is wrong by, all gains are.
    common = current.noise * rng.standard_normal(_NOISE_DRAWS if current.noise > 0.0 else 1)
    of_some = np.full(common.size, special.logsumexp(some) if some.size else -np.inf)
    nothing, unknown, named = special.softmax([none[0] + common, none[1] + common, of_some], axis=0).mean(axis=1)
    # Noise tells which effect has the share of all effects, not how great that share is: the greatest of many evidences
    # is too great by accident already.
    draws = rng.standard_normal((_NOISE_DRAWS if noise.any() else 1, noise.size))[:, known] * noise
    probability = named * special.softmax(some + draws, axis=1).mean(axis=0) if some.size else some
    hopeful = [
        special.softmax([*none, *np.delete(some, k), some[k] + noise[k]])[-1] > 1.0 - CREDIBLE for k in range(some.size)
    ]
    order = np.argsort(-probability)
    return Explanations(
        float(nothing), float(unknown), tuple(effects[k] for k in order), tuple(float(probability[k]) for k in order),
        tuple(effects[k] for k in order if hopeful[k]),
    )  # fmt: skip


def with_probabilities(found: FoundEffect, accepted: Trial, probable: Explanations) -> FoundEffect:
    """Return a found effect with its posterior probability, and with what has the rest of it.

    Parameters
    ----------
    found : FoundEffect
        The effect.
    accepted : Trial
        The trial with the effect.
    probable : Explanations
        Probabilities of all that was tried.
    """
    assert accepted.effect is not None
    return replace(found, probability=probable.of(accepted.effect), alternatives=probable.beside(accepted.effect))


def log_prior_odds(effect: Effect, directions: Sequence[Direction]) -> float:
    """Return the log of an effect's prior probability over that of nothing.

    Parameters
    ----------
    effect : Effect
        The effect.
    directions : sequence of Direction
        All candidates of the catalogue.
    """
    nothing, _, share = _priors([effect], directions, 1)
    return float(np.log(share / nothing))


def evidence_of_scores(directions: Sequence[Direction], score: Float, std: Float) -> Float:
    """Return the log evidence over nothing that the scores of candidates promise [nat].

    Near no effect, the log evidence of a candidate of size s is ``u s - s^2 I / 2`` for its score u and information I.
    Its mean over the prior of s has a closed form if that prior is a normal, cut at zero for one-sided candidates. This
    is how evidence behaves for small effects; a large one has to be refitted.

    Parameters
    ----------
    directions : sequence of Direction
        The K candidates.
    score, std : ndarray, shape (K,)
        Their scores, and the standard deviations of these when the model is right [nat].

    Returns
    -------
    ndarray, shape (K,)
    """
    return np.array([
        _evidence_of_score(direction, float(of_one), float(std_of_one))
        for direction, of_one, std_of_one in zip(directions, score, std, strict=True)
    ])  # fmt: skip


def nothing_without_refits(judgement: Judgement, directions: Sequence[Direction]) -> float:
    """Return the probability that a model lacks nothing, from the scores of all candidates alone.

    Parameters
    ----------
    judgement : Judgement
        Tests of the log.
    directions : sequence of Direction
        The K candidates of these tests.
    """
    nothing, _ = _by_scores_alone(directions, judgement.score, judgement.score_std, judgement.p_value)
    return nothing


def unknown_without_refits(judgement: Judgement, directions: Sequence[Direction]) -> float:
    """Return the probability that a model lacks something that no effect explains, from its alarms: an upper bound.

    Parameters
    ----------
    judgement : Judgement
        Tests of the log under a model beside which no effect is probable.
    directions : sequence of Direction
        The K candidates of these tests.
    """
    nothing, unknown = _priors([], directions, 1)
    return float(special.expit(np.log(unknown / nothing) + _evidence_bound(judgement.p_value)))


def suspects(judgement: Judgement, directions: Sequence[Direction]) -> list[Effect]:
    """Return the effects that may be right by their scores as they are, though no alarm may be raised.

    A test lets no few rows decide, for a false alarm is worse than a missed one. An effect that acts in few rows, such
    as steps with heavy tails, hardly passes it. Its evidence, once it is fitted, tells whether it is there.

    Parameters
    ----------
    judgement : Judgement
        Tests of the log.
    directions : sequence of Direction
        The K candidates of these tests.

    Returns
    -------
    list of Effect
        Those that could have a part in the answer: with a probability above one less :data:`CREDIBLE`.
    """
    score = judgement.plain_z * judgement.plain_std
    _, probabilities = _by_scores_alone(directions, score, judgement.plain_std, judgement.p_value)
    return [effect for effect, probability in probabilities if probability > 1.0 - CREDIBLE]


def _by_scores_alone(
    directions: Sequence[Direction], score: Float, std: Float, p_value: float
) -> tuple[float, list[tuple[Effect, float]]]:
    """Return the probabilities of nothing and of each effect, from scores alone."""
    promised = evidence_of_scores(directions, score, std)
    effects: dict[object, list[float]] = {}
    kept: dict[object, Effect] = {}
    for direction, value in zip(directions, promised, strict=True):
        key = instance_key(direction.effect)
        effects.setdefault(key, []).append(float(value))
        kept[key] = direction.effect
    prior = _priors(list(kept.values()), directions, 1)
    # Of an effect with several strengths each is a model of its own, alike probable.
    evidence = [special.logsumexp(values) - np.log(len(values)) for values in effects.values()]
    nothing, _, *others = special.softmax(np.log(prior) + np.array([0.0, _evidence_bound(p_value), *evidence]))
    return float(nothing), list(zip(kept.values(), map(float, others), strict=True))


def _priors(effects: Sequence[Effect], directions: Sequence[Direction], formulas: int) -> Float:
    """Return prior probabilities of nothing, of something unknown, and of each effect."""
    places: dict[str, set[object]] = {}
    for direction in directions:
        # An effect that moves to its place in a fit has the prior of its place there.
        place = direction.effect.name if direction.effect.shape else instance_key(direction.effect)
        places.setdefault(direction.effect.name, set()).add(place)
    of_family = (1.0 - NOTHING_PRIOR) / (len(places) + 2)
    shares = [
        of_family / (formulas if effect.name.startswith(PREFIX) else len(places.get(effect.name, (0,))))
        for effect in effects
    ]
    return np.array([NOTHING_PRIOR, of_family, *shares])


def _evidence_bound(p_value: float) -> float:
    """Return the greatest log Bayes factor that a p-value allows [nat]."""
    p = max(p_value, 1e-300)
    return -math.log(-math.e * p * math.log(p)) if p < 1.0 / math.e else 0.0


def _known_best(k: int, trials: Sequence[Trial], same: Mapping[str, str]) -> int:
    """Return the number of the trial that counts among those of one effect under several names.

    It is the one that was fitted longest; of several, the one with more evidence.
    """
    names = [trial.effect.name for trial in trials if trial.effect is not None]
    name = same.get(names[k], names[k])
    if name == names[k] and name not in same.values():
        return k
    alike = [number for number, other in enumerate(names) if same.get(other, other) == name]
    of = [(trials[number].effort.draws, trials[number].evidence) for number in alike]
    return alike[max(range(len(alike)), key=of.__getitem__)]


def _noise(trial: Trial) -> float:
    if trial.nested:
        return trial.noise
    length, share = _FIT_NOISE[trial.effort]
    return float(np.hypot(trial.noise, length + share * abs(trial.evidence)))


def _evidence_of_score(direction: Direction, score: float, std: float) -> float:
    """Return the log evidence of a small effect over none, from its score and the score's standard deviation [nat]."""
    effect, k = direction.effect, direction.strength
    spread = float(effect.parameters[k].prior.std())
    step = abs(float(direction.above[k]) - effect.null[k])
    if not np.isfinite(spread) or step == 0.0:
        return 0.0
    # In steps of the score. Effects that enter through their square are scored along the square.
    size = (spread / step) ** 2 if effect.squared else spread / step
    root = np.hypot(1.0, std * size)
    z = score * size / root
    evidence = 0.5 * z * z - np.log(root)
    if direction.one_sided:
        evidence += np.log(2.0) + float(special.log_ndtr(z))
    return float(evidence)
