"""NetCDF files: nothing is lost, and nothing that was there is destroyed."""

from __future__ import annotations

import os

import h5py
import numpy as np
import pytest
import xarray as xr

from pmcl.errors import LogError
from pmcl.logs import netcdf
from pmcl.logs.netcdf import read_dataset
from pmcl.logs.robot_log import RobotLog


def bits(array):
    return np.ascontiguousarray(array).view(np.uint64)


def test_a_round_trip_keeps_every_bit(log, tmp_path):
    log.write(tmp_path / "log.nc")
    back = RobotLog.read(tmp_path / "log.nc")
    xr.testing.assert_identical(back.dataset, log.dataset)
    for name in log.dataset.data_vars:
        np.testing.assert_array_equal(bits(back.dataset[name].values), bits(log.dataset[name].values), err_msg=name)
    assert back.fingerprint() == log.fingerprint()
    assert back.where == str(tmp_path / "log.nc")
    assert back.true_theta == log.true_theta
    assert back.landmarks.names == ("red", "blue")


def test_a_long_random_log_survives(rng, tmp_path):
    n = 1000
    log = RobotLog.build(
        time=np.cumsum(rng.uniform(0.01, 1.0, n)),
        odometry=rng.normal(size=(n, 3)) * 10.0 ** rng.integers(-300, 3, (n, 3)),
        ranges=rng.uniform(0.0, 5.0, (n, 180)),
        beam_poses=rng.normal(size=(180, 3)),
        max_range=5.0,
    )
    log.write(tmp_path / "log.nc")
    back = RobotLog.read(tmp_path / "log.nc")
    np.testing.assert_array_equal(bits(back.times), bits(log.times))
    np.testing.assert_array_equal(bits(back.odometry), bits(log.odometry))
    np.testing.assert_array_equal(bits(back.ranges), bits(log.ranges))


def test_the_classic_format_is_read_too(log, tmp_path):
    log.dataset.to_netcdf(tmp_path / "classic.nc", engine="scipy", format="NETCDF3_64BIT")
    assert RobotLog.read(tmp_path / "classic.nc").fingerprint() == log.fingerprint()


def test_the_file_is_closed_after_reading(log, tmp_path):
    log.write(tmp_path / "log.nc")
    first = RobotLog.read(tmp_path / "log.nc")
    log.select(0, 2).write(tmp_path / "log.nc")
    assert (first.n_steps, RobotLog.read(tmp_path / "log.nc").n_steps) == (4, 2)


def whole(log, path):
    log.write(path)
    return path.read_bytes()


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda b: b[: len(b) // 2], "cannot be read"),
        (lambda b: b[:100], "cannot be read"),
        (lambda b: b"", "cannot be read"),
        (lambda b: b"time,x,y\n0,1,2\n", "cannot be read"),
        (lambda b: b"CDF\x01" + b[4:], "cannot be read"),
    ],
)
def test_a_damaged_file_is_one_line(log, tmp_path, damage, says):
    path = tmp_path / "log.nc"
    path.write_bytes(damage(whole(log, path)))
    with pytest.raises(LogError, match=says) as caught:
        RobotLog.read(path)
    assert str(caught.value).startswith(f"{path}: expected a NetCDF file")
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_a_folder_are_one_line(tmp_path):
    os.mkfifo(tmp_path / "pipe")  # reading it would wait for a writer
    for path in (tmp_path / "absent.nc", tmp_path, tmp_path / "pipe"):
        with pytest.raises(LogError, match=r"expected a .*NetCDF file, got") as caught:
            RobotLog.read(path)
        assert str(caught.value).startswith(f"{path}: ")
        assert "\n" not in str(caught.value)


def test_numbers_that_no_log_needs_are_not_loaded(log, tmp_path):
    """Neither those of a variable that is no part of the format: 4 GB that take no room on disk."""
    path = tmp_path / "log.nc"
    log.write(path)
    with h5py.File(path, "r+") as file:
        properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
        properties.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
        space = h5py.h5s.create_simple((500_000_000,))
        h5py.h5d.create(file.id, b"foreign", h5py.h5t.NATIVE_DOUBLE, space, dcpl=properties)
    with pytest.raises(LogError, match="at most 20000000 numbers in a log, got '/foreign' of shape 500000000"):
        RobotLog.read(path)


def test_classic_files_have_the_same_limits(log, tmp_path, monkeypatch):
    path = tmp_path / "classic.nc"
    log.dataset.to_netcdf(path, engine="scipy", format="NETCDF3_64BIT")
    monkeypatch.setattr(netcdf, "MOST_NUMBERS", 30)
    with pytest.raises(LogError, match="at most 30 numbers in a log, got '/"):
        RobotLog.read(path)
    monkeypatch.setattr(netcdf, "MOST_NUMBERS", 10_000)
    monkeypatch.setattr(netcdf, "MOST_IN_GROUP", 3)
    with pytest.raises(LogError, match="variables, more than 3"):
        RobotLog.read(path)


def test_another_netcdf_file_is_no_log(tmp_path):
    xr.Dataset({"temperature": ("x", [1.0, 2.0])}).to_netcdf(tmp_path / "weather.nc", engine="h5netcdf")
    with pytest.raises(LogError, match=r"weather.nc: expected a robot log"):
        RobotLog.read(tmp_path / "weather.nc")


def test_a_failed_write_keeps_the_existing_file(log, tmp_path, monkeypatch):
    path = tmp_path / "log.nc"
    before = whole(log, path)

    def full_disk(self, target, **options):
        target.write_bytes(b"half a file")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(xr.Dataset, "to_netcdf", full_disk)
    with pytest.raises(LogError, match="No space left on device") as caught:
        log.select(0, 2).write(path)
    assert "\n" not in str(caught.value)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["log.nc"]


def test_an_interrupted_write_keeps_the_existing_file(log, tmp_path, monkeypatch):
    path = tmp_path / "log.nc"
    before = whole(log, path)

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        log.select(0, 2).write(path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["log.nc"]


def test_attributes_that_no_file_can_hold_are_one_line(arrays, tmp_path):
    with pytest.raises(LogError, match="attributes") as caught:
        RobotLog.build(**arrays, attributes={"notes": {"a": object()}}).write(tmp_path / "log.nc")
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_writing_nowhere_is_one_line(log, tmp_path):
    with pytest.raises(LogError, match="existing folder"):
        log.write(tmp_path / "absent" / "log.nc")
    with pytest.raises(LogError, match="got a folder"):
        log.write(tmp_path)


def test_a_symbolic_link_stays_one(log, tmp_path):
    target, link = tmp_path / "target.nc", tmp_path / "link.nc"
    log.write(target)
    link.symlink_to(target)
    log.select(0, 2).write(link)
    assert link.is_symlink()
    assert RobotLog.read(target).n_steps == 2


def test_times_stay_numbers(log, tmp_path):
    dataset = log.dataset.copy(deep=True)
    dataset["time"].attrs["units"] = "seconds since 2009-07-24"
    dataset["landmark_time_offset"].attrs["units"] = "seconds"
    dataset.to_netcdf(tmp_path / "log.nc", engine="h5netcdf")
    assert read_dataset(tmp_path / "log.nc")["landmark_time_offset"].dtype == np.float64
    np.testing.assert_array_equal(RobotLog.read(tmp_path / "log.nc").times, log.times)
