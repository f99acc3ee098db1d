"""``pmcl criticize`` as a user runs it."""

from __future__ import annotations

import json

import pytest

from pmcl.robots.amigobot import simulate_amigobot

# mypy: disable-error-code="no-untyped-def"

NOISE = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.05}


@pytest.fixture(scope="module")
def biased(tmp_path_factory):
    path = tmp_path_factory.mktemp("critic") / "log.nc"
    simulate_amigobot(120.0, 4, NOISE, effects=("beam-bias@2=0.25",), hide_effects=True).write(path)
    return path


@pytest.mark.slow
def test_criticize_writes_a_page_and_json(run, biased, tmp_path):
    page, content = tmp_path / "report.html", tmp_path / "report.json"
    result = run("criticize", biased, "-o", page, "--json", content, "--no-joint", "--seed", "2")
    assert result.exit_code == 0, result.output
    assert "beam-bias" in result.stdout.splitlines()[0].lower()
    assert f"report: {page}" in result.stdout
    found = json.loads(content.read_text())
    assert found["effects"][0]["name"] == "beam-bias"
    assert found["effects"][0]["where"] == {"beams": [2]}
    text = page.read_text()
    assert found["sentence"] in text.replace("&lt;", "<").replace("&#39;", "'")
    # Map, heat map, PITs, and scores and gains of the first step; nothing is loaded from elsewhere.
    assert text.count("data:image/png;base64,") >= 5
    assert "src=\"http" not in text
    for told in ("Before and after", "Tried and rejected", "Which channel, and when", "coverage"):
        assert told in text


def test_what_criticize_refuses(refused, biased, log_file, tmp_path):
    page = tmp_path / "page.html"
    assert "at least 60 rows" in refused("criticize", log_file, "-o", page)
    assert "other than the input" in refused("criticize", log_file, "-o", log_file)
    assert "other than the input" in refused("criticize", log_file, "-o", page, "--json", log_file)
    assert "no such file" in refused("criticize", tmp_path / "none.nc", "-o", page)
    assert "no folder" in refused("criticize", biased, "-o", tmp_path / "nowhere" / "x.html")
    assert "'--particles'" in refused("criticize", biased, "-o", page, "--particles", "3")
    assert "'--level'" in refused("criticize", biased, "-o", page, "--level", "0.7")
    assert not page.exists()
