"""Moves between gross errors and kinks of the path keep the exact law, and lead from one to the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.monte_carlo import TOLERANCE, assert_agrees, off_by, standard_error

import pmcl
from pmcl.engine.linear_readings import BEARING, RANGE, times_of
from pmcl.filtering.particle_filter import draw_paths, log_joint, make_rng, run_filter
from pmcl.geometry import compose, wrap
from pmcl.models.sensor import sensor_of
from pmcl.models.sensors.landmarks.linearisation import ideal
from pmcl.sampling import doubtful_rows
from pmcl.sampling.doubtful_rows import Doubts, doubts_at, redrawn_where_doubtful
from pmcl.sampling.schedule import Schedule
from pmcl.sampling.transforms import Unconstrained
from pmcl.sampling.transport import Proposal, linearised_at, sharing_doubts, transport_moves
from pmcl.simulations.landmark_field import simulate_landmark_field

T = 10
# Readings less sharp than the motion, of which one in ten is a gross error.
VALUES = {"sigma_forward": 0.02, "sigma_left": 0.02, "sigma_turn": 0.02, "sigma_landmark_range": 0.1,
          "sigma_bearing": 0.05, "landmark_outlier_weight": 0.1}  # fmt: skip
# How far a function may be off, in its own standard deviations.
MATTERS = 0.2


def _bound():
    log = simulate_landmark_field(T, 5, bearings=True, n_landmarks=10, reach=7.0)
    return pmcl.default_model(log, outliers=True).bind(log)


def _theta(bound, **changes):
    return np.array([{**VALUES, **changes}.get(name, 0.0) for name in bound.names])


def _draw_path(tables, rng):
    path = np.empty((T, 3))
    path[0] = rng.normal(tables.start.mean, tables.start.std)
    for t in range(1, T):
        increment = rng.normal(tables.motion.mean[t], tables.motion.std[t])
        path[t] = compose(path[t - 1], increment)
        path[t, 2] = path[t - 1, 2] + increment[2]
    return path


def _driven(tables):
    """The path without noise."""
    path = np.tile(tables.start.mean, (T, 1))
    for t in range(1, T):
        path[t] = compose(path[t - 1], tables.motion.mean[t])
    return path


def _draw_readings(sensor, geometry, path, rng):
    """Draw the readings of a path with gross errors, in place."""
    n, which = sensor.time.size, sensor.landmark
    exact = ideal(sensor, path)
    gross = rng.random(n) < sensor.outlier_weight[which]
    ranges = np.where(gross, sensor.max_range * rng.random(n), rng.normal(exact[:, 0], sensor.range_std[which]))
    bearings = np.where(gross, rng.uniform(-np.pi, np.pi, n), rng.normal(exact[:, 1], sensor.bearing_std[which]))
    sensor.range[:], sensor.bearing[:] = ranges, wrap(bearings)
    for kind, values in ((RANGE, sensor.range), (BEARING, sensor.bearing)):
        of_kind = np.flatnonzero(geometry.kind == kind)
        assert of_kind.size == n
        # Both are in the order of time; of a row, in the order of its sightings.
        np.testing.assert_array_equal(geometry.channel[of_kind], which)
        geometry.reading[of_kind] = values


def _change(draws, seed):
    """Draw path and readings, and return by how much the move changes some functions of them."""
    bound = _bound()
    rng, sfc, theta = np.random.default_rng(seed), make_rng(seed), _theta(bound)
    tables = bound.tables(theta)[0]
    reference = _driven(tables)
    transport = linearised_at(bound, theta, [reference], Proposal(np.eye(bound.dimension)))
    (geometry,) = transport.geometries[0]
    geometry.weight[:] = 0.9
    doubtful = rng.random(geometry.weight.size) < 0.7
    doubts = Doubts(np.unique(times_of(geometry)[doubtful]), (doubtful,))
    found, moved = [], 0
    for _ in range(draws):
        path = _draw_path(tables, rng)
        _draw_readings(tables.sensors[0], geometry, path, rng)
        new, value = redrawn_where_doubtful(tables, (geometry,), reference, doubts, path, 2, sfc)
        assert value == pytest.approx(log_joint(tables, new))
        moved += not np.array_equal(new, path)
        found.append([_functions(tables, path), _functions(tables, new)])
    before, after = np.moveaxis(np.array(found), 1, 0)
    return (after - before) / before.std(axis=0), moved / draws


def _functions(tables, path):
    sensor = tables.sensors[0]
    off = (sensor.range - ideal(sensor, path)[:, 0]) / sensor.range_std[sensor.landmark]
    steps = np.diff(path, axis=0)
    return np.array([
        *path[[0, 4, 9]].ravel(), np.log1p(off**2).mean(), (np.abs(off) < 2.0).mean(),
        np.abs(steps).max(), (steps**2).mean(),
    ])  # fmt: skip


def test_the_move_keeps_the_law():
    change, moved = _change(4000, 1)
    assert moved > 0.3
    assert_agrees(change, 0.0, matters=MATTERS)


@pytest.mark.slow
@pytest.mark.parametrize("defect", ["too narrow", "always accepted"])
def test_mistakes_in_the_move_are_noticed(defect, monkeypatch):
    real = doubtful_rows.redraw_doubtful_rows

    def wrong(*given):
        *others, as_sound, noise, log_uniform = given
        if defect == "always accepted":
            return real(*others, as_sound, noise, np.full_like(log_uniform, -1e9))
        return real(*others, as_sound, 0.8 * noise, log_uniform)

    monkeypatch.setattr(doubtful_rows, "redraw_doubtful_rows", wrong)
    change, _ = _change(4000, 1)
    assert off_by(change, 0.0).max() > TOLERANCE


def _with_a_kink(bound, theta, row, turn):
    """Make the readings of a straight drive, but of one row as if the robot had turned and turned back."""
    tables = bound.tables(theta)[0]
    path = _driven(tables)
    kinked = path.copy()
    kinked[row, 2] += turn
    sensor = tables.sensors[0]
    exact = ideal(sensor, kinked)
    sensor.range[:], sensor.bearing[:] = exact[:, 0], wrap(exact[:, 1])
    return path, kinked


def test_only_a_model_with_gross_errors_has_doubtful_readings():
    bound, row = _bound(), 5
    for share in (0.0, 0.02):
        theta = _theta(bound, landmark_outlier_weight=share, sigma_bearing=0.01)
        straight, kinked = _with_a_kink(bound, theta, row, turn=0.18)
        tables = bound.tables(theta)[0]
        for path in (straight, kinked):
            geometry = (sensor_of(tables.sensors[0]).linearise(tables.sensors[0], path),)
            rows = doubts_at(tables, geometry, path).rows
            # The readings of the row do not fit the straight path, and the kinked path has an unlikely step before and
            # after it.
            assert list(rows) == ([] if share == 0.0 else [row] if path is straight else [row - 1, row, row + 1])


def _is_kinked(paths, row):
    return paths[..., row, 2] - 0.5 * (paths[..., row - 1, 2] + paths[..., row + 1, 2]) > 0.09


def _share_in_the_kink(tables, row, passes=16):
    """The share of paths with the kink, and its standard error, by filters so large that some particles turn."""
    evidence, share = np.empty(passes), np.empty(passes)
    for k in range(passes):
        rng = make_rng(k)
        filtered = run_filter(tables, T, 300_000, rng)
        evidence[k], share[k] = filtered.log_evidence, _is_kinked(draw_paths(tables, filtered, 500, rng), row).mean()
    weight = np.exp(evidence - evidence.max())
    mean = np.average(share, weights=weight)
    return mean, np.sqrt(np.sum((weight * (share - mean)) ** 2)) / weight.sum()


def test_chains_cross_between_gross_errors_and_a_kink():
    """With the move, chains from either side agree how often each explanation holds; without it they stay."""
    bound, row = _bound(), 5
    theta = _theta(bound, landmark_outlier_weight=0.02, sigma_bearing=0.01, sigma_turn=0.05)
    straight, kinked = _with_a_kink(bound, theta, row, turn=0.18)
    tables = bound.tables(theta)
    still = Proposal(1e-9 * np.eye(bound.dimension))

    def in_the_kink(path, *, crossing, steps):
        transport = linearised_at(bound, theta, [path], still, Schedule(block=4))
        other = linearised_at(bound, theta, [straight + kinked - path], still, Schedule(block=4))
        transport = sharing_doubts([transport, other])[0]
        assert row in transport.doubts[0].rows
        if not crossing:
            transport = replace(transport, doubts=())
        rng, found = make_rng(3), []
        for _ in range(steps):
            path = transport_moves(
                bound, theta, tables, [path], transport, Unconstrained(bound.parameters), 1, 1.0, rng
            ).paths[0]
            found.append(_is_kinked(path, row))
        return np.array(found)

    one, other = (in_the_kink(path, crossing=True, steps=3000) for path in (straight, kinked))
    for found in (one, other):
        assert np.count_nonzero(np.diff(found)) > 80
    batches = [found.reshape(30, -1).mean(axis=1) for found in (one, other)]
    assert_agrees(batches[0] - batches[1], 0.0, matters=0.2)
    exact, error = _share_in_the_kink(tables[0], row)
    assert 0.1 < exact < 0.9
    assert abs(np.mean(batches) - exact) < TOLERANCE * np.hypot(error, standard_error(np.concatenate(batches)))
    assert TOLERANCE * error < 0.15
    for path, inside in ((straight, False), (kinked, True)):
        assert (in_the_kink(path, crossing=False, steps=1000) == inside).mean() > 0.9
