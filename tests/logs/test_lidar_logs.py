"""Logs with lidars and a grid map: names by pattern, checks, files, and what is made from such a log."""

import pickle

import numpy as np
import pytest
import xarray as xr

from pmcl.errors import LogError, MapError
from pmcl.logs import LidarScans, RobotLog
from pmcl.logs.plausibility import implausible, without_map
from pmcl.logs.schema import Variable, named, plural_of, readings
from pmcl.maps import OccupancyGrid

T = 40


def laser(n_rays, seed=0, **changes):
    ranges = np.random.default_rng(seed).uniform(0.2, 5.0, (T, n_rays))
    ranges[0, 0], ranges[1, 0], ranges[2, 0] = np.nan, np.inf, 0.0
    fields = {"ranges": ranges, "angles": np.linspace(-1.5, 1.5, n_rays), "min_range": 0.1, "max_range": 10.0}
    return LidarScans(**{**fields, "pose": [0.2, 0.0, 0.1], **changes})


def build(lidars=None, **changes):
    arguments = {
        "time": 0.1 * np.arange(T),
        "odometry": np.tile([0.05, 0.0, 0.01], (T, 1)),
        "lidars": {"": laser(9)} if lidars is None else lidars,
        "start_mean": [1.0, 1.0, 0.0],
        "start_std": [0.1, 0.1, 0.1],
        "warn": False,
    }
    return RobotLog.build(**{**arguments, **changes})


@pytest.fixture
def grid():
    cells = np.zeros((40, 60), dtype=np.uint8)
    cells[[0, -1]] = cells[:, 0] = 1
    return OccupancyGrid(cells, 0.1)


@pytest.fixture
def files(tmp_path, grid):
    """A log and its map in one folder."""
    grid.write(tmp_path / "hall.yaml")
    build(grid_map=OccupancyGrid.read(tmp_path / "hall.yaml")).write(tmp_path / "log.nc")
    return tmp_path


def test_one_lidar_and_several_are_read_as_they_were_built():
    one = build().lidars
    assert list(one) == [""]
    np.testing.assert_array_equal(one[""].ranges, laser(9).ranges)
    two = build({"front": laser(9), "rear_2": laser(5, 1, angles=np.linspace(2.0, -2.0, 5), min_range=0)})
    assert list(two.lidars) == ["front", "rear_2"]
    for name, given in (("front", laser(9)), ("rear_2", laser(5, 1))):
        np.testing.assert_array_equal(two.lidars[name].ranges, given.ranges)
        np.testing.assert_array_equal(two.lidars[name].pose, given.pose)
        assert two.lidars[name].max_range == 10.0
    assert two.lidars["rear_2"].min_range == 0.0
    assert (np.diff(two.lidars["rear_2"].angles) < 0.0).all()
    assert two.dataset["scan_front"].dims == ("time", "ray_front")
    # Every number that was measured counts, also a ray without echo.
    assert two.n_readings == 14 * T - 2
    assert readings(two.dataset)[-2:] == ("scan_front", "scan_rear_2")


def test_a_log_with_lidars_survives_its_file(tmp_path):
    log = build({"front": laser(9), "rear": laser(5)})
    log.write(tmp_path / "log.nc")
    again = RobotLog.read(tmp_path / "log.nc")
    assert again.fingerprint() == log.fingerprint()
    assert again.grid_map is None
    np.testing.assert_array_equal(again.lidars["rear"].pose, [0.2, 0.0, 0.1])


def test_files_of_other_programs_may_call_the_rays_of_every_laser_ray():
    given = build({"front": laser(9)}).dataset
    renamed = given.rename(ray_front="ray").transpose("ray", ...)
    assert RobotLog.from_dataset(renamed).fingerprint() == build({"front": laser(9)}).fingerprint()


def test_reach_mount_and_readings_count_in_the_fingerprint(grid):
    changes = [{}, {"min_range": 0.2}, {"max_range": 11.0}, {"pose": [0.2, 0.0, 0.2]}, {"angles": np.arange(9) / 9.0}]
    logs = [build({"": laser(9, **change)}) for change in changes]
    logs += [build({"a": laser(9)}), logs[0].with_map(grid), logs[0].with_map(OccupancyGrid(grid.cells, 0.2))]
    assert len({log.fingerprint() for log in logs}) == len(logs)
    assert logs[0].with_map(grid).with_map(None).fingerprint() == logs[0].fingerprint()


def test_patterns_give_way_to_names_and_to_longer_patterns():
    declared = {name: Variable((), name, "") for name in ("scan", "scan_angle")}
    declared |= {"scan_{name}": Variable(("ray_{name}",), "m", ""), "scan_angle_{name}": Variable((), "rad", "")}
    assert named(declared, "scan_front").dims == ("ray_front",)
    assert named(declared, "scan_angle").units == "scan_angle"
    assert named(declared, "scan_angle_front").units == "rad"
    for name in ("scan_", "scanner", "scan_a b", "my_scan_front", "scan_{name}"):
        assert named(declared, name) is None
    assert plural_of("scan_front") == "lidar ranges"


BAD = {
    "angles missing": (lambda d: d.drop_vars("scan_angle"), "'scan_angle' .* beside 'scan', got none"),
    "angles alone": (lambda d: d.rename(scan="other"), "at least one of"),
    "endless angle": (lambda d: changed(d, "scan_angle", 3, np.inf), r"finite 'scan_angle' \[rad\], got inf at \[3\]"),
    "degrees": (lambda d: d.assign(scan_angle=np.degrees(d.scan_angle)), "convert degrees to radians"),
    "more than a turn": (lambda d: d.assign(scan_angle=2.5 * d.scan_angle), "within one turn, got 7.5 rad"),
    "twice the same angle": (lambda d: changed(d, "scan_angle", 3, -0.75), "strictly increasing .* at ray 3"),
    "zigzag": (lambda d: changed(d, "scan_angle", 3, -1.4), "strictly increasing .* at ray 3"),
    "number of angles": (lambda d: d.assign(scan_angle=("x", np.arange(3.0))), r"dimensions \(ray\)"),
    "negative": (lambda d: changed(d, "scan", (3, 4), -0.1), "'scan' >= 0 .* row 3 .*ray 4"),
    "text": (lambda d: d.assign(scan=(d.scan.dims, d.scan.values.astype(str))), r"numbers \[m\] in 'scan'"),
    "no max_range": (lambda d: stated(d, max_range=None), "max_range > 0 .* got none"),
    "endless max_range": (lambda d: stated(d, max_range=np.inf), "max_range > 0 .* got inf"),
    "absurd max_range": (lambda d: stated(d, max_range=3e38), "max_range > 0 .* at most .* got 3e\\+38"),
    "mount beyond the earth": (lambda d: stated(d, pose=[1e9, 0.0, 0.0]), "three finite numbers .* within 2e\\+07 m"),
    "no min_range": (lambda d: stated(d, min_range=None), "min_range on 'scan' from 0 to below .* got none"),
    "min above max": (lambda d: stated(d, min_range=10.0), "min_range .* below max_range = 10 m, got 10.0"),
    "negative min": (lambda d: stated(d, min_range=-0.1), "min_range .* got -0.1"),
    "no pose": (lambda d: stated(d, pose=None), "pose on 'scan' as three finite numbers .* got none"),
    "two numbers": (lambda d: stated(d, pose=[0.0, 0.0]), "three finite numbers"),
    "pose without end": (lambda d: stated(d, pose=[0.0, np.nan, 0.0]), "three finite numbers"),
    "yaw in degrees": (lambda d: stated(d, pose=[0.0, 0.0, 180.0]), "convert degrees"),
}


def changed(dataset, name, index, value):
    values = np.array(dataset[name].values)
    values[index] = value
    return dataset.assign({name: (dataset[name].dims, values, dataset[name].attrs)})


def stated(dataset, **attributes):
    dataset = dataset.copy(deep=True)
    for name, value in attributes.items():
        dataset.scan.attrs[name] = value
        if value is None:
            del dataset.scan.attrs[name]
    return dataset


@pytest.mark.parametrize("case", BAD)
def test_a_bad_scan_is_one_line_that_names_the_place(case):
    change, says = BAD[case]
    with xr.set_options(keep_attrs=True):
        dataset = change(build().dataset)
    with pytest.raises(LogError, match=f"^night.nc: expected .*{says}|^night.nc: expected {says}") as caught:
        RobotLog.from_dataset(dataset, "night.nc")
    assert "\n" not in str(caught.value)


def test_angles_of_a_laser_that_has_no_scan_are_an_error():
    dataset = build({"front": laser(9), "rear": laser(5)}).dataset.drop_vars("scan_rear")
    with pytest.raises(LogError, match="'scan_rear' beside 'scan_angle_rear'"):
        RobotLog.from_dataset(dataset)


@pytest.mark.parametrize("name", ["angle", "angle_front", "a b", "ä", "front-left"])
def test_a_lidar_has_a_name_that_can_stand_in_the_file(name):
    with pytest.raises(LogError, match="names of lidars of letters"):
        build({name: laser(9)})


def test_a_lidar_is_given_as_scans():
    with pytest.raises(LogError, match=r"lidars\[''\] as LidarScans"):
        build({"": laser(9).ranges})


def test_a_sound_log_is_plausible_and_mistakes_of_units_are_named(grid):
    sound = build(grid_map=grid)
    assert not implausible(sound)
    assert not without_map(sound)
    assert [finding.name for finding in without_map(build())] == ["no-grid-map"]
    assert not without_map(build(attributes={"map": "hall.yaml"}))
    given = laser(9)
    cases = {
        "ranges-beyond-map": given._replace(ranges=1000.0 * given.ranges, max_range=1e4),
        "all-at-max-range": given._replace(ranges=1000.0 * given.ranges),
        "all-at-min-range": given._replace(ranges=0.001 * given.ranges),
    }
    for name, mistaken in cases.items():
        assert [finding.name for finding in implausible(build({"": mistaken}, grid_map=grid))] == [name]


def test_everything_that_is_made_from_a_log_shares_its_grid(grid):
    log = build(grid_map=grid)
    made = [log.select(3, 9), log.without_truth(), log.select(0, 5).without_truth()]
    assert all(each.grid_map is grid for each in made)
    assert pickle.loads(pickle.dumps(log)).fingerprint() == log.fingerprint()
    assert log.require_grid_map() is grid
    with pytest.raises(MapError, match="expected a grid map for the lidar, got none: give one with --map"):
        log.with_map(None).require_grid_map()


def test_a_start_off_the_map_is_an_error(grid):
    log = build(start_mean=[6.5, 1.0, 0.0])
    for make in (lambda: log.with_map(grid), lambda: build(start_mean=[6.5, 1.0, 0.0], grid_map=grid)):
        with pytest.raises(MapError, match=r"start_mean on the grid map \(x 0 to 6 m, y 0 to 4 m\), got \(6.5, 1\) m"):
            make()
    assert log.select(2, 9).with_map(grid).grid_map is grid
    with pytest.raises(LogError, match="grid_map as OccupancyGrid"):
        log.with_map("hall.yaml")


def test_a_log_finds_the_map_that_it_names(files, grid):
    log = RobotLog.read(files / "log.nc")
    assert log.dataset.attrs["map"] == "hall.yaml"
    assert log.grid_map.fingerprint() == grid.fingerprint()
    # Folder and files may move together.
    moved = files.rename(files.with_name("moved"))
    assert RobotLog.read(moved / "log.nc").fingerprint() == log.fingerprint()


def test_a_map_that_is_given_comes_before_the_one_that_is_named(files, grid):
    other = OccupancyGrid(grid.cells, 0.2)
    other.write(files / "other.yaml")
    for given in (other, files / "other.yaml", str(files / "other.yaml")):
        assert RobotLog.read(files / "log.nc", given).grid_map.fingerprint() == other.fingerprint()
    assert RobotLog.read(files / "log.nc", map=files / "other.yaml").grid_map.resolution == 0.2


def test_a_log_names_a_map_only_where_it_can_be_found_again(files, grid, tmp_path_factory):
    log = RobotLog.read(files / "log.nc")
    elsewhere = tmp_path_factory.mktemp("elsewhere") / "log.nc"
    log.write(elsewhere)
    assert "map" not in RobotLog.read(elsewhere).dataset.attrs
    assert RobotLog.read(elsewhere).grid_map is None
    (files / "sub").mkdir()
    grid.write(files / "sub" / "hall.yaml")
    RobotLog.read(files / "log.nc", files / "sub" / "hall.yaml").write(files / "log.nc")
    assert RobotLog.read(files / "log.nc").dataset.attrs["map"] == "sub/hall.yaml"
    # The file of that name holds another map by now.
    stale = RobotLog.read(files / "log.nc")
    OccupancyGrid(grid.cells, 0.2).write(files / "sub" / "hall.yaml")
    stale.write(files / "log.nc")
    assert RobotLog.read(files / "log.nc").grid_map is None


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("gone.yaml", "got no such file: copy it there, or give the map with --map"),
        ("/etc/hall.yaml", "relative to the log"),
        ("../hall.yaml", "in the folder of the log or below"),
        ("sub/../../hall.yaml", "in the folder of the log or below"),
        ("", "relative to the log"),
        (3, "relative to the log, got"),
    ],
)
def test_a_named_map_that_cannot_be_read_is_one_line(tmp_path, name, says):
    folder = tmp_path / "logs"
    (folder / "sub").mkdir(parents=True)
    build(attributes={"map": name}).write(folder / "log.nc")
    with pytest.raises(LogError, match=says) as caught:
        RobotLog.read(folder / "log.nc")
    assert str(caught.value).startswith(f"{folder / 'log.nc'}: expected")
    assert "--map MAP.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)
