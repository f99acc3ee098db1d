"""Scans and rays that AMCL uses, against its loops as nav2 writes them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pmcl.errors import LogError
from pmcl.logs.amcl_rows import amcl_rows, thinned


def nav2_loop(poses, lasers, min_d, min_a):
    """One flag for each laser, as in nav2_amcl: motion since the last update of the filter sets them all."""
    flags, filter_pose, used = {}, None, []
    for k, ((x, y, heading), laser) in enumerate(zip(poses, lasers, strict=True)):
        flags.setdefault(laser, True)
        if filter_pose is not None:
            dx, dy = x - filter_pose[0], y - filter_pose[1]
            turn = math.remainder(heading - filter_pose[2], 2 * math.pi)
            if abs(dx) > min_d or abs(dy) > min_d or abs(turn) > min_a:
                flags = dict.fromkeys(flags, True)
        if flags[laser]:
            flags[laser] = False
            filter_pose = (x, y, heading)
            used.append(k)
    return used


@pytest.mark.parametrize("n_lasers", [1, 3])
def test_random_drives_against_nav2s_loop(rng, n_lasers):
    for _ in range(20):
        poses = np.cumsum(rng.normal(0.0, [0.08, 0.08, 0.1], (200, 3)), axis=0)
        poses[:, 2] = np.arctan2(np.sin(poses[:, 2]), np.cos(poses[:, 2]))
        lasers = rng.integers(0, n_lasers, 200)
        rows = amcl_rows(poses, 0.25, 0.2, laser=lasers)
        assert rows.tolist() == nav2_loop(poses, lasers.tolist(), 0.25, 0.2)
        assert 10 < len(rows) < 190


def test_the_rules_differ_on_a_diagonal():
    poses = [[0, 0, 0], [0.2, 0.2, 0], [0.26, 0.2, 0]]
    assert amcl_rows(poses, 0.25, 0.2).tolist() == [0, 2]
    assert amcl_rows(poses, 0.25, 0.2, "euclidean").tolist() == [0, 1]


def test_bounds_are_strict_and_turns_go_the_shorter_way_round():
    assert amcl_rows([[0, 0, 0], [0.25, 0, 0], [0.2500001, 0, 0]], 0.25, 0.2).tolist() == [0, 2]
    assert amcl_rows([[0, 0, 3.1], [0, 0, -3.1], [0, 0, -2.9]], 0.25, 0.2).tolist() == [0, 2]


def test_without_thresholds_every_scan_is_used():
    assert amcl_rows(np.zeros((4, 3)), 0.0, 0.0).tolist() == [0, 1, 2, 3]
    assert amcl_rows(np.zeros((4, 3)), 0.0, 0.1).tolist() == [0]


RAYS = [(1440, 60), (761, 60), (60, 60), (59, 60), (181, 181), (7, 2), (1, 60), (90, 60)]


@pytest.mark.parametrize(("n", "most"), RAYS)
def test_rays_against_nav2s_loop(n, most):
    step = max((n - 1) // (most - 1), 1)
    expected, ray = [], 0
    while ray < n:
        expected.append(ray)
        ray += step
    assert np.arange(n)[thinned(n, most)].tolist() == expected


def test_all_rays():
    assert np.arange(7)[thinned(7, None)].tolist() == list(range(7))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([[0, 0]],), r"expected 'poses' of shape \(N, 3\)"),
        (([[0, 0, np.nan]],), "expected finite numbers in 'poses'"),
        (([[0, 0, 0]], -1.0), "expected update_min_d as a number of at least 0 m"),
        (([[0, 0, 0]], 0.1, np.inf), "expected update_min_a as a number of at least 0 rad"),
        (([[0, 0, 0]], 0.1, 0.1, "manhattan"), "expected rule as one of 'nav2', 'euclidean'"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(LogError, match=message):
        amcl_rows(*arguments)
    with pytest.raises(LogError, match="same length"):
        amcl_rows([[0, 0, 0]], laser=[0, 1])
