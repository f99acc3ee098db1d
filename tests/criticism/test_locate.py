"""Where a disagreement is, also where only a handful of readings show it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import special

from pmcl.criticism.judging.alarms import Alarm, Judgement
from pmcl.criticism.judging.locate import locate
from pmcl.criticism.scoring.covariates import RowCovariates
from pmcl.criticism.scoring.features import Feature
from pmcl.criticism.workflow import criticize
from pmcl.logs.robot_log import RobotLog
from pmcl.simulations.landmark_field import simulate_landmark_field

# mypy: disable-error-code="no-untyped-def, arg-type"

ROWS = 200


def scored_log(times, xi, channel=3):
    """What is known of the readings of one channel, deviations `xi` at rows `times`."""
    times = np.asarray(times)
    n = times.size
    made = SimpleNamespace(
        kind=np.zeros(n, dtype=int), kinds=("landmark_range",), channel=np.full(n, channel), time=times
    )
    rows = RowCovariates(np.arange(ROWS) * 0.5, *np.zeros((5, ROWS)))
    readings = {"distance": np.linspace(1.0, 5.0, n)}
    return SimpleNamespace(predictions=made, pit=special.ndtr(np.asarray(xi, dtype=float)), row_covariates=rows,
                           reading_covariates=readings)  # fmt: skip


def located(times, xi, covariate="", channel=3):
    alarm = Alarm("uniformity", 1e-6, True, Feature("uniformity", "landmark_range", channel, covariate), 5.0)
    alarm = alarm._replace(worst=Feature("covariate", "landmark_range", channel, covariate))
    return locate(alarm, scored_log(times, xi), {})


@pytest.mark.parametrize("count", [1, 2, 3, 9, 10, 15, 16, 17])
def test_a_channel_with_few_readings_has_a_place_in_time(count):
    times = np.arange(190 - count, 190)
    found = located(times, np.full(count, 3.0), "distance")
    assert found.beams == (3,)
    assert times[0] <= found.time[0] <= found.time[1] <= times[-1]
    assert 1.0 <= found.interval[0] <= found.interval[1] <= 5.0
    if count < 4:
        assert found.time == (times[0], times[-1])


def test_few_readings_still_tell_when_it_was_worst():
    xi = np.zeros(10)
    xi[6:8] = 4.0
    assert located(np.arange(100, 110), xi).time == (106, 107)


def test_a_covariate_that_is_unknown_everywhere_has_no_interval():
    alarm = Alarm("covariate", 1e-6, True, Feature("covariate", "landmark_range", 3, "distance"), 5.0)
    scored = scored_log(np.arange(20), np.ones(20))
    scored.reading_covariates["distance"][:] = np.nan
    assert np.isnan(locate(alarm, scored, {}).interval).all()


def test_p_values_of_what_is_unexplained_count_all_families():
    """Holm's rule, from the example of Holm (1979) in numbers: 0.01, 0.02, 0.03, 0.005 at level 0.05."""
    p_values = {"uniformity": 0.01, "serial": 0.02, "covariate": 0.9, "score": 0.005}
    raised = {"uniformity": True, "serial": True, "covariate": False, "score": True}
    alarms = tuple(Alarm(name, p, raised[name], Feature(name, "range"), 3.0) for name, p in p_values.items())
    judgement = Judgement(alarms, *6 * (np.empty(0),), np.inf, (), np.empty(0))
    assert [alarm.family for alarm in judgement.raised] == ["score", "uniformity", "serial"]
    assert judgement.raised_p_values == pytest.approx((0.02, 0.03, 0.04))
    assert judgement.raised_p_values[0] == judgement.p_value


@pytest.mark.slow
def test_a_landmark_that_is_first_seen_late_and_is_wrong_does_not_end_the_run():
    log = simulate_landmark_field(90, 3)
    dataset = log.dataset.copy(deep=True)
    ranges = dataset["landmark_range"].values.copy()
    ranges[:80, 2] = np.nan
    ranges[80:, 2] += 4.0
    late = RobotLog(dataset.assign(landmark_range=(("time", "landmark"), ranges)), "late.nc")
    settings = {"simulations": 15, "paths": 4, "particles": 200, "rounds": 1, "joint": False, "workers": 1, "seed": 1}
    found = criticize(late, effects=(), **settings)
    assert found.unexplained
    # Its readings pull the path away, so that a landmark that is seen at the same time may be told beside it.
    late_rows = [one for one in found.unexplained if 2 in one.beams]
    assert late_rows
    assert all(len(one.beams) <= 2 for one in late_rows)
    assert all(80 <= one.time[0] <= one.time[1] <= 89 for one in late_rows)
    assert all(one.p_value <= 0.05 for one in found.unexplained)
