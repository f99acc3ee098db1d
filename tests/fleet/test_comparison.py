"""Which robot stands out: all odd ones and no other, at a known rate of false alarms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from synthetic import LINE, SIGMA, fleet_of

from pmcl.errors import SamplingError
from pmcl.fleet import comparison as module
from pmcl.fleet.comparison import compare_robots, holm
from pmcl.fleet.densities import robot_density
from pmcl.fleet.population import population_of
from pmcl.models.parameters import Parameter, gamma_prior

SECOND = Parameter("sigma_turn", "rad", gamma_prior(0.1))


def _fleet(rng, odd_first=None, odd_second=None, robots=20):
    """Two parameters of each robot; a fleet's spread is 15 %, and a log tells each within 8 %."""
    first = fleet_of(rng, 0.08, 0.15, 0.08, robots, odd_first)
    second = fleet_of(rng, 0.05, 0.15, 0.08, robots, odd_second)
    return {name: {"sigma_range": first[name], "sigma_turn": second[name]} for name in first}


def _compared(draws):
    return compare_robots(draws, dict.fromkeys(draws, (SIGMA, SECOND)))


def _odd(draws):
    return {(member.robot, member.parameter) for member in _compared(draws).standing_out}


def test_three_odd_robots_of_twenty_are_found_and_no_other(rng):
    found = _compared(_fleet(rng, {3: 1.1, 8: 1.2}, {15: -1.2}))
    assert {(member.robot, member.parameter) for member in found.standing_out} == {
        ("robot3", "sigma_range"), ("robot8", "sigma_range"), ("robot15", "sigma_turn"),
    }  # fmt: skip
    assert found.standing_out[0].adjusted_p_value <= found.standing_out[-1].adjusted_p_value
    by_robot = {member.robot: member for member in found.standing_out}
    assert by_robot["robot3"].deviation == pytest.approx(np.exp(1.1), rel=0.5)
    assert by_robot["robot15"].deviation < 0.5
    assert all(member.odd_probability > 0.9 for member in found.standing_out)


def test_without_room_for_odd_robots_they_hide_behind_each_other(rng):
    """The negative control: what the population allows for is what finds them."""
    draws = fleet_of(rng, 0.08, 0.15, 0.08, odd={3: 1.1, 8: 1.1, 15: 1.1})
    robots = [robot_density(one, LINE) for one in draws.values()]
    for oddness, found in ((0.0, False), (0.1, True)):
        population = population_of(robots, LINE, oddness)
        adjusted = holm([population.conflict(i)[0] for i in range(20)])
        assert bool(np.all(adjusted[[3, 8, 15]] <= module.LEVEL)) is found


def test_p_values_of_robots_that_are_alike_are_uniform(rng):
    p_values = []
    for _ in range(8):
        robots = [robot_density(one, LINE) for one in fleet_of(rng, 0.08, 0.15, 0.1, 12).values()]
        population = population_of(robots, LINE)
        p_values += [population.conflict(i)[0] for i in range(12)]
    assert stats.kstest(p_values, "uniform").pvalue > 0.01


@pytest.mark.long
def test_odd_robots_are_found_and_others_are_not_in_many_fleets(rng):
    """Of 20 fleets with three odd robots and 40 without, two parameters each."""
    where = {("robot3", "sigma_range"), ("robot8", "sigma_range"), ("robot15", "sigma_turn")}
    exactly = sum(_odd(_fleet(rng, {3: 1.1, 8: 1.2}, {15: -1.2})) == where for _ in range(20))
    alarms = sum(bool(_odd(_fleet(rng))) for _ in range(40))
    # Level 5 % for any alarm in a fleet: more than 6 of 40 come by chance in three of a thousand such tests.
    assert alarms <= 6, alarms
    assert exactly >= 18, exactly


def test_two_robots_are_compared_and_neither_stands_out_alone(rng):
    draws = _fleet(rng, {0: 0.8}, robots=2)
    found = _compared(draws)
    assert not found.standing_out, "with one other robot nobody knows what is usual"
    low, high = found.populations["sigma_range"].mean_quantiles((0.05, 0.95))
    assert high > 2.0 * low


def test_what_cannot_be_compared_is_refused(rng):
    draws = _fleet(rng, robots=2)
    with pytest.raises(SamplingError, match="expected at least two robots"):
        compare_robots({"robot0": draws["robot0"]}, {"robot0": (SIGMA, SECOND)})
    other = Parameter("sigma_range", "m", gamma_prior(0.2))
    with pytest.raises(SamplingError, match=r"one prior of sigma_range.*robot0 and robot1"):
        compare_robots(draws, {"robot0": (SIGMA, SECOND), "robot1": (other, SECOND)})


def test_a_parameter_that_one_robot_alone_has_is_left_out(rng):
    draws = _fleet(rng, robots=3)
    parameters = dict.fromkeys(draws, (SIGMA,)) | {"robot0": (SIGMA, SECOND)}
    assert set(compare_robots(draws, parameters).populations) == {"sigma_range"}


def test_holm_is_that_of_the_paper():
    np.testing.assert_allclose(holm([0.01, 0.04, 0.03, 0.005]), [0.03, 0.06, 0.06, 0.02])
    assert holm([]).size == 0
