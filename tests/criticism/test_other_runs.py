"""Runs of the critic that go another way: nothing hidden, late effects, doubt, lost robots, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hidden_logs import hidden, small

from pmcl.criticism import loop
from pmcl.criticism.naming.probability import Explanations
from pmcl.criticism.naming.search import Outcome, Search
from pmcl.criticism.workflow import criticize
from pmcl.errors import CriticismError, FilterError, PmclError
from pmcl.logs.robot_log import RobotLog
from pmcl.simulations.amigobot import simulate_amigobot

# mypy: disable-error-code="no-untyped-def"


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is_hidden():
    result = small(hidden(""))
    assert result.verdict == "no missing effect"
    assert not result.effects
    assert len(result.steps) == 1
    assert 0.85 < result.steps[0].gap.coverage_90 < 0.95


@pytest.mark.slow
def test_result_is_a_function_of_the_seed_and_never_reads_the_truth():
    log = hidden("beam-bias@2=0.1", 120.0)
    first, again = small(log, workers=1, rounds=1), small(log.without_truth(), workers=2, rounds=1)
    assert first.to_json() == again.to_json()


def test_a_posterior_needs_full_chains():
    with pytest.raises(CriticismError, match="expected full chains for a posterior"):
        criticize(hidden("", 80.0), joint=False, posterior=True)


@pytest.mark.long
def test_an_effect_that_begins_late_is_named():
    """The noise grows at 65 % of the log; parameters are fitted to the first 60 % where gaps are shown."""
    result = small(hidden("range-noise-changes-in-time=0.9,0.65"), rounds=1)
    assert result.effects[0].name == "range-noise-changes-in-time"
    assert result.split == 180
    assert result.effects[0].parameters["range_noise_changes_in_time_when"].mean == pytest.approx(0.65, abs=0.03)
    # Those rows cannot tell the size, so that the gap says little here.
    assert np.isfinite(result.steps[-1].gap.log_score_per_reading)


@pytest.mark.slow
@pytest.mark.parametrize("doubted", [True, False])
def test_an_alarm_in_doubt_is_judged_again_before_everything_is_searched(monkeypatch, doubted):
    done = []

    def explain(search, last, current, further=True):
        done.append("everywhere" if further else "the likeliest")
        return Outcome(None, None, [], Explanations(0.5, 0.5, (), ()))

    def judge_again(search, last):
        done.append("again")
        return last

    monkeypatch.setattr(Search, "explain", explain)
    monkeypatch.setattr(Search, "judge_again", judge_again)
    monkeypatch.setattr(loop, "in_doubt", lambda judgement: doubted)
    result = small(hidden("beam-bias@2=0.1", 120.0), rounds=1)
    assert done == (["the likeliest", "again"] if doubted else []) + ["everywhere"]
    assert not result.effects


@pytest.mark.slow
@pytest.mark.parametrize("refuted", [True, False])
def test_what_the_log_refutes_is_not_the_answer_before_all_else_was_tried(monkeypatch, refuted):
    asked, explain = [], Search.explain

    def explain_or_give_up(search, last, current, further=True, refuted=None):
        if refuted is not None:
            asked.append(refuted.found.name)
            if len(asked) == 1:
                return refuted  # and that is asked the same
            return Outcome(None, None, [], Explanations(0.0, 1.0, (), ()))
        return explain(search, last, current, further)

    monkeypatch.setattr(Search, "explain", explain_or_give_up)
    monkeypatch.setattr(Search, "refuted", lambda search, outcome: refuted and outcome.accepted is not None)
    result = small(hidden("beam-bias@2=0.1", 120.0), rounds=1)
    assert asked == (["beam-bias", "beam-bias"] if refuted else [])
    assert [effect.name for effect in result.effects] == ([] if refuted else ["beam-bias"])


@pytest.mark.long
def test_a_filter_that_is_lost_without_an_effect_finds_the_robot_with_it(monkeypatch):
    follow = loop.particles_that_follow

    def lost_without(bound, theta, particles, seed, **patience):
        if "turn_noise_grows_with_turn" not in bound.names:
            raise FilterError("made", row=77)
        return follow(bound, theta, particles, seed, **patience)

    monkeypatch.setattr(loop, "particles_that_follow", lost_without)
    result = small(hidden("turn-noise-grows-with-turn=0.5"), rounds=1)
    assert result.effects[0].name == "turn-noise-grows-with-turn"
    assert "without turn-noise-grows-with-turn the filter loses the robot at t=77 s" in result.notes
    assert result.steps[0].decision == "add turn-noise-grows-with-turn: with it the filter follows"


# What cannot be criticised


def test_short_log():
    with pytest.raises(CriticismError, match="at least 60 rows"):
        criticize(simulate_amigobot(40.0, 1))


def test_no_motion():
    log = simulate_amigobot(80.0, 1)
    dataset = log.dataset.copy(deep=True)
    dataset["odometry"].values[:] = 0.0
    with pytest.raises(CriticismError, match="moves"):
        criticize(RobotLog(dataset, "still"))


def test_readings_in_one_part_only():
    log = simulate_amigobot(80.0, 1)
    dataset = log.dataset.copy(deep=True)
    dataset["range"].values[45:] = np.nan
    with pytest.raises(CriticismError, match="20 readings"):
        criticize(RobotLog(dataset, "silent"))


def test_all_readings_missing():
    log = simulate_amigobot(80.0, 1)
    dataset = log.dataset.copy(deep=True)
    dataset["range"].values[:] = np.nan
    with pytest.raises(PmclError):
        criticize(RobotLog(dataset, "silent"))
