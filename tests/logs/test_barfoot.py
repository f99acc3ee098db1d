"""The reader of Lost in the Woods: a recording made by hand, malformed ones, and the real one."""

from __future__ import annotations

import numpy as np
import pytest
from recorded import dead_reckoning, residuals, robust_sd
from scipy.io import savemat

from pmcl.errors import LogError
from pmcl.logs.barfoot import read_barfoot


@pytest.fixture
def content():
    """Three seconds at 10 Hz, straight ahead at 1 m/s; two tubes; the reference fails from 1.5 s to 2.4 s."""
    n = 31
    t = 0.1 * np.arange(n)[:, None]
    r, b = np.zeros((n, 2)), np.zeros((n, 2))
    r[10], b[10] = (2.0, 0.0), (0.5, 0.0)
    r[19], b[19] = (1.5, 3.0), (0.6, -0.2)
    valid = np.ones((n, 1), np.uint8)
    valid[15:25] = 0
    return {
        "t": t, "v": np.ones((n, 1)), "om": np.zeros((n, 1)), "r": r, "b": b, "l": np.array([[3.0, 1.0], [0.0, 5.0]]),
        "x_true": t, "y_true": 0.0 * t, "th_true": 0.0 * t, "true_valid": valid, "d": np.array([[0.25]]),
    }  # fmt: skip


def save(folder, content):
    savemat(folder / "dataset2.mat", content)
    return folder


def test_a_recording_by_hand(tmp_path, content):
    log = read_barfoot(save(tmp_path, content))
    nan = np.nan
    np.testing.assert_allclose(log.times, [0.0, 1.0, 2.0, 3.0])
    np.testing.assert_allclose(log.odometry, [[0, 0, 0], [1, 0, 0], [1, 0, 0], [1, 0, 0]], atol=1e-12)
    np.testing.assert_array_equal(log.landmark_range, [[nan, nan], [2.0, nan], [nan, nan], [nan, nan]])
    np.testing.assert_array_equal(log.landmark_bearing, [[nan, nan], [0.5, nan], [nan, nan], [nan, nan]])
    np.testing.assert_array_equal(log.landmark_sensor_pose, [0.25, 0.0, 0.0])
    np.testing.assert_allclose(log.true_poses, [[0, 0, 0], [1, 0, 0], [nan, nan, nan], [3, 0, 0]], atol=1e-12)
    np.testing.assert_array_equal(log.start_std, [0.1, 0.1, 0.1])
    assert log.dataset.attrs["dropped_outside"] == 2


def test_the_nearest_scan_that_saw_a_landmark_when_asked(tmp_path, content):
    log = read_barfoot(save(tmp_path, content) / "dataset2.mat", max_offset=None)
    np.testing.assert_array_equal(log.landmark_range[2], [1.5, 3.0])
    np.testing.assert_allclose(log.landmark_time_offset[2], [-0.1, -0.1])


def test_a_start_without_reference_pose_is_one_line(tmp_path, content):
    folder = save(tmp_path, content)
    with pytest.raises(LogError, match=r"expected a reference pose at 2 s") as caught:
        read_barfoot(folder, begin=2.0)
    assert "\n" not in str(caught.value)
    assert read_barfoot(folder, begin=2.0, start="anywhere").n_steps == 2


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"v": None}, "expected variable 'v', got none"),
        ({"om": "fast"}, "expected numbers in 'om', got text"),
        ({"v": np.ones((30, 1))}, r"'v' of shape \(31,\) .* got \(30,\)"),
        ({"r": np.ones((31, 3))}, r"'r' of shape \(31, 2\) .* got \(31, 3\)"),
        ({"d": np.ones((1, 2))}, r"'d' of shape \(1,\) .* got \(2,\)"),
        ({"th_true": np.full((31, 1), np.nan)}, "finite numbers in 'th_true'"),
        ({"t": np.ones((31, 1))}, "increasing times in 't', got 1 s at index 1"),
    ],
)
def test_a_malformed_recording_is_one_line(tmp_path, content, change, says):
    save(tmp_path, {name: value for name, value in (content | change).items() if value is not None})
    with pytest.raises(LogError, match=says) as caught:
        read_barfoot(tmp_path)
    assert str(caught.value).startswith(str(tmp_path / "dataset2.mat"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("keep", [0.0, 0.1, 0.7])
def test_a_truncated_file_is_one_line(tmp_path, content, keep):
    path = save(tmp_path, content) / "dataset2.mat"
    whole = path.read_bytes()
    path.write_bytes(whole[: int(keep * len(whole))])
    with pytest.raises(LogError, match=r"dataset2.mat: expected") as caught:
        read_barfoot(path)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_one_line(tmp_path):
    for path in (tmp_path, tmp_path / "absent.mat"):
        with pytest.raises(LogError, match="got no such file"):
            read_barfoot(path)


@pytest.fixture(scope="module")
def real(shared_data):
    return read_barfoot(shared_data / "lost_in_the_woods")


def test_the_real_recording_has_the_expected_size(real):
    assert real.n_steps == 1261
    assert real.landmark_range.shape == (1261, 17)
    assert 6000 < real.n_readings < 6200
    assert np.isnan(real.true_poses[:, 0]).mean() < 0.03
    assert np.nanmax(np.abs(real.landmark_time_offset)) < 1e-6


def test_the_reference_is_the_centre_and_the_laser_sits_ahead(real):
    """With the laser ahead of the reference the publisher's 0.030 m come out; with the laser on it, four times that."""
    distance, bearing = residuals(real)
    print(f"distance {np.median(distance):.4f} m, sd {robust_sd(distance):.4f} m; "
          f"bearing {np.median(bearing):.4f} rad, sd {robust_sd(bearing):.4f} rad")  # fmt: skip
    assert abs(np.median(distance)) < 0.005
    assert robust_sd(distance) == pytest.approx(0.030, abs=0.002)
    assert abs(np.median(bearing)) < 0.005
    assert robust_sd(bearing) < 0.02
    on_the_centre, _ = residuals(real, np.zeros(3))
    assert robust_sd(on_the_centre) > 3.0 * robust_sd(distance)


def test_dead_reckoning_follows_the_real_robot(real):
    for seconds in (10.0, 30.0):
        drift, moved = dead_reckoning(real, seconds)
        print(f"{seconds:.0f} s, drift {drift}, moved {moved}")
        assert (drift < 0.25 * moved).all()
