"""What the numbers of a log show by themselves: each mistake, and beside it what it must not be taken for."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from oracles import mistakes

from pmcl.errors import LogError
from pmcl.logs.plausibility import implausible, without_map
from pmcl.logs.robot_log import RobotLog
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field


@pytest.fixture(scope="module")
def sonars():
    return simulate_amigobot(100.0, 4)


@pytest.fixture(scope="module")
def field():
    return simulate_landmark_field(100, 4, bearings=True, field_of_view=3.0)


def names(log):
    return [finding.name for finding in implausible(log)]


def built(log, **changes):
    given = {
        "time": log.times, "odometry": log.odometry, "ranges": log.ranges, "beam_poses": log.beam_poses,
        "max_range": log.max_range, "walls": log.walls, "start_mean": log.start_mean, "start_std": log.start_std,
    }  # fmt: skip
    return RobotLog.build(**{**given, **changes})


def test_sound_logs_show_nothing(sonars, field):
    assert names(sonars) == names(field) == []


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "milli"), (1e6, "micro"), (1e9, "nano")])
def test_times_in_smaller_units(sonars, factor, unit):
    assert names(mistakes.changed(sonars, time=factor * (10.0 + sonars.times))) == [f"times-in-{unit}seconds"]


def test_a_slow_robot_that_is_rarely_recorded_is_sound(sonars):
    """One row in a minute, 0.1 m apart: 2 mm/s."""
    assert names(mistakes.changed(sonars, time=60.0 * sonars.times)) == []


def test_speed_and_turns(sonars):
    fast = mistakes.with_odometry(sonars, sonars.odometry * (50.0, 50.0, 1.0))
    assert names(fast) == ["fast"]
    assert not implausible(fast)[0].mistake
    assert names(mistakes.turns_in_degrees(sonars)) == ["large-turns"]
    glitch = sonars.odometry.copy()
    glitch[7, 0] = 6.0
    assert names(mistakes.with_odometry(sonars, glitch)) == []


def test_zero_for_not_seen(field):
    assert set(names(mistakes.zeros_for_not_seen(field))) == {"zero-for-not-seen"}
    # Bearings in whole degrees are zero now and then.
    rounded = mistakes.changed(field, landmark_bearing=np.radians(np.round(np.degrees(field.landmark_bearing))))
    assert names(rounded) == []


def test_a_stuck_beam_is_told_from_coarse_rounding_and_from_a_robot_that_stands_still(sonars):
    assert names(mistakes.stuck_sensor(sonars)) == ["stuck-sensor"]
    assert names(mistakes.changed(sonars, range=np.round(2.0 * sonars.ranges) / 2.0)) == []
    still = mistakes.with_odometry(mistakes.stuck_sensor(sonars), np.zeros_like(sonars.odometry))
    assert names(still) == []
    clipped = mistakes.changed(sonars, range=np.minimum(sonars.ranges, 1.0), max_range=1.0)
    assert "stuck-sensor" not in names(clipped)


def test_repeated_rows(sonars):
    stale = mistakes.stale_readings(sonars)
    assert names(stale) == ["stale-readings"]
    assert "50 of 99 rows" in implausible(stale)[0].message
    assert names(mistakes.with_odometry(stale, np.zeros_like(stale.odometry))) == []


def test_nothing_but_max_range(sonars):
    assert names(mistakes.all_at_max_range(sonars)) == ["all-at-max-range"]
    assert names(mistakes.ranges_in_millimetres_max_range_in_metres(sonars)) == ["all-at-max-range"]
    assert names(mistakes.max_range_in_millimetres(sonars)) == ["max-range-too-long"]


def test_yaws_that_are_numbers(sonars):
    assert names(mistakes.yaws_as_indices(sonars)) == ["beam-yaws-are-indices"]


def test_build_warns_and_can_be_silenced(sonars, caplog):
    with caplog.at_level(logging.WARNING, "pmcl"):
        built(sonars)
        built(sonars, time=1e9 * sonars.times, warn=False)
        assert caplog.text == ""
        built(sonars, time=1e9 * sonars.times)
    assert "RobotLog.build: rows are 1e+09 s apart" in caplog.text
    assert "divide them by 1e+09" in caplog.text


def test_missing_walls_are_noticed_unless_a_map_is_named(sonars, caplog):
    with caplog.at_level(logging.WARNING, "pmcl"):
        assert not without_map(built(sonars, walls=None, attributes={"map": "hall.yaml"}))
        assert caplog.text == ""
        assert without_map(built(sonars, walls=None))
    assert "range readings have no map" in caplog.text


def test_angles_beyond_one_turn_are_refused(sonars, field):
    with pytest.raises(LogError, match=r"'landmark_bearing' within one turn .*, got .* in row 0 .*convert degrees"):
        mistakes.changed(field, landmark_bearing=np.degrees(field.landmark_bearing))
    with pytest.raises(LogError, match="got 90 for beam 0: convert degrees to radians"):
        mistakes.yaws_in_degrees(sonars)
    whole_turns = field.landmark_bearing + np.where(field.landmark_bearing < 0.0, 2.0 * np.pi, 0.0)
    assert names(mistakes.changed(field, landmark_bearing=whole_turns)) == []
