"""The critic on simulated logs of lidars with nothing wrong, and with too few scans."""

from __future__ import annotations

import pytest

from pmcl.criticism.workflow import criticize
from pmcl.errors import CriticismError
from pmcl.models import Lidar, RobotModel
from pmcl.simulations.lidar_room import simulate_lidar_room

# mypy: disable-error-code="no-untyped-def"


def room(seed, rows=120):
    return simulate_lidar_room(rows, seed, n_rays=12)


def small(log, model=None, **settings):
    model = RobotModel(sensors=(Lidar(),)) if model is None else model
    return criticize(log, model, **{"simulations": 20, "joint": False, "seed": 1, "rounds": 1, **settings})


@pytest.mark.long
def test_a_right_mount_is_left_alone():
    result = small(room(1))
    assert result.verdict == "no missing effect"
    assert result.effects == ()


def test_a_log_with_too_few_scans_is_told_how_to_get_more():
    with pytest.raises(CriticismError, match=r"but got 33; record longer, or convert .*--update-min-d 0\.1"):
        small(room(1, rows=33))
