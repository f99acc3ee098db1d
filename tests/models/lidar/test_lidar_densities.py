"""Densities of lidar readings against independent implementations, and how they add up."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from oracles import grid_maps
from oracles.grid_maps import beam_density, beam_probability
from scipy import integrate, stats

from pmcl.engine import contract
from pmcl.engine.residuals import theta_logpdf
from pmcl.engine.tables import NoExtras, with_fields
from pmcl.logs import LidarScans, RobotLog
from pmcl.maps import OccupancyGrid
from pmcl.models import Lidar
from pmcl.models.sensors.lidar.geometry import lengths_along
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


def at_once(table):
    """Return a table whose readings are not late."""
    if isinstance(table.extras, NoExtras):
        return table
    return with_fields(table, {"lag": np.zeros_like(table.extras.lag)})


def logpdf_along(table, path):
    values = np.zeros(len(path))
    scratch = np.empty((contract.scratch_rows(table), len(path)))
    contract.path_reading_logpdf(table, len(path), np.ascontiguousarray(path.T), values, scratch)
    return values


def to_disc(x, y, direction, disc):
    """Return the first positive distance at which a ray crosses a circle from outside; inf where there is none."""
    ahead = np.array([np.cos(direction), np.sin(direction)])
    away = np.array([x - disc[0], y - disc[1]])
    roots = np.roots([1.0, 2.0 * ahead @ away, away @ away - disc[2] ** 2])
    real = roots.real[np.abs(roots.imag) < 1e-12]
    return real.min() if real.size == 2 and real.min() > 0.0 else np.inf


def disc_density(z, expected, scale, max_range, model):
    if model == "beam":
        return beam_density(z, expected, max_range, *BEAM_THETA)
    sigma, z_rand = FIELD_THETA
    # An obstacle answers with the noise of any hit, what the cells hide included: small_log has cells of 0.1 m.
    sigma = np.hypot(sigma, 0.1 / np.sqrt(6.0))
    return (1.0 - z_rand) * stats.norm.pdf((z - expected) / scale, scale=sigma) + z_rand / max_range


def expected_logpdf(log, path, model, exponent, bias=0.0, scale=1.0, discs=()):
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
                length = grid_maps.cast(geometry, (x, y), direction, laser.max_range)
                length = min(length + WALL_DEPTH * log.grid_map.resolution, 100.0)
                if model == "beam":
                    value = beam_density(z, scale * length + bias, laser.max_range, *BEAM_THETA)
                elif z < laser.max_range:
                    reach = (z - bias) / scale
                    point = x + reach * np.cos(direction), y + reach * np.sin(direction)
                    value = grid_maps.field_density(log.grid_map, point, *FIELD_THETA, laser.max_range)
                else:
                    continue
                for disc in discs:
                    near = to_disc(x, y, direction, disc)
                    if near < length:
                        echo = disc_density(z, scale * near + bias, scale, laser.max_range, model)
                        value = (1.0 - disc[3]) * value + disc[3] * echo
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


@pytest.mark.parametrize(("model", "theta"), [("likelihood-field", FIELD_THETA), ("beam", BEAM_THETA)])
@pytest.mark.parametrize("weights", [(0.3, 1.0), (0.6, 0.0)])
def test_obstacles_answer_their_share_of_the_rays_that_meet_them_before_a_wall(rng, model, theta, weights):
    log, path = small_log(rng, rows=12)
    # One beside the third pose, and a large one in the middle of the map.
    middle = grid_maps.to_map(log.grid_map, 20.0, 15.0)
    discs = np.array([(path[3, 0] + 0.5, path[3, 1], 0.3, weights[0]), (*middle, 0.8, weights[1])])
    table = Lidar(model=model, exponent=0.25).bind(log).table(theta)
    plain = expected_logpdf(log, path, model, 0.25)
    table = table._replace(bias=table.bias + 0.1, scale=table.scale * 1.05)
    table = with_fields(table, {"obstacles": discs})
    expected = expected_logpdf(log, path, model, 0.25, 0.1, 1.05, discs)
    assert (np.abs(expected - plain) > 0.1).sum() >= 3
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
@pytest.mark.parametrize(("lag", "weight"), [(0.0, 0.0), (0.6, 0.0), (0.0, 0.7)])
def test_single_readings_add_up_to_their_scan(rng, model, theta, lag, weight):
    log, path = small_log(rng, rows=5)
    table = Lidar(model=model, exponent=0.1).bind(log).table(theta)
    t, n = 3, 7
    if lag or weight:
        disc = (path[t, 0] + 0.6, path[t, 1] + 0.3, 0.4, weight)
        table = with_fields(table, {"lag": np.full(5, lag), "obstacles": np.array([disc])})
    states = path[t][:, None] + 0.1 * rng.standard_normal((3, n))
    before = path[t - 1][:, None] + 0.1 * rng.standard_normal((3, n))
    rows = contract.scratch_rows(table)
    whole, total = np.zeros(n), np.zeros(n)
    contract.reading_logpdf(table, t, before, states, whole, np.empty((rows, n)))
    late = states - lag * (states - before)
    np.testing.assert_allclose(
        whole, [logpdf_of_rows(at_once(table), np.tile(late[:, i], (5, 1)))[t] for i in range(n)],
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


@pytest.mark.parametrize("model", ["likelihood-field", "beam"])
def test_distribution_function_beside_obstacles_is_that_of_the_draws(rng, model):
    """PITs of readings drawn beside an obstacle that answers half of the rays are uniform, and without it they are not.

    Rays that meet the obstacle only: the others are as in a table without it.
    """
    grid = OccupancyGrid(grid_maps.box(60, 60), 0.1, (0.0, 0.0, 0.0))
    rows, angles = 150, np.linspace(-0.2, 0.2, 9)
    lidars = {"": LidarScans(np.ones((rows, 9)), angles, 0.05, 8.0, np.zeros(3))}
    log = RobotLog.build(
        time=np.arange(rows, dtype=float), odometry=np.zeros((rows, 3)), lidars=lidars, grid_map=grid, warn=False
    )
    path = np.column_stack([rng.uniform(1.0, 1.5, rows), rng.uniform(2.9, 3.1, rows), np.zeros(rows)])
    theta = np.array([0.05, 0.0]) if model == "likelihood-field" else np.array([0.05, 0.0, 0.0, 0.0, 1.0])
    table = Lidar(model=model, exponent=1.0).bind(log).table(theta)
    beside = with_fields(table, {"obstacles": np.array([(3.0, 3.0, 0.8, 0.5)])})
    drawn = Lidar.simulate(beside, path, np.random.default_rng(3))

    def pit(judged):
        found, noise = [], np.random.default_rng(4)
        scratch, memory = np.empty((contract.scratch_rows(judged), 1)), np.empty((3, 1))
        for t in range(rows):
            state = path[t][:, None].copy()
            for slot in range(*contract.reading_slots(judged, t)):
                logp, low, high = np.empty((3, 1))
                assert contract.one_reading(judged, t, slot, state, state, logp, low, high, memory, scratch)
                found.append(low[0] + (high[0] - low[0]) * noise.random())
        return np.array(found)

    assert np.mean(drawn.reading < 2.3) == pytest.approx(0.5, abs=0.05)
    assert stats.kstest(pit(drawn), "uniform").statistic < 0.05
    assert stats.kstest(pit(table._replace(reading=drawn.reading)), "uniform").statistic > 0.3


@pytest.mark.parametrize("exponent", [1.0, 0.25, 1 / 30])
def test_replicated_scans_are_worth_what_the_exponent_says(exponent):
    """Means of scans scatter like those of beams * exponent independent beams; single readings are as ever."""
    grid = OccupancyGrid(grid_maps.box(60, 60), 0.1, (0.0, 0.0, 0.0))
    rows, rays = 1500, 360
    lidars = {"": LidarScans(np.ones((rows, rays)), np.linspace(-0.1, 0.1, rays), 0.05, 8.0, np.zeros(3))}
    log = RobotLog.build(
        time=np.arange(rows, dtype=float), odometry=np.zeros((rows, 3)), lidars=lidars, grid_map=grid, warn=False
    )
    table = Lidar(model="beam", exponent=exponent, max_beams=rays).bind(log)
    table = table.table(np.array([0.05, 0.0, 0.0, 0.0, 1.0]))
    path = np.tile((3.0, 3.0, 0.0), (rows, 1))
    drawn = Lidar.replicate(table, path, np.random.default_rng(2)).reading
    error = (drawn - lengths_along(table, path)) / 0.05
    assert error.std() == pytest.approx(1.0, rel=0.1)
    assert rays * exponent * error.mean(axis=1).var() == pytest.approx(1.0, rel=0.15)
    # Rows are independent.
    assert abs(np.corrcoef(error[:-1].mean(axis=1), error[1:].mean(axis=1))[0, 1]) < 0.1


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
