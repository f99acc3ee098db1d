"""Sound logs pass without a word; each mistake is named on logs of several kinds."""

from __future__ import annotations

import json
import logging
from functools import cache

import numpy as np
import pytest
from oracles import mistakes

from pmcl.calibration import calibrate
from pmcl.errors import LogError, MapError
from pmcl.geometry import compose
from pmcl.logs.mrclam import read_mrclam
from pmcl.logs.robot_log import RobotLog
from pmcl.maps.walls import WallMap
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.models.sensors.range_beams.kernels.rays import cast_rays
from pmcl.preflight.check import _tells, checked_logs, disagreements, preflight, quick_readings_of
from pmcl.preflight.evidence import evidence_of
from pmcl.preflight.hypotheses import hypotheses_of
from pmcl.preflight.stretch import stretch_of
from pmcl.simulations.aibo import simulate_aibo
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field

USUAL = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.05}


@cache
def amigobot():
    return simulate_amigobot(120.0, 11, {**USUAL, "sigma_range": 0.08})


@cache
def aibo():
    return simulate_aibo(200.0, 12, {**USUAL, "sigma_bearing": 0.08, "sigma_size": 0.15})


@cache
def field():
    return simulate_landmark_field(150, 13, bearings=True, field_of_view=4.0)


LOGS = {"field": field, "aibo": aibo, "amigobot": amigobot}

# What these logs cannot show. The L-shaped room is its own mirror image about the diagonal, so that a filter that is
# lost at first finds a pose that fits in the end. A bearing below six degrees has as much noise as signal. The odometry
# of a robot that goes at one speed fits nearly as well backwards, with some more noise.
NOT_SHOWN = {
    ("amigobot", "map-mirrored"),
    ("field", "bearings-in-degrees"),
    ("aibo", "bearings-in-degrees"),
    ("field", "odometry-disagrees (another drive)"),
    ("aibo", "odometry-disagrees (another drive)"),
}


def _cases():
    """Every mistake with every robot; all but the first robot of each mistake have a schedule of their own.

    Of mistakes that may be made in several ways, one always runs; so do those that can be made in the first log.
    """
    first = set()
    for robot, make in LOGS.items():
        for name in mistakes.mistakes_of(make()):
            if (robot, name) not in NOT_SHOWN:
                some = [pytest.mark.slow] if "(" in name or robot != "field" else []
                yield pytest.param(robot, name, marks=[pytest.mark.long] if name in first else some)
                first.add(name)


def names(log):
    return {finding.name for finding in preflight(log)}


@pytest.mark.parametrize("robot", LOGS)
def test_sound_logs_pass(robot):
    assert preflight(LOGS[robot]()) == ()


@pytest.mark.parametrize(("robot", "name"), list(_cases()))
def test_mistake_is_named(robot, name):
    change = mistakes.mistakes_of(LOGS[robot]())[name]
    if (robot, name) == ("amigobot", "map-mirrored (y axis)"):
        # The walls end up where the robot is not.
        with pytest.raises(MapError, match="start_mean inside the walls"):
            change(LOGS[robot]())
        return
    assert name.split(" (")[0] in names(change(LOGS[robot]()))


@pytest.mark.parametrize(
    ("robot", "change", "message"),
    [
        ("field", lambda log: mistakes.changed(log, landmark_bearing=np.degrees(log.landmark_bearing)), "degrees"),
        ("amigobot", mistakes.yaws_in_degrees, r"beam yaws within one turn .* got 90 for beam 0.*degrees"),
        (
            "amigobot",
            lambda log: mistakes.changed(log, beam_pose=np.column_stack((log.beam_poses[:, :2], np.arange(8.0)))),
            "numbers",
        ),
    ],
)
def test_impossible_angles_are_refused(robot, change, message):
    with pytest.raises(LogError, match=message):
        change(LOGS[robot]())


def test_narrow_beams_in_degrees_are_told_by_the_readings():
    log = amigobot()
    poses = log.beam_poses[:5] * (1.0, 1.0, 0.0) + np.array([0.0, 0.0, 1.0]) * np.linspace(-0.1, 0.1, 5)[:, None]
    # The beams of a narrow scanner, as the walls alone make them.
    rng = np.random.default_rng(1)
    lengths = cast_rays(*log.walls.vertices_and_edges(), compose(log.true_poses[:, None], poses))
    sound = RobotLog.build(
        time=log.times, odometry=log.odometry, ranges=lengths + 0.02 * rng.standard_normal(lengths.shape),
        beam_poses=poses, max_range=log.max_range, walls=log.walls, start_mean=log.start_mean, start_std=log.start_std,
    )  # fmt: skip
    assert names(sound) == set()
    assert "beam-yaws-in-degrees" in names(mistakes.yaws_in_degrees(sound))


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["amigobot", "field"])
def test_a_start_that_is_not_known_is_no_mistake(robot):
    log = LOGS[robot]().select(0, 80)
    unknown = mistakes.changed(log, start_std=np.full(3, np.inf))
    assert names(unknown) == set()
    assert "turn-sign-flipped" in names(mistakes.turn_sign_flipped(unknown))


def test_a_symmetric_map_may_be_mirrored_without_a_word():
    """Nothing in a square room says which way round its map is when nobody knows where the robot began."""
    square = WallMap.from_polygon([(0.0, 0.0), (3.0, 0.0), (3.0, 3.0), (0.0, 3.0)])
    log = simulate_amigobot(60.0, 3, room=square, waypoints=[(0.8, 0.8), (2.2, 0.8), (2.2, 2.2), (0.8, 2.2)])
    assert names(mistakes.map_mirrored(log)) == set()


def test_the_explanation_that_all_is_noise_is_compared_too():
    """Readings that are pure noise have no better explanation in any unit: nothing is named but that."""
    log = amigobot()
    rng = np.random.default_rng(5)
    noise = mistakes.changed(log, range=rng.uniform(0.0, 5.0, log.ranges.shape))
    assert names(noise) == {"readings-unrelated-to-map"}


def test_the_odometry_of_a_hypothesis_undoes_the_mistake():
    """Each change of the odometry, applied to a log with that mistake, gives the sound increments back."""
    log = field()
    for name in ("turns-in-degrees", "turn-sign-flipped", "poses-as-increments", "odometry-columns-swapped",
                 "velocities-as-increments", "odometry-in-world-frame"):  # fmt: skip
        wrong = mistakes.ODOMETRY[name](log)
        found = [way.odometry for way in hypotheses_of(wrong, {}) if way.name == name]
        assert any(np.allclose(odometry[2:], log.odometry[2:], atol=1e-9) for odometry in found), name


def test_evidence_of_the_same_way_twice_differs_by_its_own_noise_only():
    log = amigobot()
    readings = quick_readings_of(log, {"sigma_range": 0.1})
    plain = hypotheses_of(log, readings)[0]
    rows = stretch_of(log, readings.values(), 60)
    evidence = evidence_of(log, readings, rows, (plain, plain), np.array([0.05, 0.03, 0.05]), 200, 0)
    gain = evidence.rows[1] - evidence.rows[0]
    assert np.isfinite(gain).all()
    assert np.any(gain != 0.0)
    assert not _tells(gain, 30)


@pytest.mark.parametrize(
    ("gain", "tells"),
    [
        (np.full(100, 0.5), True),
        (np.full(100, 0.1), False),  # too little in each half
        (np.concatenate((np.zeros(50), np.full(50, 1.0))), False),  # one half says nothing
        (np.where(np.arange(100) % 50 == 7, 25.0, 0.0), False),  # two rows made it all
        (np.append(np.full(99, 0.5), np.nan), False),  # given up
    ],
)
def test_both_halves_and_most_blocks_must_tell(gain, tells):
    assert _tells(gain, 30) is tells


def test_a_stretch_has_the_rows_in_which_the_view_changed():
    log = amigobot()
    still = mistakes.changed(log, odometry=np.where(np.arange(log.n_steps)[:, None] < 50, 0.0, log.odometry))
    readings = quick_readings_of(log, {}).values()
    assert stretch_of(still, readings, 30).tolist()[:2] == [0, 50]
    assert len(stretch_of(log, readings, 30)) == 30


def test_findings_of_several_logs_are_numbered_and_warned_of(caplog):
    wrong = mistakes.turn_sign_flipped(field())
    with caplog.at_level(logging.WARNING, "pmcl"):
        entries = json.loads(checked_logs((field(), wrong)))
    assert [(entry["name"], entry["log"], entry["mistake"]) for entry in entries] == [("turn-sign-flipped", 1, True)]
    assert "log with a mistake: the turns of the odometry seem to have the wrong sign" in caplog.text
    assert set(json.loads(checked_logs((wrong,)))[0]) == {"name", "level", "mistake", "message"}


def test_a_model_says_how_much_noise_is_usual():
    """A model that knows sonars to be far better than their prior says does not change what is found."""
    log = amigobot()
    sure = RobotModel(sensors=default_model(log).sensors, fixed={"sigma_range": 0.05})
    assert disagreements(log, sure) == ()
    assert "turn-sign-flipped" in {f.name for f in disagreements(mistakes.turn_sign_flipped(log), sure)}


def test_one_row_is_refused():
    with pytest.raises(LogError, match="at least two rows"):
        calibrate(amigobot().select(0, 1))


def test_recorded_robots_pass(shared_data):
    for robot in (1, 2):
        log = read_mrclam(shared_data / "mrclam6", robot)
        assert preflight(log) == ()
    hard = read_mrclam(shared_data / "mrclam7", 3)
    assert preflight(hard) == ()


@pytest.mark.parametrize("name", ["bearings-in-degrees", "bearings-in-world-frame", "velocities-as-increments",
                                  "map-mirrored", "turn-sign-flipped", "ranges-in-centimetres"])  # fmt: skip
def test_mistakes_with_a_recorded_robot_are_named(shared_data, name):
    log = read_mrclam(shared_data / "mrclam6", 1)
    assert name in names(mistakes.mistakes_of(log)[name](log))
