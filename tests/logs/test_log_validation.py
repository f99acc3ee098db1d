"""Each way in which a log can be wrong: one line that names the place and what came."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from pmcl.errors import LogError, MapError, PmclError
from pmcl.logs.robot_log import RobotLog

WHERE = "night.nc"


def put(name, index, value):
    def change(dataset):
        dataset[name] = dataset[name].copy(deep=True)
        dataset[name].values[index] = value
        return dataset

    return change


def times(*values):
    return lambda dataset: dataset.assign_coords(time=np.array(values))


def drop(*names):
    return lambda dataset: dataset.drop_vars(list(names))


def attribute(name, value):
    return lambda dataset: dataset.assign_attrs({name: value})


def max_range(value):
    def change(dataset):
        dataset["range"] = dataset["range"].copy()
        dataset["range"].attrs = {} if value is None else {"max_range": value}
        return dataset

    return change


def size_at_one_metre(value):
    def change(dataset):
        dataset["landmark_size"].attrs["size_at_one_metre"] = value
        return dataset

    return change


BAD = {
    "other format": (attribute("format", "pmcl-log/9"), LogError, "format = 'pmcl-log/1', got 'pmcl-log/9'"),
    "no format": (lambda d: d.drop_attrs(deep=False), LogError, "format = 'pmcl-log/1', got none"),
    "empty": (lambda d: d.isel(time=slice(0, 0)), LogError, "at least one sample, got an empty log"),
    "no time": (drop("time"), LogError, "variable 'time'"),
    "no odometry": (drop("odometry"), LogError, "variable 'odometry'"),
    "unsorted": (times(0.0, 2.0, 1.0, 3.0), LogError, r"got time\[2\] = 1 s after time\[1\] = 2 s"),
    "duplicate": (times(0.0, 1.0, 2.0, 2.0), LogError, r"got time\[3\] = 2 s after time\[2\] = 2 s"),
    "NaN time": (times(0.0, np.nan, 1.0, 2.0), LogError, r"got time\[1\] = nan"),
    "dates": (
        times(*np.array(["2020-01-01", "2020-01-02", "2020-01-03", "2020-01-04"], "M8[ns]")),
        LogError,
        r"\[s\] in 'time', got dates",
    ),
    "NaN odometry": (put("odometry", (2, 1), np.nan), LogError, r"got left = nan in row 2 \(time 1 s\)"),
    "infinite odometry": (put("odometry", (3, 2), np.inf), LogError, r"got turn = inf in row 3 \(time 1.7 s\)"),
    "text": (
        lambda d: d.assign(odometry=(("time", "increment"), np.full((4, 3), "fast"))),
        LogError,
        "'odometry', got text such as 'fast'",
    ),
    "truth values": (
        lambda d: d.assign(start_mean=("pose", np.ones(3, bool))),
        LogError,
        "got truth values such as True",
    ),
    "no sensor": (
        drop("range", "landmark_range", "landmark_bearing", "landmark_size"),
        LogError,
        "at least one of range, landmark_range, landmark_bearing, landmark_size, scan, got none",
    ),
    "odometry of two columns": (
        lambda d: d.drop_vars(["odometry", "increment"]).assign(odometry=(("time", "increment"), np.zeros((4, 2)))),
        LogError,
        r"'odometry' with dimensions \(time, increment=3\), got \(time=4, increment=2\)",
    ),
    "odometry without time": (
        lambda d: d.assign(odometry=("increment", np.zeros(3))),
        LogError,
        r"'odometry' with dimensions \(time, increment=3\), got \(increment=3\)",
    ),
    "beams of another count": (
        lambda d: d.drop_vars("beam_pose").assign(beam_pose=(("beams", "pose"), np.zeros((2, 3)))),
        LogError,
        r"'beam_pose' with dimensions \(beam, pose=3\), got \(beams=2, pose=3\)",
    ),
    "landmarks of another count": (
        lambda d: d.drop_vars("landmark_position").assign(landmark_position=(("mark", "xy"), np.zeros((7, 2)))),
        LogError,
        r"'landmark_position' with dimensions \(landmark, xy=2\), got \(mark=7, xy=2\)",
    ),
    "no beam poses": (drop("beam_pose"), LogError, "'beam_pose' .* beside 'range', got none"),
    "NaN beam pose": (put("beam_pose", (1, 2), np.nan), LogError, r"finite 'beam_pose' .* got nan at \[1, 2\]"),
    "format of two numbers": (lambda d: d.assign_attrs(format=[1, 2]), LogError, r"'pmcl-log/1', got \[1, 2\]"),
    "truth nested without end": (lambda d: d.assign_attrs(true_theta="[" * 99_999), LogError, "JSON object of numbers"),
    "odometry beyond the earth": (
        put("odometry", (2, 0), 1e308),
        LogError,
        "'odometry' within 2e\\+07 m, got 1e\\+308 in row 2, increment 0: check the unit",
    ),
    "turn of a million turns": (put("odometry", (2, 2), -1e7), LogError, "'odometry' within 1e\\+06 rad, got -1e\\+07"),
    "start beyond the earth": (
        put("start_mean", 1, -3e7),
        LogError,
        "'start_mean' within 2e\\+07 m, got -3e\\+07 in pose 1",
    ),
    "absurd landmark range": (put("landmark_range", (0, 1), 1e30), LogError, "'landmark_range' within 2e\\+07 m"),
    "absurd wall": (put("wall", (0, 1, 0), 1e200), LogError, "'wall' within 2e\\+07 m"),
    "absurd max_range": (max_range(1e38), LogError, "max_range > 0 .* at most 2e\\+07, got 1e\\+38"),
    "labels twice": (
        lambda d: d.assign_coords(increment=["forward", "forward", "turn"]),
        LogError,
        "the labels forward, left, turn along 'increment', got forward, forward, turn",
    ),
    "other labels": (
        lambda d: d.assign_coords(increment=["x", "y", "yaw"]),
        LogError,
        "the labels forward, left, turn along 'increment', got x, y, yaw",
    ),
    "no max_range": (max_range(None), LogError, "max_range > 0 .* got none"),
    "zero max_range": (max_range(0.0), LogError, "max_range > 0 .* got 0.0"),
    "infinite max_range": (max_range(np.inf), LogError, "max_range > 0 .* got inf"),
    "text max_range": (max_range("4 m"), LogError, "max_range > 0 .* got '4 m'"),
    "negative range": (put("range", (3, 1), -0.1), LogError, r"got -0.1 in row 3 \(time 1.7 s\), beam 1"),
    "minus infinity": (put("range", (1, 2), -np.inf), LogError, r"got -inf in row 1 \(time 0.5 s\), beam 2"),
    "no landmark map": (
        drop("landmark_position"),
        LogError,
        "'landmark_position' .* beside 'landmark_range', got none",
    ),
    "NaN landmark": (put("landmark_position", (1, 0), np.nan), MapError, "'landmark_position': .* got nan at index"),
    "two landmarks of one name": (
        lambda d: d.assign_coords(landmark=["a", "a"]),
        MapError,
        "distinct landmark names, got 'a' more than once",
    ),
    "negative landmark range": (put("landmark_range", (0, 0), -1.0), LogError, r"got -1 in row 0 .* landmark 0"),
    "infinite landmark range": (put("landmark_range", (2, 1), np.inf), LogError, r"got inf in row 2 .* landmark 1"),
    "infinite bearing": (put("landmark_bearing", (2, 1), -np.inf), LogError, r"got -inf in row 2 .* landmark 1"),
    "negative size": (put("landmark_size", (2, 1), -3.0), LogError, r"'landmark_size' >= 0 \[pixel\], got -3 in row 2"),
    "zero size": (size_at_one_metre(0.0), LogError, r"size_at_one_metre > 0 \[pixel\] .* got 0.0"),
    "NaN sensor pose": (put("landmark_sensor_pose", 1, np.nan), LogError, "'landmark_sensor_pose' .* got nan"),
    "infinite time offset": (
        put("landmark_time_offset", (0, 0), np.inf),
        LogError,
        "'landmark_time_offset' .* got inf",
    ),
    "wall without length": (put("wall", 2, 0.0), MapError, "'wall': expected walls of positive length"),
    "NaN wall": (put("wall", (0, 0, 0), np.nan), MapError, "'wall': expected finite walls, got nan"),
    "no start": (drop("start_std"), LogError, "variable 'start_std'"),
    "negative start_std": (put("start_std", 0, -0.1), LogError, r"start_std >= 0 .* got \[-0.1, 0.1, inf\]"),
    "NaN start_std": (put("start_std", 1, np.nan), LogError, r"start_std >= 0 .* got \[0.1, nan, inf\]"),
    "NaN start_mean": (put("start_mean", 0, np.nan), LogError, r"finite start_mean, got \[nan, 1.0, 0.0\]"),
    "start outside": (put("start_mean", 0, 3.5), MapError, r"inside the walls \(x 0 to 3 m, .* got \(3.5, 1\) m"),
    "true_theta no JSON": (attribute("true_theta", "sigma=1"), LogError, "JSON object of numbers, got 'sigma=1'"),
    "true_theta of text": (attribute("true_theta", '{"a": "b"}'), LogError, "JSON object of numbers"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_log_is_one_line_that_names_the_place(log, case):
    change, error, says = BAD[case]
    with pytest.raises(error, match=says) as caught:
        RobotLog.from_dataset(change(log.dataset.copy(deep=True)), WHERE)
    message = str(caught.value)
    assert message.startswith(WHERE)
    assert ": expected " in message
    assert "\n" not in message
    assert ": " in message.split(", got ", 1)[1], "says nothing about what to do"


def test_something_else_is_no_log():
    with pytest.raises(LogError, match=r"expected an xarray.Dataset, got dict"):
        RobotLog.from_dataset({"time": [0.0]})


LEGAL = {
    "no reading at all": put("range", slice(None), np.nan),
    "a range of zero": put("range", (0, 0), 0.0),
    "a range beyond max_range": put("range", (0, 0), 9.0),
    "a row zero of anything": put("odometry", 0, np.inf),
    "a bearing beyond pi": put("landmark_bearing", (0, 0), 5.0),
    "a start outside, known nowhere": lambda d: put("start_std", slice(None), np.inf)(put("start_mean", 0, 9.0)(d)),
    "a start outside open walls": lambda d: put("start_mean", 0, 9.0)(d.isel(wall_index=slice(0, 3))),
    "an unknown start without mean": lambda d: put("start_mean", 2, np.nan)(d),
    "a start known exactly": put("start_std", slice(None), 0.0),
    "no reference": drop("true_pose"),
    "no walls": drop("wall"),
}


@pytest.mark.parametrize("case", LEGAL)
def test_unusual_logs_are_legal(log, case):
    assert RobotLog.from_dataset(LEGAL[case](log.dataset.copy(deep=True)), WHERE).n_steps == 4


BAD_ARRAYS = {
    "beam count": ({"beam_poses": np.zeros((2, 3))}, "expected 3 along 'beam' in 'beam_pose' .* 'range', got 2"),
    "landmark count": ({"landmarks": np.zeros((5, 2))}, "expected 2 along 'landmark' in 'landmark_position' .* got 5"),
    "time count": ({"odometry": np.zeros((3, 3))}, "expected 4 along 'time' in 'odometry' .* 'time', got 3"),
    "pose size": ({"start_mean": [0.0, 0.0]}, "expected 3 along 'pose' in 'start_mean' .* the format, got 2"),
    "axes": ({"ranges": np.zeros(4)}, r"expected 'range' of shape \(time, beam\), got \(4,\)"),
    "text": ({"time": ["0", "1", "2", "3"]}, r"numbers \[s\] for 'time', got text such as '0'"),
    "ragged": ({"odometry": [[0, 0, 0], [1]]}, "'odometry', got rows of unequal length"),
    "true theta": ({"true_theta": {"sigma_range": "small"}}, "true_theta as JSON object of numbers"),
    "one half of a start": ({"start_std": None}, "variable 'start_std'"),
}


@pytest.mark.parametrize("case", BAD_ARRAYS)
def test_bad_arrays_are_one_line(arrays, case):
    change, says = BAD_ARRAYS[case]
    with pytest.raises(PmclError, match=says) as caught:
        RobotLog.build(**{**arrays, **change}, where="simulator")
    assert str(caught.value).startswith("simulator: expected ")
    assert "\n" not in str(caught.value)


def test_validation_leaves_the_dataset_alone(log):
    dataset = log.dataset.copy(deep=True).drop_vars(["increment", "pose"])
    before = dataset.copy(deep=True)
    RobotLog.from_dataset(dataset)
    xr.testing.assert_identical(dataset, before)
