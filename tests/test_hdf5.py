"""Files of HDF5 that point elsewhere, or declare what they do not hold, are refused."""

from __future__ import annotations

import os

import h5py
import numpy as np
import pytest
import xarray as xr

from pmcl.errors import LogError, PosteriorError
from pmcl.hdf5 import MOST_IN_GROUP, StoredArray, UnsafeFileError, stored_arrays
from pmcl.localization.track import Track
from pmcl.logs.robot_log import RobotLog
from pmcl.posterior.files import read_posterior
from pmcl.simulations.amigobot import simulate_amigobot


def external_link(file):
    file["elsewhere"] = h5py.ExternalLink("secret.h5", "/numbers")


def virtual(file):
    layout = h5py.VirtualLayout((3,), "f8")
    layout[:] = h5py.VirtualSource("secret.h5", "numbers", shape=(3,))
    file.create_virtual_dataset("elsewhere", layout)


def raw(file):
    file.create_dataset("elsewhere", (3,), "f8", external=[("secret.bin", 0, 24)])


def soft_link(file):
    file["elsewhere"] = h5py.SoftLink("/nothing")


ELSEWHERE = {
    external_link: "a link '.*elsewhere' to another file, 'secret.h5'",
    virtual: "an array '.*elsewhere' that is put together from other files",
    raw: "an array '.*elsewhere' whose data are in another file, 'secret.bin'",
    soft_link: "a link '.*elsewhere' to another place, '/nothing'",
}
PLACES = ["/", "/posterior", "/posterior/a/b/c"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Here lie the files that others point to, with bytes that must not be seen."""
    monkeypatch.chdir(tmp_path)
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["numbers"] = np.array([7.25, 7.5, 7.75])
    (tmp_path / "secret.bin").write_bytes(np.array([7.25, 7.5, 7.75]).tobytes())
    return tmp_path


def made(path, change, place="/"):
    with h5py.File(path, "a") as file:
        change(file.require_group(place))
    return path


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("change", ELSEWHERE)
def test_what_lies_elsewhere_is_refused_at_any_depth(folder, change, place):
    with pytest.raises(UnsafeFileError, match=ELSEWHERE[change]):
        stored_arrays(made(folder / "file.h5", change, place))


@pytest.mark.parametrize("change", [external_link, virtual, raw])
def test_the_tests_files_do_point_to_the_secret(folder, change):
    # Else the tests above would pass for files that HDF5 does not follow in any case.
    with h5py.File(made(folder / "file.h5", change)) as file:
        assert file["elsewhere"][...].tolist() == [7.25, 7.5, 7.75]


@pytest.mark.parametrize("change", ELSEWHERE)
def test_logs_posteriors_and_tracks(folder, change):
    """One line that names the file, for each kind of file."""
    simulate_amigobot(5.0).write(folder / "log.nc")
    with pytest.raises(LogError, match=f"log.nc: expected a NetCDF file with its own data .*{ELSEWHERE[change]}"):
        RobotLog.read(made(folder / "log.nc", change, "/some/group"))
    draws = xr.Dataset({"sigma": (("chain", "draw"), np.ones((2, 5)))})
    draws.to_netcdf(folder / "posterior.nc", group="posterior", engine="h5netcdf")
    assert read_posterior(folder / "posterior.nc")
    with pytest.raises(PosteriorError, match=f"with its own data .*{ELSEWHERE[change]} at .*posterior.nc"):
        read_posterior(made(folder / "posterior.nc", change, "/posterior"))
    with pytest.raises(PosteriorError, match=r"track.nc: expected a track .* got a file that cannot be read"):
        Track.read(made(folder / "track.nc", change))


def test_arrays_are_listed_with_their_sizes(tmp_path):
    with h5py.File(tmp_path / "file.h5", "w") as file:
        file["a"] = np.zeros((3, 4))
        file.create_group("g/h")["b"] = np.float32(1.0)
        file["g"]["nothing"] = h5py.Empty("f8")
        file["g"]["type"] = np.dtype("i4")
    assert stored_arrays(tmp_path / "file.h5") == {
        "/a": StoredArray((3, 4), 96), "/g/h/b": StoredArray((), 4), "/g/nothing": StoredArray((), 8),
    }  # fmt: skip


def within_itself(file):
    group = file.create_group("g")
    group.create_group("h")["up"] = group


def deep(file):
    for _ in range(20):
        file = file.create_group("g")


def many(file):
    for k in range(MOST_IN_GROUP + 1):
        file[f"v{k}"] = 0.0


UNUSUAL = {
    "a group within itself": (within_itself, "a group '/g/h/up' within itself"),
    "deep groups": (deep, "within itself, or too many groups"),
    "many variables": (many, "1001 variables in '/', more than 1000"),
    "10^12 cells": (
        lambda file: file.create_dataset("big", (10**6, 10**6), "f8", chunks=(9, 9)),
        "'/big' of shape 1000000 x",
    ),
    "zeros that take no room": (
        lambda file: file.create_dataset("big", data=np.zeros((3000, 4000)), chunks=(3000, 400), compression="gzip"),
        "arrays of 91.6 MB in 0.0.* MB of data",
    ),
}


@pytest.mark.parametrize("name", UNUSUAL)
def test_what_takes_far_more_than_the_file_is_refused(tmp_path, name):
    change, says = UNUSUAL[name]
    with pytest.raises(UnsafeFileError, match=says):
        stored_arrays(made(tmp_path / "file.h5", change))


def test_what_shrinks_as_data_do_is_read(tmp_path):
    """A chain that never moved, and numbers that are drawn."""
    rng = np.random.default_rng(1)
    with h5py.File(tmp_path / "file.h5", "w") as file:
        file.create_dataset("still", data=np.ones((1000, 1000)), compression="gzip")
        file.create_dataset("drawn", data=rng.normal(size=(300, 100)), compression="gzip")
    assert len(stored_arrays(tmp_path / "file.h5")) == 2


@pytest.mark.parametrize("kind", ["pipe", "missing", "text"])
def test_what_is_no_file_of_hdf5(tmp_path, kind):
    path = tmp_path / "file.h5"
    if kind == "pipe":
        os.mkfifo(path)
    if kind == "text":
        path.write_text("a text")
    with pytest.raises((OSError, UnsafeFileError)):
        stored_arrays(path)
