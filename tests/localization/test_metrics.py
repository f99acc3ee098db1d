"""Errors of tracks, by hand and by simulation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from pmcl.errors import PmclError
from pmcl.geometry import compose
from pmcl.localization import metrics

TRUE = np.array([[0.0, 0.0, 3.1], [1.0, 0.0, -3.1], [1.0, 2.0, 0.0], [1.0, 5.0, 1.0]])


def test_absolute_errors():
    estimate = TRUE + np.array([[0.3, 0.4, 0.1], [0.0, 0.0, -0.1], [0.0, -2.0, 7.0], [1.0, 0.0, 0.0]])
    errors = metrics.pose_errors(estimate, TRUE)
    np.testing.assert_allclose(errors.position, [0.5, 0.0, 2.0, 1.0])
    np.testing.assert_allclose(errors.heading, [0.1, -0.1, 7.0 - 2.0 * math.pi, 0.0], atol=1e-12)
    assert metrics.rmse(errors.position) == pytest.approx(math.sqrt((0.25 + 4.0 + 1.0) / 4.0))


def test_a_heading_across_the_cut_is_a_small_error():
    errors = metrics.pose_errors(np.array([[0.0, 0.0, -math.pi + 0.01]]), np.array([[0.0, 0.0, math.pi - 0.01]]))
    assert errors.heading[0] == pytest.approx(0.02)


def test_unknown_truth_does_not_count():
    reference = TRUE.copy()
    reference[1] = np.nan
    errors = metrics.pose_errors(TRUE + np.array([1.0, 0.0, 0.0]), reference)
    assert np.isnan(errors.position[1])
    assert metrics.rmse(errors.position) == pytest.approx(1.0)
    assert np.isnan(metrics.rmse(np.full(3, np.nan)))
    values = metrics.nees(TRUE, np.tile(np.eye(3), (4, 1, 1)), reference)
    assert np.isnan(values[1])
    assert metrics.coverage(values) == 1.0
    assert np.isnan(metrics.coverage([np.nan]))


def test_a_track_that_is_moved_and_turned_as_a_whole_has_no_relative_error(rng):
    path = np.cumsum(rng.normal(size=(30, 3)), axis=0)
    moved = compose(np.array([5.0, -2.0, 2.0]), path)
    for lag in (1, 7):
        errors = metrics.relative_errors(moved, path, lag)
        assert errors.position.shape == (30 - lag,)
        np.testing.assert_allclose(errors.position, 0.0, atol=1e-12)
        np.testing.assert_allclose(errors.heading, 0.0, atol=1e-12)
    assert metrics.pose_errors(moved, path).position.min() > 0.1


def test_relative_errors_of_a_scaled_track():
    straight = np.column_stack([np.arange(11.0), np.zeros(11), np.zeros(11)])
    longer = straight * np.array([1.1, 1.0, 1.0])
    np.testing.assert_allclose(metrics.relative_errors(longer, straight, 4).position, 0.4)
    by_distance = metrics.relative_errors_by_distance(longer, straight, 3.0)
    assert by_distance.position.shape == (8,)
    np.testing.assert_allclose(by_distance.position, 0.3)
    both = metrics.relative_errors(np.stack([straight, longer]), straight, 4).position
    np.testing.assert_allclose(both.max(axis=1), [0.0, 0.4])


@pytest.mark.parametrize("dof", [2, 3])
def test_honest_beliefs_are_covered(dof, rng):
    n = 20_000
    root = rng.normal(size=(n, 3, 3))
    covariance = root @ root.transpose(0, 2, 1) + 1e-3 * np.eye(3)
    error = (np.linalg.cholesky(covariance) @ rng.normal(size=(n, 3, 1)))[..., 0]
    # Errors of a heading beyond half a turn come back from the other side: keep clear of that.
    error, covariance = 0.05 * error, 0.05**2 * covariance
    truth = rng.uniform(-3.0, 3.0, (n, 3))
    values = metrics.nees(truth + error, covariance, truth, dof)
    assert stats.kstest(values, stats.chi2(dof).cdf).pvalue > 1e-5
    tolerance = 5.0 * math.sqrt(0.95 * 0.05 / n)
    assert abs(metrics.coverage(values, 0.95, dof) - 0.95) < tolerance
    assert metrics.coverage(metrics.nees(truth + error, 0.8 * covariance, truth, dof), 0.95, dof) < 0.95 - tolerance


def test_a_belief_that_excludes_everything():
    values = metrics.nees(TRUE + 0.1, np.zeros((4, 3, 3)), TRUE)
    assert np.isinf(values).all()
    assert metrics.coverage(values) == 0.0


def test_bad_input():
    with pytest.raises(PmclError, match="one pose for each row"):
        metrics.pose_errors(TRUE[:3], TRUE)
    with pytest.raises(PmclError, match="lag of 1 to 3"):
        metrics.relative_errors(TRUE, TRUE, 4)
    with pytest.raises(PmclError, match="distance > 0"):
        metrics.relative_errors_by_distance(TRUE, TRUE, 0.0)
    with pytest.raises(PmclError, match="2 degrees of freedom"):
        metrics.nees(TRUE, np.tile(np.eye(3), (4, 1, 1)), TRUE, 1)
