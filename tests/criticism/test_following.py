"""A lost filter is noticed, and one that is only too small is enlarged."""

from __future__ import annotations

import numpy as np
import pytest

from pmcl.criticism.fitting import following
from pmcl.criticism.fitting.following import gross_at, lost_at, particles_that_follow
from pmcl.errors import FilterError
from pmcl.filtering.one_step_ahead import Predictions, predict_readings
from pmcl.filtering.particle_filter import make_rng
from pmcl.logs.robot_log import RobotLog
from pmcl.models.robot_model import default_model
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field

# mypy: disable-error-code="no-untyped-def"

NOISE = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.05}


@pytest.fixture(scope="module")
def log():
    return simulate_amigobot(120.0, 6, NOISE)


def _carried(log):
    """From row 60 the readings are those of another place."""
    dataset = log.dataset.copy(deep=True)
    dataset["range"].values[60:] = dataset["range"].values[:60]
    return RobotLog(dataset, "carried.nc")


def test_a_filter_that_follows_is_left_alone(log):
    bound = default_model(log).bind(log)
    theta = np.array([NOISE[name] for name in bound.names])
    assert particles_that_follow(bound, theta, 300, 1) == (300, "")


@pytest.mark.parametrize(("needed", "used"), [(300, 300), (600, 600), (1200, 1200), (2400, None)])
def test_no_more_particles_are_taken_than_follow(log, monkeypatch, needed, used):
    """Filters with less than some number of particles are made to lose the robot."""

    def predicted(tables, n_steps, n, rng):
        if n < needed:
            raise FilterError("lost")
        return predict_readings(tables, n_steps, 300, rng)

    monkeypatch.setattr(following, "predict_readings", predicted)
    bound = default_model(log).bind(log)
    theta = np.array([NOISE[name] for name in bound.names])
    if used is None:
        with pytest.raises(FilterError, match="loses the robot at t=0 s"):
            particles_that_follow(bound, theta, 300, 1)
        return
    note = "" if used == 300 else f"300 particles lose the robot for a while; {used} are used"
    assert particles_that_follow(bound, theta, 300, 1) == (used, note)


@pytest.mark.parametrize("largest", [True, False])
def test_where_large_filters_differ_a_larger_one_may_confirm_the_first(log, monkeypatch, largest):
    asked = []

    def predicted(tables, n_steps, n, rng):
        asked.append(n)
        if n < 1200 or asked == [1200, 300, 600, 1200] or (n > 1200 and not largest):
            raise FilterError("lost")
        return predict_readings(tables, n_steps, 300, rng)

    monkeypatch.setattr(following, "predict_readings", predicted)
    bound = default_model(log).bind(log)
    theta = np.array([NOISE[name] for name in bound.names])
    with pytest.raises(FilterError, match="loses the robot at t=0 s"):
        particles_that_follow(bound, theta, 300, 1)
    assert asked == [1200, 300, 600, 1200]
    asked.clear()
    if not largest:
        with pytest.raises(FilterError, match="loses the robot at t=0 s"):
            particles_that_follow(bound, theta, 300, 1, patient=True)
    else:
        assert particles_that_follow(bound, theta, 300, 1, patient=True)[0] == 1200
    assert asked == [1200, 300, 600, 1200, 4800]


def test_a_robot_that_was_carried_away_is_lost_from_then_on(log):
    carried = _carried(log)
    bound = default_model(carried).bind(carried)
    theta = np.array([NOISE[name] for name in bound.names])
    made = predict_readings(bound.tables(theta)[0], 120, 500, make_rng(1))
    lost = lost_at(made, 120)
    assert lost is not None
    assert 50 <= lost <= 75
    with pytest.raises(FilterError, match=r"carried.nc: the filter loses the robot at t=\d+ s") as caught:
        particles_that_follow(bound, theta, 500, 1)
    assert 50 <= caught.value.row <= 75
    # The part before the robot was carried away is followed.
    before = carried.select(0, 55)
    assert particles_that_follow(default_model(before).bind(before), theta, 500, 1) == (500, "")


@pytest.mark.slow
def test_a_lost_robot_shows_although_all_its_readings_may_be_gross_errors():
    """With gross errors in the model no reading contradicts it; a lost robot shows in most of them being such."""
    log = simulate_landmark_field(200, 1, bearings=True)
    dataset = log.dataset.copy(deep=True)
    for name in ("landmark_range", "landmark_bearing"):
        dataset[name].values[100:] = log.dataset[name].values[:100]
    theta = np.array([0.1, 0.02, 0.1, 0.3, 0.05, 0.2])

    def judged(log):
        bound = default_model(log, outliers=True).bind(log)
        made = predict_readings(bound.tables(theta)[0], 200, 500, make_rng(1))
        return lost_at(made, 200), gross_at(bound, theta, made, make_rng(2))

    assert judged(log) == (None, None)
    unseen, seen = judged(RobotLog(dataset, "carried"))
    assert unseen is None
    assert 85 <= seen <= 135
    # A model without gross errors has none to count.
    bound = default_model(log).bind(log)
    made = predict_readings(bound.tables(theta[:5])[0], 200, 100, make_rng(1))
    assert gross_at(bound, theta[:5], made, make_rng(2)) is None


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.05, 0.3])
def test_gross_errors_here_and_there_are_no_lost_robot(share):
    log = simulate_landmark_field(200, 1, bearings=True)
    dataset, rng = log.dataset.copy(deep=True), np.random.default_rng(1)
    gross = rng.random(dataset["landmark_range"].shape) < share
    dataset["landmark_range"].values[gross] = rng.uniform(0.5, 8.0, gross.sum())
    dataset["landmark_bearing"].values[gross] = rng.uniform(-3.0, 3.0, gross.sum())
    wild = RobotLog(dataset, "wild")
    bound = default_model(wild, outliers=True).bind(wild)
    theta = np.array([0.1, 0.02, 0.1, 0.3, 0.05, share])
    made = predict_readings(bound.tables(theta)[0], 200, 500, make_rng(1))
    assert gross_at(bound, theta, made, make_rng(2)) is None


def test_a_missing_effect_of_one_channel_is_no_lost_robot(log):
    dataset = log.dataset.copy(deep=True)
    dataset["range"].values[:, 2] += 0.5
    wrong = RobotLog(dataset, "biased")
    bound = default_model(wrong).bind(wrong)
    theta = np.array([NOISE[name] for name in bound.names])
    theta[3] = 0.15
    assert lost_at(predict_readings(bound.tables(theta)[0], 120, 500, make_rng(1)), 120) is None


@pytest.mark.parametrize(("landmarks", "far_off", "lost"), [(2, 30, None), (4, 30, 30), (4, 0, None), (4, 1, 1)])
def test_one_row_gives_a_loss_away_only_by_several_landmarks(landmarks, far_off, lost):
    """Range and bearing of two landmarks can both be far off when the model misses something; of four they are not.

    In the first row a wide start belief may have no particle where sharp readings say that the robot is.
    """
    row, channel, kind = (
        part.ravel() for part in np.meshgrid(np.arange(60), np.arange(landmarks), [0, 1], indexing="ij")
    )
    seen = np.where(row == far_off, 1e-9, 0.5)
    nothing = np.zeros(row.size)
    made = Predictions(None, nothing, kind, channel, row, ("range", "bearing"), nothing, nothing, seen, seen)
    assert lost_at(made, 60) == lost


@pytest.mark.parametrize(("rows", "apart"), [({30: 500.0}, False), ({30: 500.0, 31: 70.0}, True), ({}, False)])
def test_filters_disagree_where_they_differ_in_more_than_one_row(rows, apart):
    """A step far astray may cost hundreds of nats at one row; a robot that is lost costs them row after row."""
    large, small = np.zeros(100), np.zeros(100)
    for row, nats in rows.items():
        small[row] -= nats
    assert (following._disagree_at(small, large) is not None) is apart
    assert following._disagree_at(large, small) is None
    assert (following._disagree_at(large, small, both_ways=True) is not None) is apart
    assert following._disagree_at(large - 4.0, large) is not None
