"""CARMEN and Wean texts as logs: recordings made by hand, malformed ones, and the real one beside a bag of it."""

from __future__ import annotations

import gzip
import math

import numpy as np
import pytest
from oracles.made_bags import MadeBag

from pmcl.errors import LogError
from pmcl.geometry import between, compose
from pmcl.logs import lidar_recording, text_lines
from pmcl.logs.bags.read import read_bag
from pmcl.logs.carmen import read_carmen
from pmcl.logs.wean import read_wean

ALL = {"update_min_d": 0.0, "update_min_a": 0.0, "max_beams": None}
TIMES = np.arange(5.0)
POSES = np.column_stack([0.4 * TIMES, 0.1 * TIMES**2, 0.3 * TIMES - 0.5])
RANGES = 1.0 + np.arange(180) / 100 + TIMES[:, None]

SHIFT = np.array([1.0, 2.0, 0.0])


def words(*numbers):
    return " ".join(f"{number:.9f}" for number in np.concatenate([np.atleast_1d(n) for n in numbers]))


def flaser(mount=(0.2, 0.0, 0.0), ranges=RANGES):
    lines = ["# CARMEN Logfile", "PARAM robot_length 0.5 0 host 0"]
    for t, pose, scan in zip(TIMES, POSES, ranges, strict=True):
        lines.append(f"ODOM {words(pose)} 0.1 0.1 0.0 {t:.3f} host {t:.3f}")
        laser = compose(pose, mount)
        lines.append(f"FLASER {len(scan)} {words(scan, laser, pose)} {t + 0.5:.3f} host {t + 0.6:.3f}")
    return lines


def robotlaser():
    lines = []
    for t, pose, scan in zip(TIMES, POSES, RANGES[:, :90], strict=True):
        head = "1 -0.800000 1.570796 0.017800 30.000000 0.010000 0 90"
        laser = compose(pose, (0.3, 0.05, 0.1))
        body = f"{head} {words(scan)} 2 0.5 0.5 {words(laser, pose)} 0 0 0.5 0.4 0"
        lines.append(f"ROBOTLASER1 {body} {t:.3f} host {t:.3f}")
        lines.append(f"TRUEPOS {words(pose + SHIFT, pose)} {t:.3f} host {t:.3f}")
    return lines


@pytest.fixture
def write(tmp_path):
    def write_lines(lines, name="text.log"):
        path = tmp_path / name
        text = lines if isinstance(lines, str) else "\n".join(lines) + "\n"
        path.write_bytes(gzip.compress(text.encode()) if name.endswith(".gz") else text.encode())
        return path

    return write_lines


@pytest.mark.parametrize("name", ["robot.log", "robot.log.gz"])
def test_flaser(write, name):
    log = read_carmen(write(flaser(), name), **ALL)
    np.testing.assert_allclose(log.times, TIMES, atol=1e-9)
    assert log.dataset.attrs["time_origin"] == pytest.approx(0.5)
    np.testing.assert_allclose(log.odometry[1:], between(POSES[:-1], POSES[1:]), atol=1e-8)
    laser = log.lidars[""]
    np.testing.assert_allclose(laser.ranges, RANGES, atol=1e-8)
    np.testing.assert_allclose(laser.pose, [0.2, 0.0, 0.0], atol=1e-8)
    np.testing.assert_allclose(laser.angles, np.radians(np.arange(-90, 90)), atol=1e-12)
    assert laser.max_range == 81.9
    assert log.true_poses is None


def test_the_mount_and_the_reach_may_be_parameters_of_the_log(write):
    lines = ["PARAM robot_frontlaser_offset 0.31 0 host 0", "PARAM robot_front_laser_max 4.0 0 host 0", *flaser()]
    laser = read_carmen(write(lines), **ALL).lidars[""]
    np.testing.assert_allclose(laser.pose, [0.31, 0.0, 0.0])
    assert laser.max_range == 4.0
    assert np.isinf(laser.ranges[RANGES > 4.0]).all()
    stated = read_carmen(write(lines), laser_pose=(0.1, 0.2, 0.3), **ALL).lidars[""]
    np.testing.assert_allclose(stated.pose, [0.1, 0.2, 0.3])


def test_rays_of_181_and_361_readings(write):
    for n in (181, 361):
        laser = read_carmen(write(flaser(ranges=np.ones((5, n)))), **ALL).lidars[""]
        np.testing.assert_allclose(laser.angles, np.linspace(-math.pi / 2, math.pi / 2, n), atol=1e-12)


def test_robotlaser_and_truepos(write):
    log = read_carmen(write([*flaser(), *robotlaser()]), **ALL)
    laser = log.lidars[""]
    np.testing.assert_allclose(laser.ranges, RANGES[:, :90], atol=1e-8)
    np.testing.assert_allclose(laser.pose, [0.3, 0.05, 0.1], atol=1e-8)
    np.testing.assert_allclose(laser.angles, -0.8 + 0.0178 * np.arange(90), atol=1e-12)
    assert laser.max_range == 30.0
    np.testing.assert_allclose(log.true_poses, POSES + SHIFT, atol=1e-8)
    np.testing.assert_allclose(log.start_mean, POSES[0] + SHIFT, atol=1e-8)


def test_scans_with_corrected_poses_need_a_mount(write):
    lines = flaser()
    lines[5] = lines[5].replace(words(compose(POSES[1], (0.2, 0, 0))), words(POSES[1] + [3.0, 1.0, 0.4]))
    with pytest.raises(LogError, match="state the mount with --laser-pose"):
        read_carmen(write(lines), **ALL)


def test_a_recording_that_was_interrupted(write):
    whole = "\n".join(flaser())
    log = read_carmen(write(whole[: len(whole) - 900]), **ALL)
    assert log.n_steps == 4
    assert log.dataset.attrs["dropped_lines_that_are_cut_off"] == 1
    lines = flaser()
    lines[7] = lines[7][:-900]
    with pytest.raises(LogError, match=r"text\.log, line 8: expected the fields of a CARMEN message FLASER"):
        read_carmen(write(lines), **ALL)


def wean(cut=0):
    lines = []
    for t, pose, scan in zip(TIMES, POSES, RANGES, strict=True):
        laser = compose(pose, (0.25, 0.0, 0.0))
        cm = np.array([100.0, 100.0, 1.0])
        lines.append(f"O {words(pose * cm)} {t:.6f}")
        lines.append(f"L {words(pose * cm, laser * cm, 100 * scan)} {t + 0.25:.6f}")
    text = "\n".join(lines) + "\n"
    return text[: len(text) - cut] if cut else text


def test_wean(write):
    log = read_wean(write(wean()), **ALL)
    np.testing.assert_allclose(log.times, TIMES, atol=1e-9)
    np.testing.assert_allclose(log.odometry[1:], between(POSES[:-1], POSES[1:]), atol=1e-8)
    laser = log.lidars[""]
    np.testing.assert_allclose(laser.ranges, RANGES, atol=1e-8)
    np.testing.assert_allclose(laser.pose, [0.25, 0.0, 0.0], atol=1e-8)
    np.testing.assert_allclose(laser.angles[[0, -1]], [-math.pi / 2, math.pi / 2])
    assert read_wean(write(wean(cut=300)), **ALL).dataset.attrs["dropped_lines_that_are_cut_off"] == 1


@pytest.mark.parametrize("read", [read_carmen, read_wean])
def test_files_that_are_something_else(write, tmp_path, read):
    with pytest.raises(LogError, match="no such file"):
        read(tmp_path / "nothing.log")
    with pytest.raises(LogError, match="expected"):
        read(write(""))
    with pytest.raises(LogError, match="expected"):
        read(write("O 1 2 three 4\n"))
    with pytest.raises(LogError, match="got something else"):
        read(write("x" * 2_000_000))
    packed = write(flaser(), "cut.log.gz")
    packed.write_bytes(packed.read_bytes()[:200])
    with pytest.raises(LogError, match="expected"):
        read(packed)


@pytest.mark.parametrize("read", [read_carmen, read_wean])
@pytest.mark.parametrize(("limit", "value"), [("_MOST_LINES", 4000), ("_LONGEST_TEXT", 30_000)])
def test_a_packed_text_that_goes_on(write, monkeypatch, read, limit, value):
    path = write("\n" * 5000 + " " * 40_000 + "\n", "text.log.gz")
    assert path.stat().st_size < 500
    with pytest.raises(LogError, match=r"expected (lines|scans)"):
        read(path)
    monkeypatch.setattr(text_lines, limit, value)
    with pytest.raises(LogError, match=r"expected a text of at most .* got more: cut it into parts"):
        read(path)


@pytest.mark.parametrize("read", [read_carmen, read_wean])
def test_more_readings_than_fit_into_memory(write, monkeypatch, read):
    wean = [f"L {30 * k} 0 0 {30 * k} 0 0 {' '.join(['100'] * 180)} {k}" for k in range(5)]
    path = write(flaser() if read is read_carmen else wean)
    monkeypatch.setattr(lidar_recording, "MOST_NUMBERS", 5 * 180)
    assert read(path, **ALL).n_steps == 5
    monkeypatch.setattr(lidar_recording, "MOST_NUMBERS", 5 * 180 - 1)
    with pytest.raises(LogError, match="expected at most 899 readings in a log, got 900 in 5 rows"):
        read(path, **ALL)
    monkeypatch.setattr(lidar_recording, "_MOST_READINGS", 899)
    with pytest.raises(LogError, match="expected at most 899 readings, got more: choose a smaller --max-beams"):
        read(path, **ALL)


def test_a_packed_text_that_is_cut_off(write):
    packed = write(flaser() * 20, "cut.log.gz")
    packed.write_bytes(packed.read_bytes()[:-200])
    with pytest.raises(LogError, match=r"expected a readable text, got .* after line \d+: copy it again"):
        read_carmen(packed)


def test_a_folder_with_several_wean_recordings(tmp_path):
    for k in (1, 2):
        (tmp_path / f"robotdata{k}.log").write_text(wean())
    with pytest.raises(LogError, match=r"got robotdata1\.log, robotdata2\.log: give the file itself"):
        read_wean(tmp_path)
    (tmp_path / "robotdata2.log").unlink()
    assert read_wean(tmp_path, **ALL).n_steps == 5


@pytest.mark.parametrize("kind", ["sqlite3", "mcap"])
def test_wean_as_a_bag_gives_the_log_of_the_text(shared_data, tmp_path, kind):
    source = shared_data / "wean" / "robotdata1.log"
    part = tmp_path / "part.log"
    part.write_text("".join(source.read_text().splitlines(keepends=True)[:800]))
    bag = MadeBag()
    bag.transform("/tf_static", 0, "base_link", "laser", (0.25, 0.0, 0.4))
    for line in part.read_text().splitlines():
        kind_of_line, *rest = line.split()
        numbers = np.array(rest, dtype=float)
        stamp, cm = round(numbers[-1] * 1e9), np.array([0.01, 0.01, 1.0])
        bag.odometry("/odom", stamp, numbers[:3] * cm)
        if kind_of_line == "L":
            bag.scan("/scan", stamp, numbers[6:-1] * 0.01, first=-math.pi / 2, step=math.pi / 179, limits=(0.0, 81.83))
    text, made = read_wean(part), read_bag(bag.write(tmp_path / "bag", kind))
    assert text.n_steps == made.n_steps > 30
    np.testing.assert_allclose(made.times, text.times, atol=1e-8)
    np.testing.assert_allclose(made.odometry, text.odometry, atol=1e-12)
    np.testing.assert_allclose(made.lidars[""].ranges, text.lidars[""].ranges, rtol=1e-7)
    np.testing.assert_allclose(made.lidars[""].angles, text.lidars[""].angles, atol=1e-6)
    np.testing.assert_allclose(made.lidars[""].pose, text.lidars[""].pose, atol=1e-6)
