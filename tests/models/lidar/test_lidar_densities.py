"""Densities of lidar readings against independent implementations, and how they add up."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import grid_maps
from oracles.grid_maps import beam_density

from pmcl.engine import contract
from pmcl.logs import LidarScans, RobotLog
from pmcl.maps import OccupancyGrid
from pmcl.models import Lidar
from pmcl.models.sensors.lidar.kernels.casting import WALL_DEPTH

FIELD_THETA = np.array([0.13, 0.2])
BEAM_THETA = np.array([0.13, 0.15, 0.1, 0.2, 0.7])
ORIGIN = (-1.3, 0.4, 0.6)


def small_log(rng, rows=6, origin=ORIGIN, resolution=0.1):
    """Return a log with two lasers on a small grid of random cells, turned in the map frame, and poses inside it."""
    grid = OccupancyGrid(grid_maps.random_grid(rng), resolution, origin)
    front, back = rng.uniform(0.0, 4.5, (rows, 9)), rng.uniform(0.0, 3.5, (rows, 4))
    front[0, :3] = np.nan, np.inf, 4.0
    front[1] = np.nan
    back[1] = np.nan
    lidars = {
        "front": LidarScans(front, np.linspace(-1.5, 1.5, 9), 0.05, 4.0, np.array([0.2, 0.05, 0.1])),
        "back": LidarScans(back, np.linspace(2.0, 3.0, 4)[::-1].copy(), 0.05, 3.0, np.array([-0.2, 0.0, np.pi])),
    }
    log = RobotLog.build(
        time=np.arange(rows, dtype=float), odometry=np.zeros((rows, 3)), lidars=lidars, grid_map=grid, warn=False
    )
    inside = rng.uniform((2.0, 2.0), (38.0, 28.0), (rows, 2))
    path = np.column_stack([*grid_maps.to_map(grid, *inside.T), rng.uniform(-4.0, 4.0, rows)])
    return log, path


def logpdf_of_rows(table, path):
    """Return the log density of each row, (T,), evaluated row by row as a filter does."""
    values = np.zeros(len(path))
    for t in range(len(path)):
        if contract.has_reading(table, t):
            state, logp = path[t][:, None].copy(), np.zeros(1)
            before = path[max(t - 1, 0)][:, None].copy()
            contract.reading_logpdf(table, t, before, state, logp, np.empty((contract.scratch_rows(table), 1)))
            values[t] = logp[0]
    return values


def logpdf_along(table, path):
    values = np.zeros(len(path))
    scratch = np.empty((contract.scratch_rows(table), len(path)))
    contract.path_reading_logpdf(table, len(path), np.ascontiguousarray(path.T), values, scratch)
    return values


def expected_logpdf(log, path, model, exponent, bias=0.0, scale=1.0):
    """Return the log density of each row from the definitions."""
    values = np.zeros(len(path))
    geometry = grid_maps.cells_of(log.grid_map)
    for laser in log.lidars.values():
        for t, pose in enumerate(path):
            for z, angle in zip(laser.ranges[t], laser.angles, strict=True):
                if np.isnan(z) or z <= laser.min_range:
                    continue
                x, y, yaw = laser.pose
                x, y, direction = grid_maps.beam_poses(pose, (x, y, yaw + angle))
                z = min(z, laser.max_range)
                if model == "beam":
                    length = grid_maps.cast(geometry, (x, y), direction, laser.max_range)
                    length = min(length + WALL_DEPTH * log.grid_map.resolution, 100.0)
                    value = beam_density(z, scale * length + bias, laser.max_range, *BEAM_THETA)
                elif z < laser.max_range:
                    reach = (z - bias) / scale
                    point = x + reach * np.cos(direction), y + reach * np.sin(direction)
                    value = grid_maps.field_density(log.grid_map, point, *FIELD_THETA, laser.max_range)
                else:
                    continue
                values[t] += exponent * np.log(value)
    return values


@pytest.mark.parametrize(("model", "theta"), [("likelihood-field", FIELD_THETA), ("beam", BEAM_THETA)])
@pytest.mark.parametrize(("bias", "scale"), [(0.0, 1.0), (0.1, 1.05)])
def test_density_of_scans(rng, model, theta, bias, scale):
    log, path = small_log(rng)
    table = Lidar(model=model, exponent=0.25).bind(log).table(theta)
    table = table._replace(bias=table.bias + bias, scale=table.scale * scale)
    expected = expected_logpdf(log, path, model, 0.25, bias, scale)
    assert (expected[[0, 2, 3]] != 0.0).all()
    np.testing.assert_allclose(logpdf_of_rows(table, path), expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(logpdf_along(table, path), expected, rtol=1e-9, atol=1e-9)
