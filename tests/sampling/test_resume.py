"""A run that is killed and resumed gives, to the last bit, what an uninterrupted one gives; so does any pool."""

from __future__ import annotations

import fcntl
import os
import signal
import socket
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import emcee
import h5py
import numpy as np
import pytest
from oracles.amigobot_model import amigobot_log, tight_model
from oracles.changed_checkpoints import changed_checkpoint, with_head
from oracles.random_walk_model import rail_log, rail_model
from scipy import stats

import pmcl
from pmcl.calibration import Ensemble, ParticleGibbs, calibrate
from pmcl.errors import SamplingError
from pmcl.models.effects.editing import edit_motion
from pmcl.models.effects.effect import Effect
from pmcl.models.parameters import Parameter
from pmcl.models.robot_model import default_model
from pmcl.posterior.files import write_posterior
from pmcl.sampling.checkpoint import fingerprint, the_only_run
from pmcl.sampling.options import RunOptions

SHORT = ParticleGibbs(
    particles=8, burn_in_particles=40, data_rate=3, settling_sweeps=4, tuning_sweeps=(6, 8), sweeps_per_draw=1
)
OPTIONS = RunOptions(draws=12, chains=3, seed=5, trajectories=4)
CALIBRATE = {
    "method": ParticleGibbs(particles=8, burn_in_particles=40, sweeps_per_draw=1),
    "draws": 12,
    "chains": 2,
    "trajectories": 4,
    "seed": 11,
}


def run(bound, method=SHORT, **changes):
    return method.run(bound, replace(OPTIONS, **changes))


# Runs a calibration that writes its checkpoint after every step, and is killed by SIGKILL in the middle of the given
# write: half of the new file is there, the old one is still in its place.
KILLED = """
import os, signal, sys
from pmcl.sampling import checkpoint
checkpoint._LEAST_PAUSE = checkpoint._PAUSE_PER_WRITE = 0.0
left = int(sys.argv[2])
written = checkpoint._write_stage
def write(group, backend):
    global left
    if backend.iteration == 1 or not backend.complete:
        left -= 1
    if left == 0:
        group.file.flush()
        os.kill(os.getpid(), signal.SIGKILL)
    written(group, backend)
checkpoint._write_stage = write
from oracles.amigobot_model import amigobot_log, tight_model
from oracles.changed_checkpoints import changed_checkpoint, with_head
from pmcl.calibration import ParticleGibbs, calibrate
calibrate(amigobot_log(6, seed=3), tight_model(), checkpoint=sys.argv[1], **{settings})
"""


def _killed(checkpoint, step, settings):
    paths = [str(Path(pmcl.__file__).parents[1]), str(Path(__file__).resolve().parents[1])]
    code = KILLED.replace("{settings}", repr(settings))
    done = subprocess.run(
        [sys.executable, "-c", code, str(checkpoint), str(step)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == -signal.SIGKILL, done.stderr


def _assert_same(one, other):
    for name in ("theta", "log_joint", "trajectory_draw", "warmup_theta", "warmup_log_joint"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    for a, b in zip(one.trajectories, other.trajectories, strict=True):
        np.testing.assert_array_equal(a, b)
    assert one.statistics.keys() == other.statistics.keys()
    for name, values in one.statistics.items():
        np.testing.assert_array_equal(values, other.statistics[name], err_msg=name)
    assert dict(one.settings) == dict(other.settings)


@pytest.fixture
def every_step(monkeypatch):
    """Write checkpoints after every step, not every few seconds."""
    monkeypatch.setattr("pmcl.sampling.checkpoint._LEAST_PAUSE", 0.0)
    monkeypatch.setattr("pmcl.sampling.checkpoint._PAUSE_PER_WRITE", 0.0)


@pytest.fixture(scope="module")
def rail():
    return rail_model().bind(rail_log(9, seed=2))


@pytest.fixture(scope="module")
def uninterrupted(rail):
    return run(rail)


@pytest.fixture(scope="module")
def calibrated():
    return calibrate(amigobot_log(6, seed=3), tight_model(), **CALIBRATE)


# Steps of the stages on a log of 6 rows: inclusion 10, tuning 30, 60 and 120, then 12 draws.
@pytest.mark.parametrize(
    "step", [pytest.param(step, marks=pytest.mark.slow if step == 5 else pytest.mark.long) for step in (5, 11, 225)]
)
def test_a_killed_run_goes_on_as_if_nothing_had_happened(step, calibrated, tmp_path):
    """Killed while data is being included, just after that stage, and among the draws."""
    log, model = amigobot_log(6, seed=3), tight_model()
    checkpoint = tmp_path / "run.h5"
    _killed(checkpoint, step, CALIBRATE)
    assert checkpoint.exists()
    resumed = calibrate(log, model, checkpoint=checkpoint, resume=True, **CALIBRATE)
    write_posterior(calibrated, tmp_path / "whole.nc")
    write_posterior(resumed, tmp_path / "resumed.nc")
    assert (tmp_path / "whole.nc").read_bytes() == (tmp_path / "resumed.nc").read_bytes()


def test_a_checkpoint_changes_nothing(rail, uninterrupted, tmp_path):
    _assert_same(run(rail, checkpoint=str(tmp_path / "run.h5")), uninterrupted)


def test_a_finished_run_is_returned_as_it_was(rail, uninterrupted, tmp_path, monkeypatch):
    path = str(tmp_path / "run.h5")
    run(rail, checkpoint=path)
    monkeypatch.setattr("pmcl.sampling.move.step", lambda *given: pytest.fail("a finished run made another step"))
    _assert_same(run(rail, checkpoint=path, resume=True), uninterrupted)


@pytest.mark.parametrize("count", [1, 3, 8, 20, 29])
@pytest.mark.usefixtures("every_step")
def test_a_run_stopped_by_an_error_can_be_resumed(rail, uninterrupted, count, tmp_path, monkeypatch):
    """While a step is being stored, in each stage in turn (7, 6, 8 and 12 steps)."""
    from pmcl.sampling import backends

    path, calls, saved = str(tmp_path / "run.h5"), [], backends.Backend.save_step

    def save(self, state, accepted):
        calls.append(1)
        if len(calls) == count:
            raise KeyboardInterrupt
        saved(self, state, accepted)

    with monkeypatch.context() as patch:
        patch.setattr(backends.Backend, "save_step", save)
        with pytest.raises(KeyboardInterrupt):
            run(rail, checkpoint=path)
    assert Path(path).exists() == (count > 1)
    _assert_same(run(rail, checkpoint=path, resume=True), uninterrupted)


def _other(what):
    """The same run but for one thing."""
    log, model, method, changes = rail_log(9, seed=2), rail_model(), SHORT, {}
    if what == "log":
        log = rail_log(9, seed=3)
    elif what == "model":
        model = rail_model(reading_std=0.4)
    elif what == "prior":
        from scipy import stats

        from pmcl.models.robot_model import RobotModel

        model = RobotModel(
            model.motion, model.sensors, model.start, priors={"reading_std": stats.gamma(3.0, scale=0.21)}
        )
    elif what == "setting":
        method = replace(SHORT, particles=9)
    elif what == "method":
        method, changes = Ensemble(particles=8, burn_in=4), {"chains": 6}
    elif what == "chains":
        changes = {"chains": 4}
    elif what == "seed":
        changes = {"seed": 6}
    return model.bind(log), method, changes


@pytest.fixture(scope="module")
def finished(rail, tmp_path_factory):
    path = str(tmp_path_factory.mktemp("finished") / "run.h5")
    run(rail, checkpoint=path)
    return path


@pytest.mark.parametrize("what", ["log", "model", "prior", "method", "setting", "chains", "seed"])
def test_another_run_is_refused(what, finished):
    bound, method, changes = _other(what)
    with pytest.raises(SamplingError, match="the checkpoint belongs to another run") as caught:
        run(bound, method, checkpoint=finished, resume=True, **changes)
    assert "\n" not in str(caught.value)
    assert finished in str(caught.value)


def test_another_version_of_pmcl_or_of_an_effect_is_another_run(rail, monkeypatch):
    """The code of an effect counts, also one that does nothing at its prior mean, which is its null."""

    def stretched(power):
        def change(tables, values, log, where):
            return edit_motion(tables, lambda motion: {"mean": motion.mean * (1.0 + values[0]) ** power}, "stretch")

        parameter = Parameter("stretch", "1", stats.norm(0.0, 0.1), "share by which steps are longer")
        return Effect("stretch", "motion", (parameter,), (0.0,), change)

    log = amigobot_log(20, 1)
    model = default_model(log)
    prints = [fingerprint(replace(model, effects=(stretched(power),)).bind(log), {}) for power in (1, 1, 2)]
    assert prints[0] == prints[1] != prints[2]
    before = fingerprint(rail, {})
    monkeypatch.setattr("pmcl.sampling.checkpoint.version", lambda package: "999")
    assert fingerprint(rail, {}) != before


def test_an_existing_checkpoint_is_never_overwritten(rail, finished):
    before = Path(finished).read_bytes()
    with pytest.raises(SamplingError, match="expected no checkpoint, but there is one"):
        run(rail, checkpoint=finished)
    assert Path(finished).read_bytes() == before


@pytest.mark.parametrize("share", [0.05, 0.5, 0.99])
def test_a_truncated_checkpoint_is_refused_in_one_line(rail, finished, share, tmp_path):
    content, path = Path(finished).read_bytes(), tmp_path / "run.h5"
    path.write_bytes(content[: int(share * len(content))])
    before = path.read_bytes()
    with pytest.raises(SamplingError, match="remove it to start anew") as caught:
        run(rail, checkpoint=str(path), resume=True)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    assert path.read_bytes() == before


def to_another_file(file):
    file["main/other"] = h5py.ExternalLink("/etc/hostname", "/x")


def of_another_file(file):
    file.create_dataset("main/other", (4,), "u1", external=[("/etc/hostname", 0, 4)])


@pytest.mark.parametrize("change", [to_another_file, of_another_file])
def test_a_checkpoint_that_points_to_other_files_is_refused(rail, finished, change, tmp_path):
    path = tmp_path / "run.h5"
    path.write_bytes(Path(finished).read_bytes())
    with changed_checkpoint(path) as file:
        change(file)
    with pytest.raises(SamplingError, match=r"with its own data and no more, .* '/etc/hostname'; remove it"):
        run(rail, checkpoint=str(path), resume=True)


def test_a_locked_checkpoint_is_refused_in_one_line(rail, finished):
    with open(finished, "rb") as held:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        with pytest.raises(SamplingError, match="another program has it open") as caught:
            run(rail, checkpoint=finished, resume=True)
    assert "\n" not in str(caught.value)


def test_two_runs_do_not_share_a_checkpoint(rail, tmp_path):
    """The second one is told whose the file is; it must not advise to remove what another run is writing."""
    path = tmp_path / "run.h5"
    with the_only_run(str(path)), pytest.raises(SamplingError) as refused:
        run(rail, checkpoint=str(path))
    assert f"process {os.getpid()} on {socket.gethostname()} since" in str(refused.value)
    assert "remove" not in str(refused.value)
    assert os.listdir(tmp_path) == []


def test_a_checkpoint_of_another_version_is_refused(rail, finished, tmp_path):
    path = tmp_path / "run.h5"
    path.write_bytes(with_head(Path(finished).read_bytes(), layout=1))
    with pytest.raises(SamplingError, match=r"another version wrote it \(layout 1 instead of 4\)"):
        run(rail, checkpoint=str(path), resume=True)


def test_every_changed_byte_is_noticed_before_hdf5_reads_the_file(rail, finished, tmp_path, monkeypatch):
    content, path = Path(finished).read_bytes(), tmp_path / "run.h5"
    monkeypatch.setattr("pmcl.sampling.checkpoint.stored_arrays", lambda path: pytest.fail("HDF5 read a damaged file"))
    for place in (0, 15, 21, 80, 90, 200, 511, 512, 600, len(content) // 2, len(content) - 1):
        changed = bytearray(content)
        changed[place] ^= 1
        path.write_bytes(changed)
        with pytest.raises(SamplingError, match="remove it to start anew"):
            run(rail, checkpoint=str(path), resume=True)


@pytest.mark.usefixtures("every_step")
def test_a_write_that_fails_leaves_the_checkpoint_before(rail, uninterrupted, tmp_path, monkeypatch, caplog):
    """The disk becomes full after ten writes: the run goes on, and what was written before can be resumed."""
    path, writes, replaced = tmp_path / "run.h5", [], os.replace

    def fail(source, target):
        writes.append(1)
        if len(writes) > 10:
            raise OSError(28, "No space left on device")
        replaced(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", fail)
        _assert_same(run(rail, checkpoint=str(path)), uninterrupted)
    assert "No space left" in caplog.text
    assert [file.name for file in tmp_path.iterdir()] == ["run.h5"]
    _assert_same(run(rail, checkpoint=str(path), resume=True), uninterrupted)


def test_a_checkpoint_holds_no_more_than_resuming_needs(tmp_path):
    """The kept trajectories in single precision, three paths of each chain in double precision, and 80 kB besides."""
    bound = rail_model().bind(rail_log(2000, seed=2))
    path, chains = tmp_path / "run.h5", 2
    method = ParticleGibbs(
        particles=4, burn_in_particles=20, data_rate=500, settling_sweeps=4, tuning_sweeps=(4, 4), transport_moves=0,
        sweeps_per_draw=1,
    )  # fmt: skip
    run(bound, method, draws=20, trajectories=10, chains=chains, checkpoint=str(path))
    numbers = chains * 2000
    assert path.stat().st_size < 4 * 10 * numbers + 8 * 3 * numbers + 80_000


def test_emcee_reads_a_checkpoint(rail, uninterrupted, finished):
    draws = emcee.backends.HDFBackend(finished, name="draws", read_only=True)
    np.testing.assert_array_equal(draws.get_chain(), np.moveaxis(uninterrupted.theta, 0, 1))
    np.testing.assert_array_equal(draws.get_log_prob(), np.moveaxis(uninterrupted.log_joint, 0, 1))


@pytest.mark.parametrize("content", [b"", b"no HDF5 file at all"])
def test_what_is_no_checkpoint_is_refused_in_one_line(rail, content, tmp_path):
    path = tmp_path / "run.h5"
    path.write_bytes(content)
    with pytest.raises(SamplingError) as caught:
        run(rail, checkpoint=str(path), resume=True)
    assert "\n" not in str(caught.value)


def test_a_checkpoint_that_cannot_be_written_is_refused(rail, tmp_path):
    with pytest.raises(SamplingError, match="cannot be written"):
        run(rail, checkpoint=str(tmp_path / "no folder" / "run.h5"))


def test_processes_give_the_same_chains_as_threads(rail, uninterrupted):
    with ProcessPoolExecutor(2, mp_context=get_context("fork")) as pool:
        _assert_same(run(rail, pool=pool), uninterrupted)


def test_another_seed_gives_other_chains(rail, uninterrupted):
    other = run(rail, seed=6)
    assert (other.theta != uninterrupted.theta).all()
    # Chains of one run differ too.
    assert len(np.unique(uninterrupted.theta[:, -1, 0])) == 3


@pytest.mark.usefixtures("every_step")
def test_an_ensemble_can_be_resumed_too(rail, tmp_path, monkeypatch):
    from pmcl.sampling import backends

    method, sizes = Ensemble(particles=20, burn_in=6), {"chains": 6, "draws": 10, "seed": 3, "trajectories": 2}
    whole = run(rail, method, **sizes)
    for count in (2, 9):
        path, calls, saved = str(tmp_path / f"run{count}.h5"), [], backends.Backend.save_step

        def save(self, state, accepted, calls=calls, count=count, saved=saved):
            calls.append(1)
            if len(calls) == count:
                raise KeyboardInterrupt
            saved(self, state, accepted)

        with monkeypatch.context() as patch:
            patch.setattr(backends.Backend, "save_step", save)
            with pytest.raises(KeyboardInterrupt):
                run(rail, method, checkpoint=path, **sizes)
        _assert_same(run(rail, method, checkpoint=path, resume=True, **sizes), whole)
