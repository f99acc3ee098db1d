"""What the critic finds in most robots; on the recorded Creates, that all cameras log depth."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pmcl.errors import CriticismError
from pmcl.fleet.common_causes import causes, read_findings

RECORDED = Path(__file__).resolve().parents[2] / "analyses" / "criticism_of_real_robots"


def _content(effects, level=0.05, log="abc"):
    return {
        "format": "pmcl-criticism/1", "sentence": "a sentence", "settings": {"level": level, "log": log},
        "effects": [
            {"name": name, "where": {}, "summary": f"About {name}.", "not_distinguishable_from": list(twins),
             "parameters": {name: {"mean": mean, "sd": 0.1, "unit": "m"}}}
            for name, mean, twins in effects
        ],
    }  # fmt: skip


def _findings(tmp_path, by_robot):
    found = {}
    for robot, effects in by_robot.items():
        file = tmp_path / f"{robot}.json"
        file.write_text(json.dumps(_content(effects)))
        found[robot] = read_findings(file, "abc")
    return found


def test_all_recorded_cameras_log_depth():
    found = {}
    for number in (1, 2):
        file = RECORDED / f"create_{number}.json"
        found[f"create {number}"] = read_findings(file, json.loads(file.read_text())["settings"]["log"])
    by_name = {cause.name: cause for cause in causes(found)}
    depth = by_name["range-is-depth"]
    assert depth.common
    assert depth.sentence.startswith("all 2 robots: range-is-depth. What is logged as distance is the depth along")
    unit, least, mean, greatest = depth.parameters["range_is_depth"]
    assert unit == "1"
    assert 0.9 < least < mean < greatest < 1.0
    assert not by_name["landmark-range-scale"].common


def test_robots_are_counted_and_chance_is_told(tmp_path):
    depth, late = ("depth", 0.9, ()), ("late", 0.2, ("slow",))
    counted = {cause.name: cause for cause in causes(_findings(tmp_path, {
        "a": [depth, late], "b": [depth], "c": [("depth", 1.0, ())], "d": [], "e": [("slow", 0.1, ("depth",))],
    }))}  # fmt: skip
    found = counted["depth"]
    assert found.robots == ("a", "b", "c")
    assert found.possible == ("e",)
    assert found.criticised == 5
    assert found.p_value == pytest.approx(0.00115813, rel=1e-4)  # three or more of five at 5 % each
    assert found.at_least == pytest.approx(0.189, abs=1e-3)  # Clopper and Pearson
    assert found.common
    assert found.sentence == "3 of 5 robots: depth. About depth."
    assert not counted["late"].common, "one robot is no fleet"
    assert counted["slow"].possible == ("a",)


def test_two_of_three_at_a_high_rate_of_false_alarms_may_be_chance(tmp_path):
    found = _findings(tmp_path, {"a": [("depth", 0.9, ())], "b": [("depth", 0.9, ())], "c": []})
    loose = {robot: one._replace(level=0.3) for robot, one in found.items()}
    assert causes(found)[0].common
    assert not causes(loose)[0].common


@pytest.mark.parametrize(
    ("text", "message"),
    [("", "--json"), ("[1]", "--json"), ('{"format": "other/1"}', "--json"), ("[" * 100000, "--json")],
)
def test_what_is_no_criticism_is_refused(tmp_path, text, message):
    file = tmp_path / "a.critic.json"
    file.write_text(text)
    with pytest.raises(CriticismError, match=message):
        read_findings(file, "abc")


def test_the_criticism_of_another_log_is_refused(tmp_path):
    file = tmp_path / "a.critic.json"
    file.write_text(json.dumps(_content([])))
    with pytest.raises(CriticismError, match="it is about another log"):
        read_findings(file, "other")
