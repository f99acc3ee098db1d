"""Corrections of wheels and mounts: with them, the robot's description is right."""

from __future__ import annotations

import json

import numpy as np
import pytest
from exports.made_lidar import lidar_posterior, yaml_content

from pmcl.errors import PosteriorError
from pmcl.exports import export_text
from pmcl.exports.mounts import corrected_mount
from pmcl.exports.wheels import motion_coefficients, wheel_multipliers
from pmcl.models.effects.odometry import ODOMETRY_EFFECTS
from pmcl.models.motions.increments.motion import GrowingIncrementNoise
from pmcl.models.tables import Tables
from pmcl.simulations.amigobot import simulate_amigobot

SEPARATION = 0.4
EFFECTS = ("odometry-forward-scale", "odometry-turn-scale", "odometry-arc")


def wheels_of(forward, turn, separation):
    """Ways of the left and right wheel."""
    return forward - 0.5 * separation * turn, forward + 0.5 * separation * turn


def odometry_of(left, right, separation):
    """What diff_drive_controller reports of them: forward and turn."""
    return 0.5 * (left + right), (right - left) / separation


def pose_after(forward, turn):
    """Poses along arcs of circles."""
    pose = np.zeros(3)
    for f, w in zip(forward, turn, strict=True):
        middle = pose[2] + 0.5 * w
        chord = f * np.sinc(0.5 * w / np.pi)
        pose = pose + np.array([chord * np.cos(middle), chord * np.sin(middle), w])
    return pose


def test_corrected_odometry_is_the_true_motion_of_a_robot_with_wrong_wheels(rng):
    """The wheels are really 0.97, 1.02 and 1.05 of what the robot believes; the effects say so to first order."""
    left_true, right_true, separation_true = 0.97, 1.02, 1.05
    forward, turn = rng.uniform(-0.05, 0.2, 500), rng.uniform(-0.15, 0.2, 500)
    true_left, true_right = wheels_of(forward, turn, SEPARATION * separation_true)
    believed = true_left / left_true, true_right / right_true
    odometry = odometry_of(*believed, SEPARATION)
    # What a calibration finds: the regression of the true motion on the odometry, as the effects put it.
    scale = np.linalg.lstsq(odometry[0][:, None], forward, rcond=None)[0][0]
    per_metre, turned = np.linalg.lstsq(np.column_stack(odometry), turn, rcond=None)[0]
    theta = {"odometry_forward_scale": scale - 1.0, "odometry_turn_scale": turned - 1.0,
             "odometry_arc": per_metre / scale}  # fmt: skip
    # The arc comes last in the list: it is added to a turn that was scaled, per metre of a way that was scaled.
    found = wheel_multipliers(EFFECTS, theta, SEPARATION)
    assert found.left == pytest.approx(left_true, abs=1e-3)
    assert found.right == pytest.approx(right_true, abs=1e-3)
    assert found.separation == pytest.approx(separation_true, abs=1e-3)
    corrected = odometry_of(believed[0] * found.left, believed[1] * found.right, SEPARATION * found.separation)
    errors = [np.linalg.norm((pose_after(*way) - pose_after(forward, turn))[:2]) for way in (odometry, corrected)]
    assert errors[1] < 0.05 * errors[0]


def test_the_multipliers_have_exactly_the_coefficients_of_the_effects(rng):
    """The odometry of the corrected wheels is S f ahead, but for the cross term, and K f + R w turned."""
    theta = {"odometry_forward_scale": 0.03, "odometry_turn_scale": -0.04, "odometry_arc": 0.05}
    found = wheel_multipliers(EFFECTS, theta, SEPARATION)
    forward, per_metre, turn = motion_coefficients(EFFECTS, theta)
    f, w = rng.normal(size=(2, 50))
    left, right = wheels_of(f, w, SEPARATION)
    ahead, turned = odometry_of(left * found.left, right * found.right, SEPARATION * found.separation)
    np.testing.assert_allclose(turned, per_metre * f + turn * w, rtol=1e-12)
    cross = 0.25 * (found.right - found.left) * SEPARATION * w
    np.testing.assert_allclose(ahead, forward * f + cross, rtol=1e-12)


@pytest.mark.parametrize("order", [EFFECTS, EFFECTS[::-1], (EFFECTS[2], EFFECTS[0], EFFECTS[1])])
def test_coefficients_are_those_of_the_effects_in_their_order(order):
    log = simulate_amigobot(20.0)
    theta = {"odometry_forward_scale": 0.1, "odometry_turn_scale": -0.2, "odometry_arc": 0.3}
    effects = {effect.name: effect for effect in ODOMETRY_EFFECTS}
    motion = GrowingIncrementNoise()
    bound = motion.bind(log)
    values = np.array([parameter.prior.mean() for parameter in motion.parameters])
    tables = Tables(start=None, motion=bound.table(values), sensors=())
    before = tables.motion.mean.copy()
    for name in order:
        value = theta[name.replace("-", "_")]
        tables = effects[name].change(tables, np.array([value]), log, {})
    forward, per_metre, turn = motion_coefficients(order, theta)
    np.testing.assert_allclose(tables.motion.mean[:, 0], forward * before[:, 0], rtol=1e-12)
    expected = per_metre * before[:, 0] + turn * before[:, 2]
    np.testing.assert_allclose(tables.motion.mean[:, 2], expected, rtol=1e-12, atol=1e-15)


def test_multipliers_are_exported_with_their_spread():
    theta = {"odometry_forward_scale": 0.03, "odometry_arc": 0.02}
    data = lidar_posterior(theta, effects=("odometry-forward-scale", "odometry-arc"))
    text = export_text(data, "ros2_controllers", wheel_separation=SEPARATION)
    content = yaml_content(text)["diff_drive_controller"]["ros__parameters"]
    assert content["left_wheel_radius_multiplier"] < 1.03 < content["right_wheel_radius_multiplier"]
    assert content["wheel_separation_multiplier"] == pytest.approx(1.03, abs=0.001)
    assert text.count("+-") >= 4
    with pytest.raises(PosteriorError, match="--wheel-separation"):
        export_text(data, "ros2_controllers")
    with pytest.raises(PosteriorError, match="> 0 m"):
        export_text(data, "ros2_controllers", wheel_separation=-1.0)
    assert "odometry_multipliers" not in json.loads(export_text(data, "json"))
    content = json.loads(export_text(data, "json", wheel_separation=SEPARATION))
    assert set(content["odometry_multipliers"]) >= {"left_wheel_radius_multiplier"}


def test_a_scale_alone_needs_no_separation():
    data = lidar_posterior({"odometry_turn_scale": 0.25}, effects=("odometry-turn-scale",), spread=1e-6)
    content = yaml_content(export_text(data, "ros2_controllers"))["diff_drive_controller"]["ros__parameters"]
    assert content["wheel_separation_multiplier"] == pytest.approx(0.8, rel=1e-5)
    assert content["left_wheel_radius_multiplier"] == content["right_wheel_radius_multiplier"] == 1.0


def test_mounts_are_corrected_about_the_robots_centre():
    theta = {"sensor_yaw": np.pi / 2.0, "sensor_offset_x": 0.1, "sensor_offset_y": -0.2}
    pose = corrected_mount((0.3, 0.0, 0.1), ("sensor-yaw", "sensor-offset"), theta)
    np.testing.assert_allclose(pose, (0.1, 0.1, 0.1 + np.pi / 2.0), atol=1e-12)
    pose = corrected_mount((0.3, 0.0, 0.1), ("sensor-offset", "sensor-yaw"), theta)
    np.testing.assert_allclose(pose, (0.2, 0.4, 0.1 + np.pi / 2.0), atol=1e-12)


def test_mounts_are_exported_for_every_laser():
    theta = {"sensor_yaw": 0.05, "sensor_offset_x": 0.1, "sensor_offset_y": 0.02}
    data = lidar_posterior(theta, effects=("sensor-yaw", "sensor-offset"), lasers=("front", "rear"))
    text = export_text(data, "static-transforms")
    commands = [line for line in text.splitlines() if line.startswith("ros2 run")]
    assert len(commands) == 2
    assert "--child-frame-id rear" in commands[1]
    mounts = json.loads(export_text(data, "json"))["mounts"]
    assert [mount["laser"] for mount in mounts] == ["front", "rear"]
    assert mounts[0]["pose"][0] == pytest.approx(0.4, abs=0.01)
    assert f"--yaw {mounts[0]['pose'][2]:.6f}" in commands[0]
    assert mounts[0]["sd"][0] == pytest.approx(0.005, rel=0.1)
