"""``pmcl localize``: tracks from files, and one line for whatever does not fit."""

from __future__ import annotations

import os

import numpy as np
import pytest
from localization.posteriors import around, made_posterior

import pmcl
from pmcl.localization.track import Track
from pmcl.posterior.files import write_posterior

THETA = {"sigma_forward": 0.05, "sigma_left": 0.03, "sigma_turn": 0.05, "sigma_range": 0.1}
OLD = b"what was here before"


@pytest.fixture(scope="module")
def posterior(tmp_path_factory):
    path = tmp_path_factory.mktemp("posterior") / "posterior.nc"
    write_posterior(around(THETA, 0.1), path)
    return path


@pytest.fixture
def outputs(tmp_path):
    """An output that exists already and one that does not; checks afterwards that nothing happened to the folder."""
    folder = tmp_path / "results"
    folder.mkdir()
    existing = folder / "old.nc"
    existing.write_bytes(OLD)
    yield existing, folder / "new.nc"
    assert existing.read_bytes() == OLD
    assert os.listdir(folder) == ["old.nc"]


@pytest.mark.parametrize("method", ["mean", "map", pytest.param("posterior", marks=pytest.mark.slow)])
def test_a_track_is_written_and_summed_up(run, log, log_file, posterior, method, tmp_path):
    output, tum, reference = tmp_path / "track.nc", tmp_path / "track.tum", tmp_path / "reference.tum"
    output.write_bytes(OLD)
    result = run("localize", log_file, "--posterior", posterior, "--method", method, "--particles", 80, "--seed", 3,
                 "--tum", tum, "--tum-reference", reference, "-o", output)  # fmt: skip
    assert result.exit_code == 0, result.output
    track = Track.read(output)
    again = pmcl.localize(log, None, pmcl.read_posterior(posterior), method, particles=80, seed=3)
    np.testing.assert_array_equal(track.pose_mean, again.pose_mean)
    assert f"position error, RMSE                 {track.position_rmse:.4f} m" in result.stdout
    assert f"{100.0 * track.coverage_95:.1f} %" in result.stdout
    assert f"track: {output}" in result.stdout
    np.testing.assert_allclose(np.loadtxt(tum)[:, 1:3], track.pose_mean[:, :2], rtol=1e-6)
    np.testing.assert_allclose(np.loadtxt(reference)[:, 1:3], log.true_poses[:, :2], rtol=1e-6)
    assert sorted(os.listdir(tmp_path)) == ["log.nc", "reference.tum", "track.nc", "track.tum"]


def test_theta_and_prior_need_no_posterior(run, log, log_file, tmp_path):
    output = tmp_path / "track.nc"
    given = [text for name, value in THETA.items() for text in ("--theta", f"{name}={value}")]
    assert run("localize", log_file, *given, "-o", output).exit_code == 0
    np.testing.assert_array_equal(Track.read(output).pose_mean, pmcl.localize(log, theta=THETA).pose_mean)
    assert run("localize", log_file, "--method", "prior", "-o", output).exit_code == 0
    np.testing.assert_array_equal(Track.read(output).pose_mean, pmcl.localize(log, method="prior").pose_mean)


def test_without_a_reference_no_error_is_told(run, log, posterior, tmp_path):
    log.without_truth().write(tmp_path / "bare.nc")
    result = run("localize", tmp_path / "bare.nc", "--posterior", posterior, "-o", tmp_path / "track.nc")
    assert result.exit_code == 0, result.output
    assert "log score" in result.stdout
    assert "error" not in result.stdout


@pytest.mark.slow
def test_the_model_of_the_calibration_comes_with_the_posterior(run, log_file, tmp_path):
    model, posterior = tmp_path / "model.toml", tmp_path / "posterior.nc"
    model.write_text("[sensors.range]\noutliers = true\n[fixed]\nsigma_left = 0.02\n")
    short = ("--draws", "6", "--chains", "2", "--particles", "5", "--burn-in-particles", "50", "--data-rate", "10")
    assert run("calibrate", log_file, "-o", posterior, "--model", model, *short).exit_code == 3
    tracks = []
    for options in ((), ("--model", model)):
        output = tmp_path / f"track{len(options)}.nc"
        result = run("localize", log_file, "--posterior", posterior, "--particles", 50, *options, "-o", output)
        assert result.exit_code == 0, result.output
        tracks.append(Track.read(output))
    assert "range_outlier_weight" in tracks[0].dataset.attrs["theta"]
    assert "sigma_left" not in tracks[0].dataset.attrs["theta"]
    np.testing.assert_array_equal(tracks[0].pose_mean, tracks[1].pose_mean)


def without_readings(log):
    return log.dataset.assign(range=(("time", "beam"), np.full(log.ranges.shape, np.nan), log.dataset["range"].attrs))


MISFITS = {
    "other parameters": (around({"sigma_bearing": 0.1}, 0.1), (), "sigma_left"),
    "an effect too many": (around(THETA | {"range_bias": 0.1}, 0.1), (), "range_bias"),
    "no draws": (made_posterior(tuple(THETA), np.empty((0, 0, 4))), (), "posterior"),
    "k larger than the draws": (around(THETA, 0.1, (1, 7)), ("--method", "posterior", "--draws-per-reading", "8"),
                                "at most 7, the number of draws in the posterior, but got 8"),
    "no joint density": (made_posterior(tuple(THETA), np.full((1, 3, 4), 0.1)), ("--method", "map"), "'lp'"),
}  # fmt: skip


@pytest.mark.parametrize("name", MISFITS)
def test_posteriors_that_do_not_fit(name, log_file, tmp_path, refused, outputs):
    from pmcl.posterior.compat import save_netcdf

    data, options, message = MISFITS[name]
    path = tmp_path / "misfit.nc"
    save_netcdf(data, path)
    for output in outputs:
        line = refused("localize", log_file, "--posterior", path, *options, "-o", output)
        assert message in line
        assert str(path) in line


def test_foreign_parameters_name_log_and_posterior(log_file, tmp_path, refused, outputs):
    write_posterior(around({"sigma_bearing": 0.1}, 0.1), tmp_path / "other.nc")
    line = refused("localize", log_file, "--posterior", tmp_path / "other.nc", "-o", outputs[1])
    for word in ("sigma_range", "sigma_bearing", str(log_file), str(tmp_path / "other.nc")):
        assert word in line


def test_logs_that_cannot_be_localized(log, posterior, tmp_path, refused, outputs):
    bare = tmp_path / "bare.nc"
    pmcl.RobotLog.from_dataset(without_readings(log)).write(bare)
    for output in outputs:
        assert "missing (NaN)" in refused("localize", bare, "--posterior", posterior, "-o", output)
        assert "no such file" in refused("localize", tmp_path / "nothing.nc", "-o", output)
        assert "posterior" in refused("localize", bare, "--posterior", bare, "-o", output)


USAGE = {
    (): "--posterior: method 'mean' expects a posterior",
    ("--posterior", "nowhere.nc"): "nowhere.nc",
    ("--method", "median"): "'median' is not one of",
    ("--method", "prior", "--theta", "sigma_trun=1"): "did you mean 'sigma_turn'",
    ("--method", "prior", "--theta", "sigma_turn=-1"): "within its prior",
    ("--method", "prior", "--theta", "sigma_turn"): "expected name=value",
    ("--method", "prior", "--particles", "1"): "'--particles'",
    ("--method", "prior", "--least-particles", "600"): "expected at least 600 particles, but got 500",
    ("--method", "prior", "--tum", "nowhere/t.tum"): "no folder nowhere",
    ("--method", "prior", "--model", "nothing.toml"): "nothing.toml",
}


@pytest.mark.parametrize("options", USAGE, ids=" ".join)
def test_bad_usage(options, log_file, refused, outputs):
    for output in outputs:
        assert USAGE[options] in refused("localize", log_file, *options, "-o", output)


def test_inputs_are_not_overwritten(log_file, posterior, tmp_path, refused):
    before = log_file.read_bytes(), posterior.read_bytes()
    for output in (log_file, posterior):
        assert "other than" in refused("localize", log_file, "--posterior", posterior, "-o", output)
    line = refused("localize", log_file, "--method", "prior", "--tum", tmp_path / "t.nc", "-o", tmp_path / "t.nc")
    assert "other than" in line
    assert (log_file.read_bytes(), posterior.read_bytes()) == before
    assert sorted(os.listdir(tmp_path)) == ["log.nc"]


def test_an_mcap_file_is_written_beside_the_track(run, refused, log, log_file, tmp_path):
    output, shown = tmp_path / "track.nc", tmp_path / "track.mcap"
    result = run("localize", log_file, "--method", "prior", "--particles", 80, "-o", output, "--mcap", shown)
    assert result.exit_code == 0, result.output
    assert shown.read_bytes().startswith(b"\x89MCAP0\r\n")
    assert "is both" in refused("localize", log_file, "--method", "prior", "-o", output, "--mcap", output)
