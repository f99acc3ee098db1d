"""Odometry that comes too late, against interpolation along a line and on the spot, and along a path with both."""

from __future__ import annotations

import numpy as np
import pytest

from pmcl.geometry import between, compose
from pmcl.models.motions.increments.kernels.delayed import delayed_increments


@pytest.mark.parametrize("delay", [0.0, 0.3, 2.5, -0.4, 100.0])
def test_distances_and_turns_are_those_of_the_time_before(delay, rng):
    times = np.cumsum(rng.uniform(0.05, 1.0, 40))
    increments = np.zeros((40, 3))
    for column in (0, 2):
        increments[:, column] = rng.normal(size=40)
        so_far = np.concatenate([[0.0], np.cumsum(increments[1:, column])])
        expected = np.diff(np.interp(times - delay, times, so_far))
        found = delayed_increments(increments, times, delay)
        np.testing.assert_allclose(found[:, column], expected, atol=1e-12)
        increments[:, column] = 0.0


def test_whole_steps_late_are_the_increments_before(rng):
    increments = rng.normal(scale=0.3, size=(30, 3))
    found = delayed_increments(increments, 0.5 * np.arange(30.0), 1.5)
    np.testing.assert_allclose(found[3:], increments[1:-3], atol=1e-9)
    np.testing.assert_array_equal(found[:3], 0.0)


def test_a_share_of_a_step_late_leads_along_the_same_path(rng):
    """A step is shared out with its own direction: from one share of a step to the same share of the next."""
    increments, share = rng.normal(scale=0.3, size=(30, 3)), 0.6
    found = delayed_increments(increments, 0.5 * np.arange(30.0), 0.5 * (1.0 - share))
    pose = np.zeros(3)
    for t in range(1, 29):
        here = compose(pose, share * increments[t])
        pose = compose(pose, increments[t])
        there = compose(pose, share * increments[t + 1])
        np.testing.assert_allclose(found[t], between(here, there), atol=1e-9)
