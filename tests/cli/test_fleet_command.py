"""``pmcl fleet``, from logs to a folder with posteriors, a page, and data."""

from __future__ import annotations

import json
import shutil

import pytest

import pmcl

# As short as a run can be that has all its stages.
SHORT = ("--draws", "15", "--chains", "2", "--particles", "5", "--burn-in-particles", "40", "--sweeps-per-draw", "1",
         "--workers", "1")  # fmt: skip


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    names = [folder / f"robot{k}.nc" for k in range(2)]
    for k, name in enumerate(names):
        pmcl.simulate_amigobot(20.0, seed=k).write(name)
    return names


def _criticism(log, name="range-bias"):
    return json.dumps({
        "format": "pmcl-criticism/1", "sentence": f"sonars read too far ({name})",
        "settings": {"level": 0.05, "log": log.fingerprint()},
        "effects": [{"name": name, "where": {}, "summary": "Ranges are too long.", "not_distinguishable_from": [],
                     "parameters": {"range_bias": {"mean": 0.05, "sd": 0.01, "unit": "m"}}}],
    })  # fmt: skip


@pytest.mark.slow
def test_it_writes_posteriors_a_page_and_data_and_skips_what_is_done(run, files, tmp_path):
    folder = tmp_path / "fleet"
    first = run("fleet", *files, "-o", folder, *SHORT)
    assert first.exit_code == 3, first.output  # runs so short have not converged
    assert "robot1: done (2 of 2)" in first.stderr
    assert f"report: {folder / 'fleet.html'}" in first.stdout
    assert {file.name for file in folder.iterdir()} == {"robot0.nc", "robot1.nc", "fleet.html", "fleet.json"}
    assert "robot0: Not converged" in first.stdout
    for name in ("robot0", "robot1"):
        (folder / f"{name}.critic.json").write_text(_criticism(pmcl.read_log(files[int(name[-1])])))
    before = (folder / "robot0.nc").stat().st_mtime_ns
    second = run("fleet", *files, "-o", folder, *SHORT)
    assert second.exit_code == 3, second.output
    assert "there already: robot0, robot1" in second.stderr
    assert (folder / "robot0.nc").stat().st_mtime_ns == before
    assert "all 2 robots: range-bias. Ranges are too long." in second.stdout
    content = json.loads((folder / "fleet.json").read_text())
    assert content["format"] == "pmcl-fleet/1"
    assert [robot["name"] for robot in content["robots"]] == ["robot0", "robot1"]
    assert content["common_causes"][0]["robots"] == ["robot0", "robot1"]
    page = (folder / "fleet.html").read_text()
    for words in ('<h3 id="robot-2">robot1</h3>', "range-bias", "2 of 2", "sonars read too far"):
        assert words in page


@pytest.mark.slow
def test_a_folder_of_other_settings_or_a_criticism_of_another_log_is_refused(run, refused, files, tmp_path):
    folder = tmp_path / "fleet"
    assert run("fleet", files[0], "-o", folder, *SHORT, "--no-progress").exit_code == 3
    message = refused("fleet", files[0], "-o", folder, *SHORT, "--seed", "1", "--no-progress")
    assert "robot0.nc: expected the posterior of this log, model and settings" in message
    (folder / "robot0.critic.json").write_text(_criticism(pmcl.read_log(files[1])))
    result = run("fleet", files[0], "-o", folder, *SHORT, "--no-progress")
    assert result.exit_code == 2
    assert "robot0.critic.json: expected the criticism of this robot's log" in result.stderr.splitlines()[-1]


def test_bad_input_is_refused_in_one_line(refused, files, tmp_path):
    (tmp_path / "twin").mkdir()
    twin = tmp_path / "twin" / "robot0.nc"
    shutil.copy(files[0], twin)
    assert "both robot0: rename one" in refused("fleet", files[0], twin, "-o", tmp_path / "out")
    assert "would replace it" in refused("fleet", twin, "-o", tmp_path / "twin")
    assert "missing.nc" in refused("fleet", files[0], tmp_path / "missing.nc", "-o", tmp_path / "out")
    assert "no folder" in refused("fleet", files[0], "-o", tmp_path / "no" / "such")
    assert "is a file" in refused("fleet", files[0], "-o", twin)
    assert not (tmp_path / "out").exists()
