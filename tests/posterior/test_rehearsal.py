"""What comes after sampling is tried before it; what fails all the same costs no draws."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
from click.testing import CliRunner
from synthetic_posterior import fake_case

import pmcl
from pmcl.calibration import workflow
from pmcl.cli.commands import pmcl as application
from pmcl.errors import ConversionError, PosteriorError
from pmcl.posterior import rehearsal
from pmcl.posterior.files import read_posterior
from pmcl.posterior.rehearsal import rehearse
from pmcl.simulations.landmark_field import simulate_landmark_field
from pmcl.whole_file import remove_rests

QUICK = pmcl.ParticleGibbs(
    particles=5, burn_in_particles=20, data_rate=100, settling_sweeps=2, tuning_sweeps=(4,), transport_moves=0
)
COMMAND = (
    "--draws", "6", "--chains", "2", "--particles", "5", "--burn-in-particles", "20", "--data-rate", "100",
    "--settling-sweeps", "2", "--transport-moves", "0",
)  # fmt: skip


@pytest.fixture
def case():
    return fake_case(n_draws=20)


def test_a_rehearsal_leaves_nothing(case, tmp_path):
    rehearse(case.parameters, case.logs, {"model": "text"}, tmp_path / "run.h5")
    assert os.listdir(tmp_path) == []


def test_what_a_killed_rehearsal_leaves_is_removed_with_the_rests_of_its_run(case, tmp_path, monkeypatch):
    place = tmp_path / "run.h5"
    monkeypatch.setattr(rehearsal, "save_netcdf", lambda data, path: shutil.copy(path, f"{path}.part"))
    rehearse(case.parameters, case.logs, {}, place)
    assert len(os.listdir(tmp_path)) == 1
    remove_rests(place)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("step", ["to_arviz", "verdict", "save_netcdf"])
def test_whatever_fails_is_told_in_one_line_before_sampling(step, case, tmp_path, monkeypatch):
    def fail(*given, **named):
        raise ImportError("libhdf5.so: cannot open\nshared object file")

    monkeypatch.setattr(rehearsal, step, fail)
    with pytest.raises(PosteriorError, match=r"got ImportError: libhdf5\.so: .* nothing was sampled yet") as told:
        rehearse(case.parameters, case.logs, {}, tmp_path / "run.h5")
    assert "\n" not in str(told.value)
    assert os.listdir(tmp_path) == []


def test_a_setting_that_no_file_can_hold_is_found(case, tmp_path):
    with pytest.raises(PosteriorError, match="store it as text"):
        rehearse(case.parameters, case.logs, {"odd": [1, 2]})
    with pytest.raises(PosteriorError, match="surrogates"):
        rehearse(case.parameters, case.logs, {"model": "no UTF-8: \udcff"}, tmp_path / "run.h5")


def test_calibrate_rehearses_before_it_samples(tmp_path, monkeypatch):
    monkeypatch.setattr(pmcl.ParticleGibbs, "run", lambda *given: pytest.fail("sampled in spite of it"))
    for name, outcome in (("checked_logs", "[]"), ("compile_for_calibration", None)):
        monkeypatch.setattr(workflow, name, lambda *given, outcome=outcome: outcome)

    def fail(*given, **named):
        raise OSError("no place")

    monkeypatch.setattr(rehearsal, "save_netcdf", fail)
    with pytest.raises(PosteriorError, match="nothing was sampled yet"):
        workflow.calibrate(simulate_landmark_field(20, 1), checkpoint=tmp_path / "run.h5")
    assert os.listdir(tmp_path) == []


def test_an_error_of_the_conversion_carries_the_draws(monkeypatch):
    draws = fake_case(n_draws=20).chains
    for name, outcome in (("checked_logs", "[]"), ("compile_for_calibration", None), ("rehearse", None)):
        monkeypatch.setattr(workflow, name, lambda *given, outcome=outcome: outcome)
    monkeypatch.setattr(pmcl.ParticleGibbs, "run", lambda *given: draws)
    with pytest.raises(ConversionError, match="the attribute 'chains'") as told:
        workflow.calibrate(simulate_landmark_field(20, 1))
    assert told.value.chains is draws


@pytest.mark.slow
def test_the_advice_after_a_failed_conversion_works(tmp_path, monkeypatch):
    """The very command that the message names makes the posterior, without another step."""
    from pmcl.sampling import move

    log, whole, output = tmp_path / "log.nc", tmp_path / "whole.nc", tmp_path / "p.nc"
    simulate_landmark_field(20, 1).write(log)
    command = ["calibrate", str(log), *COMMAND, "-o"]
    assert CliRunner().invoke(application, [*command, str(whole)]).exit_code == 3

    def fail(*given, **named):
        raise MemoryError("no room for\nthe groups")

    with monkeypatch.context() as patch:
        patch.setattr(workflow, "to_arviz", fail)
        failed = CliRunner().invoke(application, [*command, str(output)])
    checkpoint = tmp_path / "p.nc.checkpoint.h5"
    assert failed.exit_code == 2
    line = failed.stderr.splitlines()[-1]
    assert "MemoryError: no room for the groups" in line
    assert str(checkpoint) in line
    assert "--resume" in line
    assert checkpoint.exists()
    monkeypatch.setattr(move, "step", lambda *given: pytest.fail("sampled again"))
    assert CliRunner().invoke(application, [*command, str(output), "--resume"]).exit_code == 3
    assert output.read_bytes() == whole.read_bytes()
    assert not checkpoint.exists()


HOMELESS = """
import sys
from pathlib import Path
from synthetic_posterior import fake_case
from pmcl.posterior.convert import to_arviz
from pmcl.posterior.diagnostics import verdict
from pmcl.posterior.files import write_posterior
case = fake_case(n_draws=20)
data = to_arviz(case.chains, case.parameters, case.logs)
verdict(data)
write_posterior(data, sys.argv[1])
import os
import shutil
assert os.environ.get("XDG_CACHE_HOME") is None
"""


@pytest.mark.slow
def test_a_home_that_cannot_be_written_is_no_matter(tmp_path):
    """As root every folder can be written: a file in place of HOME refuses everybody."""
    home = tmp_path / "home"
    home.write_text("")
    paths = [os.path.dirname(os.path.dirname(pmcl.__file__)), os.path.dirname(__file__)]
    kept = {name: value for name, value in os.environ.items() if not name.startswith("XDG_")}
    done = subprocess.run(
        [sys.executable, "-c", HOMELESS, str(tmp_path / "p.nc")],
        env=kept | {"HOME": str(home), "PYTHONPATH": os.pathsep.join(paths), "PYTHONWARNINGS": "ignore"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert read_posterior(tmp_path / "p.nc").posterior.sizes["draw"] == 20


def test_a_foreign_name_of_a_log_does_not_stop_the_rehearsal(case, tmp_path):
    dataset = case.logs[0].dataset.assign(prior_grid=("prior_point", np.zeros(3)), extra=("parameter", np.zeros(2)))
    odd = type(case.logs[0])(dataset, None, "odd")
    rehearse(case.parameters, [odd], {}, tmp_path / "run.h5")
