"""The MRCLAM reader: a recording made by hand, malformed ones, and the real one."""

from __future__ import annotations

import numpy as np
import pytest
from recorded import dead_reckoning, residuals, robust_sd

from pmcl.errors import LogError
from pmcl.logs.mrclam import read_mrclam
from pmcl.logs.robot_log import RobotLog

FILES = {
    "Barcodes.dat": "# subject barcode\n1 5\n2 14\n6 63\n7 81\n",
    "Landmark_Groundtruth.dat": "6 1.0 2.0 0 0\n7 -1.0 0.5 0 0\n",
    "Robot1_Odometry.dat": "100.0 1.0 0.0\n101.0 0.5 0.0\n103.0 0.0 0.0\n",
    # Landmark 6 twice near 101.0, robot 2, an unknown barcode, landmark 7 before the start.
    "Robot1_Measurement.dat": "\n".join(
        ("98.0 81 9.0 0.0", "100.8 63 1.8 0.3", "101.1 63 1.1 0.2", "101.2 14 1.0 0.1", "102.0 99 1.0 0.0")
    ),
    "Robot1_Groundtruth.dat": "\n".join(
        ("99.5 -0.2 0 0.1", "100.0 0 0 0.1", "100.4 0.4 0 0.1", "100.6 0.6 0 0.1", "101.0 1 0 0.1", "102.9 1.95 0 0.1")
    ),
}


@pytest.fixture
def folder(tmp_path):
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    return tmp_path


def test_a_recording_by_hand(folder):
    log = read_mrclam(folder, 1, period=1.0)
    nan = np.nan
    np.testing.assert_array_equal(log.times, [0.0, 1.0, 2.0])
    np.testing.assert_allclose(log.odometry, [[0, 0, 0], [1.0, 0, 0], [0.5, 0, 0]])
    np.testing.assert_array_equal(log.landmark_range, [[nan, nan], [1.1, nan], [nan, nan]])
    np.testing.assert_array_equal(log.landmark_bearing, [[nan, nan], [0.2, nan], [nan, nan]])
    np.testing.assert_allclose(log.landmark_time_offset, [[nan, nan], [0.1, nan], [nan, nan]], atol=1e-9)
    np.testing.assert_array_equal(log.landmarks.positions, [[1.0, 2.0], [-1.0, 0.5]])
    assert log.landmarks.names == ("6", "7")
    np.testing.assert_allclose(log.true_poses, [[0, 0, 0.1], [1, 0, 0.1], [nan, nan, nan]], atol=1e-9)
    np.testing.assert_array_equal(log.start_mean, log.true_poses[0])
    np.testing.assert_array_equal(log.start_std, [0.1, 0.1, 0.1])
    counts = {k: v for k, v in log.dataset.attrs.items() if k.startswith("dropped")}
    assert counts == {"dropped_robots": 1, "dropped_unknown_barcodes": 1, "dropped_outside": 1, "dropped_duplicate": 1}
    assert log.dataset.attrs["time_origin"] == 100.0


def test_a_start_that_reads_no_reference(folder):
    log = read_mrclam(folder, 1, period=1.0, start="anywhere")
    np.testing.assert_array_equal(log.start_std, np.full(3, np.inf))
    np.testing.assert_array_equal(log.start_mean, np.zeros(3))


def test_without_reference_the_log_has_no_true_poses(folder):
    (folder / "Robot1_Groundtruth.dat").unlink()
    log = read_mrclam(folder, 1, period=1.0, start="anywhere")
    assert log.true_poses is None
    assert log.n_steps == 4
    with pytest.raises(LogError, match=r"expected a reference pose at 0 s for start = 'reference'"):
        read_mrclam(folder, 1, period=1.0)


def test_a_part_of_the_recording(folder):
    log = read_mrclam(folder, 1, period=0.5, begin=0.5, duration=1.0)
    np.testing.assert_allclose(log.times, [0.5, 1.0, 1.5])
    np.testing.assert_allclose(log.odometry[:, 0], [0.0, 0.5, 0.25])
    np.testing.assert_allclose(log.start_mean, [0.5, 0.0, 0.1], atol=1e-9) if not np.isnan(
        log.true_poses[0, 0]
    ) else None


def test_only_readings_near_a_sample_when_asked(folder):
    assert read_mrclam(folder, 1, period=1.0, max_offset=0.15).n_readings == 1
    assert read_mrclam(folder, 1, period=1.0, max_offset=0.05).n_readings == 0


def test_the_log_survives_a_file(folder, tmp_path):
    log = read_mrclam(folder, 1, period=1.0)
    log.write(tmp_path / "log.nc")
    assert RobotLog.read(tmp_path / "log.nc").fingerprint() == log.fingerprint()


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("Barcodes.dat", None, r"Barcodes.dat: expected a table of subject, barcode, got no such file"),
        ("Robot1_Measurement.dat", None, r"Robot1_Measurement.dat: expected a table of .* got no such file"),
        ("Robot1_Odometry.dat", None, r"number of a robot in this folder \(none\), got 1"),
        ("Robot1_Odometry.dat", "100.0 1.0 0.0\n101 fast 0\n", "Odometry.dat, line 2: .* forward velocity, got 'fast'"),
        ("Robot1_Odometry.dat", "100.0 1.0\n", "Odometry.dat, line 1: expected 3 columns"),
        ("Robot1_Odometry.dat", "101 1 0\n100 1 0\n", "Odometry.dat: .* got 100.000 s after 101.000 s in data row 1"),
        ("Robot1_Groundtruth.dat", "1 2 3 4\n2 2 3 x\n", "Groundtruth.dat, line 2: .* heading, got 'x'"),
        ("Robot1_Groundtruth.dat", "500 0 0 0\n600 0 0 0\n", "at least two samples, got 0"),
        ("Robot1_Measurement.dat", "100 63 -1.0 0\n", "'landmark_range' >= 0 .* got -1 in row 0"),
        (
            "Landmark_Groundtruth.dat",
            "1 0 0 0 0\n",
            r"Landmark_Groundtruth.dat: expected landmarks \(subjects 6 and up\)",
        ),
    ],
)
def test_a_malformed_recording_is_one_line(folder, name, text, says):
    (folder / name).unlink() if text is None else (folder / name).write_text(text)
    with pytest.raises(LogError, match=says) as caught:
        read_mrclam(folder, 1)
    assert str(folder) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"robot": 3}, r"number of a robot in this folder \(1\), got 3"),
        ({"period": 0.0}, "period > 0"),
        ({"period": np.nan}, "period > 0"),
        ({"begin": -1.0}, "begin >= 0"),
        ({"duration": 0.0}, "duration > 0"),
        ({"max_offset": -0.1}, "max_offset >= 0"),
        ({"begin": 100.0}, "at least two samples, got 0"),
        ({"start": "here"}, "start = 'reference' or 'anywhere', got 'here'"),
    ],
)
def test_a_wrong_option_is_one_line(folder, options, says):
    with pytest.raises(LogError, match=says) as caught:
        read_mrclam(folder, **options)
    assert str(caught.value).startswith(str(folder))
    assert "\n" not in str(caught.value)


def test_a_missing_folder_is_one_line(tmp_path):
    with pytest.raises(LogError, match=r"absent: expected a folder"):
        read_mrclam(tmp_path / "absent")


@pytest.fixture(scope="module", params=[1, 2])
def real(shared_data, request):
    return read_mrclam(shared_data / "mrclam6", request.param)


def test_the_real_recording_has_the_expected_size(real):
    robot = int(real.robot[-1])
    assert real.n_steps == {1: 1520, 2: 1773}[robot]
    assert abs(real.n_readings - {1: 1218, 2: 2311}[robot]) <= 2
    assert real.landmark_range.shape == (real.n_steps, 15)
    assert real.dataset.attrs["dropped_robots"] == {1: 407, 2: 792}[robot]
    assert np.isfinite(real.true_poses).all()
    assert np.nanmax(np.abs(real.landmark_time_offset)) <= 0.25 + 1e-6


def test_the_real_frames_and_signs_fit(real):
    """Residuals at the reference poses: medians within a few centimetres and milliradians."""
    distance, bearing = residuals(real)
    print(f"{real.robot}: distance {np.median(distance):.4f} m, sd {robust_sd(distance):.4f} m; "
          f"bearing {np.median(bearing):.4f} rad, sd {robust_sd(bearing):.4f} rad")  # fmt: skip
    assert abs(np.median(distance)) < 0.05
    assert robust_sd(distance) < 0.2
    assert abs(np.median(bearing)) < 0.005
    assert robust_sd(bearing) < 0.015
    assert (np.abs(bearing) < 0.2).all()


def test_dead_reckoning_follows_the_real_robot(real):
    """Over ten seconds commanded velocities lose 0.06 m on a way of 0.6 m; a wrong sign or frame loses all of it."""
    for seconds in (10.0, 30.0):
        drift, moved = dead_reckoning(real, seconds)
        print(f"{real.robot}: {seconds:.0f} s, drift {drift}, moved {moved}")
        assert (drift < 0.25 * moved).all()
