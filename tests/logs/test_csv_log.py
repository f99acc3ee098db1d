"""CSV tables as logs: each kind of column against arrays, and tables with mistakes."""

from __future__ import annotations

import math
import tracemalloc

import numpy as np
import pytest

from pmcl.errors import LogError
from pmcl.geometry import compose
from pmcl.logs import text_lines
from pmcl.logs.csv_log import read_csv
from pmcl.logs.csv_table import read_csv_table
from pmcl.logs.robot_log import RobotLog

BEAMS = """# A remark: this is none of the settings
# robot: shoebox
# beam_0: 0.1 0 0
# beam_1: 0, 0.1, 1.5707963
# max_range: 4
# wall: 0 0 5 0
# wall: 5 0 5 4
# wall: 5 4 0 4
# wall: 0 4 0 0
# start: 1 2 0.5 0.1 0.1 0.05
time,odometry_forward,odometry_left,odometry_turn,range_0,range_1,true_x,true_y,true_heading
0.0, 0, 0, 0, 1.5, 2.5, 1, 2, 0.5
0.5, 0.1, 0, 0.2, , inf, 1.1, 2, 0.7

1.0, 0.1, -0.01, 0.1, nan, 0, , ,
"""


@pytest.fixture
def write(tmp_path):
    def write_text(text, name="table.csv"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return write_text


def test_beams_and_increments(write):
    log = read_csv(write(BEAMS))
    nan, inf = math.nan, math.inf
    expected = RobotLog.build(
        time=[0.0, 0.5, 1.0],
        odometry=[[0, 0, 0], [0.1, 0, 0.2], [0.1, -0.01, 0.1]],
        ranges=[[1.5, 2.5], [nan, inf], [nan, 0.0]],
        beam_poses=[[0.1, 0, 0], [0, 0.1, 1.5707963]],
        max_range=4.0,
        walls=[[[0, 0], [5, 0]], [[5, 0], [5, 4]], [[5, 4], [0, 4]], [[0, 4], [0, 0]]],
        start_mean=[1, 2, 0.5],
        start_std=[0.1, 0.1, 0.05],
    )
    assert log.fingerprint() == expected.fingerprint()
    assert log.robot == "shoebox"
    np.testing.assert_array_equal(log.true_poses, [[1, 2, 0.5], [1.1, 2, 0.7], [nan, nan, nan]])
    np.testing.assert_array_equal(read_csv(write(BEAMS), start="reference").start_std, [0.1, 0.1, 0.1])
    assert np.isinf(read_csv(write(BEAMS), start="anywhere").start_std).all()


def test_poses_become_increments(write):
    steps = np.array([[0, 0, 0], [0.3, 0.02, 0.4], [0.1, 0, 3.0], [0.2, 0, 0.5]])
    pose, lines = np.array([5.0, -2.0, 3.0]), ["time,odom_x,odom_y,odom_heading,range_to_a"]
    for k, step in enumerate(steps):
        pose = compose(pose, step)
        lines.append(f"{k},{','.join(f'{value:.12f}' for value in pose)},{k + 1}")
    log = read_csv(write("# landmark a: 1 1\n" + "\n".join(lines)))
    np.testing.assert_allclose(log.odometry[1:], steps[1:], atol=1e-10)
    np.testing.assert_array_equal(log.landmark_range, [[1], [2], [3], [4]])


def test_landmarks_in_columns_and_in_a_second_table(write):
    head = "# landmark tree 1: 1 2\n# landmark door: 3 4\n# landmark_sensor: 0.2 0 0\n"
    rows = [f"{k},0.1,0,0" for k in range(3)]
    names = "time,odometry_forward,odometry_left,odometry_turn"
    columns = f"{head}{names},range_to_door,bearing_to_tree 1\n{rows[0]},,0.5\n{rows[1]},2.5,\n{rows[2]},,\n"
    log = read_csv(write(columns))
    nan = math.nan
    np.testing.assert_array_equal(log.landmark_range, [[nan, nan], [nan, 2.5], [nan, nan]])
    np.testing.assert_array_equal(log.landmark_bearing, [[0.5, nan], [nan, nan], [nan, nan]])
    assert log.landmarks.names == ("tree 1", "door")
    np.testing.assert_array_equal(log.landmark_sensor_pose, [0.2, 0, 0])
    second = write("time,landmark,range,bearing\n1.2,door,2.5,0.1\n0.1,tree 1,1.5,-0.1\n", "seen.csv")
    log = read_csv(write(f"{head}{names}\n" + "\n".join(rows)), sightings=second)
    np.testing.assert_array_equal(log.landmark_range, [[1.5, nan], [nan, 2.5], [nan, nan]])
    np.testing.assert_allclose(log.landmark_time_offset, [[0.1, nan], [nan, 0.2], [nan, nan]])


LIDAR = """# scan_angles: -0.5 0.5
# scan_limits: 0.1 8
# scan_pose: 0.2 0 0.1
time,odom_x,odom_y,odom_heading,scan_0,scan_1,scan_2
0,0,0,0,1,2,3
1,1,0,0,1,,inf
"""


def test_a_lidar(write):
    laser = read_csv(write(LIDAR)).lidars[""]
    np.testing.assert_array_equal(laser.ranges, [[1, 2, 3], [1, math.nan, math.inf]])
    np.testing.assert_allclose(laser.angles, [-0.5, 0.0, 0.5])
    np.testing.assert_array_equal(laser.pose, [0.2, 0, 0.1])
    assert (laser.min_range, laser.max_range) == (0.1, 8.0)


MISTAKES = {
    "unknown column": (BEAMS.replace("odometry_turn", "odometry_trun"), "did you mean 'odometry_turn'?"),
    "unknown setting": (BEAMS.replace("max_range:", "max_rang:"), "line 5: expected a known setting, got '# max_rang"),
    "setting twice": (BEAMS.replace("# robot: shoebox", "# max_range: 3"), "line 5: expected '# max_range:' once"),
    "no beam pose": (BEAMS.replace("# beam_1", "# beam_2"), "expected the comment '# beam_1: X Y YAW' above the"),
    "two numbers": (BEAMS.replace("0.1 0 0", "0.1 0"), "line 3: expected '# beam_0:' with 3 numbers, got '0.1 0'"),
    "a cell too few": (BEAMS.replace("0.5, 0.1, 0, 0.2, , inf", "0.5, 0.1, 0, 0.2, inf"), "line 13: expected 9 cells"),
    "a word": (BEAMS.replace("inf, 1.1", "far, 1.1"), "line 13: expected a number in column 'range_1', got 'far'"),
    "no odometry": (BEAMS.replace("0.5, 0.1, 0,", "0.5, , 0,"), "a number in column 'odometry_forward', got none"),
    "part of the odometry": (BEAMS.replace("odometry_left", "true_z"), "expected known columns, got 'true_z'"),
    "neither odometry": ("time,range_0\n0,1\n1,2\n", "got neither: give one of them"),
    "a gap in ranges": (BEAMS.replace("range_1,", "range_2,"), "columns range_0 to range_1, got no range_1"),
    "same name": (BEAMS.replace("range_1,", "range_0,"), "a name of its own for each column, got 'range_0'"),
    "no time": (LIDAR.replace("time", "true_x"), "expected a column 'time'"),
    "no angles": (LIDAR.replace("# scan_angles", "# angles of rays"), "the comment '# scan_angles: FIRST STEP'"),
    "unsorted": (LIDAR.replace("\n1,1,0,0", "\n-1,1,0,0"), "strictly increasing times"),
    "no map of landmarks": ("time,odom_x,odom_y,odom_heading,range_to_a\n0,0,0,0,1\n", "'# landmark NAME: X Y'"),
    "empty": ("", "expected a header and rows, got none"),
    "header alone": ("time,odom_x,odom_y,odom_heading\n", "expected a header and rows, got none"),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes(name, write):
    text, message = MISTAKES[name]
    path = write(text)
    with pytest.raises(LogError) as caught:
        read_csv(path)
    assert message in str(caught.value)
    assert str(caught.value).startswith(str(path))


def test_a_table_takes_the_memory_of_its_numbers(write):
    rows, rays = 2000, 100
    head = f"# scan_angles: 0 0.01\n# scan_limits: 0 9\ntime,{','.join(f'scan_{k}' for k in range(rays))}\n"
    path = write(head + "".join(f"{row}{',1.2345' * rays}\n" for row in range(rows)))
    tracemalloc.start()
    try:
        table = read_csv_table(path)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert table.numbers("scan_7").tolist() == [1.2345] * rows
    # Texts of their own would take 60 bytes for each of the 200 000 numbers: 12 MB.
    assert most < 4e6


def test_texts_without_end(write, monkeypatch):
    path = write("time,odom_x\n" + "\n" * 200 + "0,0\n")
    assert len(read_csv_table(path).lines) == 1
    monkeypatch.setattr(text_lines, "_MOST_LINES", 100)
    with pytest.raises(LogError, match="expected a text of at most 1000 MB and 100 lines, got more"):
        read_csv_table(path)


def test_columns_of_texts_stay_texts(write):
    table = read_csv_table(write("time,landmark,range\n0,007,1\n1,1.0,2\n", "seen.csv"), texts=("landmark",))
    assert table.texts == {"landmark": ["007", "1.0"]}
    assert table.numbers("range").tolist() == [1.0, 2.0]


def test_files_that_are_no_tables(write, tmp_path):
    with pytest.raises(LogError, match="no such file"):
        read_csv(tmp_path / "nothing.csv")
    (tmp_path / "binary.csv").write_bytes(bytes(range(256)) * 10)
    with pytest.raises(LogError, match="expected"):
        read_csv(tmp_path / "binary.csv")
    with pytest.raises(LogError, match="got something else"):
        read_csv(write("1," * 1_000_000))
    table = write("# landmark a: 1 1\ntime,odom_x,odom_y,odom_heading\n0,0,0,0\n1,1,0,0\n")
    second = write("time,landmark\n0,a\n", "seen.csv")
    with pytest.raises(LogError, match="expected the columns time, landmark, and range or bearing"):
        read_csv(table, sightings=second)
