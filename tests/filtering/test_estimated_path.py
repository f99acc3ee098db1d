"""An estimate of the path for formulas that need one: near the truth, and where asked for without later readings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmcl.filtering.estimated_path import with_estimated_path
from pmcl.geometry import wrap
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.formula import formula_effect
from pmcl.models.robot_model import default_model
from pmcl.simulations.amigobot import simulate_amigobot

# mypy: disable-error-code="no-untyped-def"

NOISE = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.05}


@pytest.fixture(scope="module")
def log():
    return simulate_amigobot(60.0, 2, NOISE)


@pytest.fixture(scope="module")
def model(log):
    return replace(default_model(log), effects=(formula_effect("range", ["cos(world_direction)"]),))


def test_a_log_stays_as_it_is_where_no_formula_needs_a_path(log):
    plain = default_model(log)
    assert with_estimated_path(log, plain) is log
    assert with_estimated_path(log, replace(plain, effects=(formula_effect("turn", ["speed"]),))) is log


@pytest.mark.slow
def test_the_estimate_is_near_the_truth(log, model):
    known = with_estimated_path(log, model)
    error = known.estimated("path") - log.true_poses
    assert np.sqrt(np.mean(error[:, :2] ** 2)) < 0.05
    assert np.abs(wrap(error[:, 2])).mean() < 0.05
    assert np.abs(np.diff(known.estimated("path")[:, 2])).max() < np.pi, "headings are not wrapped"
    assert known.estimated("distance").shape == log.ranges.shape
    # It is found once: the log that holds it comes back, and its readings are the same.
    assert with_estimated_path(known, model) is known
    assert known.fingerprint() == log.fingerprint()
    again = with_estimated_path(log, model)
    np.testing.assert_array_equal(again.estimated("path"), known.estimated("path"))


@pytest.mark.slow
@pytest.mark.parametrize("ahead", [True, False])
def test_later_readings_count_unless_every_pose_is_to_be_foreseen(log, model, ahead):
    dataset = log.dataset.copy(deep=True)
    readings = dataset["range"].values.copy()
    readings[40:] = np.nan
    shorter = RobotLog(dataset.assign(range=(("time", "beam"), readings, dataset["range"].attrs)))
    paths = [with_estimated_path(one, model, NOISE, ahead=ahead).estimated("path") for one in (log, shorter)]
    assert np.array_equal(paths[0][:41], paths[1][:41]) == ahead
    assert not np.array_equal(paths[0][41:], paths[1][41:])
