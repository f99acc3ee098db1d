"""The second half of the verdict: what it makes of the model check and of warnings about the log."""

from __future__ import annotations

import json

import numpy as np
import pytest
import xarray as xr
from synthetic_posterior import SPREADS

from pmcl.posterior.adequacy import adequacy
from pmcl.posterior.compat import attributes, extended, find_group
from pmcl.posterior.diagnostics import verdict

# mypy: disable-error-code="no-untyped-def"

LASTING = {"name": "lasting", "log": 0, "kind": "landmark_range", "message": "errors of landmark ranges last about 3 s"}
LOST = {"name": "lost", "log": 0, "kind": "", "message": "the filter loses the robot at t=12 s"}


def with_check(data, findings, p_value=0.002):
    """The posterior with a model check that found something, or nothing."""
    attrs = {"adequate": int(not findings), "p_value": p_value, "readings": 240, "findings": json.dumps(findings)}
    scores = {"residual_range": (("time", "beam"), np.zeros((2, 2)))}
    return extended(data, {"predictive_check": xr.Dataset(scores, attrs=attrs)}, {})


def warned(data, *, mistake):
    warning = {"name": "degrees", "level": "implausible", "mistake": mistake, "message": "Bearings seem to be degrees."}
    return extended(data, {}, {"preflight": json.dumps([warning])})


def test_without_a_check_nothing_is_said_of_the_fit(data):
    result = verdict(data)
    assert result.adequate is None
    assert result.good
    assert "fit" not in result.message


def test_a_model_that_fits(data):
    result = verdict(with_check(data, [], 0.48))
    assert (result.converged, result.adequate, result.good) == (True, True, True)
    assert "The model fits: its predictions of 240 readings show nothing unusual (p = 0.48)." in result.message


def test_a_model_that_does_not_fit(data):
    result = verdict(with_check(data, [LASTING]))
    assert (result.converged, result.adequate, result.good) == (True, False, False)
    assert result.message.startswith("Converged")
    assert "But readings and model disagree: errors of landmark ranges last about 3 s." in result.message
    assert any("pmcl criticize" in line for line in result.advice)


def test_many_findings_are_counted(data):
    assert "; and 2 more." in verdict(with_check(data, [LASTING] * 5)).message


def test_a_lost_robot_is_another_remedy(data):
    result = verdict(with_check(data, [LOST]))
    assert "the filter loses the robot at t=12 s" in result.message
    assert not any("criticize" in line for line in result.advice)
    assert any("--outliers" in line for line in result.advice)


def test_of_several_logs_the_one_is_named(data):
    found = adequacy(with_check(data, [LASTING, {**LASTING, "log": 1}]))
    assert "last about 3 s in log 0; errors of landmark ranges last about 3 s in log 1" in found.sentence


def test_chains_that_have_not_converged_come_first(data):
    posterior = find_group(data, "posterior").copy(deep=True)
    posterior["sigma_turn"][0] += 5.0 * SPREADS[1]
    other = with_check(extended(data, {"posterior": posterior}, {}), [LASTING])
    result = verdict(other)
    assert (result.converged, result.adequate) == (False, False)
    assert result.message.startswith("Not converged")
    assert "Besides, readings and model disagree" in result.message
    assert "fits" not in verdict(with_check(extended(data, {"posterior": posterior}, {}), [])).message


@pytest.mark.parametrize("mistake", [True, False])
def test_a_warning_about_the_log_counts_when_it_names_a_mistake(data, mistake):
    result = verdict(warned(with_check(data, [], 0.48), mistake=mistake))
    assert result.adequate is not mistake
    assert ("But the log looks mistaken: Bearings seem to be degrees." in result.message) == mistake
    assert ("Bearings seem to be degrees." in result.advice) == (not mistake)


def test_a_mistake_counts_without_a_check(data):
    assert verdict(warned(data, mistake=True)).adequate is False
    assert verdict(warned(data, mistake=False)).adequate is None


def test_extending_leaves_the_posterior_as_it_was(data):
    before = attributes(data)
    made = extended(data, {"more": xr.Dataset({"x": ("n", np.zeros(2))})}, {"converged": 1})
    assert attributes(data) == before
    assert attributes(made)["converged"] == 1
    assert find_group(made, "posterior").attrs["converged"] == 1
    assert "converged" not in find_group(data, "posterior").attrs
