"""Posterior probabilities of explanations are Bayes' rule, and are right as often as they say."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import integrate, stats

from pmcl.criticism.fitting.quick_fit import BRIEF, GLANCE, THOROUGH
from pmcl.criticism.fitting.trials import Trial
from pmcl.criticism.naming import probability
from pmcl.criticism.naming.probability import (
    NOTHING_PRIOR,
    explanations,
    log_prior_odds,
    nothing_without_refits,
    unknown_without_refits,
)
from pmcl.criticism.scoring.scores import directions_of
from pmcl.filtering.paired_scores import Gain
from pmcl.models.effects.effect import Effect
from pmcl.models.parameters import Parameter

# mypy: disable-error-code="no-untyped-def"


def effect(name, place=None, prior=None, squared=False):
    """An effect that changes nothing; at place k if there is one."""
    prior = stats.norm(scale=2.0) if prior is None else prior
    return Effect(
        name, ".", (Parameter("size", "1", prior),), (0.0,), lambda tables, *_: tables, squared=squared,
        typical={"clear": (1.0,)}, where={} if place is None else {"beams": (place,)},
    )  # fmt: skip


def trial(of, evidence, noise=0.0, effort=THOROUGH):
    """A trial with so much evidence."""
    return Trial(of, None, None, None, 0.0, Gain(evidence, 1.0), evidence, noise, np.zeros((1, 2)), effort)


def told(trials, others=(), p_value=1.0, formulas=0, noise=0.0, p_value_with=None, **same):
    """Probabilities beside candidates that were not tried."""
    current = trial(None, 0.0, noise)
    offered = [one.effect for one in trials if not one.effect.name.startswith("formula")]
    return explanations(current, trials, directions_of([*offered, *others]), formulas, p_value, 1, p_value_with, **same)


def test_without_noise_it_is_bayes_rule(monkeypatch):
    """Families share half of the prior with formulas and with what nobody has named; places share their family's."""
    monkeypatch.setitem(probability._FIT_NOISE, THOROUGH, (0.0, 0.0))
    scale, beam = effect("odometry-turn-scale"), effect("beam-bias", 2)
    others = [effect("beam-bias", k) for k in (0, 1, 3)]
    formula = effect("formula: range += c*time")
    found = told([trial(scale, 3.0), trial(beam, 4.0), trial(formula, 1.0)], others, formulas=10)
    share = (1.0 - NOTHING_PRIOR) / 4.0
    of_tried = share * np.exp([3.0, 4.0, 1.0]) / [1.0, 4.0, 10.0]
    weights = np.array([NOTHING_PRIOR, share, *of_tried])
    expected = weights / weights.sum()
    assert found.nothing == pytest.approx(expected[0])
    assert found.unknown == pytest.approx(expected[1])
    assert [found.of(one) for one in (scale, beam, formula)] == pytest.approx(expected[2:])
    assert found.nothing + found.unknown + sum(found.probabilities) == pytest.approx(1.0)
    assert [one.name for one in found.effects] == ["odometry-turn-scale", "beam-bias", "formula: range += c*time"]
    assert found.of(others[0]) == 0.0
    beside = found.beside(scale)
    assert [one.name for one in beside] == ["beam-bias", "nothing", "unknown effect"]
    assert beside[0].where == {"beams": (2,)}


def test_an_effect_may_be_there_beside_something_unknown():
    """Alone it loses against something unknown; with what the log still shows under it, both together win."""
    scale = effect("odometry-turn-scale")
    alone = told([trial(scale, 25.0)], p_value=1e-17)
    assert not alone.likely
    both = told([trial(scale, 25.0)], p_value=1e-17, p_value_with=1e-15)
    share = (1.0 - NOTHING_PRIOR) / 3.0
    bound, with_it = (-np.log(-np.e * p * np.log(p)) for p in (1e-17, 1e-15))
    effect_only, and_unknown = share * np.exp(25.0), share * share / NOTHING_PRIOR * np.exp(25.0 + with_it)
    expected = (effect_only + and_unknown) / (NOTHING_PRIOR + share * np.exp(bound) + effect_only + and_unknown)
    assert both.of(scale) == pytest.approx(expected)
    assert both.likely
    # An effect that takes all alarms with it gains nothing by that.
    assert told([trial(scale, 25.0)], p_value=1e-17, p_value_with=0.5).of(scale) < 1.4 * alone.of(scale)


def test_an_instance_that_was_fitted_twice_counts_once():
    scale = effect("odometry-turn-scale")
    once, twice = told([trial(scale, 3.0)]), told([trial(scale, 1.0), trial(scale, 3.0)])
    assert twice.probabilities == once.probabilities
    assert twice.nothing == once.nothing


def test_evidences_that_differ_by_less_than_their_noise_share_the_probability():
    one, other = effect("odometry-turn-scale"), effect("odometry-arc")
    for noise in (0.0, 3.0):
        found = told([trial(one, 104.0, noise), trial(other, 100.0, noise)])
        # The chains of two thorough fits differ, too.
        std = np.sqrt(2.0) * np.hypot(noise, probability._FIT_NOISE[THOROUGH][0])
        expected, _ = integrate.quad(
            lambda lead, std=std: stats.norm.pdf(lead, 4.0, std) / (1.0 + np.exp(-lead)), -40.0, 40.0, points=[4.0]
        )
        # Four thousand draws.
        assert found.of(one) == pytest.approx(expected, abs=0.02)
    noisy = found
    # A short fit is further off.
    glance = told([trial(one, 104.0, 3.0, GLANCE), trial(other, 100.0, 3.0, GLANCE)])
    brief = told([trial(one, 104.0, 3.0, BRIEF), trial(other, 100.0, 3.0, BRIEF)])
    assert 0.5 < glance.of(one) < brief.of(one) < noisy.of(one)


def test_two_names_of_one_effect_share_its_probability():
    """The noise of two fits does not make one of the names more probable, nor take one out of the answer."""
    bearing, mount, drift = effect("bearing-bias"), effect("sensor-yaw"), effect("odometry-side-drift")
    trials = [trial(bearing, 104.0, 1.0), trial(mount, 110.0, 1.0, BRIEF), trial(drift, 103.0, 1.0)]
    found = told(trials, same={"bearing-bias": "sensor-yaw"})
    assert found.of(bearing) == found.of(mount) > 0.25
    assert {one.name for one in found.credible} == {"bearing-bias", "sensor-yaw", "odometry-side-drift"}
    # The evidence of the longer fit counts, whichever has it; of fits of one length, the greater.
    for values in ((110.0, 104.0), (104.0, 104.0), (90.0, 104.0)):
        effort = THOROUGH if values[0] < 100.0 else BRIEF
        turned = [trial(bearing, values[0], 1.0, effort), trial(mount, values[1], 1.0), trial(drift, 103.0, 1.0)]
        again = told(turned, same={"bearing-bias": "sensor-yaw"})
        assert again.of(bearing) == again.of(mount) == pytest.approx(found.of(bearing), abs=0.02)
    # Elsewhere they are two effects.
    assert told(trials).of(mount) > 10.0 * told(trials).of(bearing)


def test_the_answer_is_the_fewest_effects_that_have_nearly_all_that_effects_have():
    effects = [effect(f"effect-{k}") for k in range(4)]
    found = told([trial(one, value) for one, value in zip(effects, (50.0, 51.0, 48.0, 40.0), strict=True)])
    assert [one.name for one in found.credible] == ["effect-1", "effect-0"]
    assert found.explained
    assert found.named == pytest.approx(1.0)
    alone = told([trial(effects[0], 50.0)], effects[1:])
    assert [one.name for one in alone.credible] == ["effect-0"]
    poor = told([trial(effects[0], 1.0)], effects[1:])
    assert [one.name for one in poor.credible] == ["effect-0"]
    assert not poor.explained
    assert told([], effects).credible == ()


def test_prior_odds_are_those_of_the_probabilities():
    beams, scale = [effect("beam-bias", k) for k in range(4)], effect("odometry-turn-scale")
    directions = directions_of([*beams, scale])
    share = (1.0 - NOTHING_PRIOR) / 4.0
    assert log_prior_odds(scale, directions) == pytest.approx(np.log(share / NOTHING_PRIOR))
    assert log_prior_odds(beams[2], directions) == pytest.approx(np.log(share / 4.0 / NOTHING_PRIOR))


@pytest.mark.parametrize("p_value", [0.5, 1e-3, 1e-20, 0.0])
def test_something_unknown_is_bounded_by_the_p_value(p_value):
    scale = effect("odometry-turn-scale")
    found = told([trial(scale, 5.0)], p_value=p_value)
    factor = found.unknown / found.of(scale) * np.exp(5.0)
    if p_value == 0.0:
        assert found.unknown > 0.999
    else:
        assert factor == pytest.approx(1.0 if p_value > 0.4 else -1.0 / (np.e * p_value * np.log(p_value)))


@pytest.mark.parametrize(("prior", "squared"), [
    (stats.norm(scale=0.8), False), (stats.halfnorm(scale=0.8), False), (stats.halfnorm(scale=0.8), True),
])  # fmt: skip
@pytest.mark.parametrize("score", [-3.0, 0.5, 6.0])
def test_the_evidence_of_a_score_is_the_mean_over_the_prior(prior, squared, score):
    """The probability of nothing beside one candidate, by quadrature."""
    one = effect("odometry-turn-scale", prior=prior, squared=squared)
    (direction,) = directions_of([one])
    std, step = 1.7, float(direction.above[0])
    spread = float(prior.std()) / step
    sizes = stats.halfnorm(scale=spread**2 if squared else spread) if direction.one_sided else stats.norm(scale=spread)
    factor, _ = integrate.quad(
        lambda size: np.exp(score * size - 0.5 * (std * size) ** 2) * sizes.pdf(size), -60.0, 60.0, limit=400
    )
    judgement = SimpleNamespace(score=np.array([score]), score_std=np.array([std]), p_value=1.0)
    share = (1.0 - NOTHING_PRIOR) / 3.0
    expected = NOTHING_PRIOR / (NOTHING_PRIOR + share + share * factor)
    assert nothing_without_refits(judgement, [direction]) == pytest.approx(expected, rel=1e-6)


def test_names_that_are_told_with_a_probability_are_right_as_often(rng):
    """Logs whose explanation is drawn from the prior, each candidate with one number that is exactly Gaussian."""
    effects = [effect(f"effect-{k}") for k in range(6)]
    spread, share, logs = 2.0, (1.0 - NOTHING_PRIOR) / 8.0, 1500
    probability, right = [], []
    # Explanations 6 and 7 stand for formulas and for something unknown: nothing that was tried shows them.
    truths = rng.choice(9, logs, p=[share] * 8 + [NOTHING_PRIOR])
    for truth in truths:
        numbers = rng.standard_normal(6)
        if truth < 6:
            numbers[truth] += spread * rng.standard_normal()
        evidence = 0.5 * numbers**2 * spread**2 / (1.0 + spread**2) - 0.5 * np.log1p(spread**2)
        found = told([trial(one, float(value)) for one, value in zip(effects, evidence, strict=True)])
        probability += [*(found.of(one) for one in effects), found.nothing]
        right += [*(truth == k for k in range(6)), truth == 8]
    probability, right = np.array(probability), np.array(right)
    for low, high in pairwise([0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0]):
        inside = (probability >= low) & (probability < high)
        if inside.sum() < 50:
            continue
        error = np.sqrt(probability[inside] @ (1.0 - probability[inside])) / inside.sum()
        # Formulas, which were not tried, have a share of the prior that is missing from the sum: 6 % at most.
        assert abs(right[inside].mean() - probability[inside].mean()) < 4.0 * error + 0.065 * probability[inside].mean()


def test_an_alarm_that_nothing_explains_needs_a_small_p_value():
    """Half is on nothing, and something unknown has the share of one family of effects."""
    directions = directions_of([effect("odometry-turn-scale"), effect("odometry-arc")])

    def unknown(p_value):
        return unknown_without_refits(SimpleNamespace(p_value=p_value), directions)

    assert unknown(0.9) == pytest.approx(0.125 / 0.625)  # a p-value that says nothing leaves the prior odds
    values = [unknown(p) for p in (0.3, 0.1, 0.03, 0.01, 1e-4)]
    assert values == sorted(values)
    # Sellke, Bayarri and Berger: odds of at most 1 / (-e p ln p) = 8.0 to 1 times the prior odds of 1 to 4.
    assert unknown(0.01) == pytest.approx(1.0 / (1.0 + 4.0 / 7.988), abs=1e-3)
    assert unknown(1e-4) > 0.99
