from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scipy import stats
from synthetic_posterior import NAMES, TRUTH, fake_case, fake_log

from pmcl.errors import PosteriorError
from pmcl.posterior.access import log_contents, log_suffixes, parameter_names, parameter_units, true_theta
from pmcl.posterior.compat import assemble, find_group, group_names
from pmcl.posterior.convert import to_arviz
from pmcl.posterior.settings import decode_setting, encode_setting, settings


def test_every_draw_is_where_the_labels_say(case, data):
    posterior = find_group(data, "posterior")
    for index, name in enumerate(NAMES):
        assert posterior[name].dims == ("chain", "draw")
        np.testing.assert_array_equal(posterior[name].values, case.chains.theta[..., index])
    assert parameter_names(data) == NAMES
    assert parameter_units(data) == ("m", "rad", "m")
    assert posterior["sigma_turn"].attrs["prior"] == "gamma(2, scale=0.05)"


def test_trajectory_has_its_own_draws_and_wrapped_headings(case, data):
    assert set(find_group(data, "posterior").data_vars) == set(NAMES), "ArviZ goes through all variables of this group"
    stored = find_group(data, "trajectories")["trajectory"]
    assert stored.dims == ("chain", "trajectory_draw", "time", "pose")
    np.testing.assert_array_equal(stored["trajectory_draw"], case.chains.trajectory_draw)
    np.testing.assert_array_equal(stored["time"], case.logs[0].dataset["time"])
    raw = case.chains.trajectories[0]
    assert np.abs(raw[..., 2]).max() > 2.0 * np.pi, "the case must need wrapping"
    assert np.abs(stored.values[..., 2]).max() <= np.pi
    np.testing.assert_array_equal(stored.values[..., :2], raw[..., :2])
    np.testing.assert_allclose(np.exp(1j * stored.values[..., 2]), np.exp(1j * raw[..., 2]), atol=1e-12)


def test_every_variable_says_its_unit_and_meaning(data):
    for group in set(group_names(data)) - {"constant_data"}:
        for name, values in find_group(data, group).data_vars.items():
            assert values.attrs.get("units"), f"{name} of {group}"
            assert values.attrs.get("long_name"), f"{name} of {group}"
    truth = find_group(data, "constant_data")["true_sigma_turn"]
    assert truth.attrs == {"units": "rad", "long_name": "true sigma_turn"}


def test_the_chains_are_left_as_they_were():
    case = fake_case(n_draws=20)
    before = case.chains.trajectories[0].copy()
    to_arviz(case.chains, case.parameters, case.logs)
    np.testing.assert_array_equal(case.chains.trajectories[0], before)


@pytest.mark.parametrize(
    "foreign",
    [
        {"extra": (("parameter",), np.arange(7.0))},
        {"extra": (("prior_point",), np.arange(7.0))},
        {"prior_grid": (("time",), None)},
        {"prior_density": ((), 1.0)},
        {"true_sigma_turn": (("elsewhere",), np.arange(7.0))},
    ],
    ids=lambda foreign: " ".join(str(part) for name, (dims, _) in foreign.items() for part in (name, *dims)),
)
def test_what_else_a_log_holds_clashes_with_nothing(foreign):
    """After hours of sampling would be a bad time to find out."""
    case = fake_case(n_draws=20)
    plain = to_arviz(case.chains, case.parameters, case.logs)
    (log,) = case.logs
    times = np.zeros(log.dataset.sizes["time"])
    held = {name: (dims, times if values is None else values) for name, (dims, values) in foreign.items()}
    data = to_arviz(case.chains, case.parameters, [replace(log, dataset=log.dataset.assign(held))])
    xr.testing.assert_identical(find_group(data, "constant_data"), find_group(plain, "constant_data"))


def test_statistics_are_per_draw_or_per_parameter(case, data):
    statistics = find_group(data, "sample_stats")
    np.testing.assert_array_equal(statistics["lp"], case.chains.log_joint)
    assert statistics["path_update_rate"].dims == ("chain", "draw")
    one = statistics["acceptance_rate"].sel(parameter="sigma_turn")
    np.testing.assert_array_equal(one, case.chains.statistics["acceptance_rate"][..., 1])


def test_burn_in_is_kept_when_there_is_any(case, data):
    np.testing.assert_array_equal(find_group(data, "warmup_posterior")["sigma_range"], case.chains.warmup_theta[..., 2])
    np.testing.assert_array_equal(find_group(data, "warmup_sample_stats")["lp"], case.chains.warmup_log_joint)
    without = fake_case(n_draws=20, warmup=0)
    names = group_names(to_arviz(without.chains, without.parameters, without.logs))
    assert not any(name.startswith("warmup") for name in names)


def test_prior_draws_follow_the_prior_and_repeat(case, data):
    prior = find_group(data, "prior")["sigma_range"].values
    assert prior.shape == (1, 1000)
    assert stats.kstest(prior[0], stats.gamma(2.0, scale=0.05).cdf).pvalue > 1e-3
    again = to_arviz(case.chains, case.parameters, case.logs)
    np.testing.assert_array_equal(find_group(again, "prior")["sigma_range"], prior)
    other = to_arviz(case.chains, case.parameters, case.logs, prior_seed=1)
    assert not np.array_equal(find_group(other, "prior")["sigma_range"], prior)


def test_prior_density_is_kept_exactly_where_the_posterior_is(case, data):
    constant = find_group(data, "constant_data").sel(parameter="sigma_range")
    grid = constant["prior_grid"].values
    np.testing.assert_allclose(constant["prior_density"], stats.gamma(2.0, scale=0.05).pdf(grid))
    draws = case.chains.theta[..., 2]
    assert grid[0] < draws.min() < draws.max() < grid[-1]


def test_a_pole_of_the_prior_density_is_not_drawn():
    case = fake_case(n_draws=20)
    parameters = [replace(one, prior=stats.gamma(0.5, scale=0.05)) for one in case.parameters]
    chains = replace(case.chains, theta=np.abs(case.chains.theta - case.chains.theta.min()))
    density = find_group(to_arviz(chains, parameters, case.logs), "constant_data")["prior_density"]
    assert not np.isinf(density).any()


def test_readings_are_observed_and_the_rest_is_constant(case, data):
    observed, constant = find_group(data, "observed_data"), find_group(data, "constant_data")
    log = case.logs[0].dataset
    assert set(observed.data_vars) == {"range"}
    assert {"odometry", "wall", "beam_pose", "start_mean", "start_std", "true_pose"} <= set(constant.data_vars)
    readings = observed["range"]
    assert readings.attrs["max_range"] == 5.0
    assert readings.attrs["units"] == "m"
    # In the order of time and beam, without the missing one; no echo is the greatest range.
    assert readings.size == log["range"].size - 1
    back = np.full(log["range"].shape, np.nan)
    row = np.searchsorted(log["time"].values, readings["range_time"].values)
    back[row, readings["range_beam"].values] = readings.values
    np.testing.assert_array_equal(back, np.minimum(log["range"].values, 5.0))
    assert back[4, 2] == 5.0
    assert np.all(np.diff(row * 4 + readings["range_beam"].values) > 0)
    np.testing.assert_array_equal(constant["start_std"], [np.inf, np.inf, np.inf])
    assert true_theta(data) == TRUTH
    assert constant["true_sigma_turn"].ndim == 0


@pytest.mark.parametrize("landmarks", [True, False])
def test_what_logs_held_is_told_from_new_and_old_files(landmarks):
    case = fake_case(n_draws=20, n_logs=2, landmarks=landmarks)
    first = case.logs[0].dataset
    if landmarks:
        first["landmark_bearing"] = first["landmark_range"].where(first["time"] > 10.0)
    data = to_arviz(case.chains, case.parameters, case.logs)
    found = log_contents(data)
    assert [one.readings for one in found] == ([300, 350] if landmarks else [239, 279])
    np.testing.assert_array_equal(found[1].times, case.logs[1].dataset["time"])
    older = xr.merge(
        [
            log.dataset.drop_vars(["increment", "true_pose"]).rename(
                {name: f"{name}_{k}" for name in (*log.dataset.data_vars, "time") if name != "true_pose"}
            )
            for k, log in enumerate(case.logs)
        ],
        combine_attrs="drop", compat="override", join="outer",
    )  # fmt: skip
    again = log_contents(assemble({"posterior": find_group(data, "posterior"), "observed_data": older}, {}))
    assert [one.readings for one in again] == [one.readings for one in found]
    assert log_contents(assemble({"posterior": find_group(data, "posterior")}, {})) == ()


def test_a_log_without_truth_has_none():
    case = fake_case(n_draws=20, truth=False)
    data = to_arviz(case.chains, case.parameters, case.logs)
    assert true_theta(data) == {}
    assert not [name for name in find_group(data, "constant_data") if str(name).startswith("true")]


def test_several_logs_keep_their_own_times_and_names():
    case = fake_case(n_draws=20, n_logs=12, n_states=4)
    data = to_arviz(case.chains, case.parameters, case.logs)
    stored = find_group(data, "trajectories")
    assert log_suffixes(data) == tuple(f"_{index}" for index in range(12))
    assert parameter_names(data) == NAMES
    for index in (0, 1, 11):
        assert stored[f"trajectory_{index}"].dims == ("chain", "trajectory_draw", f"time_{index}", "pose")
        assert stored.sizes[f"time_{index}"] == 60 + 10 * index
        np.testing.assert_array_equal(stored[f"extra_state_{index}"], case.chains.trajectories[index][..., 3:])
        assert find_group(data, "constant_data")[f"odometry_{index}"].shape == (60 + 10 * index, 3)
        assert find_group(data, "observed_data")[f"range_{index}"].dims == (f"range_reading_{index}",)
        assert f"wall_{index}" in find_group(data, "constant_data")
        assert settings(data)[f"log_fingerprint_{index}"] == f"hash-log{index}"


def test_truth_on_which_logs_differ_is_left_out():
    case = fake_case(n_draws=20, n_logs=2)
    other = replace(case.logs[1], true_theta={**TRUTH, "sigma_turn": 0.5})
    data = to_arviz(case.chains, case.parameters, [case.logs[0], other])
    assert set(true_theta(data)) == {"sigma_forward", "sigma_range"}


def test_settings_come_back_with_their_types(case, data):
    assert case.chains.settings.items() <= settings(data).items()
    assert settings(data)["resumed"] is False
    assert settings(data)["seed"] == 2**80 + 1
    assert settings(data)["log_fingerprint"] == "hash-log0"


@pytest.mark.parametrize("value", [True, False, 0, -(2**70), 2**63 - 1, 1.5, "text", "", np.float64(2.5), np.int32(3)])
def test_a_setting_survives_encoding(value):
    back = decode_setting(encode_setting("name", value))
    assert back == value
    assert isinstance(back, bool) == isinstance(value, bool)


def _with_nan(case):
    theta = case.chains.theta.copy()
    theta[1, 3, 2] = np.nan
    return {"chains": replace(case.chains, theta=theta)}


BAD = {
    "parameters in another order": (lambda c: {"parameters": c.parameters[::-1]}, "in this order"),
    "a parameter too few": (lambda c: {"parameters": c.parameters[:-1]}, "sigma_forward, sigma_turn"),
    "no draws": (lambda c: {"chains": replace(c.chains, theta=c.chains.theta[:, :0])}, "at least one"),
    "not a number": (_with_nan, "sigma_range in chain 1 at draw 3"),
    "a statistic of another length": (
        lambda c: {"chains": replace(c.chains, statistics={"odd": np.zeros((4, 7))})},
        "'odd'",
    ),
    "lp as a statistic": (
        lambda c: {"chains": replace(c.chains, statistics={"lp": np.zeros(c.chains.log_joint.shape)})},
        "only once",
    ),
    "log joint of another length": (lambda c: {"chains": replace(c.chains, log_joint=np.zeros((4, 3)))}, "'lp'"),
    "no log": (lambda c: {"logs": []}, "for 0 logs"),
    "a log too many": (lambda c: {"logs": [*c.logs, fake_log()]}, "for 2 logs"),
    "another log": (lambda c: {"logs": [fake_log(61)]}, "for log 0"),
    "a setting that is a list": (lambda c: {"chains": replace(c.chains, settings={"moves": [1, 2]})}, "'moves'"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_does_not_belong_together_is_refused_in_one_line(name):
    case = fake_case(n_draws=20)
    change, place = BAD[name]
    arguments = {"chains": case.chains, "parameters": case.parameters, "logs": case.logs} | change(case)
    arguments["result"] = arguments.pop("chains")
    with pytest.raises(PosteriorError) as caught:
        to_arviz(**arguments)
    message = str(caught.value)
    assert place in message
    assert "expected" in message
    assert "\n" not in message


def test_importing_the_package_does_not_import_arviz():
    modules = ("access", "compat", "convert", "diagnostics", "estimates", "files", "log_groups", "settings")
    code = (
        f"import {', '.join('pmcl.posterior.' + name for name in modules)}, sys; "
        "sys.exit(any(m.split('_')[0] == 'arviz' or m == 'matplotlib' for m in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_no_stored_trajectories_is_fine():
    case = fake_case(n_draws=20, n_stored=1)
    empty = replace(
        case.chains,
        trajectories=(np.empty((4, 0, 60, 3)),),
        trajectory_draw=np.empty(0, dtype=np.int64),
    )
    data = to_arviz(empty, case.parameters, case.logs)
    assert log_suffixes(data) == ()
    assert "trajectories" not in group_names(data)
    assert parameter_names(data) == NAMES


def test_the_motion_after_which_amcl_took_scans_stays_known():
    case = fake_case(n_draws=20)
    case.logs[0].dataset.attrs |= {"update_min_d": 0.25, "update_min_a": 0.2, "update_rule": "nav2"}
    attrs = find_group(to_arviz(case.chains, case.parameters, case.logs), "observed_data").attrs
    assert (attrs["update_min_d"], attrs["update_min_a"], attrs["update_rule"]) == (0.25, 0.2, "nav2")
