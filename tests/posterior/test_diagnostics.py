from __future__ import annotations

import re
import time
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from synthetic_posterior import CENTRES, NAMES, SPREADS, TRUTH, Case, FakeLog, autoregressive, fake_case

from pmcl.errors import PosteriorError
from pmcl.posterior.compat import assemble
from pmcl.posterior.convert import to_arviz
from pmcl.posterior.diagnostics import lost_chains, summarize, verdict


def converted(case: Case, **changes):
    return to_arviz(replace(case.chains, **changes), case.parameters, case.logs)


def test_the_table_agrees_with_numpy(case, data):
    table = summarize(data)
    flat = case.chains.theta.reshape(-1, 3)
    assert list(table["parameter"].values) == list(NAMES)
    assert list(table["unit"].values) == ["m", "rad", "m"]
    np.testing.assert_allclose(table["mean"], flat.mean(axis=0))
    np.testing.assert_allclose(table["sd"], flat.std(axis=0, ddof=1))
    np.testing.assert_allclose(table["q5"], np.quantile(flat, 0.05, axis=0))
    np.testing.assert_allclose(table["q95"], np.quantile(flat, 0.95, axis=0))
    np.testing.assert_array_equal(table["truth"], [TRUTH[name] for name in NAMES])


def test_effective_draws_of_an_autoregressive_chain_are_known():
    # Draws with correlation c have N (1 - c) / (1 + c) effective draws for their mean.
    correlation, n_chains, n_draws = 0.6, 4, 5000
    case = fake_case(n_draws=20, warmup=0)
    normal = autoregressive(np.random.default_rng(3), n_chains, n_draws, 3, correlation)
    table = summarize(
        converted(case, theta=CENTRES + SPREADS * normal, log_joint=np.zeros((n_chains, n_draws)), statistics={})
    )
    expected = n_chains * n_draws * (1.0 - correlation) / (1.0 + correlation)
    np.testing.assert_allclose(table["ess_bulk"], expected, rtol=0.12)
    np.testing.assert_allclose(table["mcse"], SPREADS / np.sqrt(expected), rtol=0.12)
    np.testing.assert_allclose(table["r_hat"], 1.0, atol=0.003)


def test_unknown_truth_is_nan():
    case = fake_case(n_draws=20, truth=False)
    assert np.isnan(summarize(converted(case))["truth"]).all()


def test_good_chains_converge(data):
    result = verdict(data)
    assert result.converged
    assert result.message.startswith("Converged")
    assert result.advice == ()


def test_few_effective_draws_name_the_parameter_and_how_many_are_needed():
    case = fake_case(n_draws=400, correlation=0.0, warmup=0)
    theta = case.chains.theta.copy()
    slow = autoregressive(np.random.default_rng(5), 4, 400, 1, 0.9)[..., 0]
    theta[..., 1] = CENTRES[1] + SPREADS[1] * slow
    data = converted(case, theta=theta)
    result = verdict(data)
    assert not result.converged
    assert "sigma_turn has R-hat" in result.message
    assert "sigma_range" not in result.message
    (advice,) = result.advice
    advised = int(advice.split("about ")[1].split()[0])
    # Correlation 0.9 makes 1600 draws worth 84: between 1900 and twice that per chain, or more if R-hat asks.
    assert 1200 <= advised <= 8000
    # The advice must be true: chains of that length converge.
    longer = fake_case(n_draws=advised, correlation=0.0, warmup=0, seed=2)
    theta = longer.chains.theta.copy()
    theta[..., 1] = CENTRES[1] + SPREADS[1] * autoregressive(np.random.default_rng(6), 4, advised, 1, 0.9)[..., 0]
    assert summarize(converted(longer, theta=theta))["ess_bulk"].min() > 250


def test_r_hat_alone_prevents_convergence():
    case = fake_case(n_draws=4000, correlation=0.0, warmup=0)
    theta = case.chains.theta.copy()
    theta[0, :, 2] += 0.4 * SPREADS[2]
    table = summarize(converted(case, theta=theta))
    assert float(table["r_hat"].sel(parameter="sigma_range")) > 1.01
    result = verdict(converted(case, theta=theta))
    assert not result.converged
    assert "sigma_range" in result.message


def test_tails_alone_prevent_convergence():
    # Rare excursions, long and in every chain alike: the bulk mixes, the 95 % quantile does not.
    rng = np.random.default_rng(8)
    case = fake_case(n_draws=2000, correlation=0.0, warmup=0)
    theta = case.chains.theta.copy()
    for chain in range(4):
        start = rng.integers(0, 1900)
        theta[chain, start : start + 100, 0] += 6.0 * SPREADS[0]
    table = summarize(converted(case, theta=theta)).sel(parameter="sigma_forward")
    assert table["ess_bulk"] > table["ess_tail"]
    assert table["ess_tail"] < 400
    assert not verdict(converted(case, theta=theta)).converged


def test_a_lost_chain_is_found_and_told_by_how_much():
    case = fake_case(n_draws=500)
    density = case.chains.log_joint.copy()
    density[2] -= 310.0
    theta = case.chains.theta.copy()
    theta[2] += 20.0 * SPREADS
    result = verdict(converted(case, theta=theta, log_joint=density))
    assert not result.converged
    told = re.search(r"chain 2 is lost: its log joint is (\d+) nats below the others", result.message)
    assert told is not None
    assert abs(int(told[1]) - 310) <= 2
    assert "particles during burn-in" in result.advice[0]
    assert not any("draws per chain" in line for line in result.advice)


def test_a_lost_chain_prevents_convergence_even_when_theta_agrees(case):
    density = case.chains.log_joint.copy()
    density[0] -= 310.0
    result = verdict(converted(case, log_joint=density))
    assert not result.converged
    assert "chain 0 is lost" in result.message


def test_lost_chains_exactly():
    flat = np.tile(np.linspace(-10.0, 10.0, 101), (4, 1))
    assert lost_chains(flat) == {}
    moved = flat - np.array([0.0, 310.0, 0.0, 500.0])[:, None]
    assert lost_chains(moved) == {1: pytest.approx(310.0), 3: pytest.approx(500.0)}
    assert lost_chains(flat[:1]) == {}


@pytest.mark.parametrize("seed", range(10))
def test_slow_chains_are_not_called_lost(seed):
    rng = np.random.default_rng(seed)
    slow = -900.0 + 15.0 * autoregressive(rng, 4, 600, 1, 0.99)[..., 0]
    assert lost_chains(slow) == {}


def test_a_chain_that_still_climbs_is_lost():
    rng = np.random.default_rng(0)
    density = rng.normal(-900.0, 10.0, size=(4, 500))
    density[1] -= np.linspace(900.0, 100.0, 500)
    assert set(lost_chains(density)) == {1}


def test_chains_at_different_places_are_not_told_to_run_longer_only():
    case = fake_case(n_draws=500, warmup=0)
    theta = case.chains.theta.copy()
    theta[1] += 5.0 * SPREADS
    result = verdict(converted(case, theta=theta))
    assert not result.converged
    assert any("lengthen the burn-in" in line for line in result.advice)


def test_a_single_chain_cannot_converge():
    case = fake_case(n_chains=1, n_draws=3000)
    result = verdict(converted(case))
    assert not result.converged
    assert any("at least 2 chains" in line for line in result.advice)


@pytest.mark.parametrize("n_draws", [1, 2, 3])
def test_a_handful_of_draws_is_told_so(n_draws):
    case = fake_case(n_draws=n_draws, n_stored=1, warmup=0)
    result = verdict(converted(case))
    assert not result.converged
    assert "no R-hat" in result.message
    assert any("at least 400 draws" in line for line in result.advice)
    assert "nan" not in " ".join((result.message, *result.advice))


def test_a_parameter_that_never_moved_is_named():
    case = fake_case(n_draws=2000, correlation=0.0)
    theta = case.chains.theta.copy()
    theta[..., 1] = 0.02
    result = verdict(converted(case, theta=theta))
    assert not result.converged
    assert any(line.startswith("sigma_turn never moved") for line in result.advice)
    assert not any("draws per chain" in line for line in result.advice)


def test_low_path_update_and_acceptance_are_told():
    case = fake_case(n_draws=1000)
    accepted = np.full(case.chains.theta.shape, 0.4)
    accepted[..., 1], accepted[..., 2] = 0.02, 0.97
    statistics = {"acceptance_rate": accepted, "path_update_rate": np.full(case.chains.log_joint.shape, 0.05)}
    text = "\n".join(verdict(converted(case, statistics=statistics)).advice)
    assert "renews only 5 % of the path: use more particles" in text
    assert "sigma_turn: 2 % of the proposals" in text
    assert "shorten its steps" in text
    assert "sigma_range: 97 %" in text
    assert "widen its steps" in text
    assert "sigma_forward" not in text


def test_a_move_that_was_never_proposed_is_not_judged():
    case = fake_case(n_draws=1000)
    never = {"transport_acceptance_rate": np.full(case.chains.log_joint.shape, np.nan)}
    assert verdict(converted(case, statistics=never)).advice == ()


def test_a_posterior_of_another_program_is_judged_by_its_draws():
    rng = np.random.default_rng(0)
    other = assemble({"posterior": xr.Dataset({"mu": (("chain", "draw"), rng.normal(size=(4, 1000)))})}, {})
    assert verdict(other).converged


def test_a_summary_of_another_posterior_is_refused(data):
    other = summarize(data).isel(parameter=slice(0, 2))
    with pytest.raises(PosteriorError, match="same data"):
        verdict(data, other)


def test_a_long_run_is_converted_and_judged_quickly():
    rng = np.random.default_rng(0)
    small = fake_case(n_draws=20, warmup=0)
    theta = CENTRES + SPREADS * rng.normal(size=(4, 5000, 3))
    log = small.logs[0].dataset.isel(time=np.zeros(2000, dtype=int)).assign_coords(time=np.arange(2000.0))
    chains = replace(
        small.chains,
        theta=theta,
        log_joint=rng.normal(size=(4, 5000)),
        statistics={},
        trajectories=(rng.normal(size=(4, 100, 2000, 3)),),
        trajectory_draw=np.arange(0, 5000, 50),
    )
    summarize(converted(small))  # the first call imports ArviZ
    start = time.process_time()
    verdict(to_arviz(chains, small.parameters, [FakeLog(log)]))
    assert time.process_time() - start < 3.0
