"""Track files as the format says, and TUM text."""

from __future__ import annotations

import math

import numpy as np
import pytest
import xarray as xr

import pmcl
from pmcl.errors import PmclError, PosteriorError
from pmcl.localization.track import Track
from pmcl.localization.tum import write_tum


@pytest.fixture(scope="module")
def track(room_log, theta):
    return pmcl.localize(room_log, theta=theta, particles=100)


def test_a_track_holds_what_the_format_says(track, room_log, tmp_path):
    track.write(tmp_path / "track.nc")
    with xr.open_dataset(tmp_path / "track.nc", engine="h5netcdf", decode_times=False) as dataset:
        assert dataset["pose_mean"].dims == ("time", "pose")
        assert dataset["pose_cov"].dims == ("time", "pose", "pose2")
        assert dataset["log_score"].dims == dataset["ess"].dims == ("time",)
        assert {"position_rmse", "heading_rmse", "coverage_95"} <= set(dataset.attrs)
        np.testing.assert_array_equal(dataset["time"], room_log.times)
    again = Track.read(tmp_path / "track.nc")
    for name in track.dataset.data_vars:
        np.testing.assert_array_equal(again.dataset[name], track.dataset[name])
    assert again.position_rmse == track.position_rmse
    assert sorted(path.name for path in tmp_path.iterdir()) == ["track.nc"]


def test_a_log_whose_name_is_no_utf_8_has_a_track(room_log, theta, tmp_path):
    """On Linux a name may be any bytes, and Python gives those that are no UTF-8 as lone surrogates."""
    log = pmcl.RobotLog.from_dataset(room_log.dataset, "/folder/log\udcff.nc", room_log.grid_map)
    pmcl.localize(log, theta=theta, particles=50).write(tmp_path / "track\udcff.nc")
    assert Track.read(tmp_path / "track\udcff.nc").dataset.attrs["source"] == "log?.nc"


def test_uncertainties_are_covariances(track):
    assert (track.ess >= 1.0).all()
    assert (track.ess <= 100.0 + 1e-9).all()
    np.testing.assert_array_equal(track.pose_cov, track.pose_cov.transpose(0, 2, 1))
    assert (np.linalg.eigvalsh(track.pose_cov) > 0.0).all()


def test_tum_text(track, room_log, tmp_path):
    path = tmp_path / "track.tum"
    track.write_tum(path)
    rows = np.loadtxt(path)
    assert rows.shape == (room_log.n_steps, 8)
    np.testing.assert_allclose(rows[:, 0], room_log.times)
    np.testing.assert_allclose(rows[:, 1:3], track.pose_mean[:, :2], rtol=1e-7)
    np.testing.assert_array_equal(rows[:, 3:6], 0.0)
    np.testing.assert_allclose(np.hypot(rows[:, 6], rows[:, 7]), 1.0, rtol=1e-7)
    turned = np.angle(np.exp(1j * (2.0 * np.arctan2(rows[:, 6], rows[:, 7]) - track.pose_mean[:, 2])))
    np.testing.assert_allclose(turned, 0.0, atol=1e-7)


def test_tum_text_of_a_reference_with_gaps_and_clock_times(tmp_path):
    times = 1248272288.123456 + np.arange(3.0)
    poses = np.array([[1.0, 2.0, math.pi / 2.0], [np.nan] * 3, [1.0, 2.0, -math.pi]])
    write_tum(tmp_path / "a.tum", times, poses)
    lines = (tmp_path / "a.tum").read_text().splitlines()
    assert lines[0] == "1248272288.123456 1 2 0 0 0 0.707106781 0.707106781"
    assert len(lines) == 2
    with pytest.raises(PmclError, match="one pose for each time"):
        write_tum(tmp_path / "b.tum", times[:2], poses)
    with pytest.raises(PmclError, match="nowhere known"):
        write_tum(tmp_path / "b.tum", times, poses * np.nan)
    assert not (tmp_path / "b.tum").exists()


def test_files_that_are_no_tracks(tmp_path, room_log):
    with pytest.raises(PosteriorError, match="cannot be read"):
        Track.read(tmp_path / "nothing.nc")
    room_log.write(tmp_path / "log.nc")
    with pytest.raises(PosteriorError, match="expected a track, got variables"):
        Track.read(tmp_path / "log.nc")
