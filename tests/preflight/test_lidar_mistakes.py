"""Sound logs of lidars pass without a word; mistakes with mounts, units, maps, starts and clocks are named."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy import stats

from pmcl.logs.bags.read import read_bag
from pmcl.logs.robot_log import RobotLog
from pmcl.maps.occupancy_grid import OCCUPIED, OccupancyGrid
from pmcl.models.quick import ReadAs
from pmcl.models.sensors.lidar.quick import QuickScans, ScanChange
from pmcl.preflight.check import preflight
from pmcl.simulations.lidar_room import simulate_lidar_room


@cache
def room():
    return simulate_lidar_room(90, 3)


def changed(log, grid=None, **changes):
    """The same log with another map, other variables, or other attributes of the scans."""
    dataset = log.dataset.copy(deep=True)
    for name, value in changes.items():
        if name in dataset.data_vars:
            dataset[name] = (dataset[name].dims, np.asarray(value, dtype=float), dataset[name].attrs)
        else:
            dataset["scan"].attrs[name] = value
    return RobotLog.from_dataset(dataset, "log with a mistake", grid or log.grid_map)


def turned(log, angle):
    pose = np.array(log.lidars[""].pose)
    pose[2] = np.mod(pose[2] + angle + np.pi, 2.0 * np.pi) - np.pi
    return changed(log, pose=pose)


def late(log, rows):
    """Scans with the stamp of so many rows later, which are a second apart."""
    scans = np.array(log.lidars[""].ranges)
    scans[rows:] = scans[:-rows].copy()
    return changed(log, scan=scans)


def flipped(log):
    grid = log.grid_map
    return changed(log, grid=OccupancyGrid(grid.cells[::-1].copy(), grid.resolution, grid.origin))


def moved(log, dx):
    grid = log.grid_map
    return changed(log, grid=OccupancyGrid(grid.cells, grid.resolution, (grid.origin[0] + dx, *grid.origin[1:])))


MISTAKES = {
    "laser-upside-down": lambda log: changed(log, scan_angle=-log.lidars[""].angles),
    "laser-yaw-off (180 degrees)": lambda log: turned(log, np.pi),
    "map-mirrored (rows from the top)": flipped,
    "start-elsewhere": lambda log: changed(log, start_mean=(12.0, 10.0, 2.0)),
    "stamps-off (late)": lambda log: late(log, 3),
    "laser-yaw-off (+90 degrees)": lambda log: turned(log, 0.5 * np.pi),
    "laser-yaw-off (-90 degrees)": lambda log: turned(log, -0.5 * np.pi),
    "ranges-in-millimetres": lambda log: changed(log, scan=1e3 * log.lidars[""].ranges),
    "ranges-in-centimetres": lambda log: changed(
        log, scan=1e2 * log.lidars[""].ranges, max_range=1e2 * log.lidars[""].max_range
    ),
    "start-elsewhere (another frame)": lambda log: moved(log, -4.0),
    "stamps-off (5 s)": lambda log: late(log, 5),
    "turn-sign-flipped": lambda log: changed(log, odometry=log.odometry * (1.0, 1.0, -1.0)),
    "odometry-columns-swapped": lambda log: changed(log, odometry=log.odometry[:, [1, 0, 2]]),
}

OF_LIDARS = (
    "laser-upside-down", "laser-yaw-off (180 degrees)", "map-mirrored (rows from the top)", "stamps-off (late)",
)  # fmt: skip


def names(log):
    return {finding.name for finding in preflight(log)}


@pytest.mark.slow
def test_a_sound_log_passes():
    assert preflight(room()) == ()


@pytest.mark.parametrize(
    # Those that only a lidar can have; the others are like those of the logs in test_preflight.
    "mistake",
    [pytest.param(name, marks=pytest.mark.slow if name in OF_LIDARS else pytest.mark.long) for name in MISTAKES],
)
def test_a_mistake_is_named(mistake):
    assert mistake.split(" (")[0] in names(MISTAKES[mistake](room()))


@pytest.mark.long
def test_a_start_that_is_not_known_is_no_mistake():
    unknown = changed(room(), start_std=np.full(3, np.inf))
    assert preflight(unknown) == ()
    assert "laser-upside-down" in names(MISTAKES["laser-upside-down"](unknown))


@pytest.mark.long
def test_sound_logs_pass():
    """None of thirty, of several sizes, fields of view and noises; a hundred were silent when this was written."""
    found = {}
    for seed in range(30):
        rng = np.random.default_rng([seed, 21])
        log = simulate_lidar_room(
            int(rng.integers(60, 160)),
            seed,
            {"sigma_hit": float(rng.choice([0.03, 0.08, 0.2])), "z_rand": float(rng.choice([0.02, 0.1, 0.3]))},
            n_rays=int(rng.choice([20, 60])),
        )
        found |= {seed: names(log)} if names(log) else {}
    assert found == {}


def scans_of(log):
    return QuickScans(log.lidars, log.grid_map, 0.1)


def test_the_density_is_that_of_the_nearest_occupied_cell():
    """Against a search through all occupied cells, for a log as it is, upside down and on a turned map."""
    log = room()
    scans, grid, laser = scans_of(log), log.grid_map, log.lidars[""]
    walls = grid.from_cells(np.argwhere(grid.cells == OCCUPIED)[:, ::-1] + 0.5)
    quarter, shift = np.array([[0.0, -1.0], [1.0, 0.0]]), np.array([3.0, -1.0])
    plain = np.eye(2), np.zeros(2)
    ways = [
        ReadAs(*plain), ReadAs(*plain, ScanChange(upside_down=True)), ReadAs(*plain, ScanChange(range_factor=0.5)),
        ReadAs(quarter, shift),
    ]  # fmt: skip
    density = scans.under(ways)
    x, y, heading, level, row = 4.0, 3.0, 0.7, 0.4, 7
    for h, (hand, factor) in enumerate([(1.0, 1.0), (-1.0, 1.0), (1.0, 0.5), (1.0, 1.0)]):
        rays = scans.rays(row)
        expected = 0.0
        for ray, reading in zip(rays.ray, rays.reading, strict=True):
            if factor * reading >= laser.max_range:
                expected += np.log(0.1)
                continue
            angle = heading + laser.pose[2] + hand * laser.angles[ray]
            c, s = np.cos(heading), np.sin(heading)
            end = np.array([x + c * laser.pose[0] - s * laser.pose[1], y + s * laser.pose[0] + c * laser.pose[1]])
            end += factor * reading * np.array([np.cos(angle), np.sin(angle)])
            end = quarter.T @ (end - shift) if h == 3 else end
            cell = np.floor(grid.to_cells(end)) + 0.5
            inside = (cell > 0).all() and (cell < np.array(grid.cells.shape[::-1])).all()
            distance = np.hypot(*(walls - grid.from_cells(cell)).T).min() if inside else np.inf
            hit = stats.norm.pdf(distance, scale=np.hypot(level * 0.1, 0.5 * grid.resolution))
            expected += np.log(0.9 * factor * (0.8 * hit + 0.2 / laser.max_range))
        got = density(row, np.array([h]), np.array([level]), *(np.array([[v]]) for v in (x, y, heading)))
        assert float(got[0, 0]) == pytest.approx(expected, abs=1e-4)  # distances are kept in single precision


def test_a_symmetric_map_is_recognised():
    cells = np.zeros((60, 80), dtype=np.uint8)
    cells[[0, -1]] = cells[:, [0, -1]] = OCCUPIED
    log = room()
    over_x, to_and_fro = np.diag((1.0, -1.0)), np.array([0.0, 6.0])
    square = QuickScans(log.lidars, OccupancyGrid(cells, 0.1), 0.1)
    assert square.is_same_map(over_x, to_and_fro)
    cells[:30, 40] = OCCUPIED
    assert not QuickScans(log.lidars, OccupancyGrid(cells, 0.1), 0.1).is_same_map(over_x, to_and_fro)


@pytest.mark.slow
def test_a_recorded_robot(shared_data):
    """Jarvis and its navigation laser, with rows chosen as AMCL would."""
    folder = shared_data / "jarvis"
    grid = OccupancyGrid.read(folder / "i-108_10mm.yaml")
    log = read_bag(
        folder / "jarvis_complex_path_fast.bag",
        scans=["/driver_laser_navigation/laser_scan"],
        truth="/pose_ground_truth",
        truth_to_map=(14.617, 3.361, -0.033),
        grid_map=grid,
    )
    assert preflight(log) == ()
    for mistake in ("laser-upside-down", "laser-yaw-off (180 degrees)", "laser-yaw-off (+90 degrees)",
                    "laser-yaw-off (-90 degrees)", "map-mirrored (rows from the top)"):  # fmt: skip
        assert mistake.split(" (")[0] in names(MISTAKES[mistake](log)), mistake
