"""The ensemble on the pseudo-marginal target has the same posterior as everything else."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from oracles import kalman
from oracles.monte_carlo import TOLERANCE, chain_standard_error
from oracles.random_walk_model import rail_log, rail_model

from pmcl.calibration import Ensemble, ParticleGibbs
from pmcl.errors import SamplingError
from pmcl.filtering.particle_filter import log_joint
from pmcl.sampling.ensemble import PseudoMarginalTarget, first_walkers, run_ensemble
from pmcl.sampling.near_mode import near_mode
from pmcl.sampling.options import RunOptions
from pmcl.sampling.pseudo_marginal import BootstrapEvidence, chosen_particles, redrawn_ratio

T = 10
MATTERS = 0.4


@pytest.fixture(scope="module")
def bound():
    return rail_model().bind(rail_log(T, seed=3))


@pytest.fixture(scope="module")
def exact(bound):
    def log_prior(q, r):
        return bound.parameters[0].prior.logpdf(q) + bound.parameters[1].prior.logpdf(r)

    model = kalman.linear_model(bound.tables(bound.prior_mean())[0])
    return kalman.grid_posterior(model, log_prior, top=(4.0, 4.0))


def _moments(theta, exact):
    z = (theta - exact.mean) / exact.std
    features = np.concatenate([z, z**2 - 1.0, z[..., :1] * z[..., 1:] - exact.correlation], axis=-1)
    return features.mean(axis=(0, 1)), chain_standard_error(features, batches=5)


def _run_ensemble(bound, draws, burn_in, move="stretch"):
    options = RunOptions(draws=draws, chains=12, seed=1, trajectories=1)
    return Ensemble(particles=60, burn_in=burn_in, move=move).run(bound, options)


@pytest.mark.long
@pytest.mark.parametrize("move", ["stretch", "de"])
def test_ensemble_and_particle_gibbs_have_the_exact_posterior(bound, exact, move):
    """Twelve walkers, four chains; against the grid and against each other."""
    ensemble = _run_ensemble(bound, 1200, 200, move)
    method = ParticleGibbs(burn_in_particles=100, data_rate=5, sweeps_per_draw=1, particles=15)
    gibbs = method.run(bound, RunOptions(draws=1000, chains=4, seed=2, trajectories=1))
    found = [_moments(chains.theta, exact) for chains in (ensemble, gibbs)]
    for mean, error in found:
        assert error[:2].max() < MATTERS / 5.0, error.round(3)
        assert np.abs(mean / error).max() <= TOLERANCE, (mean / error).round(1)
    between = (found[0][0] - found[1][0]) / np.hypot(found[0][1], found[1][1])
    assert np.abs(between).max() <= TOLERANCE, between.round(1)


@pytest.mark.slow
def test_a_target_that_mistakes_theta_is_noticed(bound, exact, monkeypatch):
    real = PseudoMarginalTarget.__call__

    monkeypatch.setattr(PseudoMarginalTarget, "__call__", lambda self, theta: real(self, 0.75 * theta))
    mean, error = _moments(_run_ensemble(bound, 500, 100).theta, exact)
    assert np.abs(mean / error).max() > TOLERANCE


def test_an_estimate_is_a_function_of_theta_and_seed(bound):
    """It is never drawn again for the same theta, in whatever process."""
    theta = np.array([0.5, 0.4])
    target = PseudoMarginalTarget(BootstrapEvidence(bound), 20, 1)
    value, *blob = target(theta)
    again = pickle.loads(pickle.dumps(target))(theta)
    other = PseudoMarginalTarget(BootstrapEvidence(bound), 20, 2)(theta)
    assert value == again[0]
    assert value != other[0]
    told = dict(zip(target.dtype.names, blob, strict=True))
    np.testing.assert_array_equal(told["path"], again[1 + target.dtype.names.index("path")])
    assert value == pytest.approx(bound.log_prior(theta) + told["log_evidence"])
    tables = bound.tables(theta)[0]
    assert told["log_joint"] == pytest.approx(bound.log_prior(theta) + log_joint(tables, told["path"]))


@pytest.mark.parametrize("theta", [[-0.1, 0.4], [0.5, -1e-9]])
def test_theta_outside_the_prior_has_no_density(bound, theta):
    assert PseudoMarginalTarget(BootstrapEvidence(bound), 20, 1)(np.array(theta))[0] == -np.inf


def test_the_number_of_particles_follows_from_the_scatter_of_the_evidence(bound):
    """More of them where the readings are sharper than the motion."""
    estimate, centre = BootstrapEvidence(bound), np.exp(near_mode(bound, 1).centre)
    usual = chosen_particles(redrawn_ratio(estimate, centre), 1)
    assert chosen_particles(redrawn_ratio(estimate, np.array([1.0, 0.02])), 1) > 4 * usual
    run = Ensemble(burn_in=2, filter="bootstrap").run(bound, RunOptions(draws=2, chains=6, seed=1, trajectories=1))
    assert run.settings["particles"] == usual


def test_the_ensemble_starts_from_the_best_of_many_draws(bound):
    target = PseudoMarginalTarget(BootstrapEvidence(bound), 20, 1)
    state = first_walkers(target, 6, seed=4, pool=None)
    assert state.coords.shape == (6, 2)
    assert np.isfinite(state.log_prob).all()
    assert (np.diff(state.log_prob) <= 0.0).all()


def test_too_few_walkers_are_refused(bound):
    with pytest.raises(SamplingError, match="at least twice as many walkers as parameters"):
        run_ensemble(
            BootstrapEvidence(bound), particles=20, burn_in=2, options=RunOptions(draws=2, chains=3), settings={}
        )
