"""Weights of exported parameters: with the consumers' own formulas they are pmcl's, up to a constant."""

from __future__ import annotations

import math

import numpy as np
import pytest
from exports.made_lidar import BEAM, FIELD, MAX_RANGE, lidar_posterior, yaml_content
from oracles.amcl_formulas import (
    beluga_beam,
    beluga_likelihood_field_prob,
    beluga_rays,
    nav2_beam,
    nav2_likelihood_field,
    nav2_prob_step,
    nav2_step,
)
from scipy import stats

from pmcl.exports import export_text
from pmcl.exports.likelihood_field import beluga_weights, log_weight, nav2_weights
from pmcl.posterior.estimates import posterior_mean

ANGLES = np.linspace(-2.0, 2.0, 60)
LIMIT = 2.0


def room(x, y):
    """Distance from the nearest wall of a room of 8 m x 6 m in a map that reaches 3 m beyond it; None off the map."""
    if not (-3.0 < x < 11.0 and -3.0 < y < 9.0):
        return None
    inside = 0.0 <= x <= 8.0 and 0.0 <= y <= 6.0
    if inside:
        return min(x, 8.0 - x, y, 6.0 - y)
    return math.hypot(max(-x, 0.0, x - 8.0), max(-y, 0.0, y - 6.0))


@pytest.fixture
def scene():
    """Readings at one place, with gaps and without echo, and poses all over the room."""
    rng = np.random.default_rng(5)
    scan = rng.uniform(0.5, 5.0, size=60)
    scan[[3, 17]], scan[[5, 40]], scan[21], scan[33] = np.nan, np.inf, MAX_RANGE, 0.05
    poses = rng.uniform([1.0, 1.0, -np.pi], [7.0, 5.0, np.pi], size=(50, 3))
    return scan, poses


def field_log_weight(pose, scan, theta, exponent):
    """pmcl's log weight of a scan by its definition, with scipy."""
    total = 0.0
    for reading, angle in zip(scan, ANGLES, strict=True):
        if not 0.1 < reading < MAX_RANGE:
            continue
        far = room(pose[0] + reading * np.cos(pose[2] + angle), pose[1] + reading * np.sin(pose[2] + angle))
        d = LIMIT if far is None else min(far, LIMIT)
        hit = (1.0 - theta["z_rand"]) * stats.norm.pdf(d, scale=theta["sigma_hit"])
        total += exponent * math.log(hit + theta["z_rand"] / MAX_RANGE)
    return total


def exported(name, data):
    content = yaml_content(export_text(data, name))
    return content["amcl"]["ros__parameters"] if name != "ros1" else content


def ros1_as_nav2(content):
    """ROS 1 AMCL's formulas are nav2's; its parameters have prefixes."""
    kept = ("laser_max_range", "laser_min_range", "laser_likelihood_max_dist", "laser_model_type")
    return {key if key in kept else key.removeprefix("laser_"): value for key, value in content.items()}


@pytest.mark.parametrize("consumer", ["nav2", "ros1", "beluga"])
@pytest.mark.parametrize("theta", [FIELD, {"sigma_hit": 0.2, "z_rand": 0.5}, {"sigma_hit": 0.01, "z_rand": 0.01}])
def test_an_untempered_likelihood_field_is_exported_exactly(consumer, theta, scene):
    scan, poses = scene
    data = lidar_posterior(theta, exponent=1.0)
    content = exported(consumer, data)
    assert content["laser_model_type"] == "likelihood_field_prob"
    if consumer == "beluga":
        # beluga weighs an end point off the map by 1 / laser_max_range: here all of them are on the map.
        scan, weigh = np.where(scan > 3.5, np.nan, scan), beluga_likelihood_field_prob
        poses = poses[np.linalg.norm(poses[:, :2] - [4.0, 3.0], axis=1) < 3.0]
    else:
        weigh = nav2_likelihood_field
        content = ros1_as_nav2(content)
    assert content["z_hit"] + content["z_rand"] == pytest.approx(1.0, abs=1e-11)
    mean = posterior_mean(data)
    ours = np.array([field_log_weight(pose, scan, mean, 1.0) for pose in poses])
    theirs = np.array([weigh(pose, scan, ANGLES, content, room) for pose in poses])
    assert np.ptp(ours) > 10.0
    np.testing.assert_allclose(theirs - theirs[0], ours - ours[0], rtol=0, atol=1e-9 * np.ptp(ours))


@pytest.mark.parametrize("logs", [1, 2])
def test_what_the_cells_hide_is_part_of_the_exported_noise(logs, scene):
    """The log density of pmcl on a map with cells of 0.1 m has the variance sigma_hit^2 + 0.1^2 / 6."""
    scan, poses = scene
    data = lidar_posterior(exponent=1.0, resolution=0.1, logs=logs)
    mean = posterior_mean(data)
    content = exported("nav2", data)
    whole = mean | {"sigma_hit": math.sqrt(mean["sigma_hit"] ** 2 + 0.01 / 6.0)}
    ours = np.array([field_log_weight(pose, scan, whole, 1.0) for pose in poses])
    theirs = np.array([nav2_likelihood_field(pose, scan, ANGLES, content, room) for pose in poses])
    np.testing.assert_allclose(theirs - theirs[0], ours - ours[0], rtol=0, atol=1e-9 * np.ptp(ours))


def test_taking_numbers_over_as_they_are_gives_another_filter(scene):
    """The negative control: pmcl's own z_hit and z_rand in nav2's file."""
    scan, poses = scene
    data = lidar_posterior(exponent=1.0)
    mean = posterior_mean(data)
    content = exported("nav2", data) | {"z_hit": 1.0 - mean["z_rand"], "z_rand": mean["z_rand"]}
    ours = np.array([field_log_weight(pose, scan, mean, 1.0) for pose in poses])
    theirs = np.array([nav2_likelihood_field(pose, scan, ANGLES, content, room) for pose in poses])
    assert np.ptp(theirs - ours) > 1.0
    cubes = np.array([nav2_likelihood_field(pose, scan, ANGLES, exported("nav2", data), room, prob=False)
                      for pose in poses])  # fmt: skip
    assert np.ptp(cubes - ours) > 10.0


@pytest.mark.parametrize("translate", [nav2_weights, beluga_weights])
@pytest.mark.parametrize("exponent", [0.5, 0.1, 1.0 / 30.0, 0.01])
def test_a_tempered_beam_is_near_and_the_file_says_how_near(translate, exponent):
    z_hit, z_rand, sigma = 0.88, 0.12, 0.04
    found = translate(z_hit, z_rand, sigma, MAX_RANGE, exponent)
    d = np.linspace(0.0, 2.0, 5001)
    ours = exponent * np.log(z_hit * stats.norm.pdf(d, scale=sigma) + z_rand / MAX_RANGE)
    scale = 1.0 if translate is nav2_weights else 1.0 / (found.sigma_hit * math.sqrt(2.0 * math.pi))
    theirs = np.log(found.z_hit * scale * np.exp(-0.5 * (d / found.sigma_hit) ** 2) + found.z_rand / MAX_RANGE)
    difference = (theirs - theirs[0]) - (ours - ours[0])
    assert np.abs(difference).max() == pytest.approx(found.deviation, rel=0.02)
    assert difference[-1] == pytest.approx(0.0, abs=1e-9)
    depth = ours[0] - ours[-1]
    assert found.deviation < 0.12 * depth
    # A hit of the calibrated width would be worse, and so would the width of a hit without random readings.
    for other in (sigma, sigma / math.sqrt(exponent)):
        floor = math.exp(-depth)
        wrong = log_weight(1.0 - floor, floor, other, 1.0, d)
        assert np.abs((wrong - wrong[0]) - (ours - ours[0])).max() > 1.2 * found.deviation


def test_a_tempered_file_weighs_scans_as_the_calibration_did(scene):
    scan, poses = scene
    data = lidar_posterior(exponent=1.0 / 30.0)
    content, mean = exported("nav2", data), posterior_mean(data)
    ours = np.array([field_log_weight(pose, scan, mean, 1.0 / 30.0) for pose in poses])
    theirs = np.array([nav2_likelihood_field(pose, scan, ANGLES, content, room) for pose in poses])
    difference = (theirs - theirs.mean()) - (ours - ours.mean())
    assert np.abs(difference).max() < 0.5
    assert np.corrcoef(theirs, ours)[0, 1] > 0.99


def beam_density(reading, expected, theta):
    """pmcl's density of one reading by its definition, with scipy; a mass where there is no echo."""
    if reading == MAX_RANGE:
        return theta["z_max"]
    sigma, rate = theta["sigma_hit"], theta["lambda_short"]
    hit = stats.truncnorm.pdf(reading, -expected / sigma, (MAX_RANGE - expected) / sigma, expected, sigma)
    short = stats.truncexpon.pdf(reading, rate * expected, scale=1.0 / rate) if reading < expected else 0.0
    weight = 1.0 - theta["z_short"] - theta["z_max"] - theta["z_rand"]
    return weight * hit + theta["z_short"] * short + theta["z_rand"] / MAX_RANGE


def beam_readings():
    """Readings and what was expected of them, away from the ends of the sensor's range."""
    rng = np.random.default_rng(3)
    expected = rng.uniform(12.0, 20.0, size=400)
    reading = np.where(rng.random(400) < 0.5, expected + 0.1 * rng.standard_normal(400), rng.uniform(0.2, 22.0, 400))
    return reading, expected


def test_beams_of_beluga_are_those_of_the_calibration():
    data = lidar_posterior(BEAM, model="beam", exponent=1.0)
    content, mean = exported("beluga", data), posterior_mean(data)
    assert content["laser_model_type"] == "beam"
    reading, expected = beam_readings()
    ours = np.array([beam_density(*pair, mean) for pair in zip(reading, expected, strict=True)])
    theirs = np.array([beluga_beam(*pair, content) for pair in zip(reading, expected, strict=True)])
    np.testing.assert_allclose(theirs, ours, rtol=1e-9)


def test_beams_of_nav2_are_proportional_where_truncation_does_not_matter():
    # exp(-lambda z*) < 1e-11: the exponential density is not truncated either.
    data = lidar_posterior({**BEAM, "lambda_short": 2.5}, model="beam", exponent=1.0)
    content, mean = exported("nav2", data), posterior_mean(data)
    assert sum(content[name] for name in ("z_hit", "z_short", "z_max", "z_rand")) == pytest.approx(1.0, abs=1e-11)
    reading, expected = beam_readings()
    pairs = [*zip(reading, expected, strict=True), (MAX_RANGE, 15.0)]
    ours = np.log([beam_density(*pair, mean) for pair in pairs])
    theirs = np.log([nav2_beam(*pair, content) for pair in pairs])
    np.testing.assert_allclose(theirs - ours, (theirs - ours)[0], rtol=0, atol=1e-9)


def test_a_file_of_a_beam_model_says_that_it_is_not_exact():
    for consumer in ("nav2", "beluga", "ros1"):
        text = export_text(lidar_posterior(BEAM, model="beam"), consumer)
        assert "NOT EXACT" in text
        assert "likelihood-field" in text


@pytest.mark.parametrize("rays", [60, 180, 682, 761, 1440])
def test_as_many_beams_as_in_the_log_are_read(rays):
    """A log thinned by nav2's rule to R rays exports max_beams = R; each consumer then reads at most R, nearly all."""
    chosen = range(0, rays, nav2_step(rays, 60))
    beams = len(chosen)
    prob = len(range(0, rays, nav2_prob_step(rays, beams)))
    assert 0.9 * beams <= prob <= beams
    assert len(beluga_rays(rays, beams)) == beams
    assert beluga_rays(rays, beams)[-1] == rays - 1
