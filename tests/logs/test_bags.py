"""Bags as logs: one recording in every format, mounts, topics, stamps, and what is left out."""

from __future__ import annotations

import math

import numpy as np
import pytest
from oracles.made_bags import KINDS, MadeBag, yaw

from pmcl.errors import LogError
from pmcl.geometry import between
from pmcl.logs import lidar_recording
from pmcl.logs.bags import unpacking
from pmcl.logs.bags.read import read_bag

ORIGIN = 1_700_000_000_123_456_789
SECOND = 10**9
HALF_TURN = (1.0, 0.0, 0.0, 0.0)  # about the x axis: upside down


def path_at(seconds):
    """The robot drives a circle of 2 m at 0.5 m/s."""
    angle = 0.25 * seconds
    return 2.0 * math.sin(angle), 2.0 * (1.0 - math.cos(angle)), angle


def ranges_at(seconds):
    return 1.0 + 0.1 * np.arange(21) + 0.01 * seconds


def ns(seconds):
    return ORIGIN + round(seconds * SECOND)


def small_recording(*, static="/tf_static", odometry="topic", duration=6.0, scans=("/scan",)):
    """Odometry at 20 Hz, scans at 5 Hz from 0.5 s on, the laser on a mast 0.3 m ahead and 0.1 m to the left."""
    bag = MadeBag()
    bag.transform(static, ns(0), "base_link", "mast", (0.3, 0.0, 0.5), yaw(0.5))
    bag.transform(static, ns(0), "mast", "laser", (0.1 * math.sin(0.5), 0.1 * math.cos(0.5), 0.1), yaw(-0.2))
    for k in range(round(duration * 20) + 1):
        t = k / 20
        if odometry == "topic":
            bag.odometry("/odom", ns(t), path_at(t))
        else:
            x, y, heading = path_at(t)
            bag.transform("/tf", ns(t), "odom", "base_link", (x, y, 0.0), yaw(heading))
        if k >= 10 and k % 4 == 2:
            for number, topic in enumerate(scans):
                bag.scan(topic, ns(t), ranges_at(t) + number)
    return bag


@pytest.fixture
def recording():
    return small_recording()


def read(bag, tmp_path, kind="mcap", **settings):
    tmp_path.mkdir(exist_ok=True)
    return read_bag(bag.write(tmp_path / "bag", kind), **settings)


ALL = {"update_min_d": 0.0, "update_min_a": 0.0, "max_beams": None}


@pytest.mark.parametrize("kind", KINDS)
def test_every_scan_becomes_a_row(recording, tmp_path, kind):
    log = read(recording, tmp_path, kind, **ALL)
    times = np.arange(0.5, 6.0, 0.2)
    np.testing.assert_allclose(log.times, times - 0.5, atol=1e-9)
    poses = np.array([path_at(t) for t in times])
    np.testing.assert_allclose(log.odometry[1:], between(poses[:-1], poses[1:]), atol=1e-12)
    laser = log.lidars[""]
    np.testing.assert_array_equal(laser.ranges, np.array([ranges_at(t) for t in times]).astype(np.float32))
    np.testing.assert_allclose(laser.angles, -1.0 + np.float32(0.1).astype(float) * np.arange(21), atol=1e-12)
    np.testing.assert_allclose(laser.pose, [0.3, 0.1, 0.3], atol=1e-12)
    assert (laser.min_range, laser.max_range) == (np.float32(0.1), 20.0)
    np.testing.assert_array_equal(log.start_std, np.full(3, np.inf))
    assert log.dataset.attrs["time_origin"] == pytest.approx((ORIGIN + SECOND // 2) / SECOND, abs=1e-6)


def test_the_log_is_the_same_in_every_format(recording, tmp_path):
    logs = [read(recording, tmp_path / kind, kind) for kind in KINDS]
    assert len({log.fingerprint() for log in logs}) == 1
    moved = read(small_recording(duration=7.0), tmp_path, "mcap")
    assert moved.fingerprint() != logs[0].fingerprint()


def test_an_mcap_file_is_read_without_its_folder(recording, tmp_path):
    folder = recording.write(tmp_path / "bag", "mcap")
    (folder / "metadata.yaml").unlink()
    alone = read_bag(folder / "bag.mcap")
    assert alone.fingerprint() == read_bag(folder).fingerprint()


@pytest.mark.parametrize("static", ["/tf_static", "/tf"])
def test_odometry_from_tf_is_that_of_the_topic(recording, tmp_path, static):
    of_tf = read(small_recording(odometry="tf", static=static), tmp_path / "tf")
    np.testing.assert_allclose(of_tf.odometry, read(recording, tmp_path / "topic").odometry, atol=1e-12)
    np.testing.assert_allclose(of_tf.lidars[""].pose, [0.3, 0.1, 0.3], atol=1e-12)


def test_poses_between_odometry_messages_are_interpolated_across_the_turn_of_headings(tmp_path):
    bag = MadeBag()
    bag.transform("/tf_static", ns(0), "base_link", "laser", (0, 0, 0))
    for k, heading in enumerate([3.0, 3.1, -3.083185307179586, -2.9]):
        bag.odometry("/odom", ns(k), (k, 0, heading))
    for t in (0.5, 1.5, 2.5):
        bag.scan("/scan", ns(t), np.ones(5))
    log = read(bag, tmp_path, **ALL)
    headings = np.unwrap([3.0, 3.1, -3.083185307179586, -2.9])
    expected = np.diff(0.5 * (headings[1:] + headings[:-1]))
    np.testing.assert_allclose(log.odometry[1:, 2], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("quaternion", "pose_yaw", "sign"),
    [(yaw(0.0), 0.0, 1.0), (yaw(math.pi), math.pi, 1.0), (HALF_TURN, 0.0, -1.0), ((0.0, 1.0, 0.0, 0.0), math.pi, -1.0)],
)
def test_a_laser_that_is_turned_or_upside_down(tmp_path, quaternion, pose_yaw, sign):
    """Each ray must point where the full rotation in space turns it."""
    bag = MadeBag()
    bag.transform("/tf_static", ns(0), "base_link", "laser", (0.2, 0.0, 1.0), quaternion)
    for k in range(4):
        bag.odometry("/odom", ns(k), (k, 0, 0))
        bag.scan("/scan", ns(k), np.ones(5), first=0.3, step=0.2)
    laser = read(bag, tmp_path, **ALL).lidars[""]
    x, y, z, w = quaternion
    angle = 0.3 + np.float32(0.2).astype(float) * np.arange(5)
    ray = np.stack([np.cos(angle), np.sin(angle), np.zeros(5)])
    v = np.array([x, y, z])[:, None]
    turned = ray + 2 * np.cross(v, np.cross(v, ray, axis=0) + w * ray, axis=0)
    world = laser.pose[2] + laser.angles
    np.testing.assert_allclose(np.stack([np.cos(world), np.sin(world)]), turned[:2], atol=1e-7)
    assert math.cos(laser.pose[2] - pose_yaw) == pytest.approx(1.0)
    assert np.sign(laser.angles[1] - laser.angles[0]) == sign


def test_two_lasers_have_rows_and_names_of_their_own(tmp_path):
    bag = small_recording(scans=("/front/scan", "/rear/scan"))
    log = read(bag, tmp_path, scans=["/front/scan", "rear/scan"], **ALL)
    assert set(log.lidars) == {"front", "rear"}
    # Both have the same stamps, hence the same rows.
    np.testing.assert_allclose(log.lidars["rear"].ranges, log.lidars["front"].ranges + 1.0, rtol=1e-6)


def test_scans_at_different_times_have_different_rows(tmp_path):
    bag = small_recording()
    for t in np.arange(0.6, 5.0, 0.4):
        bag.scan("/other", ns(t), ranges_at(t) + 5.0)
    log = read(bag, tmp_path, scans=["/scan", "/other"], **ALL)
    first, second = (~np.isnan(log.lidars[name].ranges[:, 0]) for name in ("scan", "other"))
    assert first.sum() == 28
    assert second.sum() == 11
    assert not (first & second).any()
    poses = np.array([path_at(t + 0.5) for t in log.times])
    # A scan between two odometry messages lies on the chord of the arc, 0.08 mm inside it.
    np.testing.assert_allclose(log.odometry[1:], between(poses[:-1], poses[1:]), atol=2e-4)


def test_the_reference_is_brought_into_the_map(recording, tmp_path):
    for t in np.arange(0.0, 6.0, 0.1):
        recording.pose("/truth", ns(t - 0.05), path_at(t))
    log = read(recording, tmp_path, truth="/truth", truth_to_map=(1.0, 2.0, math.pi / 2), truth_shift=0.05, **ALL)
    poses = np.array([path_at(t) for t in np.arange(0.5, 6.0, 0.2)])
    known = ~np.isnan(log.true_poses[:, 0])
    assert known.sum() >= 27
    expected = np.column_stack([1.0 - poses[:, 1], 2.0 + poses[:, 0], poses[:, 2] + math.pi / 2])
    np.testing.assert_allclose(log.true_poses[known], expected[known], atol=1e-7)
    np.testing.assert_array_equal(log.start_mean, log.true_poses[0])
    np.testing.assert_array_equal(log.start_std, [0.1, 0.1, 0.1])


def test_a_frame_of_tf_is_a_reference_only_when_asked_for(recording, tmp_path):
    for t in np.arange(0.0, 6.0, 0.1):
        recording.transform("/tf", ns(t), "map", "odom", (3.0, -1.0, 0.0), yaw(math.pi / 2))
    path = recording.write(tmp_path / "bag", "mcap")
    assert read_bag(path).true_poses is None
    log = read_bag(path, truth="map", **ALL)
    poses = np.array([path_at(t) for t in np.arange(0.5, 5.9, 0.2)])
    np.testing.assert_allclose(log.true_poses[:27, :2], np.column_stack([3 - poses[:, 1], poses[:, 0] - 1]), atol=1e-9)


def test_stamps_of_the_last_ray(tmp_path):
    bag = MadeBag()
    bag.transform("/tf_static", ns(0), "base_link", "laser", (0, 0, 0))
    for k in range(41):
        bag.odometry("/odom", ns(k / 10), (k / 10, 0, 0))
    for t in (1.0, 2.0, 3.5):
        bag.scan("/scan", ns(t), np.ones(11), sweep=0.05 * t)
    log = read(bag, tmp_path, scan_stamp="last", **ALL)
    np.testing.assert_allclose(log.odometry[1:, 0], [0.95, 1.425], atol=1e-7)


def test_readings_out_of_reach(tmp_path):
    """nav2's amcl_node.cpp maps readings up to range_min to the greatest range; NaN is no reading."""
    bag = MadeBag()
    bag.transform("/tf_static", ns(0), "base_link", "laser", (0, 0, 0))
    ranges = [0.0, 0.1, 0.2, -math.inf, math.nan, 19.9, 20.0, 25.0, math.inf]
    for k in range(3):
        bag.odometry("/odom", ns(k), (k, 0, 0))
        bag.scan("/scan", ns(k), ranges, limits=(0.15, 20.0))
    read_ranges = read(bag, tmp_path, **ALL).lidars[""].ranges[0]
    inf, nan = math.inf, math.nan
    np.testing.assert_allclose(read_ranges, [inf, inf, 0.2, inf, nan, 19.9, inf, inf, inf], rtol=1e-7)


def dropped(log):
    return {k.removeprefix("dropped_"): v for k, v in log.dataset.attrs.items() if k.startswith("dropped_") and v}


def test_what_cannot_be_used_is_left_out_and_counted(recording, tmp_path):
    path = recording.write(tmp_path / "plain", "mcap")
    plain = read_bag(path, **ALL)
    assert dropped(plain) == {}
    recording.scan("/scan", ns(-0.2), ranges_at(0))  # before the odometry
    recording.scan("/scan", ns(6.1), ranges_at(6))  # after it
    recording.scan("/scan", ns(6.2), ranges_at(6)[:13])  # fewer rays than usual
    recording.scan("/scan", ns(0.5), ranges_at(0))  # a stamp that was there
    recording.scan("/scan", ns(90 * 86400), ranges_at(0))  # the clock jumps by months
    recording.odometry("/odom", ns(-5.0), path_at(0), recorded=ns(3.0))  # and back
    recording.odometry("/odom", ns(3.01), (math.nan, 0.0, 0.0))
    log = read_bag(recording.write(tmp_path / "more", "mcap"), **ALL)
    np.testing.assert_allclose(log.times, plain.times, atol=1e-9)
    np.testing.assert_allclose(log.odometry, plain.odometry, atol=1e-9)
    np.testing.assert_array_equal(log.lidars[""].ranges, plain.lidars[""].ranges)
    assert dropped(log) == {
        "scans_without_odometry": 2,
        "scans_of_another_shape": 1,
        "scans_with_repeated_stamps": 1,
        "clock_jumps": 2,
        "invalid_poses": 1,
    }


REFUSED = {
    "no scans": ({"scans": ()}, {}, "expected a topic of type sensor_msgs/LaserScan, got none"),
    "two scans": ({"scans": ("/a", "/b")}, {}, "got 2: choose one, or several, with --scan; the bag holds /odom"),
    "unknown scan": ({}, {"scans": ["/lidar"]}, "got '/lidar': choose another; the bag holds /odom"),
    "scan of another type": ({}, {"scans": ["/odom"]}, "got /odom of type nav_msgs/Odometry"),
    "unknown odometry": ({}, {"odometry": "/wheels"}, "got '/wheels'"),
    "no such frame": ({"odometry": "tf"}, {"odometry": "wheels"}, "from 'wheels' to the robot that carries 'laser'"),
    "unknown truth": ({}, {"truth": "/truth"}, "expected --truth to name a topic of the bag, got '/truth'"),
    "no truth": ({}, {"start": "reference"}, "expected reference poses for start = 'reference', got none"),
    "truth in no frame": ({}, {"truth": "map"}, "a frame of tf above 'base_link' or 'odom', got 'map'"),
    "begins too late": ({}, {"begin": 60.0}, "expected at least two scans to use, got 0 of 28"),
    "moves too little": ({}, {"update_min_d": 50.0, "update_min_a": 6.0}, "got 1 of 28"),
    "one beam": ({}, {"max_beams": 1}, "expected max_beams of at least 2"),
    "stamps of the last ray": ({}, {"scan_stamp": "middle"}, "expected scan_stamp as one of"),
    "a start of two numbers": ({}, {"start": (1.0, 2.0)}, "three finite numbers X,Y,YAW"),
    "negative duration": ({}, {"duration": -1.0}, "expected duration > 0 [s]"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_missing_or_ambiguous_is_said(name, tmp_path):
    made, settings, message = REFUSED[name]
    with pytest.raises(LogError) as caught:
        read(small_recording(**made), tmp_path, **settings)
    assert message in str(caught.value)
    assert str(tmp_path) in str(caught.value) or "max_beams" in message or "scan_stamp" in message


def test_a_laser_without_a_place_on_the_robot(tmp_path):
    bag = MadeBag()
    bag.transform("/tf_static", ns(0), "base_link", "camera", (0, 0, 0))
    for k in range(3):
        bag.odometry("/odom", ns(k), (k, 0, 0))
        bag.scan("/scan", ns(k), np.ones(5))
    with pytest.raises(LogError, match=r"from 'base_link' to 'laser' .* got none \(frames: base_link, camera\)"):
        read(bag, tmp_path)


def test_a_laser_that_moves_on_the_robot(tmp_path):
    bag = MadeBag()
    for k in range(3):
        bag.transform("/tf", ns(k), "base_link", "laser", (0, 0, 0), yaw(0.1 * k))
        bag.odometry("/odom", ns(k), (k, 0, 0))
        bag.scan("/scan", ns(k), np.ones(5))
    with pytest.raises(LogError, match="expected a constant transform from 'base_link' to 'laser' of /scan, got one"):
        read(bag, tmp_path)


def test_a_laser_that_is_not_level(tmp_path):
    bag = MadeBag()
    bag.transform("/tf_static", ns(0), "base_link", "laser", (0, 0, 0), (math.sin(0.1), 0.0, 0.0, math.cos(0.1)))
    for k in range(3):
        bag.odometry("/odom", ns(k), (k, 0, 0))
        bag.scan("/scan", ns(k), np.ones(5))
    with pytest.raises(LogError, match=r"level within 0.1 rad, got a tilt of 0.2 rad"):
        read(bag, tmp_path)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("keep", [0, 5, 40, 0.5, 0.9, 0.999])
def test_truncated_bags(recording, tmp_path, kind, keep):
    path = recording.write(tmp_path / "bag", kind)
    file = path if path.is_file() else next(each for each in path.iterdir() if each.suffix in (".mcap", ".db3"))
    content = file.read_bytes()
    file.write_bytes(content[: int(keep * len(content)) if isinstance(keep, float) else keep])
    with pytest.raises(LogError, match="expected"):
        read_bag(file)
    with pytest.raises(LogError, match="expected"):
        read_bag(path)


COMPRESSED = [("ros1", "bz2"), ("ros1", "lz4"), ("mcap", "chunk")]
COMPRESSED += [(kind, mode) for kind in ("sqlite3", "mcap") for mode in ("message", "file")]


@pytest.mark.parametrize(("kind", "compression"), COMPRESSED)
def test_compressed_bags(recording, tmp_path, kind, compression):
    log = read_bag(recording.write(tmp_path / "packed", kind, compression), **ALL)
    assert log.fingerprint() == read(recording, tmp_path, **ALL).fingerprint()


BOMBS = [(*each, True) for each in COMPRESSED if each[1] != "file"] + [("mcap", "chunk", False)]


@pytest.mark.parametrize(("kind", "compression", "indexed"), BOMBS)
def test_a_few_bytes_that_stand_for_very_many(tmp_path, monkeypatch, kind, compression, indexed):
    """The true limit is 256 times as large; the size of what comes out is counted, whatever the file says of it."""
    monkeypatch.setattr(unpacking, "LARGEST_CHUNK", 1 << 20)
    bag = small_recording()
    # Messages that are compressed one by one are unpacked only where they are needed.
    if compression == "message":
        bag.scan("/scan", ns(5.0), np.zeros(400_000))
    else:
        bag.padding("/zeros", ns(5.0), 1_500_000)
    path = bag.write(tmp_path / "bomb", kind, compression)
    if not indexed:
        without_index(path / "bomb.mcap")
    with pytest.raises(LogError, match=r"expected an undamaged bag, got 'a chunk of .*more than 1 MB"):
        read_bag(path)


def without_index(file):
    """Let the footer of an MCAP file say that there is no summary (mcap.dev/spec)."""
    content = bytearray(file.read_bytes())
    content[-28:-8] = bytes(20)
    file.write_bytes(content)


def test_a_chunk_that_says_less_than_it_holds(tmp_path, monkeypatch):
    bag = small_recording()
    bag.padding("/zeros", ns(5.0), 3_000_000)
    file = bag.write(tmp_path / "bag", "mcap", "chunk") / "bag.mcap"
    content = bytearray(file.read_bytes())
    (chunk,) = unpacking.checked_chunks(file).values()
    size = chunk.size.to_bytes(8, "little")
    assert content.count(size) == 2  # in the chunk and in the index
    file.write_bytes(content.replace(size, (1000).to_bytes(8, "little")))
    monkeypatch.setattr(unpacking, "LARGEST_CHUNK", 1 << 20)
    with pytest.raises(LogError, match="a chunk of more than 1 MB"):
        read_bag(file)


def test_an_index_that_speaks_of_other_chunks(recording, tmp_path):
    file = recording.write(tmp_path / "bag", "mcap", "chunk") / "bag.mcap"
    content = bytearray(file.read_bytes())
    (chunk,) = unpacking.checked_chunks(file).values()
    last = content.rindex(chunk.size.to_bytes(8, "little"))
    content[last : last + 8] = (chunk.size + 1).to_bytes(8, "little")
    file.write_bytes(content)
    with pytest.raises(LogError, match="an index that does not fit the chunks"):
        read_bag(file)


def test_a_file_that_says_it_becomes_gigabytes(recording, tmp_path):
    folder = recording.write(tmp_path / "bag", "sqlite3", "file")
    (file,) = folder.glob("*.zstd")
    # A frame with a content size of 8 bytes (RFC 8878, section 3.1.1.1).
    file.write_bytes(b"\x28\xb5\x2f\xfd\xe0" + (10**12).to_bytes(8, "little") + bytes(50))
    with pytest.raises(LogError, match="a file of 63 bytes that says it becomes 1000000000000 bytes"):
        read_bag(folder)


@pytest.mark.parametrize("kind", ["sqlite3", "mcap"])
def test_messages_that_are_counted_but_missing(recording, tmp_path, kind):
    folder = recording.write(tmp_path / "bag", kind)
    described = (folder / "metadata.yaml").read_text()
    assert described.count("message_count: 28") == 1
    (folder / "metadata.yaml").write_text(described.replace("message_count: 28", "message_count: 31"))
    log = read_bag(folder, **ALL)
    assert dropped(log) == {"messages_that_are_missing": 3}
    assert log.n_steps == 28


@pytest.mark.parametrize("wrong", ["many", "[1, 2]", "-.inf", "null"])
def test_a_description_with_something_else_in_it(recording, tmp_path, wrong):
    folder = recording.write(tmp_path / "bag", "mcap")
    described = (folder / "metadata.yaml").read_text()
    for right in ("message_count: 28", "name: /scan", "type: sensor_msgs/msg/LaserScan"):
        (folder / "metadata.yaml").write_text(described.replace(right, f"{right.split(':')[0]}: {wrong}"))
        with pytest.raises(LogError, match="expected"):
            read_bag(folder)


def test_poses_beyond_the_earth_are_left_out_and_counted(recording, tmp_path):
    plain = read(recording, tmp_path / "plain", **ALL)
    for number in (1e300, -3e7, math.inf):
        recording.odometry("/odom", ns(3.01), (number, 0.0, 0.0))
    log = read(recording, tmp_path / "wild", **ALL)
    assert dropped(log) == {"invalid_poses": 3}
    np.testing.assert_array_equal(log.odometry, plain.odometry)


def test_more_readings_than_fit_into_memory(recording, tmp_path, monkeypatch):
    monkeypatch.setattr(lidar_recording, "_MOST_READINGS", 28 * 21)
    assert read(recording, tmp_path / "all", **ALL).n_steps == 28
    monkeypatch.setattr(lidar_recording, "_MOST_READINGS", 28 * 21 - 1)
    with pytest.raises(LogError, match="expected at most 587 readings, got more: choose a smaller --max-beams"):
        read(recording, tmp_path / "more", **ALL)


def test_scans_that_all_differ(tmp_path):
    bag = MadeBag()
    bag.transform("/tf_static", ns(0), "base_link", "laser", (0, 0, 0))
    for k in range(4):
        bag.odometry("/odom", ns(k), (k, 0, 0))
        bag.scan("/scan", ns(k), np.ones(5 + k))
    with pytest.raises(LogError, match="got 4 scans that all differ, such as 5 and 6 rays"):
        read(bag, tmp_path)


def test_other_files_are_refused(recording, tmp_path):
    with pytest.raises(LogError, match="no such file: check the path"):
        read_bag(tmp_path / "nothing.bag")
    with pytest.raises(LogError, match="got 0 such files"):
        read_bag(tmp_path)
    (tmp_path / "notes.bag").write_text("a text that is no bag")
    with pytest.raises(LogError, match="got something else"):
        read_bag(tmp_path / "notes.bag")
    folder = recording.write(tmp_path / "bag", "mcap")
    (folder / "bag.mcap").rename(tmp_path / "bag.db3")
    with pytest.raises(LogError, match=r"expected the suffix \.mcap"):
        read_bag(tmp_path / "bag.db3")


def test_without_rosbags_the_command_that_installs_it_is_said(recording, tmp_path, monkeypatch):
    path = recording.write(tmp_path / "bag", "mcap")
    monkeypatch.setitem(__import__("sys").modules, "rosbags", None)
    with pytest.raises(LogError, match=r"pip install 'pmcl\[ros\]'"):
        read_bag(path)
