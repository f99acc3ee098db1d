"""Rays on a grid against the geometry of its occupied cells, and scans linearised around a path."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import grid_maps

from pmcl.maps import OccupancyGrid
from pmcl.models import Lidar
from pmcl.models.sensors.lidar.geometry import lengths_along, ray_origins
from pmcl.models.sensors.lidar.kernels.casting import WALL_DEPTH, free_squares, ray_lengths
from pmcl.simulations.lidar_room import simulate_lidar_room

AHEAD = np.zeros((1, 3))


def lengths(grid, poses, reach=100.0, mounts=AHEAD):
    """Return lengths to the near side of the first occupied cell."""
    cast = ray_lengths(
        free_squares(grid.cells == 1), grid.resolution, np.array(grid.origin), mounts, np.full(len(mounts), reach),
        np.atleast_2d(poses),
    )  # fmt: skip
    return cast - WALL_DEPTH * grid.resolution


@pytest.mark.parametrize("share", [0.003, 0.05, 0.3])
@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (-2.0, 3.5, 0.8)])
def test_rays_end_at_the_first_occupied_cell(rng, share, origin):
    grid = OccupancyGrid(grid_maps.random_grid(rng, share=share), 0.1, origin)
    geometry = grid_maps.cells_of(grid)
    inside = rng.uniform((0.01, 0.01), (39.99, 29.99), (150, 2))
    poses = np.column_stack([*grid_maps.to_map(grid, *inside.T), rng.uniform(-4.0, 4.0, 150)])
    expected = [grid_maps.cast(geometry, pose[:2], pose[2], 6.0) for pose in poses]
    assert np.isfinite(expected).sum() > 10
    np.testing.assert_allclose(lengths(grid, poses)[:, 0], expected, atol=1e-9)


def test_rays_along_rows_columns_and_diagonals(rng):
    """From corners, centres and the border of the map: the angles at which a ray touches cells without entering."""
    cells = np.zeros((9, 12), dtype=np.uint8)
    cells[4, 10] = cells[8, 3] = 1
    grid = OccupancyGrid(cells, 1.0)
    east, north = lengths(grid, [(2.5, 4.5, 0.0), (3.5, 0.5, 0.5 * np.pi)])[:, 0]
    assert (east, north) == (7.5, pytest.approx(7.5))
    assert lengths(grid, [(6.5, 0.5, 0.25 * np.pi)])[0, 0] == pytest.approx(3.5 * np.sqrt(2.0))
    assert np.isinf(lengths(grid, [(2.5, 5.5, 0.0), (2.5, 4.5, np.pi)])).all()
    # The far side of a map, and poses that are outside it or no number, meet nothing; none of them hangs.
    assert np.isinf(lengths(grid, [(-1.0, 4.5, 0.0), (12.0, 4.5, np.pi), (np.nan, 4.5, 0.0), (np.inf, 1.0, 0.0)])).all()
    assert lengths(grid, [(10.5, 4.5, 0.3)])[0, 0] == 0.0


def test_rays_end_at_the_reach(rng):
    cells = np.zeros((5, 300), dtype=np.uint8)
    cells[:, 290] = 1
    grid = OccupancyGrid(cells, 0.1)
    assert np.isinf(lengths(grid, [(0.05, 0.25, 0.0)], reach=20.0)).all()
    assert lengths(grid, [(0.05, 0.25, 0.0)], reach=30.0)[0, 0] == pytest.approx(28.95)


def test_squares_are_free_and_largest(rng):
    occupied = grid_maps.random_grid(rng, 17, 23, 0.04) == 1
    sides = free_squares(occupied)
    for quadrant, (right, up) in enumerate([(0, 0), (1, 0), (0, 1), (1, 1)]):
        for j, i in np.ndindex(occupied.shape):
            def part(side, j=j, i=i, right=right, up=up):
                rows = slice(j, j + side) if up else slice(max(j - side + 1, 0), j + 1)
                return occupied[rows, slice(i, i + side) if right else slice(max(i - side + 1, 0), i + 1)]

            side = int(sides[quadrant, j, i])
            assert not part(side).any()
            assert side == 255 or part(side + 1).any()


@pytest.mark.parametrize("model", ["likelihood-field", "beam"])
def test_linearised_scans(model):
    """Slopes against differences of the distance to the same wall; the few rays that cross an edge are told apart."""
    log = simulate_lidar_room(40, 2, sensor=Lidar(model=model))
    bound = Lidar(model=model).bind(log)
    table = bound.table(np.array([0.08, 0.05] if model == "likelihood-field" else [0.08, 0.05, 0.02, 0.05, 0.5]))
    path = log.true_poses.copy()
    linear = Lidar.linearise(table, path)
    time = np.repeat(np.arange(40), np.diff(linear.first))
    read = np.count_nonzero(table.reading < table.max_range)
    assert 0.5 * read < time.size <= read
    if model == "beam":
        np.testing.assert_allclose(linear.value, lengths_along(table, path)[time, linear.channel])
    straight = []
    for d, step in enumerate((0.2, 0.2, 0.05)):
        shift = np.zeros(3)
        shift[d] = step
        ahead, behind = (lengths_along(table, path + sign * shift)[time, linear.channel] for sign in (1.0, -1.0))
        with np.errstate(invalid="ignore"):
            slope = (ahead - behind) / (2.0 * step)
        # The side of a cell makes a length uncertain by as much; a ray that crosses an edge jumps.
        straight.append(np.abs(slope - linear.jacobian[:, d]) * step < 0.15)
    assert np.mean(np.all(straight, axis=0)) > (0.85 if model == "beam" else 0.75)


def test_moved_mounts_change_the_linearisation_by_geometry():
    log = simulate_lidar_room(20, 3)
    table = Lidar().bind(log).table(np.array([0.08, 0.05]))
    path = log.true_poses.copy()
    linear = Lidar.linearise(table, path)
    assert Lidar.moved_linearisation(table._replace(exponent=0.5), table, linear, path) is linear
    # A laser that is moved ahead sees what a robot sees that has moved ahead.
    shift = np.array([0.1, -0.05, 0.0])
    moved = Lidar.moved_linearisation(table._replace(beam_pose=table.beam_pose + shift), table, linear, path)
    time = np.repeat(np.arange(20), np.diff(linear.first))
    c, s = np.cos(path[time, 2]), np.sin(path[time, 2])
    displacement = np.column_stack([c * 0.1 + s * 0.05, s * 0.1 - c * 0.05])
    expected = linear.value + np.einsum("kd,kd->k", linear.jacobian[:, :2], displacement)
    np.testing.assert_allclose(moved.value, expected, atol=1e-9)


def test_ray_origins(rng):
    log = simulate_lidar_room(3, 1, pose=(0.3, -0.1, 0.7))
    table = Lidar().bind(log).table(np.array([0.1, 0.1]))
    path = rng.standard_normal((3, 3))
    origins, directions = ray_origins(table, path)
    for t in range(3):
        x, y, direction = grid_maps.beam_poses(path[t], table.beam_pose[7])
        np.testing.assert_allclose([*origins[t, 7], directions[t, 7]], [x, y, direction])
