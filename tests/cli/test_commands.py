"""Each command does what it says, from files to files."""

from __future__ import annotations

import json
import logging
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import xarray as xr

import pmcl
from pmcl.cli.report import print_verdict
from pmcl.models.robot_model import default_model
from pmcl.posterior.access import parameter_names, true_theta
from pmcl.posterior.compat import assemble
from pmcl.posterior.files import read_posterior
from pmcl.posterior.settings import settings
from pmcl.sampling.checkpoint import fingerprint

# Enough for every stage of a run to be made, far too few to converge.
SHORT = ("--draws", "12", "--chains", "2", "--particles", "5", "--burn-in-particles", "50", "--data-rate", "10")


def python(code):
    return [sys.executable, "-c", code]


def test_version_and_help(run):
    assert run("--version").stdout == f"pmcl {pmcl.__version__}\n"
    simulators = ("simulate", "simulate amigobot", "simulate aibo")
    for command in ("", *simulators, "convert", "calibrate", "compare", "localize", "report", "demo", "effects"):
        result = run(*command.split(), "--help")
        assert result.exit_code == 0
        assert result.stdout.startswith("Usage: ")
        assert result.stderr == ""


def test_help_and_import_are_quick_and_load_nothing_heavy():
    code = (
        "import sys, pmcl, pmcl.cli.commands; print(pmcl.__doc__[:8]); "
        "print(sorted({'numpy', 'xarray', 'scipy', 'numba', 'emcee', 'arviz', 'matplotlib'} & set(sys.modules)))"
    )
    started = time.perf_counter()
    done = subprocess.run(python(code), capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.splitlines() == ["Bayesian", "[]"]
    assert time.perf_counter() - started < 5.0


def test_public_names_are_few_and_all_there():
    assert len(pmcl.__all__) <= 20
    assert sorted(pmcl.__all__) == dir(pmcl)
    for name in pmcl.__all__:
        assert getattr(pmcl, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'calibrat'"):
        _ = pmcl.calibrat


def test_simulate_amigobot(run, tmp_path):
    path = tmp_path / "log.nc"
    result = run("simulate", "amigobot", "-o", path, "--duration", "40", "--seed", "3", "--theta", "sigma_turn=0.02")
    assert result.exit_code == 0
    assert f"{path}: 40 samples, 320 readings" in result.stdout
    assert "sigma_turn = 0.02" in result.stdout
    log = pmcl.read_log(path)
    assert log.fingerprint() == pmcl.simulate_amigobot(40.0, 3, {"sigma_turn": 0.02}).fingerprint()
    assert log.true_theta["sigma_turn"] == 0.02


def test_simulate_aibo(run, tmp_path):
    path = tmp_path / "log.nc"
    result = run("simulate", "aibo", "-o", path, "--duration", "60", "--seed", "4", "--theta", "sigma_size=0.1")
    assert result.exit_code == 0, result.output
    log = pmcl.read_log(path)
    assert f"{path}: 60 samples, {log.n_readings} readings" in result.stdout
    assert "sigma_size = 0.1" in result.stdout
    assert log.fingerprint() == pmcl.simulate_aibo(60.0, 4, {"sigma_size": 0.1}).fingerprint()


def test_print_model_gives_the_model_that_is_used(run, log, log_file, tmp_path):
    result = run("calibrate", log_file, "--print-model", "--outliers")
    assert result.exit_code == 0
    path = tmp_path / "model.toml"
    path.write_text(result.stdout)
    again = run("calibrate", log_file, "--print-model", "--model", path)
    assert again.stdout == result.stdout
    from pmcl.models.model_file import read_model

    usual = default_model(log, outliers=True)
    assert fingerprint(read_model(path, log).bind(log), {}) == fingerprint(usual.bind(log), {})


def test_calibrate_writes_a_posterior_and_says_that_it_has_not_converged(run, log_file, tmp_path):
    output = tmp_path / "posterior.nc"
    output.write_bytes(b"older")
    result = run("calibrate", log_file, "-o", output, *SHORT, "--seed", "7", "--transport-moves", "0")
    assert result.exit_code == 3, result.output
    assert "Not converged" in result.stdout
    assert f"posterior: {output}" in result.stdout
    data = read_posterior(output)
    assert parameter_names(data) == ("sigma_forward", "sigma_left", "sigma_turn", "sigma_range")
    assert set(true_theta(data)) == set(parameter_names(data))
    told = settings(data)
    assert (told["seed"], told["draws"], told["particles"], told["transport_moves"]) == (7, 12, 5, 0)
    for name in parameter_names(data):
        assert name in result.stdout
    page = tmp_path / "page.html"
    made = run("report", output, "-o", page)
    assert made.exit_code == 0, made.output
    assert "Not converged" in made.stdout
    assert "sigma_range" in page.read_text()


@pytest.mark.parametrize(
    ("spread", "adequate", "status"), [(0.0, 1, 0), (0.0, None, 0), (0.0, 0, 4), (1.0, 1, 3), (1.0, 0, 3)]
)
def test_the_exit_status_tells_both_halves_of_the_verdict(spread, adequate, status, capsys):
    draws = np.random.default_rng(1).normal(size=(4, 1000)) + spread * np.arange(4)[:, None]
    groups = {"posterior": xr.Dataset({"sigma_range": (("chain", "draw"), draws)})}
    if adequate is not None:
        finding = {"name": "spread", "log": 0, "message": "ranges scatter more than the model says"}
        attrs = {"adequate": adequate, "p_value": 0.5, "readings": 9, "findings": json.dumps([finding])}
        groups["predictive_check"] = xr.Dataset({"residual_range": ("time", np.zeros(9))}, attrs=attrs)
    assert print_verdict(assemble(groups, {})) == status
    assert ("readings and model disagree" in capsys.readouterr().out) == (adequate == 0)


@pytest.mark.slow
def test_the_model_file_and_several_logs_reach_the_sampler(run, log_file, tmp_path):
    other = tmp_path / "other.nc"
    pmcl.simulate_amigobot(20.0, seed=9).write(other)
    model = tmp_path / "model.toml"
    model.write_text("[fixed]\nsigma_left = 0.02\nsigma_turn = 0.05\n")
    output = tmp_path / "posterior.nc"
    result = run("calibrate", log_file, other, "-o", output, "--model", model, *SHORT)
    assert result.exit_code == 3, result.output
    data = read_posterior(output)
    assert parameter_names(data) == ("sigma_forward", "sigma_range")
    assert {"trajectory_0", "trajectory_1"} <= set(data["trajectories"].data_vars)


@pytest.mark.slow
def test_a_resumed_run_is_the_run(run, log_file, tmp_path):
    first, second = tmp_path / "first.nc", tmp_path / "second.nc"
    checkpoint = tmp_path / "run.h5"
    assert run("calibrate", log_file, "-o", first, *SHORT, "--checkpoint", checkpoint).exit_code == 3
    assert sorted(path.name for path in tmp_path.iterdir()) == ["first.nc", "log.nc", "run.h5"]
    done = run("calibrate", log_file, "-o", second, *SHORT, "--resume", "--checkpoint", checkpoint)
    assert done.exit_code == 3, done.output
    for name in parameter_names(read_posterior(first)):
        np.testing.assert_array_equal(
            read_posterior(first)["posterior"][name], read_posterior(second)["posterior"][name]
        )
    refused = run("calibrate", log_file, "-o", second, *SHORT, "--checkpoint", checkpoint)
    assert refused.exit_code == 2
    assert "there is one" in refused.stderr
    other = run("calibrate", log_file, "-o", second, *SHORT, "--resume", "--checkpoint", checkpoint, "--seed", "5")
    assert other.exit_code == 2
    assert "another run" in other.stderr


@pytest.mark.parametrize("other", ["out.nc", "log.nc"])
def test_checkpoint_and_posterior_are_two_files(run, log_file, tmp_path, other):
    before = log_file.read_bytes()
    refused = run("calibrate", log_file, "-o", tmp_path / "out.nc", "--checkpoint", tmp_path / other)
    assert refused.exit_code == 2
    assert "name another file" in refused.stderr
    assert log_file.read_bytes() == before
    assert not (tmp_path / "out.nc").exists()


def test_a_run_that_fails_leaves_no_checkpoint(run, log_file, tmp_path, monkeypatch):
    import pmcl.sampling.particle_gibbs as sampling
    from pmcl.errors import SamplingError

    def fail(*arguments, **settings):
        raise SamplingError("no chain can start;\nwiden the priors")

    monkeypatch.setattr(sampling, "_first_state", fail)
    result = run("calibrate", log_file, "-o", tmp_path / "p.nc", *SHORT, "--checkpoint", tmp_path / "c.h5")
    assert result.exit_code == 2
    assert result.stderr == "pmcl: error: no chain can start; widen the priors\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.nc"]


def test_an_interrupted_run_says_how_to_go_on(run, log_file, tmp_path, monkeypatch):
    import pmcl.sampling.particle_gibbs as sampling

    def interrupt(*arguments, **settings):
        raise KeyboardInterrupt

    monkeypatch.setattr(sampling, "_first_state", interrupt)
    result = run("calibrate", log_file, "-o", tmp_path / "p.nc", *SHORT)
    assert (result.exit_code, result.stderr) == (130, "pmcl: interrupted; nothing was sampled yet\n")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.nc"]


@pytest.mark.slow
def test_an_interrupted_run_is_gone_on_with(run, log_file, tmp_path, monkeypatch):
    """Ctrl-C among the draws; then the same command with --resume, which leaves nothing but the posterior."""
    import pmcl.sampling.particle_gibbs as sampling

    whole, output = tmp_path / "whole.nc", tmp_path / "p.nc"
    proposed, made = sampling.ParticleGibbsMove.propose, []

    def counted(self, model, state):
        made.append(1)
        return proposed(self, model, state)

    with monkeypatch.context() as patch:
        patch.setattr(sampling.ParticleGibbsMove, "propose", counted)
        assert run("calibrate", log_file, "-o", whole, *SHORT).exit_code == 3
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.nc", "whole.nc"]
    left = [len(made) - 2]

    def propose(self, model, state):
        left[0] -= 1
        if left[0] == 0:
            os.kill(os.getpid(), signal.SIGINT)
        return proposed(self, model, state)

    with monkeypatch.context() as patch:
        patch.setattr(sampling.ParticleGibbsMove, "propose", propose)
        result = run("calibrate", log_file, "-o", output, *SHORT)
    assert left == [0]
    checkpoint = tmp_path / "p.nc.checkpoint.h5"
    assert result.exit_code == 130
    assert result.stderr.splitlines()[-1] == (
        f"pmcl: interrupted; what was sampled is in {checkpoint}: go on with the same command and --resume"
    )
    again = run("calibrate", log_file, "-o", output, *SHORT)
    assert again.exit_code == 2
    assert "resume it (--resume)" in again.stderr
    assert run("calibrate", log_file, "-o", output, *SHORT, "--resume").exit_code == 3
    assert output.read_bytes() == whole.read_bytes()
    assert not checkpoint.exists()


def test_a_posterior_that_cannot_be_written_costs_no_run(run, log_file, tmp_path, monkeypatch):
    import pmcl.posterior.files as files
    from pmcl.errors import PosteriorError

    def fail(data, path):
        raise PosteriorError("the disk is full")

    with monkeypatch.context() as patch:
        patch.setattr(files, "write_posterior", fail)
        assert run("calibrate", log_file, "-o", tmp_path / "p.nc", *SHORT).exit_code == 2
    assert (tmp_path / "p.nc.checkpoint.h5").exists()
    monkeypatch.setattr("pmcl.sampling.move.step", lambda *given: pytest.fail("a finished run made another step"))
    assert run("calibrate", log_file, "-o", tmp_path / "p.nc", *SHORT, "--resume").exit_code == 3


def test_messages_of_the_library_are_plain_lines(run, log_file, monkeypatch):
    import pmcl.models.model_file as module

    def speak(model, log):
        logging.getLogger("pmcl.models").info("a plain message")
        return "text\n"

    monkeypatch.setattr(module, "model_text", speak)
    result = run("calibrate", log_file, "--print-model")
    assert (result.stdout, result.stderr) == ("text\n", "a plain message\n")


def test_errors_in_pmcl_itself_are_not_hidden(run, log_file, monkeypatch):
    import pmcl.models.model_file as module

    def wrong(model, log):
        raise RuntimeError("a bug")

    monkeypatch.setattr(module, "model_text", wrong)
    result = run("calibrate", log_file, "--print-model")
    assert isinstance(result.exception, RuntimeError)


def test_convert_mrclam(run, shared_data, tmp_path):
    path = tmp_path / "robot.nc"
    result = run("convert", "mrclam", shared_data / "mrclam6", "--robot", "2", "--duration", "60", "-o", path)
    assert result.exit_code == 0, result.output
    log = pmcl.read_log(path)
    assert log.n_steps == 121
    assert f"{log.n_readings} readings" in result.stdout
    refused = run("convert", "mrclam", shared_data / "mrclam6", "--robot", "9", "-o", path)
    assert refused.exit_code == 2
    assert "got 9" in refused.stderr


def test_convert_barfoot(run, shared_data, tmp_path):
    path = tmp_path / "robot.nc"
    result = run(
        "convert", "barfoot", shared_data / "lost_in_the_woods", "--duration", "60", "--start", "anywhere", "-o", path
    )
    assert result.exit_code == 0, result.output
    log = pmcl.read_log(path)
    assert log.n_steps == 61
    assert np.isinf(log.start_std).all()


def test_simulate_with_effects(run, refused, tmp_path):
    path = tmp_path / "log.nc"
    arguments = ("simulate", "amigobot", "-o", path, "--duration", "40", "--seed", "3", "--effect", "beam-bias@2=0.06")
    result = run(*arguments, "--effect", "odometry-turn-scale")
    assert result.exit_code == 0, result.output
    assert "beam_bias = 0.06, odometry_turn_scale = 0.1" in result.stdout
    log = pmcl.read_log(path)
    expected = pmcl.simulate_amigobot(40.0, 3, effects=["beam-bias@2=0.06", "odometry-turn-scale"])
    assert log.fingerprint() == expected.fingerprint()
    assert "beam-bias" in log.dataset.attrs["effects"]
    assert run(*arguments, "--hide-effects").exit_code == 0
    assert "effects" not in pmcl.read_log(path).dataset.attrs
    assert "did you mean 'range-bias'" in refused(*arguments[:4], "--effect", "rnge-bias")


def test_effects_are_listed_and_told(run, refused, tmp_path):
    from pmcl.models.effects.catalogue import CATALOGUE

    listed = run("effects").stdout
    for effect in CATALOGUE:
        assert f"  {effect.name}: " in listed
        assert all(f"{parameter.name} [{parameter.unit}]" in listed for parameter in effect.parameters)
    told = run("effects", "beam-yaw").stdout
    assert "beam-bias; to tell them apart" in told
    assert max(map(len, (listed + told).splitlines())) <= 100
    assert "did you mean 'beam-yaw'" in refused("effects", "beam-jaw")
    page = tmp_path / "effects.html"
    assert run("effects", "--html", page).exit_code == 0
    text = page.read_text()
    for effect in CATALOGUE:
        assert f'id="{effect.name}"' in text
        assert effect.summary.replace("'", "&#39;") in text
    assert "http" not in text
