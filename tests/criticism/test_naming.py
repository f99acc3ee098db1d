"""Which candidates are refitted, near twins whatever their own score; and which effects may go again."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from pmcl.criticism.fitting.quick_fit import BRIEF, quick_fit
from pmcl.criticism.fitting.trials import Trial, from_null, occam_factor, spare_effects, trial_of_base, try_effect
from pmcl.criticism.naming import scan as scan_module
from pmcl.criticism.naming.choice import (
    choose,
    confirmed_without_score,
    contenders,
    contenders_when_lost,
    leaders,
    with_formulas,
    worth_it,
)
from pmcl.criticism.naming.scan import scan
from pmcl.criticism.naming.shortlist import (
    RankedEffect,
    of_carrier,
    of_sensors,
    of_whole_robot,
    shortlist,
    untried,
    untried_twins,
)
from pmcl.criticism.scoring.scores import directions_of
from pmcl.filtering.paired_scores import paired_gain
from pmcl.models.effects.registry import candidates
from pmcl.models.effects.selection import effect_named
from pmcl.models.robot_model import default_model
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field

# mypy: disable-error-code="no-untyped-def"


def test_twins_are_refitted_without_a_score_of_their_own():
    log = simulate_landmark_field(60, 1, bearings=True)
    directions = directions_of(candidates(log))
    best, nothing = effect_named("odometry-side-drift", log), np.zeros(len(directions))
    twins = [effect.name for effect, _ in untried_twins(best, directions, nothing, [])]
    assert "sensor-yaw" in twins
    assert best.name not in twins
    assert len(set(twins)) == len(twins)
    tried = [SimpleNamespace(effect=effect_named("sensor-yaw", log))]
    assert "sensor-yaw" not in [effect.name for effect, _ in untried_twins(best, directions, nothing, tried)]


def test_of_a_twin_with_many_places_the_likeliest_is_refitted():
    log = simulate_landmark_field(60, 1, bearings=True)
    directions = directions_of(candidates(log))
    best = effect_named("landmark-noise-correlated", log)
    z = np.array([3.0 if one.effect.where.get("landmarks") == (5,) else 0.1 for one in directions])
    places = [(effect.where, value) for effect, value in untried_twins(best, directions, z, []) if effect.where]
    assert ({"landmarks": (5,)}, 3.0) in [(dict(where), value) for where, value in places]
    assert all(value == 3.0 for where, value in places if "landmarks" in where)


def made_trial(name, log, rows, base):
    """A trial whose model scores the rows as told; the first half is the fit part."""
    half = len(rows) // 2
    gains = [paired_gain(rows, base, part) for part in (slice(0, half), slice(half, None), slice(None))]
    fit = SimpleNamespace(bound=SimpleNamespace(lengths=(half,)))
    return Trial(effect_named(name, log), None, fit, rows, 5.0, *gains)


def test_what_is_named_with_the_winner():
    """Whatever is less than two standard errors behind; and known near twins unless they gain much less."""
    log, rng = simulate_landmark_field(60, 1, bearings=True), np.random.default_rng(1)
    base = rng.normal(0.0, 1.0, 1000)
    gain = 0.5 + 0.1 * rng.standard_normal(1000)
    best = made_trial("sensor-yaw", log, base + gain, base)

    def named(name, share):
        other = made_trial(name, log, base + share * gain, base)
        found, twins = choose([best, other])
        assert found is best
        return twins == [other]

    # Every lead here is many standard errors long.
    assert named("odometry-side-drift", 0.95)
    assert not named("odometry-side-drift", 0.8)
    assert not named("odometry-turn-scale", 0.95)
    alike = made_trial("odometry-turn-scale", log, base + gain - 0.01 + 0.5 * rng.standard_normal(1000), base)
    assert choose([best, alike])[1] == [alike]


def test_an_effect_that_held_out_rows_confirm_goes_before_one_that_the_fit_part_alone_shows():
    log, rng = simulate_landmark_field(60, 1, bearings=True), np.random.default_rng(1)
    base, noise = rng.normal(0.0, 1.0, 1000), 0.1 * rng.standard_normal(1000)
    early = np.where(np.arange(1000) < 500, 0.5, 0.0) + noise

    def chosen(held):
        """Choose between an effect of the fit part and one that gains so much in each row of either part."""
        gains = np.where(np.arange(1000) < 500, 0.2, held)
        steady = made_trial("odometry-turn-scale", log, base + gains + noise, base)
        return choose([made_trial("odometry-arc", log, base + early, base), steady])[0].effect.name

    assert chosen(0.2) == "odometry-turn-scale"
    assert chosen(-0.2) == "odometry-arc"


def test_what_a_prior_loses_is_exact_for_a_gaussian(rng):
    """The log of prior over posterior density at the posterior's mean."""
    draws = np.column_stack([rng.standard_normal(400), 1.0 + 0.1 * rng.standard_normal(400)])
    fit = SimpleNamespace(
        bound=SimpleNamespace(parameters=(None, SimpleNamespace(prior=stats.norm(scale=2.0)))),
        theta=draws.mean(axis=0), draws=draws,
    )  # fmt: skip
    mean, sd = draws[:, 1].mean(), draws[:, 1].std(ddof=1)
    expected = stats.norm(mean, sd).logpdf(mean) - stats.norm(scale=2.0).logpdf(mean)
    assert occam_factor(fit, 1) == pytest.approx(expected)
    assert expected > 2.5
    assert occam_factor(fit, 0) == 0.0


def test_the_distance_from_no_effect_is_that_of_the_draws(rng):
    """The greatest of its strengths counts, in standard deviations; mixture weights and the like have no distance."""
    log = simulate_landmark_field(60, 1, bearings=True)
    other, draws = rng.standard_normal(300), 0.03 + 0.01 * rng.standard_normal(300)
    free = np.array([True])
    scale = effect_named("odometry-forward-scale", log)
    found = from_null(SimpleNamespace(draws=np.column_stack([other, draws])), scale, free)
    assert found == pytest.approx(abs(draws.mean() - scale.null[0]) / draws.std())
    assert found > 2.5
    mount = effect_named("sensor-offset", log)
    both = np.column_stack([other, 0.001 * other, draws])
    assert from_null(SimpleNamespace(draws=both), mount, np.array([True, True])) == pytest.approx(
        draws.mean() / draws.std()
    )
    misread = effect_named("landmark-misread", log)
    assert from_null(SimpleNamespace(draws=both), misread, np.ones(len(misread.parameters), dtype=bool)) == np.inf
    assert from_null(SimpleNamespace(draws=both), scale, np.array([False])) == np.inf


def test_what_a_fit_cannot_tell_from_no_effect_is_not_accepted():
    log, rng = simulate_landmark_field(60, 1, bearings=True), np.random.default_rng(1)
    base = rng.normal(0.0, 1.0, 1000)
    trial = made_trial("odometry-turn-scale", log, base + 0.2 + 0.1 * rng.standard_normal(1000), base)
    assert worth_it(trial, 3.0)
    assert worth_it(replace(trial, from_null=2.1), 3.0)
    assert not worth_it(replace(trial, from_null=1.9), 3.0)


def test_a_formula_replaces_a_name_that_it_clearly_beats_and_is_told_beside_one_that_it_does_not():
    log, rng = simulate_landmark_field(60, 1, bearings=True), np.random.default_rng(1)
    base = rng.normal(0.0, 1.0, 1000)
    gain = 0.5 + 0.1 * rng.standard_normal(1000)
    noise = 0.5 * rng.standard_normal(1000)
    for name, better, equal in (("odometry-arc", True, False), ("turn-noise-correlated", True, True)):
        best = made_trial(name, log, base + gain, base)
        clear = made_trial("odometry-side-drift", log, base + 1.2 * gain, base)
        assert (with_formulas(best, [], [clear], 3.0) == (clear, [])) is better
        slight = made_trial("odometry-side-drift", log, base + gain + 0.01 - (noise - noise.mean()), base)
        assert slight.merit > best.merit
        found, twins = with_formulas(best, [], [slight], 3.0)
        assert (found is slight) is equal
        assert twins == ([] if equal else [slight])
        worse = made_trial("odometry-side-drift", log, base + 0.5 * gain, base)
        found, twins = with_formulas(best, [], [worse], 3.0)
        assert found is best
        assert twins == []


def test_nothing_is_refitted_twice():
    log = simulate_landmark_field(60, 1, bearings=True)
    base = np.zeros(100)
    trials = [made_trial(name, log, base, base) for name in ("sensor-yaw", "bearing-bias")]
    offered = [RankedEffect(effect_named(name, log), 1.0) for name in ("sensor-yaw", "landmark-range-bias")]
    assert [effect.name for effect, _ in untried(offered, trials)] == ["landmark-range-bias"]


def test_effects_of_whole_robot_are_those_without_a_place():
    log = simulate_amigobot(60.0, 1)
    directions = directions_of(candidates(log))
    z = np.arange(len(directions), dtype=float)
    names = [effect.name for effect, _ in of_whole_robot(directions, z)]
    assert {"sensor-offset", "odometry-turn-scale", "range-bias", "wheel-slip"} <= set(names)
    assert not {"beam-bias", "wall-moved", "slippery-patch", "range-noise-correlated"} & set(names)
    assert len(set(names)) == len(names)
    found = [deviation for _, deviation in of_whole_robot(directions, z)]
    assert found == sorted(found, reverse=True)
    moving = [effect for effect, _ in of_carrier(directions, z, "motion")]
    assert {"turn-noise-grows-with-turn", "odometry-arc"} < {effect.name for effect in moving}
    assert "slippery-patch" not in {effect.name for effect in moving}
    assert {effect.carrier for effect in moving} == {"motion"}
    z = np.array([9.0 if one.effect.where.get("beams") in {(2,), (6,)} else 1.0 for one in directions])
    sensing = [effect for effect, _ in of_sensors(directions, z)]
    assert sorted(effect.where["beams"] for effect in sensing if effect.name == "dead-beam") == [(2,), (6,)]
    assert not {"motion", "map"} & {effect.carrier for effect in sensing}


def test_what_can_only_be_there_or_not_is_sought_in_the_whole_robot_where_it_has_a_score():
    log = simulate_amigobot(60.0, 1)
    directions = directions_of(candidates(log))

    def names(z):
        return {effect.name for effect, _ in of_whole_robot(directions, np.full(len(directions), z))}

    assert names(0.5) < names(1.5)
    assert {"odometry-turn-bias", "sensor-yaw", "range-scale"} <= names(0.0)
    assert names(1.5) - names(0.5) >= {"wheel-slip", "short-readings", "beam-width"}


def test_what_the_whole_log_speaks_for_is_refitted_though_others_come_first_in_the_fit_part():
    log = simulate_amigobot(60.0, 1)
    directions = directions_of(candidates(log))
    position = {one.effect.name: k for k, one in enumerate(directions)}
    early, whole = np.zeros(len(directions)), np.zeros(len(directions))
    first = ("odometry-arc", "odometry-turn-bias", "sensor-yaw", "range-scale", "random-readings", "wheel-slip")
    for k, name in enumerate((*first, "turn-noise-correlated", "heavy-tailed-motion-noise")):
        early[position[name]] = 8.0 - k
    late = position["heavy-tailed-motion-noise"]

    def named():
        return [effect.name for effect, _ in shortlist(directions, early, {}, SimpleNamespace(z=whole, critical_z=3.3))]

    usual = [*first[:4], "random-readings", "turn-noise-correlated"]
    assert named() == usual
    whole[late] = 3.0
    assert named() == usual
    whole[late] = -3.5
    assert named() == [*usual, "heavy-tailed-motion-noise"]
    # Among three that are more remarkable it is none of the first.
    whole[[position[name] for name in first[:3]]] = 9.0
    assert named() == usual


def test_what_a_glance_finds_far_behind_is_not_refitted_in_earnest():
    log, base = simulate_landmark_field(60, 1, bearings=True), np.zeros(100)

    def gaining(name, total):
        return made_trial(name, log, base + total / 50, base)  # half of the rows are the fit part

    def kept(glances, rivals=()):
        return [trial.effect.name for trial in contenders([gaining(*one) for one in glances], rivals)]

    best, near, behind = ("odometry-arc", 100.0), ("odometry-turn-scale", 60.0), ("landmark-range-bias", 45.0)
    assert kept([best, near, behind]) == ["odometry-arc", "odometry-turn-scale"]
    assert kept([near, behind], [gaining(*best)]) == ["odometry-turn-scale"]
    assert kept([near, behind]) == ["odometry-turn-scale", "landmark-range-bias"]
    # Less than 15 nats behind is never far, but what clearly loses is dropped, even where nothing gains.
    assert kept([("odometry-arc", 12.0), ("landmark-range-bias", 0.5)]) == ["odometry-arc", "landmark-range-bias"]
    assert kept([("odometry-arc", 12.0), ("landmark-range-bias", -3.0)]) == ["odometry-arc"]
    assert kept([("landmark-range-bias", -8.0), ("odometry-turn-scale", 0.5)]) == ["odometry-turn-scale"]
    # An absorber drops no structured candidate that may gain, unless it gains many times as much; and near twins stay.
    assert kept([("heavy-tailed-motion-noise", 400.0), best]) == ["heavy-tailed-motion-noise", "odometry-arc"]
    assert kept([("heavy-tailed-motion-noise", 800.0), best]) == ["heavy-tailed-motion-noise"]
    assert kept([("turn-noise-correlated", 100.0), ("odometry-turn-bias", 30.0)])[1:] == ["odometry-turn-bias"]
    assert kept([("turn-noise-correlated", 100.0), ("odometry-turn-bias", 5.0)])[1:] == []
    assert kept([best, ("heavy-tailed-motion-noise", 20.0)]) == ["odometry-arc"]
    assert kept([("sensor-yaw", 5.0), ("odometry-side-drift", 100.0)]) == ["sensor-yaw", "odometry-side-drift"]
    # An absorber that gains little is no reason to drop what gains less.
    assert len(kept([("turn-noise-correlated", 4.0), ("heavy-tailed-motion-noise", 0.5), ("odometry-arc", 0.0)])) == 3


def test_of_many_that_gain_little_a_few_are_refitted_in_earnest():
    log, base = simulate_landmark_field(60, 1, bearings=True), np.zeros(100)
    names = ("odometry-turn-scale", "odometry-forward-scale", "odometry-latency", "landmark-range-bias", "sensor-yaw",
             "landmark-range-scale", "odometry-side-drift")  # fmt: skip
    glances = [made_trial(name, log, base + (13.0 - k) / 50, base) for k, name in enumerate(names)]
    assert contenders(glances) == glances[:5]
    assert contenders([glances[6], *glances[:6]]) == glances[:5]
    # Near twins of the best stay, and absorbers take nobody's place.
    best = made_trial("sensor-yaw", log, base + 14.0 / 50, base)
    assert contenders([best, *glances]) == [best, *glances[:4], glances[6]]
    absorber = made_trial("heavy-tailed-motion-noise", log, base + 11.0 / 50, base)
    assert contenders([absorber, *glances]) == [absorber, *glances[:5]]


def test_leaders_are_close_to_the_first_and_gain_something():
    log, base = simulate_landmark_field(60, 1, bearings=True), np.zeros(100)

    def led(*gains):
        trials = [made_trial("odometry-arc", log, base + gain / 50, base) for gain in gains]
        return [round(trial.on_fit.total) for trial in leaders(trials)]

    assert led(30.0, 100.0, 90.0) == [100, 90]
    assert led(10.0, 11.0, 12.0, 13.0) == [13, 12, 11]
    assert led(2.0, 10.0, 3.0) == [10]
    assert led(3.0, 2.0) == []


def test_a_scan_goes_to_the_likeliest_places_and_the_side_that_a_remarkable_score_tells(monkeypatch):
    log = simulate_landmark_field(60, 1, bearings=True)
    bound, directions, runs = default_model(log).bind(log), directions_of(candidates(log)), []

    def counted(tables, rows, particles, rng):
        runs.append(rows)
        return SimpleNamespace(log_increments=np.full(rows, -10.0 if rows < log.n_steps else 0.0))

    monkeypatch.setattr(scan_module, "run_filter", counted)
    whole = [k for k, one in enumerate(directions) if not one.effect.where]
    one_sided = sum(directions[k].one_sided for k in whole)
    somewhere = {one.effect.name: 1 if one.effect.shape else 2 for one in directions if one.effect.where}
    places = sum(somewhere.values())

    def runs_with(z):
        runs.clear()
        gains = scan(bound, bound.prior_mean(), directions, z, 0, 100)
        # What loses so much at once is followed no further; the base model is.
        assert sum(rows == log.n_steps for rows in runs) <= 1
        return len(gains), sum(rows < log.n_steps for rows in runs)

    assert runs_with(np.zeros(len(directions))) == (0, 0)
    assert runs_with(np.full(len(directions), -7.0)) == (len(whole) + places, len(whole) + places)
    alone = np.zeros(len(directions))
    alone[next(k for k, one in enumerate(directions) if one.effect.where and not one.one_sided)] = 7.0
    assert runs_with(alone) == (len(whole) + 1, 2 * len(whole) - one_sided + 1)


def test_where_the_filter_is_lost_an_effect_must_gain_nearly_everywhere():
    """What is only lucky where the robot is lost may gain more in all, and more than its standard error."""
    log, rng = simulate_landmark_field(60, 1, bearings=True), np.random.default_rng(2)
    base = rng.normal(0.0, 1.0, 600)
    noise = rng.normal(0.0, 1.0, 600)
    lucky, true = base + noise, base + noise + 1.0
    lucky[[100, 200, 400, 500]] += 300.0  # two places of each part
    current = made_trial("odometry-arc", log, base, base)
    true, lucky = (made_trial("odometry-arc", log, rows, base) for rows in (true, lucky))
    assert all(gain.total > gain.se for gain in (lucky.on_fit, lucky.on_heldout))
    assert lucky.merit > true.merit - 10.0
    assert not confirmed_without_score(lucky, current)
    assert confirmed_without_score(true, current)
    others = [made_trial("odometry-turn-scale", log, base - k, base) for k in (0.1, 0.2, 0.3, 0.4)]
    assert contenders_when_lost([*others, lucky, true], current) == [true, lucky, others[0]]
    most = made_trial("odometry-turn-scale", log, np.where(np.arange(600) == 5, 9e9, base - 9.0), base)
    assert contenders_when_lost([*others, lucky, true, most], current)[-1] is most


@pytest.mark.slow
def test_an_alias_goes_when_the_true_effect_is_in_and_what_the_data_show_stays():
    noise = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.05}
    given = ("quantized-readings=clear", "range-bias=large")
    log = simulate_amigobot(150.0, 3, noise, effects=given).without_truth()
    settings = {"seed": 1, "particles": 1000}
    fit = quick_fit(default_model(log).bind(log), 1, effort=BRIEF)
    trial = trial_of_base(default_model(log), log, 90, theta=fit.theta, path=fit.path, **settings)
    for name in ("quantized-readings", "odometry-side-drift", "range-bias"):
        trial = try_effect(trial, effect_named(name, log), 1.0, log, 90, **settings)
    assert trial.on_heldout.significant
    left, dropped = spare_effects(trial, 0, log, 90, **settings)
    assert dropped == [1]
    assert [effect.name for effect in left.model.effects] == ["quantized-readings", "range-bias"]
    assert left.model.fixed == trial.model.fixed != {}
