"""The order of candidates, near twins whatever their own score, and what evidence is made of."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from pmcl.criticism.findings.parts import FoundEffect
from pmcl.criticism.fitting import trials
from pmcl.criticism.fitting.held_out import RowScores, mixed_rows, noise_of_rows
from pmcl.criticism.fitting.quick_fit import BRIEF, GLANCE, THOROUGH, quick_fit
from pmcl.criticism.fitting.trials import log_prior_and_volume, trial_of_base, try_effect
from pmcl.criticism.naming.candidates import (
    RankedEffect,
    in_order,
    of_carrier,
    of_sensors,
    other_places,
    twins_of,
    untried,
)
from pmcl.criticism.naming.promises import promises, with_bounds
from pmcl.criticism.naming.revision import Answer, revised
from pmcl.criticism.naming.search import Outcome
from pmcl.criticism.scoring.lower_bounds import LowerBound
from pmcl.criticism.scoring.scores import directions_of, instance_key
from pmcl.filtering.paired_scores import Gain
from pmcl.models.effects.registry import candidates
from pmcl.models.effects.selection import effect_named
from pmcl.models.robot_model import default_model
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field

# mypy: disable-error-code="no-untyped-def"


def unbounded(directions):
    """Bounds that say nothing."""
    return [LowerBound(-np.inf, one.above) for one in directions]


def ordered(log, promised=None):
    """All candidates of a log, by what they promise."""
    directions = directions_of(candidates(log))
    promised = np.zeros(len(directions)) if promised is None else np.array([promised(one) for one in directions])
    return in_order(directions, with_bounds(promised, promised, unbounded(directions)))


def test_twins_are_refitted_without_a_score_of_their_own():
    log = simulate_landmark_field(60, 1, bearings=True)
    best, offered = effect_named("odometry-side-drift", log), ordered(log)
    twins = [one.effect.name for one in twins_of([best], offered)]
    assert "sensor-yaw" in twins
    assert best.name not in twins
    assert len(set(twins)) == len(twins)
    assert twins_of([], offered) == []


def test_of_a_twin_with_many_places_the_likeliest_is_refitted():
    log = simulate_landmark_field(60, 1, bearings=True)
    best = effect_named("landmark-noise-correlated", log)
    offered = ordered(log, lambda one: 3.0 if one.effect.where.get("landmarks") == (5,) else 0.1)
    places = [(dict(one.effect.where), one.z) for one in twins_of([best], offered) if one.effect.where]
    assert ({"landmarks": (5,)}, 3.0) in places
    assert all(value == 3.0 for where, value in places if "landmarks" in where)


def test_nothing_is_refitted_twice():
    log = simulate_landmark_field(60, 1, bearings=True)
    tried = {instance_key(effect_named(name, log)) for name in ("sensor-yaw", "bearing-bias")}
    offered = [RankedEffect(effect_named(name, log), 1.0) for name in ("sensor-yaw", "landmark-range-bias")]
    assert [one.effect.name for one in untried(offered, tried)] == ["landmark-range-bias"]


def test_the_order_is_that_of_what_candidates_promise_with_few_places_of_each():
    log = simulate_amigobot(60.0, 1)
    offered = ordered(log, lambda one: 9.0 if one.effect.where.get("beams") in {(2,), (6,)} else 1.0)
    assert [one.z for one in offered] == sorted((one.z for one in offered), reverse=True)
    dead = [one.effect.where["beams"] for one in offered if one.effect.name == "dead-beam"]
    assert sorted(dead) == [(2,), (6,)]
    # A fit moves a patch to its place.
    assert sum(one.effect.name == "slippery-patch" for one in offered) == 1
    moving = {one.effect.name for one in of_carrier(offered, "motion")}
    assert {"turn-noise-grows-with-turn", "odometry-arc"} < moving
    assert "slippery-patch" not in moving
    assert not {"motion", "map"} & {one.effect.carrier for one in of_sensors(offered)}


def test_a_one_sided_candidate_is_ranked_by_how_far_it_is_above_simulated_logs():
    """Its raw score is that of a finite step, and far below zero in all logs."""
    log = simulate_amigobot(60.0, 1)
    directions = directions_of(candidates(log))
    names = [one.effect.name for one in directions]
    z, score = np.zeros(len(names)), np.zeros(len(names))
    grows = names.index("range-noise-grows-with-range")
    assert directions[grows].one_sided
    z[grows], score[grows] = 4.5, -60.0
    judgement = SimpleNamespace(z=z, score=score, score_std=np.ones(len(names)))
    first = in_order(directions, promises(directions, judgement, unbounded(directions)))[0]
    assert first.effect.name == "range-noise-grows-with-range"
    assert first.z == 4.5


def test_other_places_of_what_has_evidence_are_tried_unless_the_path_could_not_hide_it_there():
    """The path absorbs a landmark that stands elsewhere, but no patch on which the robot slips."""
    log = simulate_landmark_field(60, 1, bearings=True)
    directions = directions_of(candidates(log))
    patches = [k for k, one in enumerate(directions) if one.effect.name == "slippery-patch"]
    promised = np.full(len(directions), -1.0)
    promised[patches[-1]] = 0.5
    offered = with_bounds(promised, promised, unbounded(directions))
    tried = [
        SimpleNamespace(effect=effect_named(name, log), evidence=evidence)
        for name, evidence in (("landmark-moved", 20.0), ("slippery-patch", 20.0), ("landmark-misread", -1.0))
    ]
    places = [instance_key(one.effect) for one in other_places(tried, directions, offered)]
    moved = {instance_key(one.effect) for one in directions if one.effect.name == "landmark-moved"}
    assert set(places) == moved | {instance_key(directions[patches[-1]].effect)}
    assert places[0][0] == "slippery-patch"  # what promises most comes first


def test_what_has_no_score_is_worth_a_fit_where_the_path_can_absorb_it():
    log = simulate_amigobot(60.0, 1)
    worth = {one.effect.name for one in ordered(log, lambda one: -1.0) if one.worth_a_fit}
    assert {"odometry-turn-bias", "sensor-yaw", "range-scale"} <= worth
    assert not {"wheel-slip", "short-readings", "beam-width", "beam-bias", "slippery-patch"} & worth
    assert all(one.worth_a_fit for one in ordered(log, lambda one: 1.0))


def test_evidence_is_exact_for_a_gaussian(rng):
    """The log score at the mean, the prior's density there, and the volume of the posterior."""
    draws = rng.multivariate_normal([0.3, 1.0], [[1.0, 0.05], [0.05, 0.01]], size=400)
    priors = (stats.norm(scale=3.0), stats.norm(scale=2.0))
    bound = SimpleNamespace(log_prior=lambda theta: sum(p.logpdf(x) for p, x in zip(priors, theta, strict=True)))
    fit = SimpleNamespace(bound=bound, theta=draws.mean(axis=0), draws=draws)
    posterior = stats.multivariate_normal(fit.theta, np.cov(draws.T))
    expected = bound.log_prior(fit.theta) - posterior.logpdf(fit.theta) + trials._missing_volume(400, 2)
    assert log_prior_and_volume(fit) == pytest.approx(expected, rel=1e-6)
    # What the log determines to a tenth costs more than what it leaves at its prior.
    loose = SimpleNamespace(bound=bound, theta=draws.mean(axis=0), draws=draws * [1.0, 10.0])
    assert log_prior_and_volume(loose) > log_prior_and_volume(fit) + 2.0


@pytest.mark.parametrize(("independent", "size"), [(7, 5), (24, 6), (100, 3)])
def test_the_volume_of_few_draws_is_right_on_average(independent, size, rng):
    root = rng.standard_normal((size, size))
    exact = np.linalg.slogdet(root)[1]
    draws = rng.standard_normal((4000, independent, size)) @ root.T
    found = 0.5 * np.linalg.slogdet([np.cov(one.T) for one in draws])[1]
    missing = trials._missing_volume(round(trials._DRAWS_PER_INDEPENDENT * independent), size)
    assert missing > 0.02
    assert found.mean() + missing == pytest.approx(exact, abs=0.1)


def fitted_models(log, rng, strength):
    """A base model and the same with one effect, both with draws about a mean, without a fit."""
    model, effect = default_model(log), effect_named("odometry-turn-scale", log)
    base, more = model.bind(log), replace(model, effects=(effect,)).bind(log)
    theta = base.prior_mean()
    draws = theta * (1.0 + 0.1 * rng.standard_normal((400, theta.size)))
    fits = [SimpleNamespace(bound=base, theta=draws.mean(axis=0), draws=draws, path=None, paths=())]
    draws = np.hstack([draws, strength + 0.01 * rng.standard_normal((400, 1))])
    fits.append(SimpleNamespace(bound=more, theta=draws.mean(axis=0), draws=draws, path=None, paths=()))
    return effect, fits


@pytest.mark.parametrize("strength", [0.5, 0.01])
def test_what_the_evidence_of_a_trial_is_made_of(strength, monkeypatch, rng):
    """Far from no effect from gains, noise of particles and priors; near none from the draws alone."""
    log = simulate_landmark_field(60, 1, bearings=True)
    effect, fits = fitted_models(log, rng, strength)
    base, more = fits[0].bound, fits[1].bound
    rows = {base: np.zeros(60), more: np.full(60, 0.7)}
    passes = {base: np.zeros((8, 60)) + 0.1 * rng.standard_normal((8, 60)), more: 0.2 * rng.standard_normal((2, 60))}
    noise = {base: noise_of_rows(passes[base]), more: noise_of_rows(passes[more])}

    def row_scores(bound, *_, **__):
        return RowScores(rows[bound], noise[bound], passes[bound])

    monkeypatch.setattr(trials, "row_scores", row_scores)
    monkeypatch.setattr(trials, "quick_fit", lambda *_, **__: fits[1])
    current = trial_of_base(fits[0], seed=1)
    trial = try_effect(current, effect, 1.0, log, seed=1, effort=THOROUGH)
    if strength < 0.1:
        of_effect, prior = fits[1].draws[:, -1], effect.parameters[0].prior
        expected = prior.logpdf(0.0) - stats.norm(of_effect.mean(), of_effect.std(ddof=1)).logpdf(0.0)
    else:
        lost = log_prior_and_volume(fits[1]) - log_prior_and_volume(fits[0])
        assert lost < -1.0
        variance = noise_of_rows(passes[more]) ** 2 - noise[base] ** 2
        expected = (rows[more] - rows[base]).sum() + 0.5 * variance + lost
    assert trial.evidence == pytest.approx(expected)


def filtered(variance, rng):
    """Scores by a filter: the log of an unbiased estimate of each row's density."""

    def row_scores(bound, theta, paths, *, seed, passes):
        of_row = variance[bound]
        increments = rng.normal(-0.5 * of_row, math.sqrt(of_row), (passes, bound.lengths[0]))
        return RowScores(mixed_rows(increments), noise_of_rows(increments), increments)

    return row_scores


@pytest.mark.parametrize("effort", [GLANCE, THOROUGH])
def test_few_passes_speak_neither_for_nor_against_an_effect(effort, monkeypatch, rng):
    """Eight passes together score higher than one or four: the current model's advantage must not count."""
    log = simulate_landmark_field(60, 1, bearings=True)
    effect, fits = fitted_models(log, rng, 0.5)
    variance = {fit.bound: 0.15 for fit in fits}  # a noise of three nats
    monkeypatch.setattr(trials, "row_scores", filtered(variance, rng))
    monkeypatch.setattr(trials, "quick_fit", lambda *_, **__: fits[1])
    found = []
    for _ in range(100):
        current = trial_of_base(fits[0], seed=1)
        found.append(try_effect(current, effect, 1.0, log, seed=1, effort=effort))
    expected = log_prior_and_volume(fits[1]) - log_prior_and_volume(fits[0])
    # Where blocks are bounded, gains of noise alone lose what the largest block has.
    gains = np.array([one.evidence - one.gain.bounded + one.gain.total - expected for one in found])
    assert abs(gains.mean()) < 4.0 * gains.std() / math.sqrt(gains.size)
    noise = np.array([one.noise for one in found])
    assert 0.6 * gains.std() < np.median(noise) < 1.5 * gains.std()
    # The same scores without the correction would speak against the effect.
    if effort == GLANCE:
        against = np.array([(one.row_scores - current.row_scores).sum() for one in found]).mean()
        assert against < -1.5


def test_the_largest_block_of_a_gain_is_bounded():
    assert Gain(20.0, 5.0, 4.0).bounded == 20.0
    assert Gain(20.0, 5.0, 12.0).bounded == pytest.approx(8.0 + 4.0)
    assert Gain(20.0, 5.0, 25.0).bounded == -5.0
    assert Gain(-20.0, 5.0, 3.0).bounded == -23.0


@pytest.mark.long
def test_an_alias_goes_when_the_true_effect_is_in_and_what_the_data_show_stays():
    noise = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.05}
    given = ("quantized-readings=clear", "range-bias=large")
    log = simulate_amigobot(150.0, 3, noise, effects=given).without_truth()
    settings = {"seed": 1}
    trial = trial_of_base(quick_fit(default_model(log).bind(log), 1, effort=BRIEF), **settings)
    for name in ("quantized-readings", "odometry-side-drift", "range-bias"):
        trial = try_effect(trial, effect_named(name, log), 1.0, log, effort=THOROUGH, **settings)
    assert trial.evidence > 10.0
    answers = [answer_of(effect) for effect in trial.model.effects[:-1]]
    after = revised(trial, answers, 0, lambda effect: -3.0, lambda *_: None, seed=1)
    assert after.dropped == ["odometry-side-drift"]
    assert [effect.name for effect in after.trial.model.effects] == ["quantized-readings", "range-bias"]
    assert after.trial.model.fixed == trial.model.fixed != {}
    # Without the true effect something else would have to go: it stays whatever its prior says against it.
    assert revised(after.trial, after.answers, 0, lambda effect: -3.0, lambda *_: None, seed=1).dropped == []


def answer_of(effect, **changes):
    """An accepted effect, as the loop keeps it."""
    plain = FoundEffect(effect.name, effect.summary, effect.where, {}, 0.01, math.nan, math.nan)
    return Answer(replace(plain, **changes))


@pytest.mark.parametrize("chosen", ["sensor-latency", "odometry-latency", None])
def test_an_earlier_effect_is_exchanged_for_what_is_more_probable_beside_a_later_one(chosen):
    """The model stays in order: what takes an effect's place has its position, and the newest effect is last."""
    log = simulate_landmark_field(60, 1, bearings=True).without_truth()
    settings = {"seed": 1}
    current = trial_of_base(quick_fit(default_model(log).bind(log), 1, effort=GLANCE), **settings)
    for name in ("landmark-range-bias", "sensor-latency", "bearing-bias"):
        current = try_effect(current, effect_named(name, log), 1.0, log, effort=GLANCE, **settings)
    asked = []

    def named_again(without, ranked):
        asked.append((ranked.effect.name, [effect.name for effect in without.model.effects], abs(ranked.z)))
        if ranked.effect.name != "sensor-latency" or chosen is None:
            return None
        other = try_effect(without, effect_named(chosen, log), 1.0, log, effort=GLANCE, **settings)
        found = replace(answer_of(other.effect).found, probability=0.7, not_distinguishable_from=("its twin",))
        return Outcome(other, found, [other], None, (other,))

    answers = [answer_of(effect) for effect in current.model.effects[:-1]]
    after = revised(current, answers, 0, lambda effect: 1e6, named_again, seed=1)
    assert asked == [
        ("landmark-range-bias", ["sensor-latency", "bearing-bias"], 1.0),
        ("sensor-latency", ["landmark-range-bias", "bearing-bias"], 1.0),
    ]
    kept = chosen or "sensor-latency"
    names = ["landmark-range-bias", kept, "bearing-bias"]
    assert [effect.name for effect in after.trial.model.effects] == names
    assert [answer.found.name for answer in after.answers] == names[:-1]
    assert after.trial.fit.bound.names[-2:] == (kept.replace("-", "_"), "bearing_bias")
    assert after.trial.effect is current.effect
    assert [one.name for one in after.exchanged] == (["sensor-latency"] if kept != "sensor-latency" else [])
    assert after.answers[0] == answers[0]
    assert after.answers[1].found.not_distinguishable_from == (() if chosen is None else ("its twin",))
    assert len(after.answers[1].credible) == (chosen is not None)
    gone = revised(current, answers, 0, lambda effect: -1e6, named_again, seed=1)
    assert gone.dropped == ["landmark-range-bias", "sensor-latency"]
    assert [effect.name for effect in gone.trial.model.effects] == ["bearing-bias"]
    assert not gone.answers
    assert len(asked) == 2  # what goes is not named again


def test_a_few_readings_that_are_impossible_without_a_mixture_give_it_their_evidence():
    """The weight is three standard deviations from zero, and its density there is nothing: draws do not show that."""
    evidence = {}
    for given in ("random-readings=0.002", ""):
        noise = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.06}
        log = simulate_amigobot(400.0, 5, noise, effects=(given,) if given else (), hide_effects=True)
        current = trial_of_base(quick_fit(default_model(log).bind(log), 1), seed=2)
        effect = effect_named("random-readings", log)
        trial = try_effect(current, effect, 1.0, log, seed=3, effort=THOROUGH)
        weight = trial.fit.draws[:, -1]
        assert weight.mean() < 4.0 * weight.std()
        evidence[given] = trial
    rare, none = evidence.values()
    assert not rare.nested
    assert rare.evidence > 500.0
    assert none.nested
    assert none.evidence < 0.0
