"""Lidars in everything that is done with a sensor: model files, simulation, localization, calibration, effects."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import stats

import pmcl
from pmcl.cli.commands import pmcl as application
from pmcl.engine import contract
from pmcl.errors import MapError, ModelError
from pmcl.filtering.one_step_ahead import predict_readings
from pmcl.filtering.particle_filter import make_rng
from pmcl.localization import OnlineLocalizer, localize
from pmcl.models import Lidar, RobotModel, default_model
from pmcl.models.effects.registry import candidates
from pmcl.models.effects.selection import parse_effect
from pmcl.models.model_file import model_of_text, model_text
from pmcl.models.sensor import sensor_of
from pmcl.models.tables import has_extras
from pmcl.simulations.lidar_room import simulate_lidar_room

FIELD, BEAM = Lidar(), Lidar(model="beam")


@pytest.fixture(scope="module")
def log():
    return simulate_lidar_room(60, 1)


def test_default_model_and_model_file(log):
    assert default_model(log).sensors == (FIELD,)
    text = model_text(RobotModel(sensors=(BEAM,)), log)
    assert 'model = "beam" # or "beam"' in text
    assert "exponent = 0.1 #" in text
    assert "max_beams = 20 #" in text
    again = model_of_text(text, log)
    assert again.sensors == (Lidar(model="beam", exponent=0.1, max_beams=20),)
    assert model_text(again, log) == text
    assert model_of_text("[sensors.lidar]\nmax_beams = 12", log).sensors == (Lidar(max_beams=12),)
    for setting, message in (
        ('model = "beams"', "did you mean 'beam'"),
        ("exponent = 0", "> 0, but got 0"),
        ("exponent = 1.5", "exponent"),
        ("max_beams = 2.5", "max_beams"),
        ("sigma = 1", "one of model, exponent, max_beams"),
    ):
        with pytest.raises(ModelError, match=message):
            model_of_text(f"[sensors.lidar]\n{setting}", log)


def test_what_is_missing_is_told(log):
    with pytest.raises(MapError, match="expected a grid map for the lidar, got none: give one with --map"):
        default_model(log).bind(log.with_map(None))
    with pytest.raises(ModelError, match="the log has no variable 'scan'"):
        RobotModel(sensors=(FIELD,)).bind(pmcl.simulations.simulate_landmark_field(10))


def bound_tables(log, sensor, theta, effects=()):
    model = RobotModel(sensors=(sensor,), effects=tuple(effects))
    bound = model.bind(log)
    return bound.tables(np.array([theta[name] for name in bound.names]))[0]


@pytest.mark.parametrize("sensor", [FIELD, BEAM])
def test_simulated_beams_are_foreseen(sensor):
    """From the true poses, the distribution functions of simulated readings are uniform."""
    sensor = Lidar(model=sensor.model, exponent=1.0)
    log = simulate_lidar_room(40, 4, sensor=sensor)
    tables = bound_tables(log, sensor, log.true_theta)
    table = tables.sensors[0]
    path = log.true_poses
    found = predicted_from(table, path)
    # A likelihood field takes walls as seen square on, and knows distances to half a cell.
    assert stats.kstest(found, "uniform").pvalue > (1e-4 if sensor.model == "beam" else 1e-12)
    assert stats.kstest(found, "uniform").statistic < 0.05


def predicted_from(table, path):
    """Return the PIT of every reading at its true pose."""
    rng, found = np.random.default_rng(1), []
    for t in range(len(path)):
        state = path[t][:, None].copy()
        scratch, memory = np.empty((contract.scratch_rows(table), 1)), np.empty((3, 1))
        for slot in range(*contract.reading_slots(table, t)):
            logp, low, high = np.empty((3, 1))
            if contract.one_reading(table, t, slot, state, state, logp, low, high, memory, scratch):
                found.append(low[0] + (high[0] - low[0]) * rng.random())
    return np.array(found)


@pytest.mark.slow
def test_single_readings_are_foreseen_untempered(log):
    """The score of a reading is that of its own density, whatever exponent the scan is weighed with."""
    scores = {}
    for exponent in (1.0, 2 / 60):
        tables = bound_tables(log, Lidar(exponent=exponent), log.true_theta)
        found = predict_readings(tables, 60, 200, make_rng(1))
        assert found.kinds == ("scan",)
        scores[exponent] = found.log_score
    # One beam is about as well foreseen either way; tempered densities would be thirty times as flat.
    assert scores[1.0].mean() == pytest.approx(scores[2 / 60].mean(), abs=0.2)
    assert scores[1.0].mean() > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("sensor", [FIELD, BEAM])
def test_online_is_offline(log, sensor):
    model = RobotModel(sensors=(sensor,))
    theta = {p.name: float(p.prior.mean()) for p in model.parameters}
    track = localize(log, model, theta=theta, particles=300, seed=3)
    robot = OnlineLocalizer(log, model, theta=theta, particles=300, seed=3)
    scans = log.dataset["scan"].values
    for t, time in enumerate(log.times):
        estimate = robot.update(time, log.odometry[t], scan=scans[t])
        np.testing.assert_array_equal(estimate.mean, track.pose_mean[t])
    error = np.linalg.norm(track.pose_mean[:, :2] - log.true_poses[:, :2], axis=1)
    assert error[10:].max() < 0.3


@pytest.mark.parametrize("sensor", [FIELD, BEAM])
@pytest.mark.parametrize("text", ["sensor-yaw=0.05", "sensor-offset=0.1,0.05", "sensor-latency=0.5",
                                  "range-bias=0.05", "range-scale=0.03"])  # fmt: skip
def test_effects(log, rng, sensor, text):
    """Each effect changes the table, is found again in simulated scans, and its linearisation has the right sign."""
    effect, values = parse_effect(text, log, rng)
    plain = Lidar(model=sensor.model, exponent=1.0)
    simulated = simulate_lidar_room(60, 5, sensor=plain, effects=[text])
    model = RobotModel(sensors=(plain,), effects=(effect,))
    bound = model.bind(simulated)
    path = simulated.true_poses.copy()
    path[:, 2] = np.unwrap(path[:, 2])

    def log_density(share):
        theta = np.array([simulated.true_theta.get(name, np.nan) for name in bound.names])
        theta[-len(values) :] = share * np.asarray(values)
        (table,) = bound.tables(theta)[0].sensors
        logp, scratch = np.zeros(60), np.empty((20, 60))
        contract.path_reading_logpdf(table, 60, np.ascontiguousarray(path.T), logp, scratch)
        linear = sensor_of(table).linearise(table, path)
        information, shift = np.zeros((3, 3)), np.zeros(3)
        for t in range(60):
            contract.linear_information(table, linear, t, information, shift)
        assert has_extras(table) == (effect.name == "sensor-latency")
        return logp.sum(), shift @ np.linalg.solve(np.tril(information) + np.tril(information, -1).T, shift)

    at_truth, at_null, mirrored = log_density(1.0), log_density(0.0), log_density(-1.0)
    assert at_truth[0] > at_null[0] + 3.0 > mirrored[0]
    # What the linearised poses would have to explain is least where the effect is right.
    assert at_truth[1] < mirrored[1]


@pytest.mark.parametrize("sensor", [FIELD, BEAM])
def test_an_obstacle_is_seen_where_it_stands(rng, sensor):
    """Something at (8, 8) answers seven of ten rays that meet it: weight, place and radius are likelier than others."""
    plain = Lidar(model=sensor.model, exponent=1.0)
    simulated = simulate_lidar_room(60, 5, sensor=plain, effects=["unmapped-obstacle@8,8=0.7,8,8,0.4"])
    effect, values = parse_effect("unmapped-obstacle@8,8=0.7,8,8,0.4", simulated, rng)
    bound = RobotModel(sensors=(plain,), effects=(effect,)).bind(simulated)
    path = np.ascontiguousarray(simulated.true_poses.T)

    def log_density(*obstacle):
        theta = np.array([simulated.true_theta.get(name, np.nan) for name in bound.names])
        theta[-4:] = obstacle
        (table,) = bound.tables(theta)[0].sensors
        logp, scratch = np.zeros(60), np.empty((contract.scratch_rows(table), 60))
        contract.path_reading_logpdf(table, 60, path, logp, scratch)
        return logp.sum()

    at_truth = log_density(*values)
    for other in ((0.0, 8, 8, 0.4), (0.3, 8, 8, 0.4), (1.0, 8, 8, 0.4), (0.7, 8.3, 8, 0.4), (0.7, 8, 8, 0.2)):
        assert at_truth > log_density(*other) + 3.0


def test_effects_of_beams_are_not_offered(log):
    offered = {effect.name for effect in candidates(log)}
    assert {"sensor-yaw", "sensor-offset", "sensor-latency", "range-bias", "range-scale"} <= offered
    assert "unmapped-obstacle" in offered
    assert not {"beam-bias", "short-readings", "wall-moved", "range-is-depth"} & offered


def test_calibration_needs_the_map(log, tmp_path):
    log.with_map(None).write(tmp_path / "log.nc")
    arguments = ["calibrate", str(tmp_path / "log.nc"), "-o", str(tmp_path / "posterior.nc")]
    result = CliRunner().invoke(application, arguments)
    assert result.exit_code == 2
    assert "give one with --map MAP.yaml" in result.stderr


@pytest.mark.long
def test_calibration_from_the_command_line(log, tmp_path):
    log.with_map(None).write(tmp_path / "log.nc")
    log.grid_map.write(tmp_path / "room.yaml")
    out = tmp_path / "posterior.nc"
    arguments = ["calibrate", str(tmp_path / "log.nc"), "-o", str(out), "--draws", "60", "--chains", "2"]
    result = CliRunner().invoke(application, [*arguments, "--map", str(tmp_path / "room.yaml")])
    assert result.exit_code in (0, 3, 4), result.output
    posterior = pmcl.read_posterior(out)
    assert 0.05 < float(posterior.posterior["sigma_hit"].mean()) < 0.15
    assert "exponent = 0.0333" in posterior.posterior.attrs["model"]
