"""Ctrl-C stops a run between two sweeps, wherever it comes, and nothing that was sampled is lost."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import h5py
import pytest
from oracles.random_walk_model import rail_log, rail_model

import pmcl
from pmcl.calibration import Ensemble, ParticleGibbs
from pmcl.interrupts import check_interrupt, stopping_on_interrupt
from pmcl.sampling.options import RunOptions

SHORT = ParticleGibbs(
    particles=8, burn_in_particles=40, data_rate=3, settling_sweeps=4, tuning_sweeps=(6, 8), sweeps_per_draw=1
)
OPTIONS = RunOptions(draws=12, chains=3, seed=5, trajectories=4)


def press_control_c():
    os.kill(os.getpid(), signal.SIGINT)


def test_a_program_that_is_told_to_end_stops_after_its_step_too():
    """SIGTERM, which clusters send before they kill."""
    done = []
    with pytest.raises(KeyboardInterrupt):
        run_all(lambda: os.kill(os.getpid(), signal.SIGTERM), lambda: done.append("went on"), check_interrupt)
    assert done == ["went on"]
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes cannot be forked there")
def test_a_forked_process_ends_when_its_pool_ends_it():
    """It has inherited the handler; a pool would wait for ever for a process that goes on."""
    with stopping_on_interrupt():
        process = get_context("fork").Process(target=time.sleep, args=(60.0,))
        process.start()
        process.terminate()
        process.join(20.0)
    assert process.exitcode == -signal.SIGTERM


def run_all(*functions):
    with stopping_on_interrupt():
        for function in functions:
            function()


def test_the_first_signal_waits_for_the_next_step_and_the_second_does_not():
    done = []
    with pytest.raises(KeyboardInterrupt):
        run_all(press_control_c, lambda: done.append("went on"), press_control_c, lambda: done.append("never"))
    assert done == ["went on"]
    with pytest.raises(KeyboardInterrupt):
        run_all(press_control_c, check_interrupt, lambda: done.append("never"))
    assert done == ["went on"]
    check_interrupt()


def test_the_handler_before_is_put_back():
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    with stopping_on_interrupt():
        installed = signal.getsignal(signal.SIGINT)
        assert installed is not signal.default_int_handler
        with stopping_on_interrupt():
            assert signal.getsignal(signal.SIGINT) is installed
        assert signal.getsignal(signal.SIGINT) is installed
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize("handler", [signal.SIG_IGN, lambda number, frame: None])
def test_a_program_that_handles_the_signal_itself_is_left_alone(handler):
    before = signal.signal(signal.SIGINT, handler)
    try:
        with stopping_on_interrupt():
            assert signal.getsignal(signal.SIGINT) is handler
            press_control_c()
            check_interrupt()
    finally:
        signal.signal(signal.SIGINT, before)


def test_threads_leave_the_handler_alone_but_are_stopped():
    stopped = []

    def work():
        try:
            with stopping_on_interrupt():
                while True:
                    check_interrupt()
                    time.sleep(0.001)
        except KeyboardInterrupt:
            stopped.append("thread")

    thread = threading.Thread(target=work)
    with pytest.raises(KeyboardInterrupt):
        run_all(thread.start, press_control_c, lambda: thread.join(timeout=60.0))
    assert stopped == ["thread"]


def test_no_signal_is_lost():
    """Not when it comes after the last step, and not when the work fails because of it."""


    def fail():
        raise OSError("as a pool of processes does that the signal has stopped")

    with pytest.raises(KeyboardInterrupt):
        run_all(press_control_c)
    with pytest.raises(KeyboardInterrupt):
        run_all(press_control_c, fail)
    with pytest.raises(OSError, match="pool of processes"):
        run_all(fail)


def stop_at(monkeypatch, owner, name, count):
    """Press Ctrl-C within call number `count` of a function, where Python's own handler could not pass it on."""
    original, calls = getattr(owner, name), []

    def function(*arguments, **settings):
        calls.append(1)
        if len(calls) == count:
            try:
                press_control_c()
            except KeyboardInterrupt:  # what a callback of compiled code does
                calls.append("swallowed")
        return original(*arguments, **settings)

    monkeypatch.setattr(owner, name, function)
    return calls


@pytest.mark.parametrize(
    ("name", "count", "steps"),
    [
        ("pmcl.sampling.particle_gibbs.start_chain", 1, 0),
        ("pmcl.sampling.move.step", 1, 0),
        ("pmcl.sampling.particle_gibbs.near_their_modes", 1, 7),
        ("pmcl.sampling.particle_gibbs.tuned_transports", 1, 13),
        ("pmcl.sampling.backends.Backend.save_step", 3, 3),
        ("pmcl.sampling.backends.Backend.save_step", 33, 33),
    ],
)
def test_particle_gibbs_stops_at_once_and_keeps_every_step(name, count, steps, tmp_path, monkeypatch):
    """At the start, in a sweep, between stages, while a step is stored, after the last one (7, 6, 8 and 12 steps)."""
    bound, path = rail_model().bind(rail_log(9, seed=2)), tmp_path / "run.h5"
    owner, _, function = name.rpartition(".")
    calls = stop_at(monkeypatch, _found(owner), function, count)
    with pytest.raises(KeyboardInterrupt, match="resume"):
        SHORT.run(bound, replace(OPTIONS, checkpoint=str(path)))
    assert "swallowed" not in calls
    assert _stored_steps(path) == steps
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_ensemble_stops_too(tmp_path, monkeypatch):
    from pmcl.sampling import backends

    bound, path = rail_model().bind(rail_log(9, seed=2)), tmp_path / "run.h5"
    stop_at(monkeypatch, backends.Backend, "save_step", 4)
    options = RunOptions(draws=10, chains=6, seed=3, checkpoint=str(path))
    with pytest.raises(KeyboardInterrupt):
        Ensemble(particles=20, burn_in=3).run(bound, options)
    assert _stored_steps(path) == 4


def test_without_a_checkpoint_the_caller_is_told_that_nothing_is_kept(monkeypatch):
    from pmcl.sampling import backends

    bound = rail_model().bind(rail_log(9, seed=2))
    stop_at(monkeypatch, backends.Backend, "save_step", 2)
    with pytest.raises(KeyboardInterrupt, match="without a checkpoint nothing"):
        SHORT.run(bound, OPTIONS)


def _found(name):
    import importlib

    try:
        return importlib.import_module(name)
    except ModuleNotFoundError:
        module, _, attribute = name.rpartition(".")
        return getattr(importlib.import_module(module), attribute)


def _stored_steps(path):
    if not path.exists():
        return 0
    with h5py.File(path, "r") as file:
        return sum(int(group.attrs["iteration"]) for group in file.values())


# A calibration that would take minutes, as a process of its own; it says when it samples.
PROCESS = """
import sys
from oracles.random_walk_model import rail_log, rail_model
from pmcl.calibration import ParticleGibbs, calibrate
from pmcl.sampling.backends import StageBackend
saved = StageBackend.save_step
def save(self, state, accepted):
    saved(self, state, accepted)
    print("step", flush=True)
StageBackend.save_step = save
calibrate(
    rail_log(9, seed=2), rail_model(), method=ParticleGibbs(particles=8, burn_in_particles=40), draws=1_000_000,
    chains=2, checkpoint=sys.argv[1],
)
"""


@pytest.mark.slow
def test_a_real_process_stops_at_a_real_signal(tmp_path):
    path = tmp_path / "run.h5"
    folders = [str(Path(pmcl.__file__).parents[1]), str(Path(__file__).resolve().parents[1])]
    process = subprocess.Popen(
        [sys.executable, "-c", PROCESS, str(path)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(folders)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        for _ in range(40):
            assert process.stdout.readline() == "step\n"
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=100.0)
    finally:
        process.kill()
    assert "stopping after this step; press Ctrl-C again" in said
    assert said.splitlines()[-1].startswith("KeyboardInterrupt: the run was stopped after ")
    assert str(path) in said.splitlines()[-1]
    assert _stored_steps(path) >= 40
