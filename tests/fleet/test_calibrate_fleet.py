"""A fleet's posteriors are those of its robots one by one; the folder goes on and refuses what has changed."""

from __future__ import annotations

import os
import shutil
from concurrent.futures import ThreadPoolExecutor

import pytest
from fleets import SHORT, assert_same, small_fleet

import pmcl
from pmcl.calibration.workflow import calibrate
from pmcl.errors import LogError, SamplingError
from pmcl.examples import own_effect
from pmcl.fleet import workflow
from pmcl.fleet.folder import SharedFolder
from pmcl.fleet.places import HerePlace
from pmcl.fleet.robot_run import packed
from pmcl.fleet.workflow import calibrate_fleet
from pmcl.models.effects import carried
from pmcl.models.effects.registry import read_effects


@pytest.fixture(scope="module")
def logs():
    return small_fleet(2)


@pytest.fixture(scope="module")
def alone(logs):
    return {name: calibrate(log, **SHORT) for name, log in logs.items()}


@pytest.mark.parametrize("threads", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_each_posterior_is_that_of_calibrate(logs, alone, tmp_path, threads):
    told = []
    with ThreadPoolExecutor(threads) as executor:
        run = calibrate_fleet(logs, tmp_path / "new", pool=executor, tell=lambda *words: told.append(words), **SHORT)
    assert list(run.posteriors) == list(logs)
    for name, file in run.posteriors.items():
        assert_same(pmcl.read_posterior(file), alone[name])
    assert {("robot0", "done"), ("robot1", "done")} <= set(told)
    assert any("/15" in text for _, text in told)
    assert sorted(os.listdir(tmp_path / "new")) == ["robot0.nc", "robot1.nc"]


@pytest.mark.slow
def test_a_second_call_skips_what_is_done_and_refuses_what_has_changed(logs, alone, tmp_path, monkeypatch):
    calibrate_fleet({"robot0": logs["robot0"]}, tmp_path, pool=HerePlace(), **SHORT)
    before = (tmp_path / "robot0.nc").read_bytes()
    for changed, settings in (({"robot0": logs["robot1"]}, {}), (logs, {"draws": 16}), (logs, {"seed": 4})):
        with pytest.raises(SamplingError, match=r"robot0\.nc: expected the posterior of this log.*another run"):
            calibrate_fleet(changed, tmp_path, pool=HerePlace(), **{**SHORT, **settings})
    assert not (tmp_path / "robot1.nc").exists(), "something was done before the change was noticed"
    run = calibrate_fleet(logs, tmp_path, pool=HerePlace(), **SHORT)
    assert run.skipped == ("robot0",)
    assert (tmp_path / "robot0.nc").read_bytes() == before
    assert_same(pmcl.read_posterior(run.posteriors["robot1"]), alone["robot1"])


def test_a_posterior_from_elsewhere_is_not_taken_for_one_of_the_fleet(logs, alone, tmp_path):
    pmcl.write_posterior(alone["robot0"], tmp_path / "robot0.nc")
    with pytest.raises(SamplingError, match="it has no mark of a fleet"):
        calibrate_fleet(logs, tmp_path, pool=HerePlace(), **SHORT)


@pytest.mark.slow
def test_a_robot_goes_on_from_its_checkpoint(logs, alone, tmp_path):
    """What is left when a worker is lost in the middle of a run."""
    name = "robot0"

    def stop(stage, step, steps):
        if (step, steps) == (7, 15):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        calibrate(logs[name], checkpoint=tmp_path / f"{name}.nc.checkpoint.h5", progress=stop, **SHORT)
    steps = []
    run = calibrate_fleet(
        {name: logs[name]}, tmp_path, pool=HerePlace(), tell=lambda robot, text: steps.append(text), **SHORT
    )
    assert_same(pmcl.read_posterior(run.posteriors[name]), alone[name])
    assert os.listdir(tmp_path) == [f"{name}.nc"]
    assert "draws 8/15" in steps or steps[0].endswith("8/15"), steps


def test_a_folder_out_of_sight_has_no_checkpoint(tmp_path):
    (tmp_path / "mark").touch()
    assert SharedFolder(str(tmp_path), "mark").checkpoint("a") == str(tmp_path / "a.nc.checkpoint.h5")
    assert SharedFolder(str(tmp_path), "other").checkpoint("a") is None


def test_a_robot_that_cannot_be_calibrated_stops_no_other(logs, tmp_path, monkeypatch):
    real = workflow.RobotRun.__call__

    def work(self, tell):
        if self.name == "robot0":
            raise LogError("robot0.nc: expected readings, but got none; drive")
        return real(self, tell)

    monkeypatch.setattr(workflow.RobotRun, "__call__", work)
    run = calibrate_fleet(logs, tmp_path, pool=HerePlace(), **SHORT)
    assert run.errors == {"robot0": "robot0.nc: expected readings, but got none; drive"}
    assert list(run.posteriors) == ["robot1"]


def test_two_fleets_in_one_folder_are_refused(logs, tmp_path):
    class Second(HerePlace):
        def run(self, jobs, tell):
            calibrate_fleet(logs, tmp_path, pool=HerePlace(), **SHORT)
            return iter(())

    with pytest.raises(SamplingError, match="another fleet is at work in it"):
        calibrate_fleet(logs, tmp_path, pool=Second(), **SHORT)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"logs": {}}, "at least one robot"),
        ({"logs": {"a/b": None}}, "names of files"),
        ({"model": {}}, "there is none for robot0"),
        ({"model": 3}, "expected the model of robot0"),
        ({"draws": 0}, "draws"),
        ({"pool": 3}, "method map"),
    ],
)
def test_wrong_arguments_are_refused_before_anything_runs(logs, tmp_path, arguments, message):
    with pytest.raises(pmcl.PmclError, match=message):
        calibrate_fleet(**{"logs": logs, "folder": tmp_path, **SHORT, **arguments})
    assert os.listdir(tmp_path) == []


def test_effects_of_a_file_travel_with_what_is_packed(tmp_path, monkeypatch):
    """A process that has never seen the file can unpack the effect; here it is made to forget it."""
    file = tmp_path / "mine.py"
    shutil.copy(own_effect.__file__, file)
    effects = read_effects(file)
    parcel = packed(effects)
    file.unlink()
    monkeypatch.delitem(carried._files, "pmcl_effects_of_mine")
    monkeypatch.delitem(carried.sys.modules, "pmcl_effects_of_mine")
    (found,) = parcel.unpacked()
    assert [effect.name for effect in found] == [effect.name for effect in effects]
    assert callable(found[0].change)
