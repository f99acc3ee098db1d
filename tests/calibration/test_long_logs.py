"""What a long log changes: fewer trajectories are kept, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

import pmcl
from pmcl import defaults
from pmcl.filtering import particle_filter
from pmcl.posterior.access import theta_draws, trajectory_draws
from pmcl.simulations.landmark_field import simulate_landmark_field


@pytest.mark.parametrize(("states", "kept"), [(1, 2), (2 * 40 * 4, 4), (2 * 40 * 5 - 1, 4), (10**9, 10)])
def test_trajectories_fit_into_memory(monkeypatch, states, kept):
    monkeypatch.setattr(defaults, "TRAJECTORY_STATES", states)
    log = simulate_landmark_field(40, 1)
    posterior = pmcl.calibrate(log, draws=20, chains=2, trajectories=10, check=False)
    assert trajectory_draws(posterior).sizes["trajectory_draw"] == kept


@pytest.mark.slow
def test_a_calibration_in_blocks_is_the_same(monkeypatch):
    log = simulate_landmark_field(40, 1)
    expected = theta_draws(pmcl.calibrate(log, draws=10, chains=2, seed=3, check=False))
    monkeypatch.setattr(particle_filter, "MOST_KEPT_STATES", 100)
    found = theta_draws(pmcl.calibrate(log, draws=10, chains=2, seed=3, check=False))
    np.testing.assert_array_equal(found, expected)
