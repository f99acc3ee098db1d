"""The whole loop on logs in which an effect is hidden, small: one log with nothing, six with something."""

from __future__ import annotations

import json

import numpy as np
import pytest

from pmcl.criticism import loop
from pmcl.criticism.naming.search import Outcome, Search
from pmcl.criticism.workflow import criticize
from pmcl.errors import CriticismError, FilterError, PmclError, PosteriorError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.model_file import read_model
from pmcl.sampling.checkpoint import fingerprint
from pmcl.simulations.amigobot import simulate_amigobot

# mypy: disable-error-code="no-untyped-def"

NOISE = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.05}
# Names come with the values at which they were hidden: large against this noise in 300 rows.
HIDDEN = {
    "beam-bias@2=0.1": ("beam_bias", 0.1),
    "beam-yaw@5=0.3": ("beam_yaw", 0.3),
    "range-scale=0.08": ("range_scale", 0.08),
    "odometry-turn-scale=0.25": ("odometry_turn_scale", 0.25),
    "odometry-turn-bias=0.06": ("odometry_turn_bias", 0.06),
    "wall-moved@5=0.12": ("wall_moved", 0.12),
}


def hidden(text: str, rows: float = 300.0, seed: int = 4) -> RobotLog:
    return simulate_amigobot(rows, seed, NOISE, effects=(text,) if text else (), hide_effects=True)


def small(log: RobotLog, **settings):
    return criticize(log, **{"simulations": 20, "joint": False, "seed": 1, "rounds": 2, **settings})


@pytest.fixture(scope="module")
def found():
    """What the critic says about each of the logs."""
    return {text: small(hidden(text)) for text in HIDDEN}


@pytest.mark.slow
@pytest.mark.parametrize("text", HIDDEN)
def test_hidden_effect_is_found_named_and_measured(text, found):
    result, name = found[text], text.partition("@")[0].partition("=")[0]
    parameter, value = HIDDEN[text]
    assert result.verdict in ("explained", "unknown effect")
    assert result.effects[0].name == name
    if "@" in text:
        (place,) = result.effects[0].where.values()
        assert tuple(place) == (int(text.partition("@")[2].partition("=")[0]),)
    estimate = result.effects[0].parameters[parameter]
    assert abs(estimate.mean - value) < 5.0 * estimate.sd
    assert estimate.sd < 0.2 * value
    assert result.effects[0].p_value < 1e-3


@pytest.mark.slow
def test_gap_shrinks_on_held_out_data(found):
    for result in found.values():
        first, last = result.steps[0].gap, result.steps[-1].gap
        assert last.log_score_per_reading > first.log_score_per_reading
        assert result.effects[0].log_score_gain > 0.0
    assert sum(result.verdict == "explained" for result in found.values()) >= 5


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


@pytest.mark.slow
def test_json_follows_the_format(found, tmp_path):
    result = found["beam-bias@2=0.1"]
    result.write(tmp_path / "report.json")
    content = json.loads((tmp_path / "report.json").read_text())
    assert content["format"] == "pmcl-criticism/1"
    assert content["verdict"] in ("no missing effect", "explained", "unknown effect")
    (effect, *_) = content["effects"]
    assert effect["where"] == {"beams": [2]}
    assert set(effect["parameters"]["beam_bias"]) == {"mean", "sd", "unit"}
    assert {"p_value", "log_score_gain", "log_score_gain_se", "not_distinguishable_from"} <= set(effect)
    assert content["steps"][0]["model"] == []
    assert content["steps"][0]["decision"] == "add beam-bias"
    assert content["steps"][-1]["model"][0] == "beam-bias"
    for step in content["steps"]:
        assert set(step["gap"]) == {"log_score_per_reading", "pit_distance", "coverage_90"}
        for candidate in step["candidates"]:
            assert {"name", "score_p_value", "log_score_gain", "log_score_gain_se"} <= set(candidate)


@pytest.mark.slow
def test_model_with_the_effect_is_an_ordinary_model(found):
    result = found["range-scale=0.08"]
    bound = result.model.bind(result.log)
    assert "range_scale" in bound.names
    theta = np.array([result.after[name].mean for name in bound.names])
    assert bound.log_prior(theta) > -np.inf


@pytest.mark.slow
def test_what_was_found_is_handed_over_as_a_model_file(found, tmp_path):
    for text, result in found.items():
        result.write_model(tmp_path / "better.toml")
        back = read_model(tmp_path / "better.toml", hidden(text))
        assert fingerprint(back.bind(result.log), {}) == fingerprint(result.model.bind(result.log), {})
        # Another drive of the robot takes it as well.
        assert back.bind(hidden(text, 80.0, 9)).names == result.model.bind(result.log).names
    with pytest.raises(PosteriorError, match="no full chains were run"):
        result.write_posterior(tmp_path / "better.nc")


def test_a_posterior_needs_full_chains():
    with pytest.raises(CriticismError, match="expected full chains for a posterior"):
        criticize(hidden("", 80.0), joint=False, posterior=True)


@pytest.mark.slow
def test_an_effect_that_begins_after_the_fit_part_is_named_on_a_longer_one():
    """The noise grows at 65 % of the log; the part on which names are chosen usually ends at 60 %."""
    result = small(hidden("range-noise-changes-in-time=0.9,0.65"))
    assert result.effects[0].name == "range-noise-changes-in-time"
    assert result.split == 240
    assert result.effects[0].parameters["range_noise_changes_in_time_when"].mean == pytest.approx(0.65, abs=0.03)
    assert result.steps[-1].gap.log_score_per_reading > result.steps[0].gap.log_score_per_reading + 0.05


@pytest.mark.slow
@pytest.mark.parametrize("doubted", [True, False])
def test_an_alarm_in_doubt_is_judged_again_before_everything_is_searched(monkeypatch, doubted):
    done = []

    def explain(search, last, current, thorough=True):
        done.append("everywhere" if thorough else "the likeliest")
        return Outcome(None, None, [])

    def judge_again(search, last):
        done.append("again")
        return last

    monkeypatch.setattr(Search, "explain", explain)
    monkeypatch.setattr(Search, "judge_again", judge_again)
    monkeypatch.setattr(Search, "comes_late", lambda search, last: False)
    monkeypatch.setattr(loop, "in_doubt", lambda judgement: doubted)
    result = small(hidden("beam-bias@2=0.1", 120.0), rounds=1)
    assert done == (["the likeliest", "again"] if doubted else []) + ["everywhere"]
    assert not result.effects


@pytest.mark.slow
def test_a_filter_that_is_lost_without_an_effect_finds_the_robot_with_it(monkeypatch):
    follow = loop.particles_that_follow

    def lost_without(bound, theta, particles, seed, **patience):
        if "turn_noise_grows_with_turn" not in bound.names:
            raise FilterError("made: the filter loses the robot at t=77 s; restart with more particles")
        return follow(bound, theta, particles, seed, **patience)

    monkeypatch.setattr(loop, "particles_that_follow", lost_without)
    result = small(hidden("turn-noise-grows-with-turn=0.5"))
    assert result.effects[0].name == "turn-noise-grows-with-turn"
    assert "without turn-noise-grows-with-turn the filter loses the robot at t=77 s" in result.notes
    assert result.steps[0].decision == "add turn-noise-grows-with-turn: with it the filter follows"
    with pytest.raises(FilterError, match="t=77 s"):
        small(hidden("", 120.0))


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


@pytest.mark.slow
def test_lost_robot_is_said_plainly():
    log = simulate_amigobot(200.0, 6, NOISE)
    dataset = log.dataset.copy(deep=True)
    # Carried away while the log went on: from row 60 the readings are those of another place.
    dataset["range"].values[60:] = dataset["range"].values[:140]
    with pytest.raises(FilterError, match=r"loses the robot at t=\d+ s"):
        criticize(RobotLog(dataset, "carried"))
