"""The exponent of tempered readings is chosen by held-out rows."""

from __future__ import annotations

import numpy as np
import pytest

import pmcl
from pmcl.calibration import held_out_exponent, with_exponent
from pmcl.calibration.tempering import EXPONENTS, _compared, is_tempered
from pmcl.errors import FilterError, ModelError
from pmcl.models import Lidar
from pmcl.models.robot_model import default_model
from pmcl.simulations import simulate_amigobot
from pmcl.simulations.lidar_room import simulate_lidar_room


def of_one_log(*rows):
    """Scores of each exponent: one log, whose rows have one reading each."""
    return [[(np.array(each, dtype=float), len(each))] for each in rows]


def test_the_least_exponent_that_is_as_good_as_the_best_is_chosen():
    exponents = np.array([1.0, 0.5, 0.25, 0.125])
    steady = np.zeros(60)
    wavy = np.repeat([-0.3, 0.5, -0.5, 0.2], 15)
    found = _compared(exponents, of_one_log(steady - 1.0, steady, wavy, steady - 0.5))
    np.testing.assert_allclose(found.log_score, [-1.0, 0.0, wavy.mean(), -0.5])
    np.testing.assert_allclose(found.behind, [1.0, 0.0, -wavy.mean(), 0.5])
    # Four blocks of 15 rows: the standard error of their sum, for a mean of 60 readings.
    assert found.behind_error[2] == pytest.approx(np.sqrt(4) * np.std(15 * wavy[::15], ddof=1) / 60)
    assert found.behind[2] < found.behind_error[2]
    assert found.chosen == 0.25
    assert found.readings == 60


def test_an_exponent_with_which_the_robot_is_lost_is_not_chosen():
    exponents = np.array([1.0, 0.5])
    lost = (np.full(30, -np.inf), 0)
    found = _compared(exponents, [[(np.zeros(30), 30)], [lost]])
    assert found.chosen == 1.0
    assert found.log_score[1] == -np.inf
    with pytest.raises(FilterError, match="lost it with each"):
        _compared(exponents, [[lost], [lost]])


def test_models_are_told_apart_and_changed():
    log = simulate_lidar_room(4, 1)
    model = default_model(log)
    assert is_tempered(model)
    changed = with_exponent(model, 0.25)
    assert changed.sensors == (Lidar(exponent=0.25),)
    assert changed.motion == model.motion
    sonars = simulate_amigobot(20.0, 1)
    assert not is_tempered(default_model(sonars))
    assert with_exponent(default_model(sonars), 0.25) == default_model(sonars)
    with pytest.raises(ModelError, match="expected a model with a sensor whose readings are tempered"):
        held_out_exponent(sonars)
    with pytest.raises(ModelError, match="at least 20 rows"):
        held_out_exponent(log)


def with_shared_errors(log, seed):
    """The same drive, but each scan is read from a place beside the robot, another one each time."""
    model = default_model(log)
    bound = model.bind(log)
    table = bound.tables(np.array([log.true_theta.get(name, 0.05) for name in bound.names]))[0].sensors[0]
    beside = np.array([0.15, 0.15, 0.08]) * np.random.default_rng(seed).standard_normal((log.n_steps, 3))
    drawn = Lidar.simulate(table, log.true_poses + beside, np.random.default_rng(seed))
    dataset = log.dataset.copy(deep=True)
    Lidar.store(drawn, dataset)
    return pmcl.RobotLog.from_dataset(dataset, "shared", log.grid_map)


@pytest.mark.long
def test_shared_errors_make_the_exponent_smaller():
    log = simulate_lidar_room(100, 2, sensor=Lidar(model="beam", exponent=1.0), n_rays=30)
    lines = []
    independent = held_out_exponent(log, report=lines.append)
    assert len(lines) == len(EXPONENTS)
    shared = held_out_exponent(with_shared_errors(log, 5))
    assert shared.chosen < independent.chosen
    # Trusting such scans fully costs more than the errors of the scores.
    assert shared.behind[0] > 2.0 * shared.behind_error[0]
