"""The page of a fleet tells what is remarkable, and has a section for each robot."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy import stats

from pmcl.fleet.common_causes import Findings, causes
from pmcl.fleet.comparison import compare_robots
from pmcl.fleet.result import FleetResult, Robot
from pmcl.models.parameters import Parameter, gamma_prior
from pmcl.reports.fleet_report import write_fleet_report

PARAMETERS = (
    Parameter("sigma_range", "m", gamma_prior(0.1)),
    Parameter("range_bias", "m", stats.norm(0.0, 0.1)),
)


@pytest.fixture
def result(rng):
    """Ten robots, of which robot3 has twice the noise and robot7 a bias; the critic has looked at three."""
    draws = {}
    for k in range(10):
        noise = np.log(0.05) + 0.05 * rng.normal() + (0.9 if k == 3 else 0.0)
        bias = 0.01 * rng.normal() + (0.2 if k == 7 else 0.0)
        draws[f"robot{k}"] = {
            "sigma_range": np.exp(noise + 0.04 * rng.normal(size=1000)),
            "range_bias": bias + 0.01 * rng.normal(size=1000),
        }
    effect = {"name": "range-bias", "summary": "Ranges are <b>long</b>.", "where": {}, "not_distinguishable_from": [],
              "parameters": {"range_bias": {"mean": 0.05, "unit": "m"}}}  # fmt: skip
    findings = {f"robot{k}": Findings("something is missing", (effect,), 0.05) for k in range(3)}
    robots = [
        Robot(name, f"{name}.nc", "All is well.", converged=True, adequate=True, findings=findings.get(name))
        for name in draws
    ]
    robots.append(Robot("broken & lost", "", "no reading at all"))
    return FleetResult(robots, compare_robots(draws, dict.fromkeys(draws, PARAMETERS)), causes(findings))


def test_sentences_tell_what_stands_out_and_what_is_common(result):
    told = result.sentences()
    assert told[0] == "all 3 robots: range-bias. Ranges are <b>long</b>."
    assert {line.partition(":")[0] for line in told[1:]} == {
        "robot3 stands out in sigma_range", "robot7 stands out in range_bias",
    }  # fmt: skip
    by_name = {line.partition(":")[0]: line for line in told}
    assert "times the typical value" in by_name["robot3 stands out in sigma_range"]
    assert "m beside the typical value" in by_name["robot7 stands out in range_bias"]


def test_the_page_has_a_section_for_each_robot_and_escapes_names(result, tmp_path):
    write_fleet_report(result, tmp_path / "fleet.html")
    text = (tmp_path / "fleet.html").read_text(encoding="utf-8")
    assert text.count("<h3 id=") == 11
    assert "broken &amp; lost" in text
    assert "<b>long" not in text
    assert text.count('class="short"') == 2 * 7  # the rows of the two odd robots
    assert "data:image/png" in text
    assert "3 of 3" in text


def test_the_data_hold_the_same(result, tmp_path):
    result.write(tmp_path / "fleet.json")
    content = json.loads((tmp_path / "fleet.json").read_text())
    assert {(one["robot"], one["parameter"]) for one in content["standing_out"]} == {
        ("robot3", "sigma_range"), ("robot7", "range_bias"),
    }  # fmt: skip
    noise = content["population"]["sigma_range"]
    assert noise["typical"]["q5"] < 0.05 < noise["typical"]["q95"]
    assert noise["new_robot"]["q5"] < noise["typical"]["q5"]
    assert content["robots"][3]["parameters"]["sigma_range"]["stands_out"] is True
    assert content["robots"][10] == {
        "name": "broken & lost", "posterior": "", "verdict": "no reading at all", "converged": None, "adequate": None,
        "effects": None, "parameters": {},
    }  # fmt: skip


def test_a_fleet_that_cannot_be_compared_has_a_page_too(tmp_path):
    alone = FleetResult([Robot("robot0", "robot0.nc", "not converged", converged=False)], None, ())
    write_fleet_report(alone, tmp_path / "fleet.html")
    assert "fewer than two have chains that converged" in (tmp_path / "fleet.html").read_text(encoding="utf-8")
    assert json.loads(json.dumps(alone.to_dict()))["population"] == {}
