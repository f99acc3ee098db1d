"""What the verdict rests on: all chains, bulk and tails, own beginnings, paths that move, walkers that depend."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.random_walk_model import rail_log, rail_model
from synthetic_posterior import CENTRES, SPREADS, autoregressive, fake_case

from pmcl.calibration import Ensemble, ParticleGibbs
from pmcl.posterior.convert import to_arviz
from pmcl.posterior.diagnostics import summarize, verdict
from pmcl.sampling import particle_gibbs
from pmcl.sampling.options import RunOptions


@pytest.fixture(scope="module")
def good():
    return fake_case(n_draws=1500, correlation=0.0, warmup=0)


def judged(case, *, settings=None, **changes):
    changes["settings"] = {**case.chains.settings, **(settings or {})}
    data = to_arviz(replace(case.chains, **changes), case.parameters, case.logs)
    return summarize(data), verdict(data)


def _only(values):
    """Draws of the first parameter; the others are independent."""
    theta = CENTRES + SPREADS * np.random.default_rng(2).normal(size=(*values.shape, 3))
    theta[..., 0] = CENTRES[0] + SPREADS[0] * values
    return theta


@pytest.mark.parametrize("chain", range(4))
def test_each_chain_counts(good, chain):
    """Whichever chain is elsewhere, R-hat shows it: none is left out."""
    theta = good.chains.theta.copy()
    theta[chain, :, 1] += 0.6 * SPREADS[1]
    table, result = judged(good, theta=theta)
    assert float(table["r_hat"].sel(parameter="sigma_turn")) > 1.01
    assert not result.converged


def test_effective_draws_are_those_of_all_chains(good):
    table, _ = judged(good)
    assert 0.85 * 6000 < float(table["ess_bulk"].min()) < float(table["ess_bulk"].max()) < 1.15 * 6000
    assert 0.80 * 6000 < float(table["ess_tail"].min()) < float(table["ess_tail"].max()) < 1.15 * 6000


@pytest.mark.parametrize(("measure", "passes", "fails"), [("ess_bulk", 400.0, 399.9), ("ess_tail", 400.0, 399.9),
                                                          ("r_hat", 1.01, 1.0101)])  # fmt: skip
@pytest.mark.parametrize("parameter", range(3))
def test_each_measure_of_each_parameter_alone_prevents_convergence(good, measure, passes, fails, parameter):
    data = to_arviz(good.chains, good.parameters, good.logs)
    table = summarize(data)
    for value, converged in ((passes, True), (fails, False), (np.nan, False)):
        table[measure][parameter] = value
        assert verdict(data, table).converged == converged


def test_bulk_and_tail_measure_what_they_say(good):
    """Slow in the centre, while every visit to the tails is independent of the one before; and the other way round."""
    rng = np.random.default_rng(4)
    slow = autoregressive(rng, 4, 1500, 1, 0.97)[..., 0]
    far = rng.choice([-1.0, 1.0], size=slow.shape) * rng.uniform(4.0, 6.0, size=slow.shape)
    table, _ = judged(good, theta=_only(np.where(rng.random(slow.shape) < 0.3, far, slow)))
    row = table.sel(parameter="sigma_forward")
    assert 3.0 * float(row["ess_bulk"]) < float(row["ess_tail"])
    fast = rng.normal(size=slow.shape) * np.exp(slow)
    row = judged(good, theta=_only(fast))[0].sel(parameter="sigma_forward")
    assert 3.0 * float(row["ess_tail"]) < float(row["ess_bulk"])


def test_copies_of_one_chain_are_no_evidence(good):
    """Their draws agree perfectly; but no second chain has found this place by itself."""
    _, alone = judged(good, settings={"chain_origins": "2 2 2 2"})
    assert not alone.converged
    assert "all chains are copies of one" in alone.message
    assert any("chain 0 (from 2), 1 (from 2), 3 (from 2)" in line for line in alone.advice)
    _, two = judged(good, settings={"chain_origins": "0 2 2 2"})
    assert two.converged
    assert any("chain 1 (from 2), 3 (from 2)" in line for line in two.advice)
    _, none = judged(good, settings={"chain_origins": "0 1 2 3"})
    assert none.converged
    assert none.advice == ()


@pytest.mark.parametrize(("dead", "converged"), [(0, True), (100, True), (150, False), (6000, False)])
def test_sweeps_that_leave_the_path_where_it_is_are_counted(good, dead, converged):
    """Of 12 000 sweeps: 1 % is the limit."""
    _, result = judged(good, settings={"dead_sweeps_while_drawing": dead, "sweeps_per_draw": 2})
    assert result.converged == converged
    assert ("every particle was impossible" in result.message) != converged


def test_walkers_of_an_ensemble_are_one_chain(good):
    """All walkers share a slow part: each looks well mixed beside the others, and their number adds nothing to it."""
    rng = np.random.default_rng(6)
    shared = autoregressive(rng, 1, 1500, 1, 0.9)[..., 0]
    values = np.sqrt(0.3) * shared + np.sqrt(0.7) * rng.normal(size=(10, 1500))
    changes = {"theta": _only(values), "log_joint": np.zeros((10, 1500)), "statistics": {}, "trajectories": ()}
    changes["trajectory_draw"] = np.empty(0, dtype=np.int64)
    table, naive = judged(good, **changes)
    assert naive.converged
    assert float(table["ess_bulk"].min()) > 1000
    table, result = judged(good, settings={"dependent_chains": True}, **changes)
    # The mean of all values has variance 0.3 (1.9 / 0.1) / 1500 and a little more.
    expected = 1.0 / (0.3 * (1.9 / 0.1) / 1500 + 0.7 / 15_000)
    row = table.sel(parameter="sigma_forward")
    assert float(row["ess_bulk"]) == pytest.approx(expected, rel=0.3)
    assert float(row["mcse"]) > 0.8 * SPREADS[0] / np.sqrt(expected)
    assert not result.converged
    # Independent walkers lose little by being asked.
    others = table["ess_bulk"].values[1:]
    assert (others > 0.7 * 15_000).all()


def test_tails_of_an_ensemble_count_its_dependence_too(good):
    """Now and then all walkers go far out together; the centre does not tell."""
    rng = np.random.default_rng(7)
    values = rng.normal(size=(10, 1500))
    out = np.zeros(1500, dtype=bool)
    for begin in (100, 420, 700, 1200):
        out[begin : begin + 25] = True
    values[:, out] = np.abs(values[:, out]) + 3.0
    changes = {"theta": _only(values), "log_joint": np.zeros((10, 1500)), "statistics": {}, "trajectories": ()}
    changes["trajectory_draw"] = np.empty(0, dtype=np.int64)
    naive, _ = judged(good, **changes)
    table, result = judged(good, settings={"dependent_chains": True}, **changes)
    assert float(table["ess_tail"][0]) < 0.3 * float(naive["ess_tail"][0])
    assert not result.converged


SHORT = ParticleGibbs(
    particles=8, burn_in_particles=40, data_rate=3, settling_sweeps=4, tuning_sweeps=(6, 8), sweeps_per_draw=1
)
OPTIONS = RunOptions(draws=12, chains=4, seed=5, trajectories=4)


@pytest.mark.slow
def test_a_run_tells_where_each_chain_began_and_what_stood_still_since_it_draws(monkeypatch):
    """Chain 1 is restarted from 3 after the first round of tuning, chain 3 from 0 after inclusion."""
    bound = rail_model().bind(rail_log(9, seed=2))
    plan = {"inclusion": {3: 0}, "tuning-1": {1: 3}, "tuning-2": {}}
    monkeypatch.setattr(particle_gibbs, "lost_chains", lambda backend, stage, longest: plan[stage.name])
    first_state = particle_gibbs._first_state

    def with_dead_sweeps(*given):
        state, impossible = first_state(*given)
        state.blobs["failed_updates"] = 1000 * (1 + np.arange(4))
        return state, impossible

    monkeypatch.setattr(particle_gibbs, "_first_state", with_dead_sweeps)
    settings = SHORT.run(bound, OPTIONS).settings
    assert settings["chain_origins"] == "0 0 2 0"
    assert settings["restarted_chains"] == 2
    # What came before drawing, also what a copy brought with it, does not count.
    assert settings["dead_sweeps_while_drawing"] == 0


@pytest.mark.slow
def test_an_ensemble_says_that_its_walkers_depend():
    bound = rail_model().bind(rail_log(9, seed=2))
    chains = Ensemble(particles=20, burn_in=3).run(bound, replace(OPTIONS, chains=6, draws=5))
    assert chains.settings["dependent_chains"] is True
