"""The whole loop, small, on logs in which an effect is hidden: two of them always, four on their own schedule."""

from __future__ import annotations

import functools
import json

import numpy as np
import pytest
from hidden_logs import hidden, small

from pmcl.errors import PosteriorError
from pmcl.models.model_file import read_model
from pmcl.sampling.checkpoint import fingerprint

# mypy: disable-error-code="no-untyped-def"

# Names come with the values at which they were hidden: large against this noise in 300 rows.
HIDDEN = {
    "beam-bias@2=0.1": ("beam_bias", 0.1),
    "beam-yaw@5=0.3": ("beam_yaw", 0.3),
    "range-scale=0.08": ("range_scale", 0.08),
    "odometry-turn-scale=0.25": ("odometry_turn_scale", 0.25),
    "odometry-turn-bias=0.06": ("odometry_turn_bias", 0.06),
    "wall-moved@5=0.12": ("wall_moved", 0.12),
}


# Of a beam and of the odometry.
FEW = ("beam-bias@2=0.1", "odometry-turn-scale=0.25")


@pytest.fixture(scope="module")
def found():
    """A function that returns what the critic says about one of the logs."""
    return functools.cache(lambda text: small(hidden(text)))


@pytest.mark.parametrize(
    "text", [pytest.param(text, marks=pytest.mark.slow if text in FEW else pytest.mark.long) for text in HIDDEN]
)
def test_hidden_effect_is_found_named_and_measured(text, found):
    result, name = found(text), text.partition("@")[0].partition("=")[0]
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
    assert result.nothing_probability < 1e-3
    assert result.effects[0].probability > 0.5
    rest = sum(other.probability for other in result.effects[0].alternatives)
    assert 0.9 < result.effects[0].probability + rest <= 1.0 + 1e-9


@pytest.mark.parametrize("texts", [pytest.param(FEW, marks=pytest.mark.slow, id="few"),
                                   pytest.param(tuple(HIDDEN), marks=pytest.mark.long, id="all")])  # fmt: skip
def test_gap_shrinks_on_held_out_data(found, texts):
    for result in map(found, texts):
        first, last = result.steps[0].gap, result.steps[-1].gap
        assert last.log_score_per_reading > first.log_score_per_reading
        assert result.effects[0].log_score_gain > 0.0
    assert sum(found(text).verdict == "explained" for text in texts) >= len(texts) - 1


@pytest.mark.slow
def test_json_follows_the_format(found, tmp_path):
    result = found("beam-bias@2=0.1")
    result.write(tmp_path / "report.json")
    content = json.loads((tmp_path / "report.json").read_text())
    assert content["format"] == "pmcl-criticism/1"
    assert content["verdict"] in ("no missing effect", "explained", "unknown effect")
    (effect, *_) = content["effects"]
    assert effect["where"] == {"beams": [2]}
    assert set(effect["parameters"]["beam_bias"]) == {"mean", "sd", "unit"}
    assert {"p_value", "log_score_gain", "log_score_gain_se", "not_distinguishable_from"} <= set(effect)
    assert 0.0 <= content["nothing_probability"] <= effect["probability"] <= 1.0
    assert content["steps"][0]["model"] == []
    assert content["steps"][0]["decision"] == "add beam-bias"
    assert content["steps"][-1]["model"][0] == "beam-bias"
    for step in content["steps"]:
        assert set(step["gap"]) == {"log_score_per_reading", "pit_distance", "coverage_90"}
        for candidate in step["candidates"]:
            assert {"name", "score_p_value", "log_score_gain", "log_score_gain_se", "evidence"} <= set(candidate)


@pytest.mark.slow
def test_model_with_the_effect_is_an_ordinary_model(found):
    result = found("odometry-turn-scale=0.25")
    bound = result.model.bind(result.log)
    assert "odometry_turn_scale" in bound.names
    theta = np.array([result.after[name].mean for name in bound.names])
    assert bound.log_prior(theta) > -np.inf


@pytest.mark.slow
def test_what_was_found_is_handed_over_as_a_model_file(found, tmp_path):
    for text in FEW:
        result = found(text)
        result.write_model(tmp_path / "better.toml")
        back = read_model(tmp_path / "better.toml", hidden(text))
        assert fingerprint(back.bind(result.log), {}) == fingerprint(result.model.bind(result.log), {})
        # Another drive of the robot takes it as well.
        assert back.bind(hidden(text, 80.0, 9)).names == result.model.bind(result.log).names
    with pytest.raises(PosteriorError, match="no full chains were run"):
        result.write_posterior(tmp_path / "better.nc")
