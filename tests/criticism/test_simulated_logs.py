"""Logs that never were: the same drive, and noise as the model says."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from pmcl.criticism.scoring import simulated_logs
from pmcl.criticism.scoring.simulated_logs import replicated_log
from pmcl.filtering.kernels.smc import sensor_terms
from pmcl.filtering.kernels.steering import steered_path
from pmcl.filtering.particle_filter import make_rng
from pmcl.logs.robot_log import RobotLog
from pmcl.models.motions.increments.motion import increment_residuals
from pmcl.models.motions.odometry.motion import Differential
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.models.sensors.range_beams.along_path import incidence
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field

# mypy: disable-error-code="no-untyped-def"


@pytest.fixture(params=["walls", "landmarks"])
def log(request):
    if request.param == "walls":
        return simulate_amigobot(200.0, 5, {"sigma_forward": 0.03, "sigma_turn": 0.05})
    return simulate_landmark_field(200, 5, bearings=True, reach=12.0)


def _reference(log):
    path = np.array(log.true_poses)
    path[:, 2] = np.unwrap(path[:, 2])
    return path


def test_same_drive_and_the_same_readings_missing(log):
    bound = default_model(log).bind(log)
    theta = np.array([log.true_theta[name] for name in bound.names])
    before = log.odometry.copy()
    made = replicated_log(log, bound.tables(theta)[0], _reference(log), make_rng(3)).log
    np.testing.assert_array_equal(log.odometry, before)
    for name in ("range", "landmark_range", "landmark_bearing"):
        if name in log.dataset:
            old, new = log.dataset[name].values, made.dataset[name].values
            np.testing.assert_array_equal(np.isnan(old), np.isnan(new))
            assert not np.array_equal(old, new, equal_nan=True)
    # Commands are the log's with a correction well below the noise of a step.
    correction = (made.odometry - log.odometry)[1:]
    assert np.all(correction.std(axis=0) < theta[:3])
    assert made.true_poses is None


def test_the_log_holds_the_commands_that_were_followed_and_what_was_read_on_the_way(log, monkeypatch):
    drives = []

    def steered(*arguments):
        drives.append(steered_path(*arguments))
        return drives[-1]

    monkeypatch.setattr(simulated_logs, "steered_path", steered)
    bound = default_model(log).bind(log)
    theta = np.array([log.true_theta[name] for name in bound.names])
    made = replicated_log(log, bound.tables(theta)[0], _reference(log), make_rng(3)).log
    ((path, correction),) = drives
    np.testing.assert_array_equal(made.odometry[1:], log.odometry[1:] + correction[1:])
    # The readings are those of the path that was driven: likely there, and not along the log's own.
    sensor = default_model(log).bind(made).tables(theta)[0].sensors[0]
    there, elsewhere = (sensor_terms(sensor, np.ascontiguousarray(one.T[None])) for one in (path, _reference(log)))
    assert there.sum() > elsewhere.sum() + 100.0


@pytest.mark.parametrize("noise", [1.0, 20.0])
def test_a_simulated_log_would_pass_the_checks_that_it_is_spared(log, noise):
    bound = default_model(log).bind(log)
    theta = np.array([log.true_theta[name] for name in bound.names])
    theta[3:] *= noise
    made = replicated_log(log, bound.tables(theta)[0], _reference(log), make_rng(3)).log
    checked = RobotLog.from_dataset(made.dataset)
    assert checked.fingerprint() == made.fingerprint()
    assert list(checked.dataset.variables) == list(made.dataset.variables)
    assert not made.odometry.flags.writeable


def test_noise_of_a_step_is_the_models_and_independent_of_its_command(log):
    bound = default_model(log).bind(log)
    theta = np.array([log.true_theta[name] for name in bound.names])
    tables, reference = bound.tables(theta)[0], _reference(log)
    noise, correction = [], []
    for seed in range(20):
        motion = tables.motion._replace(mean=tables.motion.mean.copy())
        path, change = steered_path(motion, motion.mean, make_rng(seed), reference[0], reference, 0.15, 0.0)
        noise.append(increment_residuals(motion.mean, path) / theta[:3])
        correction.append(change[1:])
        assert np.abs(path[:, :2] - reference[:, :2]).max() < 12.0 * theta[:2].max()
    flat, pull = np.concatenate(noise), np.concatenate(correction)
    for k in range(3):
        assert stats.kstest(flat[:, k], "norm").pvalue > 1e-4
        assert abs(np.corrcoef(flat[:, k], pull[:, k])[0, 1]) < 5.0 / np.sqrt(len(flat))


def test_a_robot_that_cannot_be_led_aside_is_led_back_by_turns():
    """Motion by alphas: no command aside, the noise of steps is the model's, and the robot stays near its path."""
    log = simulate_landmark_field(200, 5, bearings=True, reach=12.0)
    model = RobotModel(motion=Differential(), sensors=default_model(log).sensors)
    bound = model.bind(log)
    values = {"alpha1": 0.01, "alpha2": 0.001, "alpha3": 0.01, "alpha4": 0.001}
    theta = np.array([values.get(p.name, float(p.prior.mean())) for p in bound.parameters])
    tables, reference = bound.tables(theta)[0], _reference(log)
    made = replicated_log(log, tables, reference, make_rng(3), by_turning=True).log
    correction = made.odometry - log.odometry
    np.testing.assert_array_equal(correction[:, 1], 0.0)
    assert (correction[1:, [0, 2]] != 0.0).all()
    errors, free = [], []
    for seed in range(20):
        for pull, found in ((0.15, errors), (0.0, free)):
            motion = tables.motion._replace(mean=tables.motion.mean.copy())
            swerve = simulated_logs._swerve(motion.mean) if pull else 0.0
            path, _ = steered_path(motion, motion.mean, make_rng(seed), reference[0], reference, pull, swerve)
            found.append(np.hypot(*(path[-50:, :2] - reference[-50:, :2]).T).max())
    assert np.median(errors) < 0.3 * np.median(free)


def test_incidence_is_the_angle_to_the_walls_normal():
    log = simulate_amigobot(40.0, 5)
    table = default_model(log).bind(log).tables(np.array([0.05, 0.03, 0.05, 0.1]))[0].sensors[0]
    table = table._replace(beam_pose=np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.3], [0.0, 0.0, -0.7]]))
    # From the middle of the lower arm straight at the right wall.
    angles = incidence(table, np.array([[1.5, 1.0, 0.0]]))
    # The third meets the lower wall.
    np.testing.assert_allclose(angles[0], [0.0, 0.3, 0.5 * np.pi - 0.7], atol=1e-4)
