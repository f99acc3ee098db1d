"""Exported files: names, values and comments, for every consumer; what cannot be exported is refused in one line."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from exports.made_lidar import BEAM, FIELD, MAX_RANGE, lidar_posterior, yaml_content

from pmcl.errors import PosteriorError
from pmcl.exports import export_text
from pmcl.exports.spread import TELLS_NOTHING, overlap, spread_of
from pmcl.exports.text import CANNOT_TELL
from pmcl.posterior.estimates import map_estimate, posterior_mean


def test_a_nav2_file_holds_everything_that_the_calibration_decides():
    data = lidar_posterior()
    mean = posterior_mean(data)
    content = yaml_content(export_text(data, "nav2"))["amcl"]["ros__parameters"]
    assert content["robot_model_type"] == "nav2_amcl::DifferentialMotionModel"
    for number in range(1, 5):
        assert content[f"alpha{number}"] == pytest.approx(mean[f"alpha{number}"], rel=1e-11)
    assert content["update_min_d"] == 0.25
    assert content["update_min_a"] == 0.2
    assert content["laser_model_type"] == "likelihood_field_prob"
    assert content["do_beamskip"] is False
    assert content["laser_max_range"] == MAX_RANGE
    assert content["laser_min_range"] == 0.1
    assert content["laser_likelihood_max_dist"] == 2.0
    assert content["max_beams"] == 60
    types = {type(value) for key, value in content.items() if key.startswith(("alpha", "z_", "sigma", "laser_m"))}
    assert types == {float, str}


def test_ros1_gets_the_corrected_models_and_its_own_names():
    content = yaml_content(export_text(lidar_posterior(BEAM, model="beam"), "ros1"))
    assert content["odom_model_type"] == "diff-corrected"
    assert {f"odom_alpha{number}" for number in range(1, 5)} <= set(content)
    expected = (
        "z_hit",
        "z_short",
        "z_max",
        "z_rand",
        "sigma_hit",
        "lambda_short",
        "max_beams",
        "min_range",
        "max_range",
    )
    assert {f"laser_{name}" for name in expected} <= set(content)
    omni = lidar_posterior({**FIELD, "alpha5": 0.07}, motion="omni")
    assert yaml_content(export_text(omni, "ros1"))["odom_model_type"] == "omni-corrected"
    nav2 = yaml_content(export_text(omni, "nav2"))["amcl"]["ros__parameters"]
    assert nav2["robot_model_type"] == "nav2_amcl::OmniMotionModel"
    assert nav2["alpha5"] == pytest.approx(posterior_mean(omni)["alpha5"])


def test_each_value_has_its_spread_and_an_untold_one_says_so():
    lines = export_text(lidar_posterior(unknown=("alpha3",)), "nav2").splitlines()
    comments = {line.split(":")[0].strip(): line.partition("#")[2] for line in lines}
    assert CANNOT_TELL in comments["alpha3"]
    for name in ("alpha1", "alpha2", "alpha4", "z_hit", "z_rand", "sigma_hit"):
        assert "+-" in comments[name]
        assert CANNOT_TELL not in comments[name]


def test_fixed_parameters_are_exported_with_their_values():
    theta = {name: value for name, value in FIELD.items() if name != "alpha4"}
    text = export_text(lidar_posterior(theta, fixed={"alpha4": 0.0123}), "nav2")
    assert yaml_content(text)["amcl"]["ros__parameters"]["alpha4"] == 0.0123
    assert "fixed by the model" in text


def test_the_tempering_is_told():
    text = export_text(lidar_posterior(exponent=0.05), "nav2")
    assert "tempering exponent 0.05" in text
    assert "as 3 independent ones" in text
    assert "no tempering" in export_text(lidar_posterior(exponent=1.0), "nav2")


def test_too_many_beams_for_a_product_are_named():
    text = export_text(lidar_posterior({"sigma_hit": 0.04, "z_rand": 0.01}, beams=360, exponent=1.0), "nav2")
    line = next(line for line in text.splitlines() if "CAREFUL" in line)
    allowed = int(line.split("at most ")[1].split()[0])
    content = yaml_content(text)["amcl"]["ros__parameters"]
    least = math.log(content["z_rand"] / content["laser_max_range"])
    assert math.exp(allowed * least) > 0.0
    assert math.exp(360 * least) == 0.0


def test_a_run_that_did_not_converge_or_fit_says_so_in_the_file():
    text = export_text(lidar_posterior(converged=0, adequate=0), "nav2")
    assert "have not converged" in text
    assert "readings and model disagree" in text
    assert "CAREFUL" not in export_text(lidar_posterior(converged=1, adequate=1), "nav2")


def test_map_is_the_draw_of_the_greatest_density():
    data = lidar_posterior()
    content = yaml_content(export_text(data, "beluga", estimate="map"))["amcl"]["ros__parameters"]
    assert content["alpha1"] == pytest.approx(map_estimate(data)["alpha1"], rel=1e-11)
    assert content["alpha1"] != pytest.approx(posterior_mean(data)["alpha1"], rel=1e-6)


def test_json_holds_every_parameter_for_programs():
    data = lidar_posterior(unknown=("alpha2",), fixed={"z_max": 0.0}, lasers=("front", "rear"))
    content = json.loads(export_text(data, "json"))
    assert content["format"] == "pmcl-export/1"
    entry = content["parameters"]["sigma_hit"]
    draws = data["posterior"]["sigma_hit"].values
    assert entry["mean"] == pytest.approx(draws.mean())
    assert entry["sd"] == pytest.approx(draws.std())
    assert entry["quantiles"]["0.05"] == pytest.approx(np.quantile(draws, 0.05))
    assert entry["unit"] == "m"
    assert entry["log_can_tell"] is True
    assert content["parameters"]["alpha2"]["log_can_tell"] is False
    assert content["parameters"]["z_max"] == {"value": 0.0, "unit": "", "fixed": True}
    assert content["updates"] == {"update_min_d": 0.25, "update_min_a": 0.2, "update_rule": "nav2"}
    assert [laser["name"] for laser in content["lasers"]] == ["front", "rear"]


def test_several_logs_are_one_robot():
    data = lidar_posterior(logs=2, lasers=("front", ""))
    content = json.loads(export_text(data, "json"))
    assert content["updates"]["update_min_d"] == 0.25
    assert [laser["name"] for laser in content["lasers"]] == ["front", ""]
    data["observed_data"].attrs["update_min_d_1"] = 0.1
    assert "update_min_d" not in json.loads(export_text(data, "json"))["updates"]
    assert "not known of this log" in export_text(data, "nav2")


def test_an_increments_posterior_has_no_alphas_to_give():
    text = export_text(lidar_posterior({"sigma_hit": 0.04, "z_rand": 0.1}, motion="increment"), "nav2")
    assert "no alphas" in text
    assert "alpha1" not in yaml_content(text)["amcl"]["ros__parameters"]


@pytest.mark.parametrize(
    ("data", "name", "expected"),
    [
        (lambda: lidar_posterior(), "nav3", "format"),
        (lambda: lidar_posterior({"sigma_range": 0.1}, motion="increment"), "nav2", "sigma_range"),
        (lambda: lidar_posterior(lasers=()), "nav2", "greatest range"),
        (lambda: lidar_posterior(), "ros2_controllers", "odometry-forward-scale"),
        (lambda: lidar_posterior(), "static-transforms", "sensor-yaw"),
    ],
)
def test_what_cannot_be_exported_is_refused(data, name, expected):
    with pytest.raises(PosteriorError, match=expected):
        export_text(data(), name)


def test_the_overlap_is_that_of_two_normals():
    rng = np.random.default_rng(1)
    prior = rng.standard_normal(200_000)
    # Two normals of one mean cross at +-c; the share of the narrower one within is its excess.
    ratio = 1.0 / math.sqrt(2.0)
    c = math.sqrt(2.0 * math.log(1.0 / ratio) / (1.0 / ratio**2 - 1.0))

    def cdf(x):
        return 0.5 * (1.0 + math.erf(x / math.sqrt(2.0)))

    exact = 1.0 - 2.0 * (cdf(c / ratio) - cdf(c))
    assert exact == pytest.approx(TELLS_NOTHING, abs=0.005)
    # Ten parts of equal probability average within a part, so the overlap comes out a little too large.
    assert overlap(prior, ratio * rng.standard_normal(200_000)) == pytest.approx(exact, abs=0.02)
    assert overlap(prior, prior + 1.0) < 0.65
    assert overlap(np.exp(prior), np.exp(ratio * prior)) == pytest.approx(overlap(prior, ratio * prior), abs=1e-12)


def test_an_unchanged_prior_is_seldom_said_to_be_told():
    rng = np.random.default_rng(2)
    told = [spread_of(rng.gamma(2.0, size=400), rng.gamma(2.0, size=1000)).told for _ in range(300)]
    assert np.mean(told) < 0.02
    clear = [spread_of(2.0 + 0.5 * rng.standard_normal(400), rng.gamma(2.0, size=1000)).told for _ in range(300)]
    assert np.mean(clear) == 1.0
