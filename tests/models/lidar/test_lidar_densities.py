"""Densities of lidar readings against independent implementations, and how they add up."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from oracles import grid_maps
from oracles.grid_maps import beam_density, beam_probability
from scipy import integrate

from pmcl.engine import contract
from pmcl.engine.residuals import theta_logpdf
from pmcl.engine.tables import NoExtras, with_fields
from pmcl.logs import LidarScans, RobotLog
from pmcl.maps import OccupancyGrid
from pmcl.models import Lidar
from pmcl.models.sensors.lidar.kernels.beam import beam_below, beam_logpdf
from pmcl.models.sensors.lidar.kernels.casting import WALL_DEPTH
from pmcl.models.sensors.lidar.tempering import usual_exponent

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


@pytest.mark.parametrize("length", [0.02, 0.4, 3.0, 3.95, 6.0])
@pytest.mark.parametrize("theta", [BEAM_THETA, *np.array([(0.02, 0.0, 0.0, 0.3, 1.0), (1.0, 0.3, 0.1, 0.0, 4.0)])])
def test_beam_model_sums_to_one(length, theta):
    """The kernel's own density, integrated over all ranges, and the probability of no echo."""
    reach, z_hit = 4.0, 1.0 - theta[1:4].sum()
    weights = (z_hit, *theta[1:4], theta[4])

    def density(z):
        return np.exp(beam_logpdf(z, length, reach, theta[0], *weights))

    edges = np.unique(np.clip([0.0, length - 5 * theta[0], length, length + 5 * theta[0], reach], 0.0, reach))
    parts = [integrate.quad(density, a, b, epsabs=1e-12, limit=200)[0] for a, b in itertools.pairwise(edges)]
    assert sum(parts) + density(reach) == pytest.approx(1.0, abs=1e-8)
    for z in (0.1, 0.5 * length, 0.9 * min(length, reach), 3.99):
        below = beam_below(z, length, reach, theta[0], *weights)
        assert below[0] == below[1] == pytest.approx(beam_probability(0.0, z, length, reach, *theta), abs=1e-8)
    low, high = beam_below(reach, length, reach, theta[0], *weights)
    assert high == 1.0
    assert high - low == pytest.approx(density(reach), abs=1e-12)


def test_weights_beyond_one_have_no_density(rng):
    log, path = small_log(rng)
    beam = Lidar(model="beam").bind(log).table(np.array([0.1, 0.5, 0.4, 0.2, 1.0]))
    assert (logpdf_of_rows(beam, path)[[0, 2, 3]] == -np.inf).all()
    statistics = Lidar(model="beam").bind(log).statistics(
        beam, path, Lidar.ideal_readings(beam, path), np.arange(5), np.array([0.1, 0.5, 0.4, 0.2, 1.0])
    )
    assert theta_logpdf(statistics, np.array([0.1, 0.5, 0.4, 0.2, 1.0])) == -np.inf


@pytest.mark.parametrize(("model", "theta"), [("likelihood-field", FIELD_THETA), ("beam", BEAM_THETA)])
def test_statistics_have_the_density_of_the_path(rng, model, theta):
    """What the Metropolis update sees differs from the density of all rows by the same number for every theta."""
    log, path = small_log(rng, rows=20)
    bound = Lidar(model=model).bind(log)
    table = bound.table(theta)
    table = table._replace(bias=table.bias + 0.05)
    statistics = bound.statistics(table, path, Lidar.ideal_readings(table, path), np.arange(theta.size), theta)
    differences = []
    for factor in (1.0, 0.7, 1.3):
        other = bound.table(theta * factor)._replace(bias=table.bias)
        differences.append(theta_logpdf(statistics, theta * factor) - logpdf_along(other, path).sum())
    np.testing.assert_allclose(differences, 0.0, atol=1e-9)


@pytest.mark.parametrize(("model", "theta"), [("likelihood-field", FIELD_THETA), ("beam", BEAM_THETA)])
@pytest.mark.parametrize("lag", [0.0, 0.6])
def test_single_readings_add_up_to_their_scan(rng, model, theta, lag):
    log, path = small_log(rng, rows=5)
    table = Lidar(model=model, exponent=0.1).bind(log).table(theta)
    if lag:
        table = with_fields(table, {"lag": np.full(5, lag)})
    t, n = 3, 7
    states = path[t][:, None] + 0.1 * rng.standard_normal((3, n))
    before = path[t - 1][:, None] + 0.1 * rng.standard_normal((3, n))
    rows = contract.scratch_rows(table)
    whole, total = np.zeros(n), np.zeros(n)
    contract.reading_logpdf(table, t, before, states, whole, np.empty((rows, n)))
    late = states - lag * (states - before)
    np.testing.assert_allclose(
        whole, [logpdf_of_rows(table._replace(extras=NoExtras()), np.tile(late[:, i], (5, 1)))[t] for i in range(n)],
        rtol=1e-9,
    )  # fmt: skip
    scratch, memory = np.empty((rows, n)), np.empty((3, n))
    first, stop = contract.reading_slots(table, t)
    index = Lidar.index(table, 5)
    for slot in range(first, stop):
        logp, low, high = np.empty((3, n))
        if contract.one_reading(table, t, slot, before, states, logp, low, high, memory, scratch):
            total += logp
            assert (low <= high).all()
            assert (low > -1e-9).all()
            assert (high < 1.0 + 1e-9).all()
            assert not np.isnan(index.reading[slot])
    np.testing.assert_allclose(contract.reading_exponent(table) * total, whole, rtol=1e-9)


def test_usual_exponent():
    assert [usual_exponent(beams) for beams in (1, 2, 8, 60, 1000)] == [1.0, 1.0, 0.25, 2 / 60, 0.002]


def test_index_and_store(rng):
    """Rays keep their names and numbers; rays that the model does not read are not measured in what it stores."""
    log, _ = small_log(rng)
    table = Lidar(max_beams=5, exponent=1.0).bind(log).table(FIELD_THETA)
    index = Lidar.index(table, 6)
    assert index.kinds == ("scan_front", "scan_back")
    dataset = log.dataset.copy(deep=True)
    Lidar.store(table._replace(reading=np.arange(54.0).reshape(6, 9)), dataset)
    for kind, name, rays in ((0, "scan_front", [0, 2, 4, 6, 8]), (1, "scan_back", [0, 1, 2, 3])):
        mine = index.kind == kind
        assert np.unique(index.channel[mine]).tolist() == rays
        stored = dataset[name].values
        assert np.flatnonzero(~np.isnan(stored).all(axis=0)).tolist() == rays
        np.testing.assert_array_equal(stored[index.time[mine], index.channel[mine]], np.arange(54.0)[mine])


def test_the_density_of_a_likelihood_field_is_bounded(rng):
    """Many readings end in occupied cells, at distance 0: without noise of the cells sigma_hit would fall to 0."""
    log, path = small_log(rng)
    bound = Lidar(exponent=1.0).bind(log)
    noise = log.grid_map.resolution / np.sqrt(6.0)
    highest = np.log(1.0 / (noise * np.sqrt(2.0 * np.pi)))
    index = np.array([0, 1])
    for sigma in (1.0, 1e-3, 1e-12, 0.0):
        theta = np.array([sigma, 0.1])
        table = bound.table(theta)
        assert table.level_log_density.max() < highest
        assert table.std[0] == pytest.approx(np.hypot(sigma, noise), rel=1e-12)
        statistics = bound.statistics(table, path, Lidar.ideal_readings(table, path), index, theta)
        assert theta_logpdf(statistics, theta) == pytest.approx(logpdf_along(table, path).sum(), rel=1e-9)
