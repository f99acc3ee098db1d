"""The log itself: what goes in comes out, and what calibration sees is told apart from what it must not see."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import xarray as xr

from pmcl.errors import LogError, MapError
from pmcl.logs.robot_log import RobotLog
from pmcl.logs.schema import variables


def test_arrays_come_out_as_they_went_in(log, arrays):
    for name in ("ranges", "beam_poses", "landmark_range", "landmark_bearing", "landmark_size", "landmark_time_offset",
                 "landmark_sensor_pose", "start_mean", "start_std", "true_poses"):  # fmt: skip
        np.testing.assert_array_equal(getattr(log, name), arrays[name], err_msg=name)
    np.testing.assert_array_equal(log.times, arrays["time"])
    np.testing.assert_array_equal(log.odometry[1:], arrays["odometry"][1:])
    np.testing.assert_array_equal(log.walls.segments, arrays["walls"].segments)
    assert (log.max_range, log.robot, log.source, log.true_theta) == (4.0, "amigobot", "by hand", {"sigma_range": 0.1})
    assert log.landmarks.names == ("red", "blue")
    assert log.size_at_one_metre == 900.0
    assert log.n_steps == 4


def test_the_ignored_odometry_reads_as_zero(log):
    np.testing.assert_array_equal(log.odometry[0], np.zeros(3))


def test_readings_are_counted_once(log):
    # Eight ranges that are not NaN (an echo that never came was measured); three landmarks were seen.
    assert log.n_readings == 8 + 3


def test_arrays_are_read_only_also_after_pickling(log):
    for copy in (log, pickle.loads(pickle.dumps(log))):
        for array in (
            copy.times,
            copy.odometry,
            copy.ranges,
            copy.start_std,
            copy.true_poses,
            copy.landmarks.positions,
        ):
            assert array.dtype == np.float64
            assert array.flags.c_contiguous
            assert not array.flags.writeable


def test_the_log_does_not_follow_later_changes_to_its_source(arrays):
    dataset = RobotLog.build(**arrays).dataset.copy(deep=True)
    log = RobotLog.from_dataset(dataset)
    before = log.fingerprint()
    dataset["odometry"].values[:] = 99.0
    dataset["range"].attrs["max_range"] = 1.0
    assert log.fingerprint() == before
    assert log.max_range == 4.0


def test_absent_variables_are_none():
    log = RobotLog.build(time=[0.0], odometry=[[0, 0, 0]], landmark_bearing=[[0.1]], landmarks=[[1.0, 2.0]])
    for name in (
        "ranges",
        "beam_poses",
        "landmark_range",
        "landmark_size",
        "landmark_time_offset",
        "walls",
        "true_poses",
    ):
        assert getattr(log, name) is None, name
    assert log.true_theta is None
    assert log.robot == log.source == ""
    assert log.max_range == np.inf
    assert log.size_at_one_metre is None
    np.testing.assert_array_equal(log.landmark_sensor_pose, np.zeros(3))
    np.testing.assert_array_equal(log.start_std, np.full(3, np.inf))


def test_the_dataset_carries_dims_units_and_format(log):
    assert log.dataset.attrs["format"] == "pmcl-log/1"
    held = {name: variable for name, variable in variables().items() if name in log.dataset}
    assert set(variables()) - set(held) == {"scan", "scan_angle"}
    for name, variable in held.items():
        assert log.dataset[name].dims == variable.dims
        assert log.dataset[name].attrs["units"] == variable.units
    assert log.dataset["range"].attrs["max_range"] == 4.0
    assert list(log.dataset["increment"].values) == ["forward", "left", "turn"]


def test_other_orders_of_dimensions_and_components_are_the_same_log(log):
    shuffled = log.dataset.transpose(*reversed(list(log.dataset.dims)))
    shuffled = shuffled.isel(increment=[2, 0, 1], pose=[1, 2, 0], end=[1, 0], xy=[1, 0])
    assert shuffled["odometry"].dims != log.dataset["odometry"].dims
    xr.testing.assert_identical(RobotLog.from_dataset(shuffled).dataset, log.dataset)


def test_unlabelled_components_and_integers_are_accepted(log):
    bare = log.dataset.drop_vars(["increment", "pose", "xy", "end"]).assign(start_mean=("pose", np.array([1, 1, 0])))
    assert RobotLog.from_dataset(bare).fingerprint() == log.fingerprint()


def test_true_theta_may_hold_numpy_numbers(arrays):
    log = RobotLog.build(**{**arrays, "true_theta": {"a": np.float64(0.1), "b": np.float32(0.5), "c": 2}})
    assert log.true_theta == {"a": 0.1, "b": 0.5, "c": 2.0}


def test_max_range_may_stand_on_the_file(log):
    dataset = log.dataset.copy(deep=True)
    dataset.attrs["max_range"] = dataset["range"].attrs.pop("max_range")
    assert RobotLog.from_dataset(dataset).max_range == 4.0


def test_variables_outside_the_format_are_kept(log):
    extra = log.dataset.assign(battery=("time", [1, 2, 3, 4]))
    assert list(RobotLog.from_dataset(extra).dataset["battery"].values) == [1, 2, 3, 4]


UNSEEN = {
    "robot": "aibo",
    "source": "elsewhere",
    "seed": 8,
    "true_theta": {"sigma_range": 0.2},
    "true_poses": None,
}


@pytest.mark.parametrize("name", UNSEEN)
def test_fingerprint_ignores_what_calibration_does_not_see(log, arrays, name):
    assert RobotLog.build(**{**arrays, name: UNSEEN[name]}).fingerprint() == log.fingerprint()


def test_fingerprint_ignores_row_zero_of_odometry_and_the_sign_of_zero(log, arrays):
    odometry = arrays["odometry"].copy()
    odometry[0] = 5.0
    odometry[odometry == 0.0] = -0.0
    assert RobotLog.build(**{**arrays, "odometry": odometry}).fingerprint() == log.fingerprint()


@pytest.mark.parametrize(
    "name",
    ["time", "odometry", "ranges", "beam_poses", "landmark_range", "landmark_bearing", "landmark_size",
     "landmark_time_offset", "landmark_sensor_pose", "start_mean", "start_std"],
)  # fmt: skip
def test_fingerprint_sees_the_last_bit_of_every_number(log, arrays, name):
    changed = np.array(arrays[name])
    at = tuple(np.argwhere(np.isfinite(changed) & (changed > 0.0))[-1])
    changed[at] = np.nextafter(changed[at], np.inf)
    assert RobotLog.build(**{**arrays, name: changed}).fingerprint() != log.fingerprint()


def test_fingerprint_sees_map_and_max_range(log, arrays):
    others = (
        {"max_range": 4.5},
        {"size_at_one_metre": 901.0},
        {"landmarks": [[0.5, 0.5], [2.5, 1.1]]},
        {"walls": arrays["walls"].segments[:3]},
        {"landmark_size": None},
    )
    found = {RobotLog.build(**{**arrays, **other}).fingerprint() for other in others}
    assert len(found | {log.fingerprint()}) == 6
    assert len(log.fingerprint()) == 64


def test_select_cuts_rows_and_forgets_the_start(log):
    part = log.select(1, 3)
    np.testing.assert_array_equal(part.times, [0.5, 1.0])
    np.testing.assert_array_equal(part.ranges, log.ranges[1:3])
    np.testing.assert_array_equal(part.landmark_time_offset, log.landmark_time_offset[1:3])
    np.testing.assert_array_equal(part.odometry[0], np.zeros(3))
    np.testing.assert_array_equal(part.start_std, np.full(3, np.inf))
    np.testing.assert_array_equal(part.walls.segments, log.walls.segments)


def test_select_from_row_zero_keeps_the_start(log):
    part = log.select(0, 2)
    np.testing.assert_array_equal(part.start_std, log.start_std)
    assert log.select(0, 4).fingerprint() == log.fingerprint()


def test_select_with_a_start_of_its_own(log):
    part = log.select(2, 4, start_mean=[1.0, 0.5, 0.1], start_std=[0.2, 0.2, 0.2])
    np.testing.assert_array_equal(part.start_mean, [1.0, 0.5, 0.1])
    np.testing.assert_array_equal(part.start_std, [0.2, 0.2, 0.2])


@pytest.mark.parametrize(("start", "stop"), [(0, 5), (-1, 2), (2, 2), (3, 1)])
def test_select_outside_the_log_is_one_line(log, start, stop):
    with pytest.raises(LogError, match=f"RobotLog.build: expected rows .* <= 4, got {start}, {stop}"):
        log.select(start, stop)


def test_select_wants_mean_and_std_together(log):
    with pytest.raises(LogError, match="together"):
        log.select(1, 3, start_mean=[0.0, 0.0, 0.0])


def test_without_truth_there_is_no_truth(log):
    bare = log.without_truth()
    assert bare.true_poses is None
    assert bare.true_theta is None
    assert "seed" not in bare.dataset.attrs
    assert bare.fingerprint() == log.fingerprint()
    assert log.true_theta is not None


def test_ranges_without_walls_are_a_log_that_lacks_a_map(arrays, log):
    log.require_map()
    without = RobotLog.build(**{**arrays, "walls": None})
    with pytest.raises(MapError, match=r"RobotLog.build: expected walls .* got none") as caught:
        without.require_map()
    assert "\n" not in str(caught.value)
    RobotLog.build(**{**arrays, "walls": None, "ranges": None}).require_map()


def test_the_log_introduces_itself(log):
    assert repr(log) == "<RobotLog of amigobot: 4 samples, 11 readings, from RobotLog.build>"
