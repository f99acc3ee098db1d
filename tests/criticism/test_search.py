"""When a finding needs no further look at its alarm, what is refitted again, and what formulas are compared with."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pmcl.criticism.fitting.quick_fit import GLANCE, quick_fit
from pmcl.criticism.fitting.trials import PRACTICAL, Trial
from pmcl.criticism.judging import judged_log
from pmcl.criticism.naming import lost_robot, refits, search
from pmcl.criticism.naming.choice import worth_it
from pmcl.criticism.naming.formula_trials import FormulaTrials
from pmcl.criticism.naming.refits import Refits
from pmcl.criticism.naming.search import Outcome, Search
from pmcl.criticism.naming.shortlist import RankedEffect
from pmcl.criticism.scoring.scores import directions_of
from pmcl.criticism.settings import Settings
from pmcl.errors import FilterError
from pmcl.filtering.paired_scores import Gain
from pmcl.models.effects.registry import candidates
from pmcl.models.effects.selection import effect_named
from pmcl.models.robot_model import default_model
from pmcl.simulations.landmark_field import simulate_landmark_field

# mypy: disable-error-code="no-untyped-def"

SETTINGS = Settings(particles=100, seed=1, level=0.05, simulations=20, paths=5, workers=1, progress=False)


def without_candidates(log):
    """A search that has none, and the model that it starts from."""
    one = Search(log, (), SETTINGS)
    one.judged = SimpleNamespace(z=np.zeros(0))
    fit = SimpleNamespace(bound=None, theta=None)
    return one, Trial(None, None, fit, np.zeros(60), 0.0, *(3 * [Gain(0.0, 0.0)]), SETTINGS.comparing)


@pytest.mark.parametrize(
    ("heldout", "whole", "certain"),
    [
        (Gain(10.0, 4.0), Gain(12.0, 8.0), True),  # the held-out part says it alone
        (Gain(10.0, 7.0), Gain(40.0, 9.0), True),  # the whole log leaves no doubt
        (Gain(10.0, 7.0), Gain(40.0, 25.0), False),  # one row may have made all of that
        (Gain(10.0, 7.0), Gain(14.0, 3.0), False),  # so much some candidate may gain by chance
        (Gain(-5.0, 7.0), Gain(40.0, 9.0), False),
        (Gain(2.0, 0.5), Gain(40.0, 9.0), False),  # never worth a parameter
        (Gain(6.0, 7.0), Gain(60.0, 9.0), False),  # the held-out part says nothing
        (Gain(79.0, 55.0), Gain(157.0, 76.0), True),  # a few gross errors explained
        (Gain(79.0, 55.0, 50.0), Gain(157.0, 76.0, 70.0), True),
        (Gain(79.0, 35.0, 80.0), Gain(157.0, 66.0, 80.0), False),  # a single gross error explained
        (Gain(10.0, 4.0, 3.0), Gain(42.0, 9.0, 40.0), False),
    ],
)
def test_what_confirms_an_effect_and_settles_an_alarm_in_doubt(heldout, whole, certain):
    trial = Trial(None, None, None, None, 2.9, whole, heldout, whole)
    assert Outcome(trial, None, [trial]).certain is certain
    assert worth_it(trial, 3.2) is certain
    # A remarkable score is a test by itself.
    several = heldout.largest < heldout.total and whole.largest < whole.total - PRACTICAL
    assert worth_it(replace(trial, z=4.0), 3.2) is (heldout.total > 0.0 and whole.total > whole.se and several)


def test_nothing_found_settles_nothing():
    assert not Outcome(None, None, []).certain


def test_a_refit_is_kept_for_the_part_of_the_log_that_it_was_made_on(monkeypatch):
    log, nothing, splits = simulate_landmark_field(60, 1, bearings=True), Gain(0.0, 0.0), []

    def made(effect, z):
        return Trial(effect, None, None, None, z, nothing, nothing, nothing, SETTINGS.comparing)

    def tried(current, effect, z, log, split, **settings):
        splits.append(split)
        return made(effect, z)

    monkeypatch.setattr(refits, "try_effect", tried)
    refitting, effect, current = Refits(log, SETTINGS, 36), effect_named("odometry-arc", log), made(None, 0.0)
    for split, z in ((36, 4.0), (36, 5.0), (48, 6.0), (36, 7.0)):
        refitting.split = split
        (trial,) = refitting.refit(current, [RankedEffect(effect, z)])
        assert trial.z == z
    assert splits == [36, 48]


def test_only_the_likeliest_are_refitted_where_not_everything_is_to_be_searched(monkeypatch):
    log = simulate_landmark_field(60, 1, bearings=True)
    one, current = without_candidates(log)
    judgement = SimpleNamespace(z=np.zeros(0), critical_z=3.0, p_value=1e-4)
    monkeypatch.setattr(one, "_search_further", lambda *_: "searched further")
    assert one.explain(SimpleNamespace(judgement=judgement), current, False) == Outcome(None, None, [])
    monkeypatch.setattr(one, "comes_late", lambda last: False)
    assert one.explain(SimpleNamespace(judgement=judgement), current) == "searched further"
    judgement.p_value = 0.04
    assert one.explain(SimpleNamespace(judgement=judgement), current) == Outcome(None, None, [])


@pytest.mark.parametrize(("z", "everywhere", "expected"), [
    (5.0, True, "accepted"), (9.0, True, "searched further"), (9.0, False, "accepted"),
])  # fmt: skip
def test_what_gains_less_than_the_alarm_is_worth_is_not_the_end_of_the_search(monkeypatch, z, everywhere, expected):
    """30 nats are more than 5^2 / 2, and less than 9^2 / 2."""
    log = simulate_landmark_field(60, 1, bearings=True)
    one, current = without_candidates(log)
    best = replace(current, effect=effect_named("odometry-arc", log), on_fit=Gain(20.0, 5.0),
                   on_heldout=Gain(10.0, 4.0), on_all=Gain(30.0, 6.0))  # fmt: skip
    assert best.confirmed
    likeliest = [RankedEffect(best.effect, 0.0)]
    monkeypatch.setattr(one.refits, "refit", lambda current, chosen, *_: [best] if chosen is likeliest else [])
    monkeypatch.setattr(search, "shortlist", lambda *_, **__: likeliest)
    monkeypatch.setattr(one, "_formula_trials", lambda *_: None)
    monkeypatch.setattr(one, "_beside_formulas", lambda *_: "accepted")
    monkeypatch.setattr(one, "_search_further", lambda *_: "searched further")
    judgement = SimpleNamespace(z=np.zeros(0), critical_z=3.0, p_value=1e-9, raised=(SimpleNamespace(z=-z),))
    assert one.explain(SimpleNamespace(judgement=judgement), current, everywhere) == expected


@pytest.mark.parametrize(("motion", "sensor", "named"), [(90.0, 60.0, False), (40.0, 60.0, True), (0.0, 60.0, True)])
def test_a_sensor_that_is_trusted_less_explains_no_lost_robot_if_the_motion_does_better(
    monkeypatch, motion, sensor, named
):
    """With no effect of the motion does the filter follow here, with that of the sensors it does."""
    log, follows = simulate_landmark_field(150, 1, bearings=True), []
    rng = np.random.default_rng(1)

    def made(name, total):
        gain = Gain(total, 5.0)
        rows = total / log.n_steps + 0.01 * rng.standard_normal(log.n_steps)
        model = SimpleNamespace(bind=lambda log: name)
        fit = SimpleNamespace(theta=None, draws=None)
        return Trial(effect_named(name, log), model, fit, rows, 0.0, gain, gain, gain)

    def follow(fit):
        follows.append(fit)
        if fit == "heavy-tailed-motion-noise":
            raise FilterError("lost")

    fit = quick_fit(default_model(log).bind(log), 1, effort=GLANCE)
    found = iter([[made("heavy-tailed-motion-noise", motion)], [made("landmark-misread", sensor)]])
    base = Trial(None, None, fit, np.zeros(log.n_steps), 0.0, *(3 * [Gain(0.0, 0.0)]))
    monkeypatch.setattr(refits, "trial_of_base", lambda *_, **__: base)
    monkeypatch.setattr(lost_robot, "quick_fit", lambda bound, *_, **__: bound)
    refitting = Refits(log, SETTINGS, int(search.FIT_SHARE * log.n_steps))
    monkeypatch.setattr(refitting, "refit", lambda *_, **__: next(found))
    monkeypatch.setattr(refitting, "refit_leaders", lambda current, trials: trials)
    outcome = lost_robot.recover(fit, directions_of(candidates(log)), refitting, follow)
    assert (outcome is not None) is named
    assert follows == [*(["heavy-tailed-motion-noise"] if motion else []), *(["landmark-misread"] if named else [])]


@pytest.mark.parametrize("confirmed", [True, False])
def test_effects_of_the_whole_robot_compete_with_a_formula_that_is_confirmed(monkeypatch, confirmed):
    log, seen = simulate_landmark_field(60, 1, bearings=True), []
    gain = Gain(40.0, 5.0)
    heldout = gain if confirmed else Gain(-5.0, 5.0)
    rows = np.zeros(log.n_steps)
    formula = Trial(effect_named("odometry-arc", log), None, None, rows, 9.0, gain, heldout, gain)
    one, last = Search(log, (), SETTINGS), SimpleNamespace(judgement=SimpleNamespace(critical_z=3.0))
    one.judged = SimpleNamespace(z=np.zeros(0))
    monkeypatch.setattr(one, "_formula_trials", lambda *_: FormulaTrials([formula], (), last.judgement, 3.0))
    monkeypatch.setattr(one.refits, "refit", lambda current, chosen, rivals: seen.append(rivals) or [])
    # Without a rival every effect gets a longer fit, and a glance is not enough to leave one out.
    monkeypatch.setattr(one.refits, "refit_thoroughly", lambda current, trials, chosen: seen.append([]) or trials)
    monkeypatch.setattr(one, "_found", lambda best, *_: best)
    outcome = one._search_further(last, formula, [])
    assert seen == [[formula] if confirmed else []]
    assert outcome.accepted is (formula if confirmed else None)
    assert outcome.trials == [formula]


@pytest.mark.parametrize("confirmed", [True, False])
def test_an_effect_that_held_out_rows_confirm_is_not_hidden_by_an_accident_of_the_fit_part(monkeypatch, confirmed):
    """The accident gains more on the fit part, and held-out rows deny it."""
    log = simulate_landmark_field(60, 1, bearings=True)

    def trial(name, fit, heldout):
        whole = Gain(fit.total + heldout.total, 5.0)
        fitted = SimpleNamespace(bound=SimpleNamespace(lengths=(log.n_steps,)))
        return Trial(effect_named(name, log), None, fitted, np.zeros(log.n_steps), 1.0, fit, heldout, whole)

    accident = trial("odometry-arc", Gain(60.0, 5.0), Gain(-5.0, 5.0))
    other = trial("odometry-turn-scale", Gain(8.0, 5.0), Gain(15.0 if confirmed else 4.0, 5.0))
    lucky = trial("odometry-side-drift", Gain(0.5, 5.0), Gain(15.0, 5.0))
    one, last = Search(log, (), SETTINGS), SimpleNamespace(judgement=SimpleNamespace(critical_z=3.0))
    one.judged = SimpleNamespace(z=np.zeros(0))
    monkeypatch.setattr(one, "_formula_trials", lambda *_: FormulaTrials([], (), last.judgement, 3.0))
    monkeypatch.setattr(one.refits, "refit_thoroughly", lambda current, trials, chosen: trials)
    monkeypatch.setattr(one.refits, "refit_leaders", lambda current, trials, rivals: trials)
    monkeypatch.setattr(one, "_found", lambda best, *_: best)
    outcome = one._search_further(last, other, [accident, other, lucky])
    assert outcome.accepted is (other if confirmed else None)
    assert {found.effect.name for found in outcome.trials} == {
        "odometry-arc", "odometry-turn-scale", "odometry-side-drift",
    }  # fmt: skip


@pytest.mark.parametrize("always", [False, True])
def test_a_simulated_robot_that_is_lost_is_simulated_again(monkeypatch, always):
    """A model that loses one robot after another cannot be judged by such logs, and says so."""
    log = simulate_landmark_field(60, 1, bearings=True)
    fit = quick_fit(default_model(log).bind(log), 1, effort=GLANCE)
    made, score_log = [], judged_log.score_log

    def lost_in_the_third(bound, *given, **settings):
        made.append(bound.logs[0])
        if len(made) < 3 or (len(made) > 3 and not always):
            return score_log(bound, *given, **settings)
        raise FilterError("particle filter: at row 12 every particle has weight zero", row=12)

    monkeypatch.setattr(judged_log, "score_log", lost_in_the_third)
    if always:
        with pytest.raises(FilterError, match=f"loses the robot at t={log.times[12]:g} s of a log that") as caught:
            judged_log.judge_log(log, fit, (), 36, SETTINGS)
        assert str(caught.value).startswith(log.where)
        assert caught.value.row is None  # it is no row of the log
        return
    judged = judged_log.judge_log(log, fit, (), 36, SETTINGS)
    count = len(judged.simulated)
    assert len(made) == 1 + count + 1
    lost, again = (one.dataset["landmark_range"].values for one in made[2:4])
    assert not np.array_equal(lost, again, equal_nan=True)


def test_a_result_says_where_held_out_rows_helped_to_choose():
    log = simulate_landmark_field(60, 1, bearings=True)
    one, current = without_candidates(log)
    judgement = SimpleNamespace(p_values=np.empty(0))
    trial = replace(current, effect=effect_named("odometry-arc", log), z=4.0)

    def told(least_z=0.0):
        return one._found(trial, (), judgement, (), least_z).chosen_on_all_rows

    assert not told()
    assert told(4.5)
    one._only_by_all_rows = [effect_named("odometry-arc", log)]
    assert told()
    one._only_by_all_rows = []
    one.refits.split = int(search.LATE_FIT_SHARE * log.n_steps)
    assert told()
