"""A real scheduler and two workers on the loopback interface, one of which is killed in the middle of a run."""

from __future__ import annotations

import importlib.util
import os
import signal
import sys
import threading

import pytest
from click.testing import CliRunner
from fleets import SHORT, assert_same, small_fleet

import pmcl
from pmcl.calibration.workflow import calibrate
from pmcl.cli.commands import pmcl as application
from pmcl.errors import SamplingError
from pmcl.fleet import cluster as module
from pmcl.fleet.cluster import cluster
from pmcl.fleet.places import Place
from pmcl.fleet.workflow import calibrate_fleet

installed = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None, reason="dask.distributed is not installed: pip install '.[dask]'"
)


@pytest.fixture(scope="module")
def scheduler():
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None
    ) as started:
        yield started


class _Killer:
    """Kills, once, a worker that is sampling."""

    def __init__(self, client) -> None:
        self.client, self.told, self.thread, self.killed = client, [], None, []

    def __call__(self, name: str, message: str) -> None:
        self.told.append((name, message))
        if self.thread is None and "/" in message:
            # Messages come in the thread that the client itself needs.
            self.thread = threading.Thread(target=self._kill)
            self.thread.start()

    def _kill(self) -> None:
        busy = [worker for worker, tasks in self.client.processing().items() if tasks]
        self.killed = busy[:1]
        os.kill(self.client.run(os.getpid, workers=self.killed)[self.killed[0]], signal.SIGKILL)


class _OutOfSight(Place):
    """The workers of a place that do not see the folder of the results."""

    def __init__(self, place, folder) -> None:
        self.place, self.folder, self.slots = place, folder, place.slots

    def run(self, jobs, tell):
        for mark in self.folder.glob(".fleet-*"):
            mark.unlink()
        return self.place.run(jobs, tell)


@installed
@pytest.mark.slow
@pytest.mark.parametrize("seen", [True, False], ids=["shared folder", "folder out of sight"])
def test_results_of_a_cluster_that_loses_a_worker_are_those_of_a_local_run(scheduler, tmp_path, seen):
    logs = small_fleet(3)
    settings = {**SHORT, "draws": 60}
    with cluster(scheduler.scheduler_address) as place:
        assert place.slots == 2
        killer = _Killer(place.client)
        pool = place if seen else _OutOfSight(place, tmp_path)
        run = calibrate_fleet(logs, tmp_path, pool=pool, tell=killer, **settings)
    assert killer.killed, "no worker that had a robot was killed: the test shows nothing"
    assert not run.errors
    assert {name for name, text in killer.told if "/" in text} == set(logs), "progress of some robot was not told"
    assert sorted(os.listdir(tmp_path)) == [f"{name}.nc" for name in logs]
    for name, log in logs.items():
        assert_same(pmcl.read_posterior(run.posteriors[name]), calibrate(log, **settings))


@installed
@pytest.mark.slow
def test_the_command_works_on_a_cluster_and_skips_what_is_done(scheduler, tmp_path):
    for name, log in small_fleet(2).items():
        log.write(tmp_path / f"{name}.nc")
    files = [str(tmp_path / f"robot{k}.nc") for k in range(2)]
    shorter = ("--draws", "15", "--chains", "2", "--particles", "5", "--burn-in-particles", "40")
    command = ("fleet", *files, "-o", str(tmp_path / "out"), "--scheduler", scheduler.scheduler_address, *shorter)
    first = CliRunner().invoke(application, command)
    assert first.exit_code in (3, 4), first.output
    assert "robot0: done (1 of 2)" in first.stderr or "robot1: done (1 of 2)" in first.stderr
    second = CliRunner().invoke(application, command)
    assert "there already: robot0, robot1" in second.stderr
    assert second.exit_code == first.exit_code


@installed
@pytest.mark.slow
def test_a_client_is_a_pool_for_the_chains_of_one_robot(scheduler):
    """Slow, since each step travels; the numbers are the same."""
    from distributed import Client

    (log,) = small_fleet(1).values()
    with Client(scheduler.scheduler_address, set_as_default=False) as client:
        assert_same(calibrate(log, pool=client, **SHORT), calibrate(log, **SHORT))


@installed
def test_a_scheduler_that_does_not_answer_is_told_in_one_line(monkeypatch):
    monkeypatch.setattr(module, "_PATIENCE", 0.3)
    with (
        pytest.raises(SamplingError, match=r"expected a Dask scheduler at tcp://127\.0\.0\.1:9, but got"),
        cluster("tcp://127.0.0.1:9"),
    ):
        pass


def test_without_dask_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(SamplingError, match=r"pip install 'pmcl\[dask\]'"), cluster("tcp://127.0.0.1:9"):
        pass
