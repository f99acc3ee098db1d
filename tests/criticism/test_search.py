"""What is refitted, how long, and in which order; what is answered; and what is said where a filter is lost."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pmcl.criticism.fitting.quick_fit import BRIEF, GLANCE, THOROUGH, quick_fit
from pmcl.criticism.fitting.trials import Trial
from pmcl.criticism.judging import judged_log
from pmcl.criticism.naming import formula_trials, judged_models, lost_robot, refits, search
from pmcl.criticism.naming.candidates import RankedEffect
from pmcl.criticism.naming.formula_trials import FormulaCandidates
from pmcl.criticism.naming.probability import Explanations
from pmcl.criticism.naming.refits import Refits
from pmcl.criticism.naming.search import Search
from pmcl.criticism.scoring.lower_bounds import LowerBound
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


def trial_of(effect, evidence=0.0, effort=GLANCE, rows=None, noise=0.3):
    """A trial with so much evidence, from many blocks of rows."""
    rows = np.zeros(60) if rows is None else rows
    return Trial(effect, None, None, rows, 1.0, Gain(evidence, 1.0), evidence, noise, rows[None], effort)


class Case:
    """A search in which fits and scores are made up, and what it has done."""

    def __init__(self, monkeypatch, evidence, scores=None, formulas=(), p_value=1e-9, bounds=None):
        self.log = simulate_landmark_field(60, 1, bearings=True)
        self.search = Search(self.log, candidates(self.log), SETTINGS)
        self.search.models.directions = directions_of(self.search.models.offered)
        self.search.models.current = None
        self.evidence, self.done, scores = evidence, [], scores or {}
        z = np.array([scores.get(one.effect.name, 0.0) for one in self.search.directions])
        self.last = SimpleNamespace(judgement=SimpleNamespace(
            z=z, score=z, score_std=np.ones(z.size), plain_z=z, plain_std=np.ones(z.size), p_value=p_value,
            p_values=np.ones(z.size), critical_z=3.0,
        ), fit=None, scored=SimpleNamespace(source=SimpleNamespace(columns=None)))  # fmt: skip
        bounds = bounds or {}
        monkeypatch.setattr(search, "bounds_of", lambda directions, *_: [
            LowerBound(bounds.get(one.effect.name, -np.inf), one.above) for one in directions
        ])  # fmt: skip
        scored = directions_of([one.effect for one in formulas])
        offered = FormulaCandidates(list(formulas), scored, SimpleNamespace(p_values=np.ones(len(scored))))

        def tried(current, effect, z, log, **settings):
            self.done.append((effect.name, "glance"))
            return trial_of(effect, self.evidence(effect), settings["effort"])

        def refitted(trial, current, *, effort, **settings):
            self.done.append((trial.effect.name, "brief" if effort == BRIEF else "thorough"))
            return replace(trial, effort=effort)

        monkeypatch.setattr(refits, "try_effect", tried)
        monkeypatch.setattr(refits, "refitted", refitted)
        monkeypatch.setattr(search, "remarkable_formulas", lambda *_: offered)

    def explain(self, further=True):
        """Run the search."""
        return self.search.explain(self.last, trial_of(None, effort=THOROUGH), further)

    def names(self, what):
        """Effects to which this was done, in this order."""
        return [name for name, done in self.done if done == what]


def gains(**evidence):
    """Evidence by name, with underscores for hyphens; other effects lose 5 nats."""
    return lambda effect: evidence.get(effect.name.replace("-", "_"), -5.0)


def test_what_explains_the_log_ends_the_search_and_only_it_gets_a_long_fit(monkeypatch):
    case = Case(monkeypatch, gains(landmark_misread=60.0), {"landmark-misread": 7.0})
    outcome = case.explain()
    assert outcome.accepted.effect.name == outcome.found.name == "landmark-misread"
    assert outcome.certain
    assert outcome.found.probability > 0.99
    assert case.names("thorough") == ["landmark-misread"]
    assert not case.names("brief")  # nothing else may be right
    assert case.names("glance")[0] == "landmark-misread"
    # One batch, and what looks like the answer.
    assert len(case.names("glance")) < search._BATCH + 6


def test_a_near_twin_without_a_score_shares_the_answer(monkeypatch):
    monkeypatch.setattr(search, "_BATCH", 1)
    # To a log of landmarks alone, a turned camera and a bearing bias are one effect.
    alike = {"odometry-side-drift", "sensor-yaw", "bearing-bias"}
    evidence = gains(odometry_side_drift=60.0, sensor_yaw=60.0, bearing_bias=60.0)
    case = Case(monkeypatch, evidence, {"odometry-side-drift": 7.0})
    outcome = case.explain()
    assert {outcome.found.name, *outcome.found.not_distinguishable_from} == alike
    assert set(case.names("thorough")) == alike
    # By its score alone the twin would not have been tried: another effect explains the log.
    alone = Case(monkeypatch, gains(landmark_misread=60.0, sensor_yaw=60.0), {"landmark-misread": 7.0})
    alone.explain()
    assert "sensor-yaw" not in alone.names("glance")
    assert outcome.found.probability + sum(one.probability for one in outcome.found.alternatives) > 0.98


def test_what_becomes_the_answer_by_a_longer_fit_of_another_is_fitted_thoroughly_too(monkeypatch):
    case = Case(monkeypatch, gains(odometry_arc=60.0, odometry_turn_scale=50.0), {"odometry-arc": 7.0})
    brief = refits.refitted

    def worse_when_thorough(trial, current, *, effort, **settings):
        longer = brief(trial, current, effort=effort, **settings)
        if effort == THOROUGH and trial.effect.name == "odometry-arc":
            return replace(longer, evidence=20.0)
        return longer

    monkeypatch.setattr(refits, "refitted", worse_when_thorough)
    monkeypatch.setattr(search, "twins_of", lambda *_: [])  # no further round mends it
    outcome = case.explain()
    assert outcome.accepted.effect.name == "odometry-turn-scale"
    assert outcome.accepted.thorough


def test_where_the_likeliest_explain_nothing_further_candidates_are_tried_unless_the_alarm_is_in_doubt(monkeypatch):
    # Its score is the least of all: the path has absorbed it.
    monkeypatch.setattr(search, "_BATCH", 2)
    evidence, scores = gains(odometry_turn_scale=60.0), {"odometry-turn-scale": -0.01}
    case = Case(monkeypatch, evidence, {**scores, **dict.fromkeys(("landmark-misread", "sensor-latency"), 2.0)})
    assert case.explain(further=False).accepted is None
    assert len(case.names("glance")) < search._BATCH + 6
    outcome = case.explain()
    assert outcome.found.name == "odometry-turn-scale"
    assert len(set(case.names("glance"))) == len(case.names("glance"))  # nothing is fitted again


def test_what_gains_along_the_trajectories_is_tried_first_whatever_its_score(monkeypatch):
    """A score says little about a large effect; it starts where it gains, and nothing else is tried."""
    scores = {"odometry-arc": 7.0, "landmark-range-bias": 6.0, "landmark-misread": -4.0}
    case = Case(monkeypatch, gains(landmark_misread=500.0), scores, bounds={"landmark-misread": 300.0})
    starts, tried = {}, refits.try_effect

    def remembered(current, effect, z, log, *, at, **settings):
        starts[effect.name] = at
        return tried(current, effect, z, log, **settings)

    monkeypatch.setattr(refits, "try_effect", remembered)
    assert case.explain().found.name == "landmark-misread"
    assert case.names("glance")[0] == "landmark-misread"
    assert starts["landmark-misread"] is not None
    assert starts["odometry-arc"] is None
    assert len(case.names("glance")) < search._BATCH + 6


def test_where_nothing_explains_the_log_also_what_its_scores_speak_against_is_tried(monkeypatch):
    """A base model that makes up for a large effect by large noise has a score that says the effect is absent."""
    case = Case(monkeypatch, gains(landmark_misread=500.0), {"landmark-misread": -4.0})
    order = search.in_order(case.search.directions, case.search._promises(case.last))
    assert not next(one for one in order if one.effect.name == "landmark-misread").worth_a_fit
    assert case.explain(further=False).accepted is None
    outcome = case.explain()
    assert outcome.found.name == "landmark-misread"
    assert {one.effect.name for one in order} <= set(case.names("glance"))


def test_a_refuted_answer_competes_with_all_that_promise_something_at_all_places(monkeypatch):
    """A patch has evidence at the place whose score promises most, and far more at another, which no fit reaches."""

    def evidence(effect):
        if effect.name == "slippery-patch":
            return 900.0 if effect.where["place"] == true_place else 20.0
        return {"landmark-range-bias": 60.0}.get(effect.name, -5.0)

    scores, bounds = {"landmark-range-bias": 9.0, "slippery-patch": 0.1}, {"slippery-patch": 0.5}
    case = Case(monkeypatch, evidence, scores, bounds=bounds)
    places = [one.effect.where["place"] for one in case.search.directions if one.effect.name == "slippery-patch"]
    true_place = places[-1]
    outcome = case.explain()
    assert outcome.found.name == "landmark-range-bias"
    assert not outcome.exhausted
    assert len(case.names("glance")) < search._BATCH + 6
    case.done.clear()
    again = case.search.explain(case.last, trial_of(None, effort=THOROUGH), refuted=outcome)
    assert again.found.name == "slippery-patch"
    assert again.accepted.effect.where["place"] == true_place
    assert again.exhausted
    assert "landmark-range-bias" not in case.names("glance")  # it was fitted before
    # An effect that explains nothing where it promises most is not tried elsewhere.
    lost = Case(monkeypatch, gains(landmark_range_bias=60.0), scores, bounds=bounds)
    answer = lost.explain()
    lost.search.explain(lost.last, trial_of(None, effort=THOROUGH), refuted=answer)
    assert lost.names("glance").count("slippery-patch") == 1
    # What promises nothing is not tried, as long as something explains the log.
    none = Case(monkeypatch, evidence, {"landmark-range-bias": 9.0, "slippery-patch": -4.0})
    none.search.explain(none.last, trial_of(None, effort=THOROUGH), refuted=none.explain())
    assert "slippery-patch" not in none.names("glance")


def test_the_search_ends_where_something_is_more_probable_than_a_refuted_answer(monkeypatch):
    """It is the answer then; what is left is tried only if that is refuted, too."""
    evidence = gains(landmark_range_bias=60.0, odometry_arc=300.0, odometry_turn_scale=900.0)
    bounds = {"odometry-arc": 0.6}
    case = Case(monkeypatch, evidence, {"landmark-range-bias": 9.0, "odometry-turn-scale": -0.01}, bounds=bounds)
    monkeypatch.setattr(search, "_BATCH", 1)
    monkeypatch.setattr(search, "twins_of", lambda *_: [])
    first = case.explain()
    assert first.found.name == "landmark-range-bias"
    found, outcome = [], first
    while outcome.found.name != "odometry-turn-scale":
        outcome = case.search.explain(case.last, trial_of(None, effort=THOROUGH), refuted=outcome)
        found.append(outcome.found.name)
        assert not outcome.exhausted or outcome.found.name == "odometry-turn-scale"
    assert found == ["odometry-arc", "odometry-turn-scale"]
    assert len(set(case.names("glance"))) == len(case.names("glance"))


@pytest.mark.parametrize(
    ("alarms", "p_value", "with_more", "refuted"),
    [
        ((), 0.3, None, False),
        (("score",), 1e-3, 1e-3, False),
        (("score",), 1e-3, 1e-9, True),
        (("score",), 1e-12, None, True),
    ],
)
def test_an_answer_is_refuted_by_an_alarm_beyond_doubt_and_judged_once(
    monkeypatch, alarms, p_value, with_more, refuted
):
    """An alarm in doubt is judged by more simulated logs first; others are not."""
    case = Case(monkeypatch, gains(landmark_misread=60.0), {"landmark-misread": 7.0})
    outcome, judged = case.explain(), []
    judgement = SimpleNamespace(raised=alarms, p_value=p_value)
    result = SimpleNamespace(judgement=judgement, scored=None)
    monkeypatch.setattr(judged_models, "judge_log", lambda *_: judged.append(1) or result)
    if with_more is not None:
        judgement = SimpleNamespace(raised=alarms, p_value=with_more)
        surer = SimpleNamespace(judgement=judgement, scored=None)
        more = {id(result): surer}
        monkeypatch.setattr(judged_models, "with_more_simulations", lambda before, *_: more[id(before)])
    monkeypatch.setattr(case.search.models, "_lacking", lambda fit: ())
    outcome = outcome._replace(accepted=replace(outcome.accepted, fit=SimpleNamespace()))
    assert case.search.refuted(outcome) is refuted
    assert case.search.judge(outcome.accepted.fit).judgement is judgement
    assert len(judged) == 1
    case.search.judge(outcome.accepted.fit)
    assert len(judged) == 2
    assert not case.search.refuted(outcome._replace(exhausted=True))
    assert not case.search.refuted(outcome._replace(accepted=None))
    assert len(judged) == 2


@pytest.mark.parametrize(("evidence", "accepted"), [(-3.0, False), (2.5, False), (12.0, True)])
def test_a_suspicion_counts_only_if_its_evidence_is_clear(monkeypatch, evidence, accepted):
    """Without an alarm: what the scores as they are suspect is fitted, with its twins, and nothing else is."""
    case = Case(monkeypatch, gains(landmark_misread=evidence), {"landmark-misread": 7.0}, p_value=0.5)
    current = trial_of(None, effort=THOROUGH)
    outcome = case.search.explain_suspicion(case.last, current)
    assert (outcome is not None) is accepted
    assert case.names("glance")[0] == "landmark-misread"
    assert len(case.names("glance")) <= 4
    if accepted:
        assert outcome.found.name == "landmark-misread"
    case.last.judgement.plain_z = np.zeros(case.last.judgement.z.size)
    case.done.clear()
    assert case.search.explain_suspicion(case.last, current) is None
    assert not case.done


def test_nothing_is_answered_where_all_candidates_lose(monkeypatch):
    case = Case(monkeypatch, gains())
    outcome = case.explain()
    assert outcome.accepted is None
    assert outcome.found is None
    assert not outcome.certain
    assert outcome.probable.nothing + outcome.probable.unknown > 0.99
    order = search.in_order(case.search.directions, case.search._promises(case.last))
    worth = {one.effect.name for one in order if one.worth_a_fit}
    assert worth <= set(case.names("glance"))


def test_what_gains_less_than_the_alarm_is_worth_leaves_the_log_unexplained(monkeypatch):
    """An effect that is only related to the missing one gains something, and the p-value says that more is missing."""
    related = gains(odometry_arc=12.0)
    outcome = Case(monkeypatch, related, {"odometry-arc": 5.0}, p_value=1e-3).explain()
    assert outcome.found.name == "odometry-arc"
    outcome = Case(monkeypatch, related, {"odometry-arc": 5.0}, p_value=1e-18).explain()
    assert outcome.accepted is None
    assert outcome.probable.unknown > 0.9


def test_a_formula_competes_with_the_best_effect(monkeypatch):
    log = simulate_landmark_field(60, 1, bearings=True)
    formula = replace(effect_named("odometry-arc", log), name="formula: turn += c*speed")
    ranked = [search.RankedEffect(formula, 6.0)]
    better = {"formula:_turn_+=_c*speed": 80.0, "odometry_turn_scale": 60.0}
    evidence = lambda effect: better.get(effect.name.replace("-", "_").replace(" ", "_"), -5.0)  # noqa: E731
    outcome = Case(monkeypatch, evidence, {"odometry-turn-scale": 7.0}, ranked).explain()
    assert outcome.found.name == "formula: turn += c*speed"
    better["formula:_turn_+=_c*speed"] = 59.0
    outcome = Case(monkeypatch, evidence, {"odometry-turn-scale": 7.0}, ranked).explain()
    assert outcome.found.name == "odometry-turn-scale"


def test_a_formula_competes_with_what_explains_a_doubted_alarm_but_is_not_tried_where_nothing_explains_it(monkeypatch):
    log = simulate_landmark_field(60, 1, bearings=True)
    formula = replace(effect_named("odometry-arc", log), name="formula: turn += c*speed")
    ranked, scores = [search.RankedEffect(formula, 6.0)], {"odometry-turn-scale": 7.0}
    for of_effect, tried in ((60.0, True), (-5.0, False)):
        better = {"formula:_turn_+=_c*speed": 80.0, "odometry_turn_scale": of_effect}
        evidence = lambda effect: better.get(effect.name.replace("-", "_").replace(" ", "_"), -5.0)  # noqa: E731, B023
        case = Case(monkeypatch, evidence, scores, ranked)
        outcome = case.explain(further=False)
        assert (formula.name in case.names("glance")) is tried
        assert (outcome.accepted is not None) is tried
        assert not tried or outcome.found.name == formula.name


def test_a_formula_that_a_log_can_tell_from_an_effect_is_no_other_word_for_it(rng):
    """Scores with a correlation of 0.99 tell two changes apart where they promise more than some hundred nats."""
    effect, other = rng.standard_normal((2, 4000))
    formula = 0.99 * effect + np.sqrt(1.0 - 0.99**2) * other
    scores, catalogue = np.array([formula, formula, other]), effect[None]
    assert list(formula_trials._same_changes(scores, catalogue, np.array([20.0, 400.0, 20.0]))) == [True, False, False]
    # What is exactly proportional never counts, and without a catalogue all counts.
    assert list(formula_trials._same_changes(-3.0 * catalogue, catalogue, np.array([1e6]))) == [True]
    assert not formula_trials._same_changes(scores, catalogue[:0], np.full(3, 20.0)).any()


def test_a_formula_with_little_of_the_leading_effects_score_is_not_refitted(monkeypatch):
    log = simulate_landmark_field(60, 1, bearings=True)
    arc, *others = (effect_named(name, log) for name in ("odometry-arc", "odometry-turn-scale", "landmark-misread"))
    names = ["formula: turn += c", "formula: turn += c*speed"]
    offered = directions_of([replace(arc, name=name) for name in names])
    catalogue = directions_of(others)
    rows = np.eye(len(catalogue) + len(offered), 60)

    def judged(directions, scores, values):
        judgement = SimpleNamespace(
            z=values, score=values, score_std=np.ones(values.size), critical_z=3.0
        )
        return judged_log.JudgedLog(SimpleNamespace(scores=scores), judgement, (), directions)

    of_catalogue = np.array([10.0 if one.effect is others[0] else 4.0 for one in catalogue])
    before = judged(catalogue, rows[: len(catalogue)], of_catalogue)
    after = judged(offered, rows[len(catalogue) :], np.array([4.5, 5.5]))
    monkeypatch.setattr(formula_trials, "formulas", lambda *_: [one.effect for one in offered])
    monkeypatch.setattr(formula_trials, "with_directions", lambda *_: after)
    monkeypatch.setattr(formula_trials, "remarkable_waves", lambda *_: SimpleNamespace(found=[]))
    last = SimpleNamespace(fit=SimpleNamespace(tables=None, path=None))
    for leading, refitted in ((others[0], names[1:]), (others[1], names[::-1]), (None, names[::-1])):
        tried = formula_trials.remarkable_formulas(last, before, log, SETTINGS, leading)
        assert [one.effect.name for one in tried.chosen] == refitted


def test_a_refit_is_kept_until_another_model_is_judged(monkeypatch):
    case = Case(monkeypatch, gains(odometry_arc=30.0))
    effect, current = effect_named("odometry-arc", case.log), trial_of(None)
    for z in (4.0, 5.0):
        (trial,) = case.search.refits.glances(current, [search.RankedEffect(effect, z)])
        assert trial.z == z
    assert case.names("glance") == ["odometry-arc"]
    case.search.refits.forget()
    case.search.refits.glances(current, [search.RankedEffect(effect, 4.0)])
    assert case.names("glance") == 2 * ["odometry-arc"]


@pytest.mark.slow
@pytest.mark.parametrize(("motion", "sensor", "named"), [(90.0, 60.0, False), (40.0, 60.0, True), (0.0, 60.0, True)])
def test_a_sensor_that_is_trusted_less_explains_no_lost_robot_if_the_motion_does_better(
    monkeypatch, motion, sensor, named
):
    """With no effect of the motion does the filter follow here, with that of the sensors it does."""
    log, follows, rng = simulate_landmark_field(150, 1, bearings=True), [], np.random.default_rng(1)

    def glances(current, offered):
        if len(offered) < 4:
            return []  # near twins of the answer; they fit no better
        carriers = {one.effect.carrier for one in offered}
        name, total = ("heavy-tailed-motion-noise", motion) if carriers == {"motion"} else ("landmark-misread", sensor)
        rows = total / log.n_steps + 0.01 * rng.standard_normal(log.n_steps)
        found = [replace(trial_of(effect_named(name, log), total, rows=rows), fit=name)]
        if carriers == {"motion"}:  # with this the filter follows, but it is far less probable
            found.append(replace(trial_of(effect_named("odometry-arc", log), total - 50.0, rows=rows), fit="arc"))
        return found

    def follow(fit):
        follows.append(fit)
        if fit == "heavy-tailed-motion-noise":
            raise FilterError("lost")

    fit = quick_fit(default_model(log).bind(log), 1, effort=GLANCE)
    base = trial_of(None, rows=np.zeros(log.n_steps))
    refitting = Refits(log, SETTINGS)
    monkeypatch.setattr(refitting, "base_trial", lambda fit: base)
    monkeypatch.setattr(refitting, "glances", glances)
    monkeypatch.setattr(refitting, "longer", lambda current, trials, effort: trials)
    monkeypatch.setattr(lost_robot, "_along_a_better_path", lambda *_: None)
    outcome = lost_robot.recover(fit, directions_of(candidates(log)), refitting, follow)
    assert (outcome is not None) is named
    assert follows == [*(["heavy-tailed-motion-noise"] if motion else []), *(["landmark-misread"] if named else [])]


@pytest.mark.parametrize(("yaw", "name", "told"), [
    (420.0, "sensor-yaw", []), (402.0, "sensor-yaw", ["odometry-side-drift"]),
    (398.0, "odometry-side-drift", ["sensor-yaw"]), (380.0, "odometry-side-drift", []),
])  # fmt: skip
@pytest.mark.parametrize("lost", [False, True])
def test_a_near_twin_of_what_lets_the_filter_follow_competes_with_it(monkeypatch, yaw, name, told, lost):
    """A turned camera looks like a robot that slides, and effects of the motion are tried first."""
    log, rng = simulate_landmark_field(150, 1, bearings=True), np.random.default_rng(1)
    evidence = {"odometry-side-drift": 400.0, "sensor-yaw": yaw}

    def glances(current, offered):
        rows = {one: evidence[one] / log.n_steps + 0.01 * rng.standard_normal(log.n_steps) for one in evidence}
        tried = [one.effect.name for one in offered if one.effect.name in evidence]
        return [replace(trial_of(effect_named(one, log), evidence[one], rows=rows[one]), fit=one) for one in tried]

    def follow(fit):
        if lost and fit == "sensor-yaw":
            raise FilterError("lost")

    fit = quick_fit(default_model(log).bind(log), 1, effort=GLANCE)
    refitting = Refits(log, SETTINGS)
    monkeypatch.setattr(refitting, "base_trial", lambda fit: trial_of(None, rows=np.zeros(log.n_steps)))
    monkeypatch.setattr(refitting, "glances", glances)
    monkeypatch.setattr(refitting, "longer", lambda current, trials, effort: trials)
    monkeypatch.setattr(lost_robot, "_along_a_better_path", lambda *_: None)
    outcome = lost_robot.recover(fit, directions_of(candidates(log)), refitting, follow)
    assert outcome.accepted.effect.name == ("odometry-side-drift" if lost else name)
    assert [one.effect.name for one in outcome.twins] == ([] if lost else told)


@pytest.mark.parametrize(("evidence", "chosen"), [((90.0, 119.0, 118.0), None), ((90.0, 150.0, 121.0), 1)])
def test_a_chain_that_has_lost_the_robot_starts_again_along_the_best_filters_path(monkeypatch, evidence, chosen):
    """The current model has 100 nats; a filter with one more effect must explain the log far better."""
    log = simulate_landmark_field(60, 1, bearings=True)
    fit = quick_fit(default_model(log).bind(log), 1, effort=GLANCE)
    current = replace(trial_of(None, rows=np.full(60, 100.0 / 60)), fit=fit, model=fit.bound.model)
    names = ("odometry-arc", "wheel-slip", "heavy-tailed-motion-noise")
    offered, ran, fitted = [search.RankedEffect(effect_named(name, log), 1.0) for name in names], [], []

    def run_filter(tables, n_steps, particles, rng):
        ran.append(particles)
        if len(ran) == 4:
            raise FilterError("lost")
        return SimpleNamespace(log_evidence=evidence[len(ran) - 1], number=len(ran) - 1)

    def fit_again(bound, seed, *, theta, path):
        fitted.append((bound, path))
        return "another fit"

    monkeypatch.setattr(lost_robot, "run_filter", run_filter)
    monkeypatch.setattr(lost_robot, "draw_paths", lambda tables, filtered, n, rng: [f"path {filtered.number}"])
    monkeypatch.setattr(lost_robot, "quick_fit", fit_again)
    found = lost_robot._along_a_better_path(current, [*offered, offered[0]], SETTINGS)
    assert ran == 4 * [SETTINGS.comparing]
    assert found == (None if chosen is None else "another fit")
    assert fitted == ([] if chosen is None else [(fit.bound, f"path {chosen}")])


@pytest.mark.slow
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
            judged_log.judge_log(log, fit, (), SETTINGS)
        assert str(caught.value).startswith(log.where)
        assert caught.value.row is None  # it is no row of the log
        return
    judged = judged_log.judge_log(log, fit, (), SETTINGS)
    count = len(judged.simulated)
    assert len(made) == 1 + count + 1
    lost, again = (one.dataset["landmark_range"].values for one in made[2:4])
    assert not np.array_equal(lost, again, equal_nan=True)


def test_an_effect_is_named_again_among_what_looks_like_it_and_is_not_in_the_model(monkeypatch):
    """The noise of a scored pass hides what tells two latencies apart, so that both may be meant."""
    case = Case(monkeypatch, gains(odometry_latency=60.0, sensor_latency=59.5, bearing_bias=90.0))
    late, other = (effect_named(name, case.log) for name in ("sensor-latency", "odometry-latency"))
    without = replace(trial_of(None, effort=THOROUGH), model=SimpleNamespace(effects=()))
    again = case.search.named_again(case.last, without, RankedEffect(late, -1.0))
    assert again.found.name == "odometry-latency"
    assert again.found.not_distinguishable_from == ("sensor-latency",)
    assert "bearing-bias" not in case.names("glance")  # it does not look like a latency
    assert not case.search.refits._known  # fits belong to a model that is current no longer
    case.done.clear()
    without = replace(without, model=SimpleNamespace(effects=(other,)))
    alone = case.search.named_again(case.last, without, RankedEffect(late, -1.0))
    assert "odometry-latency" not in case.names("glance")
    assert alone is None or alone.found.name != "odometry-latency"


@pytest.mark.parametrize(
    ("evidence", "left", "accepted"), [(25.0, 1e-15, True), (25.0, 0.5, False), (0.5, 1e-15, False)]
)
def test_an_effect_is_told_beside_something_unknown_if_it_is_clear_and_alarms_stay(
    monkeypatch, evidence, left, accepted
):
    case = Case(monkeypatch, gains(landmark_misread=evidence), {"landmark-misread": 7.0}, p_value=1e-17)
    current = trial_of(None, effort=THOROUGH)
    outcome = case.explain()
    assert outcome.accepted is None
    judged = []
    result = SimpleNamespace(judgement=SimpleNamespace(raised=("score",), p_value=left), scored=None)
    monkeypatch.setattr(judged_models, "judge_log", lambda *_: judged.append(1) or result)
    monkeypatch.setattr(judged_models, "with_more_simulations", lambda before, *_: before)
    monkeypatch.setattr(case.search.models, "_lacking", lambda fit: ())
    beside = case.search.beside_something_unknown(case.last, current, outcome)
    assert (beside.accepted is not None) is accepted
    assert len(judged) == (evidence > 1.0)  # a model for which nothing speaks is not judged
    if accepted:
        assert beside.found.name == "landmark-misread"
        assert beside.found.probability > 0.9
        assert [one.effort for one in beside.trials if one is beside.accepted] == [THOROUGH]

    def lost(*_):
        raise FilterError("made", row=7)

    monkeypatch.setattr(judged_models, "judge_log", lost)
    assert case.search.beside_something_unknown(case.last, current, outcome) is outcome
    empty = outcome._replace(trials=[], probable=Explanations(0.0, 1.0, (), ()))
    assert case.search.beside_something_unknown(case.last, current, empty) is empty
