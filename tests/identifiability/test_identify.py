"""What a log can tell, in words, and what to drive to learn the rest."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from oracles.random_walk_model import rail_log, rail_model
from scipy import stats

import pmcl
from pmcl.identifiability import Prediction, identify
from pmcl.identifiability.information import information_per_row
from pmcl.identifiability.result import CANNOT_TELL, Advice
from pmcl.models.motions.increments.motion import GrowingIncrementNoise
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.models.sensors.landmarks.sensor import LandmarkNoise
from pmcl.reports.identification_report import identification_text, write_identification_report
from pmcl.simulations import simulate_landmark_field
from pmcl.simulations.drives import drives_for

THETA = {"sigma_forward": 0.05, "sigma_left": 0.03, "sigma_turn": 0.05}


def straight_log(n_steps=60, seed=1):
    """A robot that only drives straight, there and back, among landmarks."""
    rng = np.random.default_rng(seed)
    forward = np.where(np.arange(n_steps) // 15 % 2 == 0, 0.3, -0.3)
    command = np.column_stack([forward, np.zeros((n_steps, 2))])
    path = np.zeros((n_steps, 3))
    for t in range(1, n_steps):
        step = command[t] + np.array([0.04, 0.01, 0.01]) * rng.standard_normal(3)
        c, s = np.cos(path[t - 1, 2]), np.sin(path[t - 1, 2])
        path[t] = path[t - 1] + [c * step[0] - s * step[1], s * step[0] + c * step[1], step[2]]
    landmarks = np.array([(-3.0, 4.0), (8.0, 4.0), (2.0, -5.0), (9.0, -3.0)])
    offset = landmarks - path[:, None, :2]
    bearing = np.arctan2(offset[..., 1], offset[..., 0]) - path[:, 2, None]
    return pmcl.RobotLog.build(
        time=np.arange(n_steps, dtype=float),
        odometry=command,
        landmarks=landmarks,
        landmark_range=np.abs(np.hypot(offset[..., 0], offset[..., 1]) + 0.03 * rng.standard_normal((n_steps, 4))),
        landmark_bearing=(bearing + 0.02 * rng.standard_normal((n_steps, 4)) + np.pi) % (2.0 * np.pi) - np.pi,
        start_mean=np.zeros(3),
        start_std=np.full(3, 0.05),
    )


GROWING = RobotModel(GrowingIncrementNoise(), (LandmarkNoise(),))


@pytest.fixture(scope="module")
def straight():
    return identify(straight_log(), GROWING)


@pytest.mark.slow
def test_a_robot_that_never_turns_is_told_to_turn(straight):
    by_name = {prediction.name: prediction for prediction in straight.predictions}
    growth = by_name["sigma_turn_per_radian"]
    # Nothing that the robot did depends on it: the posterior is the prior.
    assert not growth.can_tell
    assert growth.share == pytest.approx(1.0, abs=0.12)
    assert growth.std == pytest.approx(growth.prior_std, rel=0.15)
    assert growth.advice is not None
    assert growth.advice.drive == "turn in place, both ways"
    assert growth.advice.share < CANNOT_TELL
    assert "sigma_turn_per_radian: this log cannot tell; turn in place, both ways for" in growth.sentence
    assert "sigma_turn_per_radian" in straight.sentence
    assert by_name["sigma_forward_per_metre"].can_tell
    assert by_name["sigma_landmark_range"].can_tell


def test_the_drive_that_is_advised_tells_what_it_promises():
    """Its information is that of the motion's definition, not a guess: straight drives tell nothing of turning."""
    log = straight_log()
    theta = np.array([0.04, 0.01, 0.01, 0.05, 0.1, 0.05, 0.03, 0.02])
    names = [parameter.name for parameter in GROWING.parameters]
    turning = names.index("sigma_turn_per_radian")
    path = np.column_stack([np.linspace(0.0, 4.5, 60), np.zeros((60, 2))])
    drives = {drive.name: drive for drive in drives_for(log, path, sideways=False)}
    assert "drive sideways, both ways" not in drives
    told = {name: information_per_row(drive, log, path, GROWING, theta, 0) for name, drive in drives.items()}
    assert told["drive straight, forward and back"][turning, turning] == pytest.approx(0.0, abs=1e-6)
    assert told["stand still"][turning, turning] == pytest.approx(0.0, abs=1e-6)
    assert told["turn in place, both ways"][turning, turning] > 0.1
    # At most 2 for each row: that of a standard deviation from one draw, when the path is known.
    assert all(np.linalg.eigvalsh(matrix)[-1] < 2.0 * 8 for matrix in told.values())


def test_sideways_drives_are_for_robots_that_move_sideways():
    log = straight_log()
    path = np.column_stack([np.linspace(0.0, 4.5, 60), np.zeros((60, 2))])
    sideways = {drive.name: drive for drive in drives_for(log, path, sideways=True)}["drive sideways, both ways"]
    assert (np.abs(sideways.commands[:, 1:, 1]) > 0.0).all()
    assert not sideways.commands[:, 1:, (0, 2)].any()


def test_drives_stay_where_the_log_has_been():
    log = pmcl.simulate_amigobot(200.0, 3, {**THETA, "sigma_range": 0.05})
    path = np.array(log.true_poses)
    for drive in drives_for(log, path, sideways=True):
        for start, command in zip(drive.starts, drive.commands, strict=True):
            pose = np.array(start)
            for forward, left, turn in command[1:]:
                c, s = np.cos(pose[2]), np.sin(pose[2])
                pose += [c * forward - s * left, s * forward + c * left, turn]
                assert np.hypot(*(path[:, :2] - pose[:2]).T).min() < 0.7, drive.name


@pytest.mark.slow
def test_more_rows_tell_more_and_the_truth_is_not_read():
    theta = {**THETA, "sigma_range": 0.05}
    log = pmcl.simulate_amigobot(160.0, 3, theta)
    long, short = (identify(each, drives=False) for each in (log, log.select(0, 40)))
    for more, less in zip(long.predictions, short.predictions, strict=True):
        # A quarter of the rows: twice the standard deviation, but for chance.
        assert 1.3 < less.std / more.std < 3.2, more.name
        assert abs(more.mean - theta[more.name]) < 4.0 * more.std
    unaware = identify(log.without_truth(), drives=False)
    assert unaware == long


@pytest.mark.slow
def test_the_same_seed_gives_the_same_result(straight):
    again = identify(straight_log(), GROWING)
    assert again == straight
    other = identify(straight_log(), GROWING, drives=False, seed=1)
    for one, two in zip(straight.predictions, other.predictions, strict=True):
        assert one.std == pytest.approx(two.std, rel=0.2)
        assert one.std != two.std


def test_states_that_are_no_poses_have_no_drives():
    found = identify(rail_log(40, 3), rail_model())
    assert found.drives == {}
    assert found.notes[0].startswith("no drives were tried")
    assert all(prediction.can_tell for prediction in found.predictions)


def test_a_parameter_with_a_tight_prior_is_not_told_and_a_fixed_one_is_left_out():
    log = simulate_landmark_field(60, seed=2)
    model = dataclasses.replace(
        default_model(log), priors={"sigma_turn": stats.gamma(400.0, scale=0.03 / 400.0)}, fixed={"sigma_left": 0.03}
    )
    found = {prediction.name: prediction for prediction in identify(log, model, drives=False).predictions}
    assert set(found) == {"sigma_forward", "sigma_turn", "sigma_landmark_range"}
    assert not found["sigma_turn"].can_tell
    assert found["sigma_turn"].remedy == ""  # no drives were tried


PREDICTION = Prediction("sigma_turn", "rad", "noise of a turn", True, 0.05, 0.006, 0.06, 0.05, 0.035, 0.2)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({}, "sigma_turn: to 12 %"),
        ({"std": 0.03, "limit": 0.11}, "sigma_turn: only that it is below 0.11 rad"),
        ({"relative": False, "unit": "1"}, "sigma_turn: to ± 0.006"),
        ({"share": 0.8}, "sigma_turn: this log cannot tell"),
        (
            {"share": 0.8, "tried": True},
            "sigma_turn: this log cannot tell; no drive that was tried tells it within ten minutes: fix it, or give it "
            "a narrower prior",
        ),
        (
            {"share": 0.8, "tried": True, "advice": Advice("stand still", 1.0, 0.01, 0.3)},
            "sigma_turn: this log cannot tell; stand still for a minute, and it is known to 20 %",
        ),
        (
            {"share": 0.8, "tried": True, "advice": Advice("stand still", 5.0, 0.04, 0.6)},
            "sigma_turn: this log cannot tell; stand still for 5 minutes, and it is known to ± 0.04 rad",
        ),
    ],
)
def test_sentences(changes, sentence):
    assert dataclasses.replace(PREDICTION, **changes).sentence == sentence


@pytest.mark.slow
def test_the_page_and_the_lines_name_everything(straight, tmp_path):
    page = tmp_path / "page.html"
    write_identification_report(straight, page)
    text = page.read_text(encoding="utf-8")
    lines = identification_text(straight)
    for prediction in straight.predictions:
        assert prediction.name in text
        assert prediction.name in lines
    for drive in straight.drives:
        assert drive in text
    assert f"{straight.sentence}." in text
    assert f"{straight.sentence}." in lines
    assert "turn in place, both ways for" in lines
    assert text.count("<img ") == 1
    assert "http" not in text.replace("http-equiv", "")
    stars = [line for line in lines.splitlines() if line.endswith(" *")]
    assert len(stars) == len(straight.untold)
