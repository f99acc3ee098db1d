"""From clocks of their own to regular samples: exact values, and an independent integrator."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pmcl.errors import LogError
from pmcl.geometry import compose, integrate_twist
from pmcl.logs.resample import hold_and_integrate, interpolate_poses, nearest_sample, regular_times, sort_sightings


def test_regular_times_reach_a_last_time_that_is_on_the_grid():
    np.testing.assert_allclose(regular_times(0.0, 0.3, 0.1), [0.0, 0.1, 0.2, 0.3])
    np.testing.assert_allclose(regular_times(2.0, 2.99, 0.5), [2.0, 2.5])
    assert len(regular_times(1.0, 0.0, 0.5)) == 0


@pytest.mark.parametrize(("last", "period"), [(10.0, 1e-9), (1e300, 0.5), (10.0, 1e-300), (1.7e18, 0.5)])
def test_more_samples_than_a_log_may_have_are_refused(last, period):
    with pytest.raises(LogError, match=r"recording: expected at most 2000000 samples, got .* choose a longer period"):
        regular_times(0.0, last, period, "recording")


def test_times_that_a_period_does_not_tell_apart_are_refused():
    with pytest.raises(LogError, match="choose a longer period, and check that times are in seconds"):
        regular_times(1.7e18, 1.7e18 + 512.0, 0.5)


def test_a_held_velocity_runs_along_its_arc():
    odometry = hold_and_integrate(
        np.array([0.0]), np.array([math.pi]), np.array([math.pi / 2]), np.array([0.5, 1.5, 3.5])
    )
    np.testing.assert_allclose(odometry, [[0, 0, 0], [2, 2, math.pi / 2], [0, 4, math.pi]], atol=1e-14)


def test_a_velocity_holds_until_the_next_one():
    odometry = hold_and_integrate(
        np.array([0.0, 0.3, 1.2]), np.array([1.0, 2.0, 5.0]), np.zeros(3), np.array([0.0, 1.0, 2.0])
    )
    np.testing.assert_allclose(odometry[:, 0], [0.0, 0.3 + 2.0 * 0.7, 2.0 * 0.2 + 5.0 * 0.8], rtol=1e-14)


def test_of_two_velocities_at_one_time_the_last_counts():
    odometry = hold_and_integrate(
        np.array([0.0, 1.0, 1.0]), np.array([1.0, 7.0, 3.0]), np.zeros(3), np.array([0.0, 1.0, 2.0])
    )
    np.testing.assert_allclose(odometry[:, 0], [0.0, 1.0, 3.0])


def test_turns_of_more_than_half_a_revolution_are_kept():
    odometry = hold_and_integrate(np.array([0.0]), np.array([0.0]), np.array([4.0]), np.array([0.0, 1.0, 2.0]))
    np.testing.assert_allclose(odometry[1:, 2], [4.0, 4.0])


def test_integration_agrees_with_composing_the_pieces_one_by_one(rng):
    n = 200
    hold = np.sort(rng.uniform(0.0, 20.0, n))
    hold[0] = 0.0
    v, w = rng.normal(size=n), rng.normal(size=n)
    times = regular_times(0.3, 19.5, 0.5)
    odometry = hold_and_integrate(hold, v, w, times)
    for t in range(1, len(times)):
        step, now = np.zeros(3), times[t - 1]
        while now < times[t]:
            k = np.flatnonzero(hold <= now)[-1]
            until = min(hold[k + 1] if k + 1 < n else np.inf, times[t])
            step, now = compose(step, integrate_twist(v[k], w[k], until - now)), until
        np.testing.assert_allclose(odometry[t, :2], step[:2], atol=1e-12)
        assert math.cos(odometry[t, 2] - step[2]) == pytest.approx(1.0, abs=1e-12)


def test_nearest_sample():
    times = np.array([0.0, 1.0, 2.0])
    readings = np.array([-0.6, -0.4, 0.0, 0.4, 0.6, 1.0, 1.9, 2.4, 2.6])
    np.testing.assert_array_equal(nearest_sample(readings, times, 0.5), [-1, 0, 0, 0, 1, 1, 2, 2, -1])
    np.testing.assert_array_equal(nearest_sample(readings, times, 0.1), [-1, -1, 0, -1, -1, 1, 2, -1, -1])
    np.testing.assert_array_equal(nearest_sample(np.array([3.0, 5.0]), np.array([3.2]), 0.5), [0, -1])


def test_sightings_go_to_the_nearest_sample_and_keep_their_offset():
    found = sort_sightings(
        np.array([0.10, 0.45, 0.46, 0.56, 9.0]),
        np.array([0, 0, 1, 0, 1]),
        np.array([[1.0, 0.1], [2.0, 0.2], [3.0, 0.3], [4.0, 0.4], [5.0, 0.5]]),
        np.array([0.0, 0.5, 1.0]),
        2,
        0.25,
    )
    nan = np.nan
    np.testing.assert_array_equal(found.values[..., 0], [[1.0, nan], [2.0, 3.0], [nan, nan]])
    np.testing.assert_array_equal(found.values[..., 1], [[0.1, nan], [0.2, 0.3], [nan, nan]])
    np.testing.assert_allclose(found.time_offset, [[0.10, nan], [-0.05, -0.04], [nan, nan]], atol=1e-15)
    assert (found.n_outside, found.n_duplicate) == (1, 1)


def test_of_equally_near_readings_the_first_stays():
    found = sort_sightings(np.array([1.0, 1.0]), np.array([0, 0]), np.array([[5.0], [6.0]]), np.array([1.0]), 1, 0.5)
    assert found.values[0, 0, 0] == 5.0


def test_every_reading_is_kept_or_counted(rng):
    n = 500
    found = sort_sightings(
        rng.uniform(-1.0, 11.0, n),
        rng.integers(0, 3, n),
        rng.normal(size=(n, 2)),
        regular_times(0.0, 10.0, 0.5),
        3,
        0.25,
    )
    assert np.isfinite(found.time_offset).sum() + found.n_outside + found.n_duplicate == n
    assert np.nanmax(np.abs(found.time_offset)) <= 0.25
    assert found.n_outside > 0
    assert found.n_duplicate > 0


def test_poses_are_interpolated_across_the_seam():
    poses = np.array([[0.0, 0.0, 3.0], [1.0, 2.0, -3.0]])
    found = interpolate_poses(np.array([0.0, 0.4]), poses, np.array([0.0, 0.1, 0.2, 0.4]), 0.5)
    np.testing.assert_allclose(found[:, :2], [[0, 0], [0.25, 0.5], [0.5, 1.0], [1.0, 2.0]])
    np.testing.assert_allclose(np.cos(found[:, 2] - [3.0, 3.0 + (math.pi - 3.0) / 2, math.pi, -3.0]), 1.0)
    assert (np.abs(found[:, 2]) <= math.pi).all()


def test_poses_are_unknown_outside_the_reference_and_in_its_pauses():
    pose_times = np.array([1.0, 1.2, 3.0, 3.3])
    times = np.array([0.9, 1.0, 1.1, 1.2, 2.0, 3.0, 3.2, 3.3, 3.4])
    found = interpolate_poses(pose_times, np.zeros((4, 3)), times, 0.5)
    np.testing.assert_array_equal(np.isnan(found).all(axis=1), [1, 0, 0, 0, 1, 0, 0, 0, 1])
