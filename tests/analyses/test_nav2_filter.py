"""The filter of ``analyses/lidar_on_real_robots`` weighs and moves as nav2 does, by formulas written for one pose."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from oracles.amcl_formulas import nav2_beam, nav2_likelihood_field, nav2_prob_step, nav2_step, sample_differential

from pmcl.geometry import wrap
from pmcl.maps.occupancy_grid import OccupancyGrid

FOLDER = Path(__file__).parents[2] / "analyses" / "lidar_on_real_robots"
# Imported with all tests: kernels of a source that comes later would make those of other tests be compiled again.
sys.path.insert(0, str(FOLDER))
try:
    import nav2_filter
finally:
    sys.path.remove(str(FOLDER))

pytestmark = pytest.mark.slow
MOUNT = (0.2, -0.05, 0.1)
MAX_RANGE = 12.0


@pytest.fixture(scope="module")
def nav2():
    return nav2_filter


@pytest.fixture(scope="module")
def scene():
    """A room whose right wall is the map's edge, poses in it, and a scan of 131 rays with odd readings."""
    cells = np.zeros((60, 85), dtype=np.uint8)
    cells[[0, -1]] = cells[:, [5, -1]] = OccupancyGrid.OCCUPIED
    cells[30:34, 40:44] = OccupancyGrid.OCCUPIED
    cells[:, :5] = OccupancyGrid.UNKNOWN
    grid = OccupancyGrid(cells, 0.1, (-1.0, 2.0, 0.0))
    rng = np.random.default_rng(7)
    poses = np.column_stack([rng.uniform(0, 7, 40), rng.uniform(2.5, 7.5, 40), rng.uniform(-4, 4, 40)])
    ranges = rng.uniform(0.5, 10.0, 131)
    ranges[[3, 60, 61]] = np.inf, np.nan, 11.9
    return grid, poses, ranges, np.linspace(-2.0, 2.0, 131)


def cell(grid, x, y):
    """Column and row of the cell that nav2 looks a point up in: the one whose lower left corner is nearest."""
    return math.floor((x - grid.origin[0]) / grid.resolution + 0.5), math.floor(
        (y - grid.origin[1]) / grid.resolution + 0.5
    )


def distance_on(grid):
    rows, columns = grid.cells.shape

    def distance(x, y):
        column, row = cell(grid, x, y)
        return grid.distance_field[row, column] if 0 <= row < rows and 0 <= column < columns else None

    return distance


def yaml(settings):
    names = ("sigma_hit", "z_hit", "z_rand", "z_short", "z_max", "lambda_short", "laser_max_range", "max_beams")
    return {name: getattr(settings, name) for name in names} | {
        "laser_min_range": -1.0, "laser_likelihood_max_dist": 2.0,
    }  # fmt: skip


@pytest.mark.parametrize("product", [False, True])
@pytest.mark.parametrize("beams", [17, 60, 200])
def test_weights_of_a_likelihood_field_are_those_of_nav2(nav2, scene, product, beams):
    grid, poses, ranges, angles = scene
    rule = nav2.PRODUCT if product else nav2.CUBES
    settings = nav2.Settings((0.2,) * 4, 0.2, 0.5, 0.4, rule, laser_max_range=11.0, max_beams=beams)
    scan = nav2.scan_of(ranges, angles, MOUNT, MAX_RANGE, settings)
    assert scan.ranges.size == len(range(0, 131, (nav2_prob_step if product else nav2_step)(131, beams)))
    found = nav2.weigh(nav2.grid_of_nav2(grid), scan, poses, settings)
    expected = [
        nav2_likelihood_field(
            pose, ranges, angles, yaml(settings), distance_on(grid), mount=MOUNT, scan_max=MAX_RANGE, prob=product
        )
        for pose in poses
    ]
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    # The map with a margin is another filter: some readings end behind the wall at the edge.
    wide = nav2.weigh(nav2.grid_of_nav2(grid.with_margin(2.0)), scan, poses, settings)
    assert np.abs(wide - found).max() > 0.01


def test_weights_are_tempered_and_normalised_as_asked(nav2, scene):
    grid, poses, ranges, angles = scene
    settings = nav2.Settings((0.2,) * 4, 0.1, 0.5, 0.5, nav2.PRODUCT)
    arrays = nav2.grid_of_nav2(grid)
    scan = nav2.scan_of(ranges, angles, MOUNT, MAX_RANGE, settings)
    plain = nav2.weigh(arrays, scan, poses, settings)
    np.testing.assert_allclose(nav2.weigh(arrays, scan, poses, settings._replace(exponent=0.1)), 0.1 * plain)
    height = 0.5 / (0.1 * math.sqrt(2.0 * math.pi))
    as_height = nav2.weigh(arrays, scan, poses, settings._replace(z_hit=height))
    np.testing.assert_allclose(nav2.weigh(arrays, scan, poses, settings._replace(beluga=True)), as_height)


def bresenham(start, stop):
    """Cells of a line, by its equation: for each step along the longer axis, the nearest cell across; halves go on."""
    (x0, y0), (x1, y1) = start, stop
    dx, dy = x1 - x0, y1 - y0
    n = max(abs(dx), abs(dy))
    for k in range(n + 2):
        along, across = (dx, dy) if abs(dy) <= abs(dx) else (dy, dx)
        # Whole numbers: how often |across| k / n, rounded half up, has been reached.
        off = (2 * k * abs(across) + n) // (2 * n) if n else 0
        u, v = int(math.copysign(k, along)) if along > 0 else -k, off if across > 0 else -off
        yield (x0 + u, y0 + v) if abs(dy) <= abs(dx) else (x0 + v, y0 + u)


def test_rays_of_the_beam_model_end_where_nav2_ends_them(nav2, scene):
    grid, poses, ranges, angles = scene
    settings = nav2.Settings((0.1,) * 4, 0.1, 0.5, 0.4, nav2.CUBES, beam=True, laser_max_range=11.0)
    scan = nav2.scan_of(ranges, angles, MOUNT, MAX_RANGE, settings)
    found = nav2.weigh(nav2.grid_of_nav2(grid), scan, poses, settings)
    rows, columns = grid.cells.shape
    reach = 11.0
    for pose, weight in zip(poses, found, strict=True):
        cubes = 1.0
        c, s = math.cos(pose[2]), math.sin(pose[2])
        x, y = pose[0] + c * MOUNT[0] - s * MOUNT[1], pose[1] + s * MOUNT[0] + c * MOUNT[1]
        for i in range(0, 131, nav2_step(131, 60)):
            if math.isnan(ranges[i]):
                continue
            reading = reach if math.isinf(ranges[i]) else ranges[i]
            direction = pose[2] + MOUNT[2] + angles[i]
            first = cell(grid, x, y)
            expected = reach
            last = cell(grid, x + reach * math.cos(direction), y + reach * math.sin(direction))
            for column, row in bresenham(first, last):
                outside = not (0 <= row < rows and 0 <= column < columns)
                if outside or grid.cells[row, column] != grid.FREE:
                    expected = math.hypot(column - first[0], row - first[1])
                    # As in nav2, which measures along the longer axis first; the same number.
                    expected *= grid.resolution
                    break
            cubes += nav2_beam(reading, expected, yaml(settings)) ** 3
        assert weight == pytest.approx(math.log(cubes), rel=1e-9)


@pytest.mark.parametrize("increment", [(0.3, 0.05, 0.2), (-0.3, 0.0, 0.1), (0.005, 0.0, 0.4)])
def test_particles_move_as_those_of_nav2(nav2, increment):
    alphas, start, n = (0.2, 0.1, 0.3, 0.05), np.array([1.0, -2.0, 2.5]), 40_000
    particles = np.tile(start, (n, 1))
    nav2.move(particles, np.array(increment), *alphas, np.random.default_rng(1))
    expected = sample_differential(start, increment, alphas, np.random.default_rng(2), n)
    for off in particles - start, expected - start:
        off[:, 2] = wrap(off[:, 2])
    a, b = particles - start, expected - start
    a[:, 2], b[:, 2] = wrap(a[:, 2]), wrap(b[:, 2])
    error = np.sqrt(2.0 * b.var(axis=0) / n)
    assert (np.abs(a.mean(axis=0) - b.mean(axis=0)) < 5.0 * error).all()
    # The variance of a normal's estimated variance is 2 sd^4 / n; wrapped and bent ones have somewhat heavier tails.
    np.testing.assert_allclose(np.cov(a.T), np.cov(b.T), atol=5.0 * 2.0 * np.sqrt(2.0 / n) * b.var(axis=0).max())


def test_kld_sampling_stops_as_nav2_does(nav2):
    rng = np.random.default_rng(3)
    together = np.tile([0.1, 0.1, 0.05], (1000, 1))
    uniform = np.full(1000, 1e-3)
    # One bin alone asks for all particles; two ask for fewer than the least number.
    assert len(nav2.resample(together, uniform, 500, 2000, rng)) == 2000
    apart = together + np.outer(np.arange(1000) % 2, [0.5, 0.0, 0.0])
    assert len(nav2.resample(apart, uniform, 500, 2000, rng)) == 501
    # 120 bins ask for ceil(119 / 0.1 * (1 - b + sqrt(b) 0.99)^3), b = 2 / (9 119): 1340, and one is drawn after that.
    b = 2.0 / (9.0 * 119.0)
    limit = math.ceil(1190.0 * (1.0 - b + math.sqrt(b) * 0.99) ** 3)
    spread = together + np.outer(np.arange(1000) % 120, [0.5, 0.0, 0.0])
    assert len(nav2.resample(spread, uniform, 500, 2000, rng)) == limit + 1
    # Particles without weight have no children, and a single one has all.
    only = np.zeros(1000)
    only[17] = 1.0
    spread[17] = 42.0
    assert (nav2.resample(spread, only, 500, 2000, rng) == 42.0).all()


def test_a_scan_that_every_particle_makes_impossible_is_ignored(nav2, scene):
    from pmcl.logs.arrays import LidarScans
    from pmcl.logs.robot_log import RobotLog

    grid, _, _, angles = scene
    scans = LidarScans(np.full((3, 131), 11.0), angles, 0.0, MAX_RANGE, np.array(MOUNT))
    log = RobotLog.build(
        time=np.arange(3.0), odometry=np.full((3, 3), 0.01), lidars={"": scans}, grid_map=grid,
        start_mean=(3.0, 5.0, 0.0), start_std=(0.1, 0.1, 0.1), warn=False,
    )  # fmt: skip
    settings = nav2.Settings((0.1,) * 4, 0.02, 0.5, 1e-9, nav2.PRODUCT)
    start = {"start_mean": np.array([3.0, 5.0, 0.0]), "start_std": np.full(3, 0.1)}
    impossible = nav2.run_filter(log, nav2.grid_of_nav2(grid), settings, 0, **start)
    assert impossible.ignored.all()
    np.testing.assert_allclose(impossible.ess, impossible.n)
    likely = nav2.run_filter(log, nav2.grid_of_nav2(grid), settings._replace(z_rand=0.5), 0, **start)
    assert not likely.ignored.any()
