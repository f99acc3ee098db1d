"""Whenever a run is killed, what lies on the disk is the beginning of the very same run."""

from __future__ import annotations

import logging
import multiprocessing
import os
import shutil
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from emcee.state import State
from oracles.amigobot_model import amigobot_log
from oracles.random_walk_model import rail_log, rail_model

from pmcl.calibration import Ensemble, ParticleGibbs, workflow
from pmcl.cli.commands import pmcl as application
from pmcl.sampling import checkpoint
from pmcl.sampling.options import RunOptions
from pmcl.whole_file import remove_rests, replacing

METHODS = {
    "particle-gibbs": ParticleGibbs(
        particles=8, burn_in_particles=40, data_rate=3, settling_sweeps=2, tuning_sweeps=(4, 4), sweeps_per_draw=1
    ),
    "ensemble": Ensemble(particles=20, burn_in=3),
}
OPTIONS = RunOptions(draws=5, chains=6, seed=5, trajectories=2)

# The fingerprint of a run that was never made.
RUN = "1" * 64


@pytest.fixture(autouse=True)
def every_step(monkeypatch):
    """Write checkpoints after every step, not every few seconds."""
    monkeypatch.setattr(checkpoint, "_LEAST_PAUSE", 0.0)
    monkeypatch.setattr(checkpoint, "_PAUSE_PER_WRITE", 0.0)


def states_of(folder, function):
    """Run a function; return the contents of a folder after each call and return of any Python or C function.

    A process that is killed between two system calls leaves one of these states. Of each file that grew, half of what
    was added is taken for another state, since a write may be cut anywhere.
    """
    states, last, known = [_contents(folder)], [], {}

    def watch(frame, event, argument):
        seen = [(entry.name, entry.inode(), entry.stat()) for entry in os.scandir(folder)]
        marks = [(name, inode, stat.st_mtime_ns, stat.st_size) for name, inode, stat in seen]
        if marks == last:
            return
        last[:] = marks
        files = _contents(folder)
        for name, inode, _ in seen:
            # By its number in the file system: a file that was renamed has not grown.
            before, content = known.get(inode, b""), files[name]
            if len(content) > len(before) + 1:
                states.append({**states[-1], name: content[: (len(before) + len(content)) // 2]})
            known[inode] = content
        states.append(files)

    watch(None, None, None)
    del states[1:]
    # Only the calling thread is watched; it is the one that writes.
    sys.setprofile(watch)
    try:
        result = function()
    finally:
        sys.setprofile(None)
    return result, states


def _contents(folder):
    return {path.name: path.read_bytes() for path in Path(folder).iterdir()}


def _same(one, other):
    np.testing.assert_array_equal(one.theta, other.theta)
    np.testing.assert_array_equal(one.trajectories[0], other.trajectories[0])
    np.testing.assert_array_equal(one.warmup_theta, other.warmup_theta)
    assert dict(one.settings) == dict(other.settings)


def _traced(name, folder):
    bound = rail_model().bind(rail_log(6, seed=2))
    run = replace(OPTIONS, checkpoint=str(folder / "run.h5"))
    written = checkpoint.Checkpoint.write
    steps, states = [], []

    def write(self):
        _, seen = states_of(folder, lambda: written(self))
        steps.append(self.steps_written)
        states.extend(seen)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(checkpoint.Checkpoint, "write", write)
        whole = METHODS[name].run(bound, run)
    assert len(set(steps)) == steps[-1], "a step was made without a write"
    return bound, whole, states, steps[-1]


def _resumed(bound, name, state, folder):
    """Put the files of a state into a new folder and resume; return the result and what is left in the folder."""
    folder.mkdir()
    for file, content in state.items():
        (folder / file).write_bytes(content)
    result = METHODS[name].run(bound, replace(OPTIONS, checkpoint=str(folder / "run.h5"), resume=True))
    left = sorted(os.listdir(folder))
    shutil.rmtree(folder)
    return result, left


def _made_up_stages(file):
    """Fill two stages of a checkpoint step by step, written after each; return their chains."""
    rng, chains = np.random.default_rng(1), []
    for name in ("inclusion", "draws"):
        backend = file.backend(name, 3, 2, 1)
        backend.reset(2, 3)
        dtype = [("path", float, (400, 3)), ("rows", np.int64)]
        for _ in range(3):
            blobs = np.zeros(2, dtype=dtype)
            blobs["path"] = rng.normal(size=(2, 400, 3))
            backend.grow(1, blobs)
            random_state = np.random.RandomState(1).get_state()
            state = State(rng.normal(size=(2, 3)), log_prob=np.zeros(2), blobs=blobs, random_state=random_state)
            backend.save_step(state, np.ones(2, dtype=bool))
            file.step_done()
        chains.append(backend.get_chain())
    return np.concatenate(chains)


def test_every_prefix_of_the_write_trace_holds_one_whole_checkpoint_or_none(tmp_path):
    """Creation too: there is no moment at which a part of the file has its name."""
    path = tmp_path / "run" / "run.h5"
    path.parent.mkdir()

    def run():
        with checkpoint.the_only_run(str(path)):
            return _made_up_stages(checkpoint.Checkpoint(str(path), RUN, resume=False))

    chain, states = states_of(path.parent, run)
    assert any(set(state) - {"run.h5", ".run.h5.lock"} for state in states), "no file was seen in the making"
    contents = list(dict.fromkeys(state["run.h5"] for state in states if "run.h5" in state))
    assert "run.h5" not in states[1]
    assert len(contents) == 6
    for steps, content in enumerate(contents, start=1):
        path.write_bytes(content)
        file = checkpoint.Checkpoint(str(path), RUN, resume=True)
        names = ["inclusion", "draws"][: 1 if steps <= 3 else 2]
        read = np.concatenate([file.backend(name, 3, 2, 1).get_chain() for name in names])
        np.testing.assert_array_equal(read, chain[:steps])


@pytest.mark.parametrize(
    "every", [pytest.param(7, marks=pytest.mark.slow, id="some"), pytest.param(1, marks=pytest.mark.long, id="all")]
)
@pytest.mark.parametrize("name", METHODS)
def test_every_prefix_of_the_write_trace_can_be_resumed(name, every, tmp_path, caplog):
    (tmp_path / "run").mkdir()
    bound, whole, states, steps = _traced(name, tmp_path / "run")
    distinct = [state for k, state in enumerate(states) if k == 0 or state != states[k - 1]]
    # A file that is begun, half of it, all of it, its new name: for each step.
    assert len(distinct) >= 4 * steps
    for state in distinct[::every]:
        caplog.clear()
        with caplog.at_level(logging.INFO, "pmcl.sampling"):
            result, left = _resumed(bound, name, state, tmp_path / "again")
        _same(result, whole)
        # Nothing of the killed process stays.
        assert left == ["run.h5"]
        told = [record.getMessage() for record in caplog.records if "checkpoint" in record.getMessage()]
        assert len(told) == ("run.h5" not in state)
        assert all(line.endswith("the run starts from the beginning") for line in told)


def test_what_a_killed_writer_left_is_removed_and_nothing_else(tmp_path):
    for name in (".run.h5.77.ab.part", ".run.h5.lock", "run.h5", ".other.h5.77.ab.part", "x.part"):
        (tmp_path / name).write_text("content")
    remove_rests(tmp_path / "run.h5")
    assert sorted(os.listdir(tmp_path)) == [".other.h5.77.ab.part", ".run.h5.lock", "run.h5", "x.part"]
    remove_rests(tmp_path / "no folder" / "run.h5")


def test_a_new_name_is_written_to_disk_before_anything_else_happens(tmp_path, monkeypatch):
    """The checkpoint is removed when the posterior is written; a crash of the machine must not undo only the second."""
    done, synced, replaced = [], os.fsync, os.replace

    def fsync(handle):
        done.append("folder" if os.path.isdir(f"/proc/self/fd/{handle}") else "file")
        synced(handle)

    def replace_file(source, target):
        done.append("replace")
        replaced(source, target)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "replace", replace_file)
    if not Path("/proc/self/fd").is_dir():
        pytest.skip("only Linux tells which file a number means")
    with replacing(tmp_path / "p.nc") as temporary:
        temporary.write_text("content")
    assert done == ["file", "replace", "folder"]


# Real processes, as copies of this one, which has imported and compiled everything: a kill is after start-up then.
FORKED = multiprocessing.get_context("fork") if sys.platform != "win32" else None
COMMAND = ("--draws", "15", "--chains", "2", "--particles", "5", "--burn-in-particles", "40", "--no-progress")


def _command(folder, *more):
    application.main(["calibrate", str(folder / "log.nc"), "-o", str(folder / "p.nc"), *COMMAND, *more])


def _silent(folder, *more):
    with open(folder / "said", "w") as said:
        for stream in (1, 2):
            os.dup2(said.fileno(), stream)
        sys.stdout = sys.stderr = said  # pytest has put others in their place
        _command(folder, *more)


def _process(folder, *more):
    process = FORKED.Process(target=_silent, args=(folder, *more))
    process.start()
    return process


@pytest.fixture(scope="module")
def whole_run(tmp_path_factory):
    """A folder with a log and the posterior of an uninterrupted run, and how long that takes [s]."""
    folder = tmp_path_factory.mktemp("whole")
    amigobot_log(12, seed=3).write(folder / "log.nc")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(workflow, "checked_logs", lambda logs, model: "[]")
        with pytest.raises(SystemExit):
            _command(folder)  # compiles
        begin = time.monotonic()
        process = _process(folder)
        process.join()
        seconds = time.monotonic() - begin
    assert process.exitcode == 3, (folder / "said").read_text()
    return folder, seconds


def _killed_at_random(number, rounds, whole_run, tmp_path, rng, monkeypatch):
    # What comes before sampling is left out, so that more moments lie in it.
    monkeypatch.setattr(workflow, "checked_logs", lambda logs, model: "[]")
    # So that half of the time is spent on writing, and half on steps.
    monkeypatch.setattr(checkpoint, "_LEAST_PAUSE", 0.02)
    folder, seconds = whole_run
    expected, met, k = (folder / "p.nc").read_bytes(), [], 0
    while len(met) < rounds:
        k += 1
        assert k < 4 * rounds, "nearly all runs end before they are killed"
        place = tmp_path / str(k)
        place.mkdir()
        shutil.copy(folder / "log.nc", place)
        process, begin = _process(place), time.monotonic()
        time.sleep(rng.uniform(0.0, seconds))
        if process.exitcode is None:
            os.kill(process.pid, number)
        process.join(60.0)
        # It may have been done before; SIGINT and SIGTERM are passed on as what they are, or end the run in order.
        assert process.exitcode in (-number, 130, 3), (place / "said").read_text()
        if process.exitcode == 130:
            assert (place / "said").read_text().splitlines()[-1].startswith("pmcl: interrupted; ")
        if process.exitcode == 3:
            # Done before it was killed: the machine has become faster.
            seconds = min(seconds, time.monotonic() - begin)
            continue
        met.append((place / "p.nc.checkpoint.h5").exists())
        again = _process(place, "--resume")
        again.join(120.0)
        assert again.exitcode == 3, (place / "said").read_text()
        assert "Traceback" not in (place / "said").read_text()
        assert (place / "p.nc").read_bytes() == expected, f"killed in round {k}"
        rests = set(os.listdir(place)) - {"log.nc", "p.nc", "said"}
        assert all(name.startswith(".p.nc.") and not name.startswith(".p.nc.checkpoint") for name in rests), rests
        shutil.rmtree(place)
    # Most moments lie in the run, with a checkpoint on the disk.
    assert sum(met) > rounds // 3, met


SIGNALS = [signal.SIGINT, signal.SIGTERM, *([signal.SIGKILL] if sys.platform != "win32" else [])]


@pytest.mark.skipif(FORKED is None, reason="processes cannot be forked there")
@pytest.mark.parametrize(
    "number", [pytest.param(n, marks=pytest.mark.slow if n is SIGNALS[-1] else pytest.mark.long) for n in SIGNALS]
)
def test_a_run_killed_at_some_moments_gives_the_same_file(number, whole_run, tmp_path, rng, monkeypatch):
    _killed_at_random(number, 4, whole_run, tmp_path, rng, monkeypatch)


@pytest.mark.long
@pytest.mark.skipif(FORKED is None, reason="processes cannot be forked there")
@pytest.mark.parametrize("number", SIGNALS)
def test_a_run_killed_at_a_hundred_moments_gives_the_same_file(number, whole_run, tmp_path, rng, monkeypatch):
    _killed_at_random(number, 100, whole_run, tmp_path, rng, monkeypatch)
