"""A calibration method of one's own is one class and its registration: calibrate, the command line, compare know it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from calibration.own_methods import PriorDraws, PriorMean
from click.testing import CliRunner

import pmcl
from pmcl import registry
from pmcl.calibration import CalibrationMethod, setting
from pmcl.calibration.methods import as_method, method_class, method_names
from pmcl.cli.commands import pmcl as application
from pmcl.comparison.compare import compare
from pmcl.errors import ModelError, SamplingError
from pmcl.posterior.access import log_joint, parameter_names, theta_draws
from pmcl.posterior.compat import find_group, group_names
from pmcl.posterior.diagnostics import summarize
from pmcl.posterior.settings import settings
from pmcl.reports.comparison_report import comparison_text, write_comparison
from pmcl.reports.posterior_report import write_report

pytestmark = pytest.mark.usefixtures("registered_methods")


def _command(*arguments):
    return CliRunner().invoke(application, [str(argument) for argument in arguments])


def _prior_draws(log, chains, draws, seed):
    bound, rng = pmcl.default_model(log).bind(log), np.random.default_rng(seed)
    return np.array([[bound.draw_prior(rng) for _ in range(draws)] for _ in range(chains)])


@pytest.mark.slow
def test_calibrate_labels_draws_without_trajectories(log, tmp_path):
    data = pmcl.calibrate(log, method=PriorDraws(scale=2.0), draws=30, chains=3, seed=4)
    np.testing.assert_array_equal(theta_draws(data), 2.0 * _prior_draws(log, 3, 30, 4))
    assert "trajectories" not in group_names(data)
    assert log_joint(data) is None
    found = settings(data)
    assert (found["method"], found["scale"], found["reverse"], found["seed"]) == ("own-draws", 2.0, False, 4)
    pmcl.write_posterior(data, tmp_path / "p.nc")
    again = pmcl.read_posterior(tmp_path / "p.nc")
    np.testing.assert_array_equal(theta_draws(again), theta_draws(data))
    assert pmcl.verdict(again).adequate is not None, "the check that ends a calibration needs no trajectories"


def test_a_name_stands_for_a_method_with_its_defaults(log):
    by_name = pmcl.calibrate(log, method="own-draws", draws=20, check=False)
    np.testing.assert_array_equal(theta_draws(by_name), _prior_draws(log, 4, 20, 0))


def test_calibrate_labels_a_point_estimate(log, tmp_path):
    data = pmcl.calibrate(log, method="own-mean")
    bound = pmcl.default_model(log).bind(log)
    np.testing.assert_array_equal(theta_draws(data), bound.prior_mean()[None, None, :])
    errors = find_group(data, "sample_stats")["standard_error"]
    np.testing.assert_allclose(errors.values[0, 0], [parameter.prior.std() for parameter in bound.parameters])
    assert settings(data)["point_estimate"] is True
    judged = pmcl.verdict(data)
    assert judged.converged
    assert judged.message.startswith("The method gives one estimate")
    assert "nan" not in judged.message
    assert not [line for line in judged.advice if "chain" in line or "moved" in line]
    np.testing.assert_allclose(summarize(data)["mean"], bound.prior_mean())
    pmcl.write_posterior(data, tmp_path / "p.nc")
    back = pmcl.read_posterior(tmp_path / "p.nc")
    by_estimate = pmcl.localize(log, posterior=back, method="mean", particles=50)
    by_values = pmcl.localize(log, theta=dict(zip(bound.names, bound.prior_mean(), strict=True)), particles=50)
    np.testing.assert_array_equal(by_estimate.pose_mean, by_values.pose_mean)
    write_report(back, tmp_path / "p.html")
    assert "own-mean" in (tmp_path / "p.html").read_text()


def test_the_command_line_has_method_and_settings(log, tmp_path):
    log.write(tmp_path / "log.nc")
    output = tmp_path / "p.nc"
    shown = "".join(_command("calibrate", "--help").stdout.split())  # lines may be broken anywhere
    for text in (
        "|own-draws|own-mean]",
        "--scale FLOAT RANGE Factor on each draw. [default: 1.0 for own-draws]",
        "--reverse / --no-reverse",
        ", 7 for own-mean",
    ):
        assert "".join(text.split()) in shown
    done = _command(
        "calibrate", tmp_path / "log.nc", "-o", output, "--method", "own-draws", "--scale", "2", "--reverse",
        "--order", "sorted", "--draws", "20", "--chains", "2", "--seed", "3",
    )  # fmt: skip
    assert done.exit_code == 3, done.output  # two chains of twenty draws are too few
    data = pmcl.read_posterior(output)
    np.testing.assert_array_equal(theta_draws(data), 2.0 * _prior_draws(log, 2, 20, 3)[:, ::-1])
    assert settings(data)["order"] == "sorted"
    estimate = _command("calibrate", tmp_path / "log.nc", "-o", output, "--method", "own-mean")
    assert estimate.exit_code in (0, 4), estimate.output
    assert parameter_names(pmcl.read_posterior(output)) == parameter_names(data)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--scale", "2"), "--scale belongs to the method own-draws: leave it out"),
        (("--method", "own-draws", "--particles", "9"), "--particles belongs to the method particle-gibbs, ensemble, "),
        (("--method", "own-draws", "--scale", "9"), "9.0 is not in the range 0.5<=x<=4.0"),
        (("--method", "own-draws", "--order", "odd"), "'odd' is not one of 'plain', 'sorted'"),
        (("--method", "own-mean", "--particles", "2"), "2 is not in the range x>=3"),
        (("--method", "own-mean", "--particles", "many"), "'many' is not a valid integer"),
        (("--method", "pryor"), "'pryor' is not one of"),
    ],
)
def test_settings_that_do_not_fit_are_refused_in_one_line(options, message, log, tmp_path):
    log.write(tmp_path / "log.nc")
    result = _command("calibrate", tmp_path / "log.nc", "-o", tmp_path / "p.nc", *options)
    assert result.exit_code == 2
    assert message in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert not (tmp_path / "p.nc").exists()


@pytest.mark.slow
def test_compare_knows_the_methods(log, tmp_path):
    """The reference and one method of pmcl against both of the tests."""
    comparison = compare(log, "own-draws,own-mean:9,plain:8", seconds=0.5, chains=2)
    assert comparison.failures == ()
    draws, mean, plain = comparison.results
    assert [str(result.method) for result in comparison.results] == ["own-draws", "own-mean:9", "plain:8"]
    assert (draws.chains, draws.draws, mean.draws) == (2, 400, 1)
    bound = pmcl.default_model(log).bind(log)
    np.testing.assert_array_equal(mean.mean, bound.prior_mean())
    np.testing.assert_allclose(mean.sd, [parameter.prior.std() for parameter in bound.parameters])
    # The prior is far from the posterior, and particle Gibbs is not.
    assert draws.curve.error[-1] > 1.0
    assert plain.draws > 1
    text = comparison_text(comparison)
    write_comparison(comparison, tmp_path / "page.html")
    for name in ("own-draws", "own-mean:9"):
        assert name in text
        assert name in (tmp_path / "page.html").read_text()
    with pytest.raises(SamplingError, match="own-draws without a number of particles"):
        compare(log, "own-draws:25")


def test_names_of_methods():
    assert method_names()[:2] == ("particle-gibbs", "ensemble"), "pmcl's own come first"
    assert method_names()[-2:] == ("own-draws", "own-mean")
    assert method_class("own-mean") is PriorMean
    assert as_method("own-draws") == PriorDraws()
    with pytest.raises(SamplingError, match="did you mean 'ensemble'"):
        as_method("ensembel")
    with pytest.raises(SamplingError, match="a calibration method or its name, but got int"):
        as_method(3)
    with pytest.raises(ModelError, match="'ensemble' is registered already"):
        registry.register(registry.METHODS, "ensemble", PriorDraws)
    registry.register(registry.METHODS, "other", PriorDraws)
    with pytest.raises(SamplingError, match="named 'other' to be registered as 'other'"):
        as_method("other")


def test_what_is_no_method_harms_no_other_command():
    registry.register(registry.METHODS, "broken", int)
    assert _command("simulate", "--help").exit_code == 0
    refused = _command("calibrate", "--help")
    assert refused.exit_code == 2
    assert refused.stderr.startswith("pmcl: error: expected a subclass of CalibrationMethod named 'broken'")
    assert len(refused.stderr.splitlines()) == 1


def test_settings_are_checked_where_the_method_is_made():
    for wrong in ({"scale": 9.0}, {"scale": "x"}, {"reverse": 1}, {"order": "odd"}):
        with pytest.raises(SamplingError, match="expected") as caught:
            PriorDraws(**wrong)
        assert "\n" not in str(caught.value)
    with pytest.raises(TypeError, match="kernel"):
        PriorDraws(kernel="smoothing")


def test_a_setting_may_be_declared_by_no_more_than_a_field():
    """It is kept with the result, and has no option."""

    @dataclass(frozen=True)
    class Plain(PriorDraws):
        name: ClassVar[str] = "plain-field"
        tuned: tuple = (1, 2)
        rounds: tuple = setting((3,), "Rounds.", kind=tuple, least=1)

    assert issubclass(Plain, CalibrationMethod)
    options = pmcl.calibration.RunOptions(draws=3)
    assert Plain().record(options)["tuned"] == "(1, 2)"
    registry.register(registry.METHODS, "plain-field", Plain)
    assert "--tuned" not in _command("calibrate", "--help").stdout
    with pytest.raises(SamplingError, match="each of rounds"):
        Plain(rounds=(0,))
