"""``pmcl convert bag``, ``carmen``, ``wean`` and ``csv``: what they write, print and refuse."""

from __future__ import annotations

import gzip
import math
import os

import numpy as np
import pytest
from oracles.made_bags import MadeBag

import pmcl
from pmcl.maps.occupancy_grid import OccupancyGrid


@pytest.fixture
def bag(tmp_path):
    """Two lasers, and a pose every half a second in a frame of its own."""
    made = MadeBag()
    made.transform("/tf_static", 10**9, "base_link", "laser", (0.2, 0.0, 0.4))
    for k in range(41):
        stamp = 10**9 + k * 10**8
        made.odometry("/odom", stamp, (0.1 * k, 0.0, 0.0))
        made.pose("/truth", stamp, (0.1 * k, 0.0, 0.0))
        for topic in ("/front/scan", "/rear/scan"):
            made.scan(topic, stamp, np.full(30, 2.0))
    return made.write(tmp_path / "drive", "mcap")


@pytest.fixture
def grid(tmp_path):
    cells = np.zeros((40, 60), dtype=np.uint8)
    cells[0] = 1
    OccupancyGrid(cells, 0.1, (-1.0, -2.0, 0.0)).write(tmp_path / "room.yaml")
    return tmp_path / "room.yaml"


def test_a_bag_and_its_map(run, bag, grid, tmp_path):
    arguments = ["--scan", "/front/scan", "--truth", "/truth", "--truth-to-map", "0,1,0", "--max-beams", 10]
    result = run("convert", "bag", bag, "-o", tmp_path / "log.nc", "--map", grid, *arguments)
    assert result.exit_code == 0, result.stderr
    # Scans at 0.1 m of each other: every third one is more than 0.25 m away.
    assert result.stdout == f"{tmp_path / 'log.nc'}: base_link, 14 samples over 4 s, 140 readings\n"
    log = pmcl.read_log(tmp_path / "log.nc")
    assert log.grid_map is not None
    assert log.dataset.attrs["map"] == "room.yaml"
    np.testing.assert_allclose(log.start_mean, [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(log.odometry[1:, 0], 0.3, atol=1e-9)


def test_other_rows(run, bag, tmp_path):
    arguments = ["--scan", "/front/scan", "--scan", "/rear/scan", "--begin", 1, "--duration", 2, "--start", "1,2,0.5"]
    every = ["--update-min-d", 0, "--update-min-a", 0, "--max-beams", 0, "--update-rule", "euclidean"]
    result = run("convert", "bag", bag, "-o", tmp_path / "log.nc", *arguments, *every)
    assert result.exit_code == 0, result.stderr
    log = pmcl.read_log(tmp_path / "log.nc")
    assert log.n_steps == 21
    assert {name: laser.ranges.shape for name, laser in log.lidars.items()} == {"front": (21, 30), "rear": (21, 30)}
    np.testing.assert_array_equal(log.start_mean, [1.0, 2.0, 0.5])


REFUSED = {
    (): "got 2: choose one, or several, with --scan; the bag holds /truth (geometry_msgs/PoseStamped, 41), /odom",
    ("--scan", "/odom"): "got /odom of type nav_msgs/Odometry",
    ("--scan", "/front/scan", "--start", "here"): "expected reference, anywhere, or X,Y,YAW in metres and radians",
    ("--scan", "/front/scan", "--start", "1,2"): "expected X,Y,YAW in metres and radians, but got '1,2'",
    ("--scan", "/front/scan", "--truth-to-map", "1,2,nan"): "expected X,Y,YAW in metres and radians",
    ("--scan", "/front/scan", "--max-beams", "1"): "expected at least 2 rays, or 0 for all, but got 1",
    ("--scan", "/front/scan", "--update-min-d", "-1"): "-1.0 is not in the range x>=0.0",
    ("--scan", "/front/scan", "--update-rule", "often"): "'often' is not one of 'nav2', 'euclidean'",
    ("--scan", "/front/scan", "--scan-stamp", "last"): "stamps can only be taken as those of the first ray",
    ("--scan", "/front/scan", "--map", "nothing.yaml"): "nothing.yaml",
    ("--scan", "/front/scan", "--duration", "0"): "expected duration > 0 [s], got 0.0",
}


@pytest.mark.parametrize("arguments", REFUSED, ids=" ".join)
def test_refused(refused, bag, tmp_path, arguments):
    if arguments[2:3] == ("--scan-stamp",):
        made = MadeBag()  # scans that do not say how long they take
        made.transform("/tf_static", 10**9, "base_link", "laser", (0.2, 0.0, 0.4))
        made.scan("/front/scan", 10**9, np.ones(5), sweep=math.nan)
        made.odometry("/odom", 10**9, (0, 0, 0))
        bag = made.write(tmp_path / "other", "mcap")
    before = sorted(os.listdir(tmp_path))
    assert REFUSED[arguments] in refused("convert", "bag", bag, "-o", tmp_path / "log.nc", *arguments)
    assert sorted(os.listdir(tmp_path)) == before


def test_a_map_of_another_frame(refused, bag, grid, tmp_path):
    arguments = ["--scan", "/front/scan", "--truth", "/truth", "--truth-to-map", "100,1,0", "--map", grid]
    assert "expected start_mean on the grid map" in refused(
        "convert", "bag", bag, "-o", tmp_path / "log.nc", *arguments
    )


@pytest.mark.parametrize("command", ["bag", "carmen", "wean", "csv"])
def test_missing_and_empty_inputs(refused, tmp_path, command):
    assert "no such file" in refused("convert", command, tmp_path / "nothing", "-o", tmp_path / "log.nc")
    (tmp_path / "empty").write_bytes(b"")
    line = refused("convert", command, tmp_path / "empty", "-o", tmp_path / "log.nc")
    assert f"{tmp_path / 'empty'}: expected" in line
    assert "both are" in refused("convert", command, tmp_path / "empty", "-o", tmp_path / "empty")


def test_a_csv_table(run, tmp_path):
    table = "# landmark post: 2 1\ntime,odom_x,odom_y,odom_heading,range_to_post\n0,0,0,0,2\n1,0.5,0,0,\n"
    (tmp_path / "table.csv").write_text(table)
    result = run("convert", "csv", tmp_path / "table.csv", "-o", tmp_path / "log.nc", "--start", "0,0,0")
    assert result.exit_code == 0, result.stderr
    assert pmcl.read_log(tmp_path / "log.nc").odometry[1].tolist() == [0.5, 0.0, 0.0]


def test_a_recording_without_a_reading_is_refused(refused, grid, tmp_path):
    made = MadeBag()
    made.transform("/tf_static", 10**9, "base_link", "laser", (0.2, 0.0, 0.4))
    for k in range(20):
        made.odometry("/odom", 10**9 + k * 10**8, (0.3 * k, 0.0, 0.0))
        made.scan("/scan", 10**9 + k * 10**8, np.full(30, math.nan))
    bag = made.write(tmp_path / "blind", "mcap")
    before = sorted(os.listdir(tmp_path))
    line = refused("convert", "bag", bag, "-o", tmp_path / "log.nc", "--map", grid)
    assert f"{bag}: expected readings in the 20 rows, got none" in line
    head = "# scan_angles: 0 1\n# scan_limits: 0 9\ntime,odom_x,odom_y,odom_heading,scan_0,scan_1\n"
    (tmp_path / "table.csv").write_text(f"{head}0,0,0,0,,\n1,1,0,0,,\n")
    assert "got none" in refused("convert", "csv", tmp_path / "table.csv", "-o", tmp_path / "log.nc")
    assert sorted(os.listdir(tmp_path)) == sorted([*before, "table.csv"])


def test_a_wean_map_is_written_beside_the_log(run, tmp_path):
    cells = "\n".join(" ".join("0.0" if x == 3 else "1.0" for _ in range(4)) for x in range(5))
    head = "robot_specifications->resolution   10\n\nglobal_map[0]: 5 4\n"
    with gzip.open(tmp_path / "map.dat.gz", "wt") as stream:
        stream.write(head + cells + "\n")
    scans = [f"L {40 * k} 0 0 {40 * k + 25} 0 0 {' '.join(['100'] * 180)} {k}.5" for k in range(4)]
    (tmp_path / "robotdata1.log").write_text("\n".join(scans) + "\n")
    result = run("convert", "wean", tmp_path, "--map", tmp_path / "map.dat.gz", "-o", tmp_path / "log.nc")
    assert result.exit_code == 0, result.stderr
    log = pmcl.read_log(tmp_path / "log.nc")
    assert log.dataset.attrs["map"] == "log_map.yaml"
    assert (log.grid_map.cells[:, 3] == 1).all()
    np.testing.assert_allclose(log.odometry[1:, 0], 0.4)
    np.testing.assert_allclose(log.lidars[""].pose, [0.25, 0.0, 0.0])
