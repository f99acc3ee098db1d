"""Whatever is wrong with the input: one line, exit status 2, and no file made, changed or left behind."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr

OLD = b"what was here before"


def broken(change):
    """Apply a change to a dataset of arrays that can be written."""

    def apply(dataset):
        dataset = dataset.copy(deep=True)
        for name in dataset.variables:
            dataset[name].values.flags.writeable = True
        return change(dataset)

    return apply


def assign(name, index, value):
    def change(dataset):
        values = np.array(dataset[name].values)
        values[index] = value
        return dataset.assign({name: (dataset[name].dims, values, dataset[name].attrs)})

    return change


def as_text(dataset):
    values = np.array([[f"{value:.3f}" for value in row] for row in dataset["range"].values])
    return dataset.assign(range=(("time", "beam"), values, dataset["range"].attrs))


def retimed(times):
    return lambda dataset: dataset.assign_coords(time=("time", times(dataset["time"].values.copy())))


def swap(times):
    times[[4, 5]] = times[[5, 4]]
    return times


def repeat(times):
    times[5] = times[4]
    return times


BAD_LOGS = {
    "unsorted times": (retimed(swap), "strictly increasing times, got time[5]"),
    "duplicate times": (retimed(repeat), "strictly increasing times, got time[5]"),
    "NaN odometry": (assign("odometry", (7, 2), np.nan), "turn = nan in row 7"),
    "negative range": (assign("range", (3, 1), -0.5), "got -0.5 in row 3"),
    "text ranges": (as_text, "expected numbers [m] in 'range'"),
    "wrong dims": (
        lambda dataset: dataset.rename(beam="ray"),
        "'range' with dimensions (time, beam), got (time=30, ray=8)",
    ),
    "odometry of two columns": (lambda dataset: dataset.isel(increment=slice(2)), "'odometry' with dimensions"),
    "no walls": (lambda dataset: dataset.drop_vars("wall"), "expected walls"),
    "start outside": (assign("start_mean", 0, 9.0), "start_mean inside the walls"),
    "empty": (lambda dataset: dataset.isel(time=slice(0)), "got an empty log"),
    "no readings": (lambda dataset: dataset.drop_vars(["range", "beam_pose"]), "expected at least one of range"),
    "all readings missing": (assign("range", slice(None), np.nan), "missing (NaN)"),
    "no max_range": (lambda dataset: without_max_range(dataset), "attribute max_range > 0"),
    "other format": (lambda dataset: dataset.assign_attrs(format="csv"), "got 'csv'"),
}


def without_max_range(dataset):
    dataset["range"].attrs.pop("max_range", None)
    dataset.attrs.pop("max_range", None)
    return dataset


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


@pytest.mark.parametrize("name", BAD_LOGS)
def test_bad_logs(name, log, tmp_path, refused, outputs):
    change, message = BAD_LOGS[name]
    path = tmp_path / "bad.nc"
    broken(change)(log.dataset).to_netcdf(path, engine="h5netcdf")
    for output in outputs:
        line = refused("calibrate", path, "-o", output)
        assert message in line
        assert str(path) in line


def test_a_beam_too_many(log, tmp_path, refused, outputs):
    readings = log.dataset.drop_vars("beam_pose")
    mounts = np.zeros((5, 3))
    bad = readings.rename(beam="sonar").assign(beam_pose=(("beam", "pose"), mounts))
    bad.to_netcdf(tmp_path / "bad.nc", engine="h5netcdf")
    for output in outputs:
        assert "'range' with dimensions (time, beam)" in refused("calibrate", tmp_path / "bad.nc", "-o", output)


@pytest.mark.parametrize("keep", [0, 3, 100, 5000])
def test_truncated_files(keep, log_file, refused, outputs):
    content = log_file.read_bytes()
    assert len(content) > keep
    log_file.write_bytes(content[:keep])
    for output in outputs:
        assert f"{log_file}: expected" in refused("calibrate", log_file, "-o", output)
        assert str(log_file) in refused("report", log_file, "-o", output)


def test_a_log_is_no_posterior(log_file, refused, outputs):
    for output in outputs:
        assert "pmcl calibrate" in refused("report", log_file, "-o", output)


@pytest.mark.parametrize("missing", [["calibrate"], ["report"], ["convert", "mrclam"], ["convert", "barfoot"]])
def test_missing_inputs(missing, tmp_path, refused, outputs):
    for output in outputs:
        line = refused(*missing, tmp_path / "nothing.nc", "-o", output)
        assert "nothing.nc" in line
        assert "such f" in line


MODELS = {
    "[fixed]\nsigma_left = 0": "sigma_left is fixed at 0",
    "[fixed]\nsigma_left = -1.0": "sigma_left is fixed at -1, outside",
    '[priors.sigma_turn]\ndistribution = "gamma"\nb = 2': "'priors.sigma_turn.b'",
    "kernel = 1": "key 'kernel'",
    "[sensors.landmarks]": "the model uses landmark_range, but the log has no such variable",
    "[fixed]\nsigma_left = 1\nsigma_forward = 1\nsigma_turn = 1\nsigma_range = 1": "at least one free parameter",
    "[start]\nmean = [0.9, 0.9, 0]\nstd = [0, 0, 0]": "three positive standard deviations",
}


@pytest.mark.parametrize("text", MODELS)
def test_bad_models(text, log_file, tmp_path, refused, outputs):
    path = tmp_path / "model.toml"
    path.write_text(text)
    for output in outputs:
        assert MODELS[text] in refused("calibrate", log_file, "--model", path, "-o", output)


USAGE = {
    ("--particles", "1"): "'--particles': 1 is not in the range",
    ("--particles", "many"): "'many' is not a valid integer",
    ("--draws", "0"): "'--draws'",
    ("--chains", "0"): "'--chains'",
    ("--data-rate", "0"): "'--data-rate'",
    ("--metropolis-steps", "-1"): "'--metropolis-steps'",
    ("--seed", "-1"): "'--seed'",
    ("--kernel", "smooth"): "'smooth' is not one of 'conditional', 'smoothing'",
    ("--method", "hmc"): "'hmc' is not one of",
    ("--partickles", "5"): "No such option",
    ("--method", "ensemble", "--kernel", "smoothing"): "--kernel belongs to the method particle-gibbs",
    ("--outliers", "--model", "m.toml"): "give one of the two",
    ("--checkpoint", "nowhere/c.h5"): "no folder nowhere",
}


@pytest.mark.parametrize("options", USAGE, ids=" ".join)
def test_bad_usage(options, log_file, refused, outputs):
    for output in outputs:
        line = refused("calibrate", log_file, "-o", output, *options)
        assert USAGE[options] in line
        assert "pmcl calibrate --help" in line


def test_outputs_that_cannot_be_written(log_file, tmp_path, refused):
    nowhere = tmp_path / "nowhere" / "x.nc"
    commands = (
        ("calibrate", log_file),
        ("simulate", "amigobot"),
        ("convert", "mrclam", "."),
        ("convert", "barfoot", "."),
        ("report", log_file),
    )
    for command in commands:
        line = refused(*command, "-o", nowhere)
        assert "no folder" in line
        assert str(nowhere.parent) in line
        assert "got the folder" in refused(*command, "-o", tmp_path)
    assert "no folder" in refused("demo", "--output-dir", nowhere)
    assert sorted(os.listdir(tmp_path)) == ["log.nc"]


def test_an_input_is_not_overwritten(log_file, refused):
    before = log_file.read_bytes()
    assert "other than the input" in refused("calibrate", log_file, "-o", log_file.parent / "." / log_file.name)
    assert log_file.read_bytes() == before


def test_an_output_is_asked_for(log_file, refused):
    assert "Missing option '-o'" in refused("calibrate", log_file)
    assert "Missing argument 'LOG.nc...'" in refused("calibrate", "-o", "x.nc")


@pytest.mark.parametrize("command", [[], ["simulate"], ["convert"]])
def test_a_command_is_asked_for(command, refused):
    assert "expected a command, but got none" in refused(*command)


def test_commands_that_do_not_exist(refused):
    assert "Did you mean 'calibrate'" in refused("calibrat")
    assert "No such command" in refused("simulate", "roomba")


SIMULATIONS = {
    ("--theta", "sigma_turn"): "expected name=value",
    ("--theta", "sigma_turn=fast"): "expected name=value",
    ("--theta", "sigma_turn=nan"): "expected name=value",
    ("--theta", "sigma_trun=0.1"): "did you mean 'sigma_turn'",
    ("--theta", "sigma_turn=-0.1"): "within its prior",
    ("--theta", "sigma_turn=0"): "sigma_turn > 0",
    ("--duration", "1"): "at least 2 s, but got 1 s",
    ("--duration", "nan"): "but got nan s",
}


@pytest.mark.parametrize("options", SIMULATIONS, ids=" ".join)
def test_impossible_simulations(options, refused, outputs):
    for output in outputs:
        assert SIMULATIONS[options] in refused("simulate", "amigobot", "-o", output, *options)


def test_a_foreign_checkpoint_stays_as_it_is(log_file, tmp_path, refused, outputs):
    checkpoint = tmp_path / "run.h5"
    checkpoint.write_bytes(OLD)
    for options in (("--checkpoint", checkpoint), ("--checkpoint", checkpoint, "--resume")):
        for output in outputs:
            assert str(checkpoint) in refused("calibrate", log_file, "-o", output, *options)
    assert checkpoint.read_bytes() == OLD


def test_a_real_process_says_one_line_without_traceback(log, tmp_path, outputs):
    path = tmp_path / "bad.nc"
    broken(assign("odometry", (7, 2), np.nan))(log.dataset).to_netcdf(path, engine="h5netcdf")
    for output in outputs:
        command = [sys.executable, "-c", "from pmcl.cli import main; main()", "calibrate", path, "-o", output]
        done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
        assert done.returncode == 2
        assert done.stderr.splitlines() == [line for line in done.stderr.splitlines() if "turn = nan in row 7" in line]
        assert len(done.stderr.splitlines()) == 1
        assert done.stdout == ""


def test_xarray_reads_what_the_tests_break(log_file):
    # Else the tests above would pass for another reason than the one they name.
    with xr.open_dataset(log_file, engine="h5netcdf", decode_times=False) as dataset:
        assert dict(dataset.sizes) == {
            "time": 30, "beam": 8, "pose": 3, "increment": 3, "wall_index": 6, "end": 2, "xy": 2,
        }  # fmt: skip
