"""``pmcl criticize`` as a user runs it."""

from __future__ import annotations

import html
import json
import re
import shlex
from pathlib import Path
from types import SimpleNamespace

import pytest
from click import Context

from pmcl.cli.commands import pmcl as application
from pmcl.cli.criticize import _next_commands
from pmcl.criticism import workflow
from pmcl.criticism.findings.parts import FoundEffect
from pmcl.criticism.fitting.next_drive import NextDrive
from pmcl.reports import criticism_report
from pmcl.simulations.amigobot import simulate_amigobot

# mypy: disable-error-code="no-untyped-def"

NOISE = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.05}


@pytest.fixture(scope="module")
def biased(tmp_path_factory):
    path = tmp_path_factory.mktemp("critic") / "log.nc"
    simulate_amigobot(120.0, 4, NOISE, effects=("beam-bias@2=0.25",), hide_effects=True).write(path)
    return path


def _check_page(text, found):
    assert found["effects"][0]["name"] == "beam-bias"
    assert found["effects"][0]["where"] == {"beams": [2]}
    # Terms are marked where they first appear on the page.
    assert found["sentence"] in html.unescape(re.sub(r"<[^>]*>", "", text))
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
    better = tmp_path / "better.nc"
    assert "--no-joint" in refused("criticize", biased, "-o", page, "--posterior", better, "--no-joint")
    assert "other than the input" in refused("criticize", log_file, biased, "-o", biased)
    assert "given twice" in refused("criticize", biased, biased, "-o", page)
    assert "two have the same name" in refused("criticize", biased, "-o", page, "--save-model", page)
    assert "other than the input" in refused("criticize", biased, "-o", page, "--posterior", biased)
    assert not page.exists()
    assert not better.exists()


def test_the_next_commands_name_the_files_that_were_written():
    told = _next_commands(("my log.nc",), Path("page.html"), Path("better.toml"), Path("a b.nc"), None)
    assert [command for _, command in told] == [
        "pmcl localize OTHER.nc --posterior 'a b.nc' -o track.nc",
        "pmcl report 'a b.nc' -o posterior.html",
        "pmcl calibrate OTHER.nc --model better.toml -o other_posterior.nc",
        "pmcl criticize OTHER.nc --model better.toml -o other.html",
    ]
    on_map = _next_commands(("my log.nc",), Path("page.html"), Path("better.toml"), Path("a b.nc"), "my map.yaml")
    assert [command for _, command in on_map] == [
        command if "report" in command else f"{command} --map 'my map.yaml'" for _, command in told
    ]
    ((_, command),) = _next_commands(("my log.nc", "b.nc"), Path("page.html"), None, None, None)
    assert command == "pmcl criticize 'my log.nc' b.nc -o page.html --save-model better.toml --posterior better.nc"
    # Each is a command line that the program understands.
    for _, line in told:
        name, *words = shlex.split(line)[1:]
        application.get_command(Context(application), name).make_parser(Context(application)).parse_args(args=words)


def test_notes_and_what_to_record_next_are_told(run, biased, tmp_path, monkeypatch):
    drive = NextDrive("turn in place, both ways", 120.0, (0.97,))
    effect = FoundEffect("odometry-arc", "", {}, {}, 1e-6, 0.0, 0.0, ("odometry-turn-bias",), record_next=drive)
    found = SimpleNamespace(
        verdict="explained", sentence="It turns", notes=("500 particles lose the robot",), effects=(effect,),
        posterior=None,
    )  # fmt: skip
    monkeypatch.setattr(workflow, "criticize", lambda *given, **settings: found)
    monkeypatch.setattr(criticism_report, "write_criticism_report", lambda *given: None)
    result = run("criticize", biased, "-o", tmp_path / "page.html")
    assert result.exit_code == 0, result.output
    first, record, note, *_ = result.stdout.splitlines()
    assert first == "explained: It turns."
    assert record.startswith("odometry-arc: record 2 minutes of 'turn in place, both ways' next")
    assert note == "note: 500 particles lose the robot"


@pytest.mark.long
def test_what_criticize_found_is_used_by_other_commands(run, biased, tmp_path, monkeypatch):
    """Criticize writes a page and JSON and hands over model and posterior; the other commands take them."""
    monkeypatch.chdir(tmp_path)
    result = run("criticize", biased, "-o", "page.html", "--json", "report.json", "--save-model", "better.toml",
                 "--posterior", "better.nc", "--seed", "2")  # fmt: skip
    assert result.exit_code in (0, 3, 4), result.output
    lines = result.stdout.splitlines()
    assert "beam-bias" in lines[0].lower()
    assert "report: page.html" in result.stdout
    _check_page(Path("page.html").read_text(), json.loads(Path("report.json").read_text()))
    commands = [line.partition("   # ")[0].strip() for line in lines[lines.index("next:") + 1 :]]
    assert len(commands) == 4
    page = Path("page.html").read_text()
    assert all(command in page for command in commands)
    # What is being tried is told although there is no terminal.
    assert "fitting the base model" in result.stderr
    assert "refitting" in result.stderr
    # The verdict is told before the full chains, which take the longest.
    before, told, _ = result.stderr.partition("verdict: ")
    assert told
    assert "named beam-bias (beam 2)" in before
    assert "calibrating the final model" not in before
    simulate_amigobot(80.0, 9, NOISE, effects=("beam-bias@2=0.25",)).write("OTHER.nc")
    for command in commands[:3]:
        words = shlex.split(command)[1:]
        extra = ["--draws", "20", "--chains", "2"] if words[0] == "calibrate" else []
        assert run(*words, *extra).exit_code in (0, 3, 4), command
    with_it, without = (
        run("localize", "OTHER.nc", *what, "-o", "track.nc", "--particles", "300").stdout
        for what in (("--posterior", "better.nc"), ("--method", "prior"))
    )
    error = [float(re.search(r"position error, RMSE +([0-9.]+)", text).group(1)) for text in (with_it, without)]
    assert error[0] < error[1]
    assert 'name = "beam-bias"' in Path("better.toml").read_text()


@pytest.mark.slow
def test_several_logs_are_criticised_together(run, tmp_path):
    """The notes tell where each begins; the numbers of the page are those of both."""
    logs = [tmp_path / f"robot{k}.nc" for k in (1, 2)]
    for seed, path in enumerate(logs):
        simulate_amigobot(150.0, 5 + seed, NOISE, effects=("odometry-turn-scale=large",), hide_effects=True).write(path)
    page, told = tmp_path / "page.html", tmp_path / "told.json"
    done = run("criticize", *logs, "-o", page, "--json", told, "--no-joint", "--no-progress")
    found = json.loads(told.read_text())
    assert [effect["name"] for effect in found["effects"]] == ["odometry-turn-scale"]
    parameter = found["effects"][0]["parameters"]["odometry_turn_scale"]
    assert abs(parameter["mean"] - 0.25) < 4.0 * parameter["sd"]
    assert "robot2.nc begins at t=209 s of the logs together, which is t=0 s of its own" in done.output
    assert "300 rows" in page.read_text()
