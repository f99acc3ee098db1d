"""The check that ends a calibration: silent about models that are right, and clear about those that are not."""

from __future__ import annotations

import json
from typing import NamedTuple

import numpy as np
import pytest
from scipy import stats

import pmcl
from pmcl.criticism.fitting.quick_fit import THOROUGH, quick_fit
from pmcl.filtering.one_step_ahead import predict_readings
from pmcl.filtering.particle_filter import make_rng
from pmcl.logs.robot_log import RobotLog
from pmcl.models.motions.increments.motion import IncrementNoise
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.models.sensor import Sensor
from pmcl.models.sensors.lidar.sensor import Lidar
from pmcl.posterior.model_check import LEVEL, check_model
from pmcl.posterior.predictive_check import check_group
from pmcl.posterior.predictive_draws import _replicated
from pmcl.simulations.landmark_field import simulate_landmark_field
from pmcl.simulations.lidar_room import simulate_lidar_room

# mypy: disable-error-code="no-untyped-def"

SONAR = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.05}
SIGHTS = {
    "sigma_forward": 0.05, "sigma_left": 0.03, "sigma_turn": 0.03, "sigma_landmark_range": 0.2, "sigma_bearing": 0.05,
}  # fmt: skip


def field_log(seed, n_steps=200, **options):
    return simulate_landmark_field(n_steps, seed, SIGHTS, bearings=True, reach=12.0, **options)


def checked_at(log, truth, seed=0, **factors):
    """The check of the default model at the true theta, some of its values multiplied."""
    bound = default_model(log).bind(log)
    return check_model(bound, np.array([truth[name] * factors.get(name, 1.0) for name in bound.names]), seed)


@pytest.mark.parametrize("kind", ["walls", "landmarks"])
def test_a_right_model_is_seldom_objected_to(kind):
    """P-values of 16 short logs at the true theta are uniform, and hardly any of them is below the level."""
    found = []
    for seed in range(16):
        log = pmcl.simulate_amigobot(60.0, seed, SONAR) if kind == "walls" else field_log(seed, 60)
        found.append(checked_at(log, SONAR if kind == "walls" else SIGHTS, seed))
    assert stats.kstest([one.p_value for one in found], "uniform").pvalue > 1e-3
    # Two of 16 happen once in a hundred times when the rate is 1 %, three once in two thousand.
    assert sum(not one.adequate for one in found) <= 2
    assert all(one.adequate == (one.p_value > LEVEL) == (not one.findings) for one in found)


@pytest.mark.parametrize(("factor", "sentence"), [(0.6, "scatter more"), (1.7, "scatter less")])
def test_a_wrong_noise_is_named(factor, sentence):
    found = checked_at(field_log(3), SIGHTS, sigma_bearing=factor)
    assert found.adequate is False
    assert f"landmark bearings {sentence} than the model says" in [one.message for one in found.findings]
    assert not any(one.kind == "landmark_range" and one.name == "spread" for one in found.findings)


def test_errors_that_last_are_named_with_their_duration():
    """Landmark ranges with errors of 4 s beside noise of half their size, as cameras of real robots have them."""
    log = field_log(5, 400)
    rng = np.random.default_rng(5)
    error = np.zeros(log.dataset["landmark_range"].shape)
    for t in range(1, len(error)):
        error[t] = np.exp(-1.0 / 4.0) * error[t - 1] + 0.25 * rng.standard_normal(error.shape[1])
    dataset = log.dataset.copy(deep=True)
    dataset["landmark_range"].values[:] = np.maximum(dataset["landmark_range"].values + error, 0.1)
    found = checked_at(RobotLog(dataset, "lasting.nc"), SIGHTS, sigma_landmark_range=2.0)
    lasting = [one for one in found.findings if one.name == "lasting" and one.kind == "landmark_range"]
    assert found.adequate is False
    assert len(lasting) == 1
    assert 2.0 < lasting[0].seconds < 8.0
    assert lasting[0].message.startswith("errors of landmark ranges last about ")


def test_a_channel_that_is_off_is_named():
    log = pmcl.simulate_amigobot(200.0, 2, SONAR)
    dataset = log.dataset.copy(deep=True)
    dataset["range"].values[:, 5] += 0.06
    found = checked_at(RobotLog(dataset, "beam.nc"), SONAR)
    (one,) = [one for one in found.findings if one.name == "channel shift"]
    assert 5 in one.channels
    assert one.message.startswith("ranges of beam")
    assert "5" in one.message


def checked_scans(seed, effect=None, sensor=None):
    """The check of a lidar's plain model at the true theta; each beam has an error of its own."""
    effects = () if effect is None else (effect,)
    log = simulate_lidar_room(80, seed, sensor=Lidar(exponent=1.0), effects=effects, hide_effects=True)
    bound = RobotModel(IncrementNoise(), (sensor or Lidar(),)).bind(log)
    return check_model(bound, np.array([log.true_theta[name] for name in bound.names]), seed)


@pytest.mark.long
def test_scans_of_a_right_model_are_seldom_objected_to():
    """Tempered or not: beams that are more independent than the exponent says are no fault."""
    found = [checked_scans(seed) for seed in range(8)] + [checked_scans(8, sensor=Lidar(exponent=1.0))]
    assert sum(not one.adequate for one in found) <= 1
    assert np.nanstd(found[-1].passes[0].scores) == pytest.approx(1.0, abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize(("effect", "name"), [("sensor-yaw=0.1", "channel shift"), ("sensor-latency=2.0", "lasting"),
                                              ("range-bias=0.15", "shift")])  # fmt: skip
def test_what_is_wrong_with_scans_is_named(effect, name):
    found = checked_scans(1, effect)
    assert found.adequate is False
    named = {one.name: one for one in found.findings}
    assert name in named
    if name == "channel shift":
        assert 0 in named[name].channels
        assert named[name].message.startswith("lidar ranges of rays 0 to 14 ")


def test_a_lost_robot_is_a_finding_with_its_time():
    """From row 60 the readings are those of another place."""
    log = pmcl.simulate_amigobot(120.0, 6, SONAR)
    dataset = log.dataset.copy(deep=True)
    dataset["range"].values[60:] = dataset["range"].values[:60]
    log = RobotLog(dataset, "carried.nc")
    found = checked_at(log, SONAR)
    assert found.adequate is False
    assert found.findings[0].name == "lost"
    assert 55.0 <= found.findings[0].seconds <= 80.0
    assert "the filter loses the robot at t=" in found.findings[0].message
    group = check_group(found, (log,))
    assert group.attrs["adequate"] == 0
    assert json.loads(group.attrs["findings"])[0]["name"] == "lost"


def test_too_few_readings_tell_nothing():
    found = checked_at(pmcl.simulate_amigobot(3.0, 1, SONAR), SONAR)
    assert found.adequate is None
    assert found.findings == ()


def test_each_log_is_judged_and_told_apart():
    good, bad = field_log(1, 100), field_log(2, 100)
    dataset = bad.dataset.copy(deep=True)
    dataset["landmark_bearing"].values[:] += 0.1 * np.sign(np.sin(np.arange(100) / 5.0))[:, None]
    bound = default_model(good).bind([good, RobotLog(dataset, "bad.nc")])
    found = check_model(bound, np.array([SIGHTS[name] for name in bound.names]), 4)
    assert found.adequate is False
    assert {one.log for one in found.findings} == {1}
    group = check_group(found, bound.logs)
    assert group["residual_landmark_bearing_1"].dims == ("time_1", "landmark_1")
    np.testing.assert_array_equal(
        np.isnan(group["residual_landmark_range_0"]), np.isnan(good.dataset["landmark_range"])
    )


def test_the_same_seed_gives_the_same_check():
    log = field_log(7, 60)
    first, second, other = (checked_at(log, SIGHTS, seed) for seed in (2**80, 2**80, 1))
    assert first.p_value == second.p_value
    np.testing.assert_array_equal(first.passes[0].scores, second.passes[0].scores)
    assert not np.array_equal(first.passes[0].scores, other.passes[0].scores)


class Probe(NamedTuple):
    """A sensor table whose simulation only notes the path that it was given."""

    paths: list


class ProbeSensor(Sensor):
    """The sensor of that table."""

    table_type = Probe

    @classmethod
    def simulate(cls, table: Probe, path: np.ndarray, rng: np.random.Generator) -> Probe:
        table.paths.append(path)
        return table


def test_each_replicated_row_follows_a_particle_and_its_ancestor():
    log = pmcl.simulate_aibo(30.0, 4)
    bound = default_model(log).bind(log)
    tables = bound.tables(bound.prior_mean())[0]
    made = predict_readings(tables, log.n_steps, 50, make_rng(1))
    probe = Probe([])
    _replicated(log, tables._replace(sensors=(probe,)), made, make_rng(2))
    even, odd = probe.paths
    for t in range(1, log.n_steps):
        path = odd if t % 2 else even
        (particle,) = np.flatnonzero((path[t] == made.filtered.particles[t].T).all(axis=1))
        ancestor = made.filtered.ancestors[t, particle]
        np.testing.assert_array_equal(path[t - 1], made.filtered.particles[t - 1, :, ancestor])


# What a short calibration leaves wrong must not be objected to: logs of all robots, theta from the priors.
def correct_log(seed):
    duration = (60, 120, 200, 400)[seed // 3 % 4]
    if seed % 3 == 0:
        return pmcl.simulate_amigobot(float(duration), seed)
    if seed % 3 == 1:
        return pmcl.simulate_aibo(float(duration), seed)
    rng = np.random.default_rng(seed)
    small = simulate_landmark_field(2, 0, bearings=True)
    theta = {one.name: float(one.prior.rvs(random_state=rng)) for one in default_model(small).parameters}
    return simulate_landmark_field(duration, seed, theta, bearings=True, reach=12.0)


@pytest.mark.long
def test_calibrated_correct_models_are_seldom_objected_to():
    """At a rate of 1 %, more than four of 90 happen in one of 400 runs; the promise is 5 %."""
    wrong = 0
    for seed in range(90):
        log = correct_log(seed)
        bound = default_model(log).bind(log)
        wrong += check_model(bound, quick_fit(bound, seed, effort=THOROUGH).theta, seed).adequate is False
    assert wrong <= 4


@pytest.mark.long
@pytest.mark.parametrize("model", ["likelihood-field", "beam"])
def test_calibrated_models_of_scans_are_seldom_objected_to(model):
    """At a rate of 1 %, more than two of 20 happen in one of a thousand runs."""
    wrong = 0
    for seed in range(20):
        log = simulate_lidar_room(120, seed, sensor=Lidar(model=model, max_beams=60))
        bound = RobotModel(IncrementNoise(), (Lidar(model=model),)).bind(log)
        wrong += check_model(bound, quick_fit(bound, seed, effort=THOROUGH).theta, seed).adequate is False
    assert wrong <= 2


@pytest.mark.slow
@pytest.mark.parametrize("robot", [1, 2])
def test_recorded_robots_disagree_with_the_default_model(shared_data, tmp_path, robot):
    from pmcl.logs.mrclam import read_mrclam

    log = read_mrclam(shared_data / "mrclam6", robot, period=0.5)
    bound = default_model(log).bind(log)
    found = check_model(bound, quick_fit(bound, robot).theta)
    assert found.adequate is False
    assert any(one.name == "lasting" and one.kind == "landmark_range" for one in found.findings)
