"""The critic answers whatever the filter does: another model, a part of the log, or where the robot is lost."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pmcl.criticism import loop
from pmcl.criticism.findings.verdict import UNKNOWN, sentence_of
from pmcl.criticism.loop import Loop
from pmcl.criticism.lost_filter import LEAST_ROWS, Runs
from pmcl.criticism.naming import gross_errors
from pmcl.criticism.naming.lost_robot import Recovery
from pmcl.criticism.naming.revision import Answer
from pmcl.criticism.naming.search import Search
from pmcl.criticism.settings import Settings
from pmcl.criticism.state import Loss, State, Task
from pmcl.criticism.workflow import criticize
from pmcl.errors import FilterError, PosteriorError
from pmcl.logs.mrclam import read_mrclam
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.selection import effect_named
from pmcl.models.outliers import with_gross_errors
from pmcl.models.robot_model import default_model
from pmcl.reports.criticism_report import write_criticism_report
from pmcl.simulations.landmark_field import simulate_landmark_field

# mypy: disable-error-code="no-untyped-def"

SETTINGS = Settings(particles=100, seed=1, level=0.05, simulations=20, paths=5, workers=1, progress=False)
# Some losses tell no row, as those of a chain that finds no start.
UNKNOWN_ROW = -1


@pytest.fixture(scope="module")
def log():
    return simulate_landmark_field(240, 1, bearings=True).without_truth()


def carried(log, row):
    """From some row on, the readings are those of another place: no effect of the catalogue does that."""
    dataset = log.dataset.copy(deep=True)
    for name in ("landmark_range", "landmark_bearing"):
        dataset[name].values[row:] = log.dataset[name].values[: log.n_steps - row]
    return RobotLog(dataset, "carried.nc")


def answered(log, follows):
    """Run with filters that lose the robot of n rows at row ``follows(gross, n)``; return runs and answer."""
    runs = []

    def run(one):
        gross = one.base.sensors[0].outliers
        runs.append((gross, one.log.n_steps, one))
        row = follows(gross, one.log.n_steps)
        if row is None:
            return one
        raise FilterError("made", row=None if row == UNKNOWN_ROW else row)

    return runs, Runs(SETTINGS, lambda log: (), run).criticism_of(log, default_model(log))


def test_a_filter_that_follows_needs_nothing_else(log):
    runs, answer = answered(log, lambda gross, n: None)
    assert [one[:2] for one in runs] == [(False, 240)]
    assert answer.loss is None
    assert not answer.notes


def test_gross_errors_are_allowed_for_where_the_filter_is_lost_without(log):
    runs, answer = answered(log, lambda gross, n: None if gross else 100)
    assert [one[:2] for one in runs] == [(False, 240), (True, 240)]
    assert answer.loss.model == default_model(log)
    assert not answer.loss.partial
    assert answer.loss.place.time == (100, 239)
    assert f"loses the robot at t={log.times[100]:g} s" in answer.loss.what
    assert "gross errors among the readings are therefore allowed for" in answer.notes[0]


def test_the_rows_before_the_loss_are_judged_where_gross_errors_do_not_help(log):
    runs, answer = answered(log, lambda gross, n: None if n < 100 else 100)
    assert [one[:2] for one in runs] == [(False, 240), (True, 240), (False, 80)]
    assert answer.loss.partial
    assert answer.loss.place.time == (100, 239)
    assert f"only the 80 rows before t={log.times[80]:g} s are judged" in answer.notes[0]


def test_a_part_is_shortened_until_the_filter_follows_and_gross_errors_may_reach_further(log):
    def follows(gross, n):
        return None if (gross and n < 150) else (160 if gross else min(130, n - 10))

    runs, answer = answered(log, follows)
    # Without gross errors each part is lost near its end, until it is too short.
    assert [one[:2] for one in runs] == [(False, 240), (True, 240), (False, 110), (False, 80), (True, 140)]
    assert answer.base.sensors[0].outliers


def test_a_part_whose_simulated_logs_lose_the_robot_is_shortened_too(log):
    """Such a loss is at no row of the log."""
    runs, answer = answered(log, lambda gross, n: 150 if n == 240 else UNKNOWN_ROW if n > 100 else None)
    assert [one[:2] for one in runs] == [(False, 240), (True, 240), (False, 130), (False, 110), (False, 90)]
    assert answer.loss.partial


@pytest.mark.parametrize("row", [0, UNKNOWN_ROW, LEAST_ROWS])
def test_where_nothing_helps_the_answer_says_where_the_robot_is_lost(log, tmp_path, row):
    runs, answer = answered(log, lambda gross, n: row)
    assert [one[:2] for one in runs] == [(False, 240), (True, 240)]
    assert answer.verdict == UNKNOWN
    row = 0 if row == UNKNOWN_ROW else row
    when = f"t={log.times[row]:g} s"
    assert answer.sentence.endswith(f"missing that no known effect explains: the filter loses the robot at {when}")
    assert "the rows before that are too few" in answer.notes[0]
    content = json.loads(answer.to_json())
    assert content["steps"][0]["gap"]["log_score_per_reading"] is None
    assert content["unexplained"][0]["time"] == [row, 239]
    assert content["unexplained"][0]["p_value"] is None
    answer.write_model(tmp_path / "model.toml")
    with pytest.raises(PosteriorError, match="no full chains"):
        answer.write_posterior(tmp_path / "posterior.nc")
    write_criticism_report(answer, tmp_path / "page.html")
    assert when in (tmp_path / "page.html").read_text()


def test_gross_errors_come_once(log):
    model = with_gross_errors(default_model(log))
    assert model == default_model(log, outliers=True)
    assert with_gross_errors(model) is model
    runs = []

    def lost(one):
        runs.append(one.base)
        raise FilterError("made", row=0)

    Runs(SETTINGS, lambda log: (), lost).criticism_of(log, model)
    assert runs == [model]


@pytest.mark.parametrize(("evidence", "follows", "kept", "note"), [
    (40.0, True, True, "the log speaks for them with 40.0 nats"),
    (-2.0, True, False, "dropped when what was found explained them"),
    (-2.0, False, True, "without them the filter loses the robot"),
])  # fmt: skip
def test_gross_errors_are_dropped_where_the_filter_follows_without_and_nothing_is_lost(
    monkeypatch, log, evidence, follows, kept, note
):
    plain = default_model(log)
    loss = Loss(plain, "", None)
    task = Task(with_gross_errors(plain), Search(log, (), SETTINGS), loss)
    bound = task.base.bind(log)
    theta = bound.prior_mean()
    known = dict(zip(bound.names, theta, strict=True))
    fit = SimpleNamespace(bound=bound, path=np.zeros((240, 3)), values=lambda: known)
    fitted = []

    def followed(fit):
        if not follows:
            raise FilterError("made", row=3)
        return ()

    def fit_again(bound, seed, *, theta, path):
        fitted.append((bound.names, theta))
        return SimpleNamespace(bound=bound, theta=theta, path=path)

    monkeypatch.setattr(gross_errors, "quick_fit", fit_again)
    monkeypatch.setattr(gross_errors, "compile_for_criticism", lambda tables: None)
    monkeypatch.setattr(gross_errors, "trial_of_base", lambda fit, **_: fit)
    monkeypatch.setattr(gross_errors, "evidence_between", lambda trial, without: evidence)
    monkeypatch.setattr(Loop, "_follow", lambda self, fit: followed(fit))
    monkeypatch.setattr(Loop, "_recorded", lambda self, state, *_: replace(state, steps=(*state.steps, "recorded")))
    monkeypatch.setattr(task.search, "judge", lambda fit: "judged again")
    before = State(SimpleNamespace(fit=fit), None, (Answer(None),))
    after = Loop(task, rounds=3)._without_gross_errors(before, loss)
    assert after.judged == (before.judged if kept else "judged again")
    assert len(after.steps) == (0 if kept else 1)
    assert note in after.notes[0]
    assert (before.steps, before.notes) == ((), ())
    names, values = fitted[0]
    assert names == bound.names[:-1]
    np.testing.assert_array_equal(values, theta[:-1])
    # Without anything found there is nothing that could have replaced them.
    nothing = replace(before, answers=())
    assert Loop(task, rounds=3)._without_gross_errors(nothing, loss) is nothing


def test_near_twins_with_which_the_filter_follows_belong_to_the_answer(monkeypatch, log):
    """The drive that would tell them apart is simulated under each of them."""
    task = Task(default_model(log), Search(log, (), SETTINGS))
    first, twin = SimpleNamespace(), SimpleNamespace()
    monkeypatch.setattr(loop, "found_effect", lambda trial, twins, *_: SimpleNamespace(name="sensor-yaw"))
    monkeypatch.setattr(Loop, "_added", lambda self, state, accepted, trials, answer, decision: answer)
    state = State(SimpleNamespace(judgement=None), None)
    monkeypatch.setattr(loop, "with_probabilities", lambda found, *_: found)
    answer = Loop(task, rounds=3)._with_recovery(state, Recovery(first, [first, twin], None, [twin]))
    assert answer.credible == (first, twin)


def test_a_lost_robot_is_part_of_the_sentence(log):
    assert sentence_of(UNKNOWN, (), (), (), {}, {}, log, "made") == (
        "Something is missing that no known effect explains: made"
    )


@pytest.mark.long
def test_a_robot_that_was_carried_away_gets_an_answer(log):
    """The part before it was carried away lacks nothing; no effect is named for what came after."""
    result = criticize(carried(log, 150), simulations=15, joint=False, seed=1, rounds=1)
    assert result.verdict == UNKNOWN
    assert not result.effects
    assert 110 <= result.log.n_steps <= 135
    assert "on the filter loses the robot" in result.sentence
    assert result.unexplained[0].channel == "pose"
    assert 140 <= result.unexplained[0].time[0] <= 155
    assert len(result.unexplained) == 1
    assert np.isnan(result.nothing_probability)


@pytest.mark.slow
def test_a_burst_of_gross_errors_is_allowed_for_where_no_candidate_explains_it(log):
    """Rows of nonsense lose a filter; with gross errors it follows to the end, and the answer says so."""
    dataset, rng = log.dataset.copy(deep=True), np.random.default_rng(3)
    for name, (low, high) in {"landmark_range": (0.5, 8.0), "landmark_bearing": (-3.0, 3.0)}.items():
        dataset[name].values[120:124] = rng.uniform(low, high, dataset[name].values[120:124].shape)
    arc = effect_named("odometry-arc", log)
    result = criticize(RobotLog(dataset, "burst.nc"), effects=[arc], simulations=15, joint=False, seed=1, rounds=1)
    assert result.log.n_steps == log.n_steps
    assert result.base.sensors[0].outliers
    assert "gross errors among the readings are therefore allowed for" in result.notes[0]
    assert not result.effects
    assert result.verdict == UNKNOWN
    assert "without gross errors among the readings the filter loses the robot" in result.sentence
    assert 115 <= result.unexplained[0].time[0] <= 123
    assert 0.005 < result.after["landmark_outlier_weight"].mean < 0.04


@pytest.mark.long
def test_a_recorded_robot_that_the_plain_model_loses_has_its_effects_named(shared_data):
    """The filter of the default model loses this Create after 330 s; like the others it logs depth as distance."""
    log = read_mrclam(shared_data / "mrclam7", 3, 0.5).select(0, 891)
    result = criticize(log, joint=False, rounds=2)
    assert "range-is-depth" in [effect.name for effect in result.effects]
    assert any("loses the robot at t=330.5 s" in note for note in result.notes)
    first, last = (result.steps[k].gap.log_score_per_reading for k in (0, -1))
    assert last > first + 0.3
