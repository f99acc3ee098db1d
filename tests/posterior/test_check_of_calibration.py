"""The check of the model at the end of a calibration: verdict, predictions and densities in the posterior."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import pmcl
from pmcl.errors import FilterError
from pmcl.filtering.one_step_ahead import predict_readings
from pmcl.filtering.particle_filter import make_rng, run_filter
from pmcl.models.robot_model import default_model
from pmcl.posterior import predictive_check
from pmcl.posterior.access import theta_draws
from pmcl.posterior.compat import assemble, attributes, extended, find_group, group_names
from pmcl.posterior.diagnostics import verdict
from pmcl.posterior.log_groups import reading_kinds
from pmcl.posterior.model_check import check_model
from pmcl.posterior.predictive_check import check_group

# mypy: disable-error-code="no-untyped-def"


@pytest.fixture(scope="module")
def calibrated():
    """A short calibration with all that ends it."""
    log = pmcl.simulate_aibo(100.0, 4)
    method = pmcl.ParticleGibbs(burn_in_particles=100)
    return log, pmcl.calibrate(log, method=method, draws=60, chains=2, trajectories=5)


def test_what_goes_wrong_in_the_check_loses_no_draws(calibrated, monkeypatch, caplog):
    log, data = calibrated

    def fail(*_):
        raise FilterError("a density is not a number")

    monkeypatch.setattr(predictive_check, "check_model", fail)
    plain = {name: find_group(data, name) for name in group_names(data) if name != "predictive_check"}
    found = predictive_check.checked(assemble(plain, {}), default_model(log).bind(log), 1)
    assert verdict(found).adequate is None
    assert "the check of the model and log_likelihood" in caplog.text
    np.testing.assert_array_equal(theta_draws(found), theta_draws(data))


def test_a_calibration_ends_with_its_verdict(calibrated):
    _, data = calibrated
    judged, told = verdict(data), attributes(data)
    assert judged.adequate is True
    assert (told["converged"], told["adequate"], told["verdict"]) == (int(judged.converged), 1, judged.message)
    assert find_group(data, "posterior").attrs["adequate"] == 1
    check = find_group(data, "predictive_check")
    assert set(check.data_vars) == {"residual_landmark_bearing", "residual_landmark_size"}
    assert all(variable.attrs["long_name"] and variable.attrs["units"] for variable in check.data_vars.values())


def test_the_check_can_be_left_out():
    method = pmcl.ParticleGibbs(burn_in_particles=50)
    data = pmcl.calibrate(pmcl.simulate_aibo(20.0, 4), method=method, draws=4, chains=2, check=False)
    assert verdict(data).adequate is None
    assert not find_group(data, "log_likelihood").data_vars


def test_predictions_have_the_shape_of_the_readings(calibrated):
    log, data = calibrated
    observed, foreseen, density = (
        find_group(data, name) for name in ("observed_data", "posterior_predictive", "log_likelihood")
    )
    kinds = set(reading_kinds(log.dataset))
    assert set(observed.data_vars) == set(foreseen.data_vars) == set(density.data_vars) == kinds
    for name, readings in observed.data_vars.items():
        assert foreseen[name].dims == density[name].dims == ("chain", "draw", *readings.dims)
        assert np.isfinite(foreseen[name]).all()
        assert np.isfinite(density[name]).all()
        np.testing.assert_array_equal(foreseen[name][f"{name}_time"], readings[f"{name}_time"])
        # Among its replications each reading has a uniform rank when the model is right.
        rank = (foreseen[name] < readings).mean(dim=("chain", "draw"))
        assert stats.kstest(rank, "uniform").pvalue > 1e-3
    posterior = find_group(data, "posterior")
    np.testing.assert_array_equal(density["draw"], np.intersect1d(density["draw"], posterior["draw"]))


def test_densities_add_up_to_the_evidence(calibrated):
    log, data = calibrated
    density = find_group(data, "log_likelihood")
    total = sum(variable.astype(float).sum(variable.dims[-1]) for variable in density.data_vars.values())
    bound = default_model(log).bind(log)
    difference = []
    for draw in density["draw"].values[:12]:
        theta = theta_draws(data)[1, draw]
        evidence = run_filter(bound.tables(theta)[0], log.n_steps, 4000, make_rng(int(draw))).log_evidence
        difference.append(float(total.sel(chain=1, draw=draw)) - evidence)
    # Fewer particles make the estimate noisier, and lower by half its variance.
    assert abs(np.mean(difference)) < 5.0 * np.std(difference, ddof=1) / np.sqrt(12) + 0.5 * np.var(difference, ddof=1)
    assert np.std(difference) < 2.0, "so that another draw's density would be noticed"


def test_each_density_belongs_to_its_reading(calibrated):
    """Means over draws go with the densities under the posterior mean, reading by reading."""
    log, data = calibrated
    bound = default_model(log).bind(log)
    made = predict_readings(bound.tables(theta_draws(data).mean(axis=(0, 1)))[0], log.n_steps, 2000, make_rng(1))
    for number, (name, values) in enumerate(find_group(data, "log_likelihood").data_vars.items()):
        mine = made.kind == made.kinds.index(name)
        order = np.lexsort((made.channel[mine], made.time[mine]))
        assert made.kinds[number + 1] == name, "bearings and sizes, after the distances that this robot does not read"
        mean = values.astype(float).mean(dim=("chain", "draw"))
        assert np.corrcoef(mean, made.log_score[mine][order])[0, 1] > 0.9


def test_arviz_compares_predictions_with_readings(calibrated):
    import arviz

    _, data = calibrated
    found = arviz.loo(data, var_name="landmark_bearing")
    assert np.isfinite(float(found.elpd_loo if hasattr(found, "elpd_loo") else found.elpd))
    if hasattr(arviz, "plot_ppc"):
        pit = np.asarray(arviz.loo_pit(data, y="landmark_bearing"))
        assert arviz.plot_ppc(data, num_pp_samples=10) is not None
    else:
        pit = np.asarray(arviz.loo_pit(data, var_names=["landmark_bearing"])["landmark_bearing"])
        assert arviz.plot_ppc_dist(data, num_samples=10) is not None
    assert stats.kstest(pit, "uniform").pvalue > 1e-3


def test_a_wrong_model_gets_the_other_half_of_the_verdict(calibrated):
    log, data = calibrated
    bound = default_model(log).bind(log)
    found = check_model(bound, 4.0 * bound.prior_mean())
    judged = verdict(extended(data, {"predictive_check": check_group(found, bound.logs)}, {}))
    assert judged.adequate is False
    assert "readings and model disagree: " in judged.message
