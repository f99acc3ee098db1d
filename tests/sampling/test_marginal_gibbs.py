"""Marginal particle Gibbs against exact answers: the mixture of two parameters, and the posterior."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import kalman
from oracles.monte_carlo import TOLERANCE, chain_standard_error
from oracles.random_walk_model import rail_log, rail_model

from pmcl.calibration import RunOptions
from pmcl.calibration.marginal_gibbs import MarginalGibbs
from pmcl.filtering.particle_filter import make_rng
from pmcl.sampling.marginal_gibbs import redraw_from_mixture

T = 8
PAIR = np.array([(0.5, 0.4), (0.8, 0.3)])


@pytest.fixture(scope="module")
def bound():
    return rail_model().bind(rail_log(T, seed=3, missing=(4,)))


def _redrawn(bound, count, shift=0.0):
    """Redraw exact draws of the mixture; return standardised paths and the chance of the second theta afterwards."""
    pair = tuple(bound.tables(theta)[0] for theta in PAIR)
    model = kalman.linear_model(pair[0])
    evidence = np.array([float(kalman.log_evidence(model, *theta)) for theta in PAIR])
    prior_odds = 0.3
    chance = 1.0 / (1.0 + np.exp(evidence[0] - evidence[1] - prior_odds))
    laws = [kalman.path_posterior(model, *theta) for theta in PAIR]
    mean = (1.0 - chance) * laws[0][0] + chance * laws[1][0]
    rng, paths, chances = make_rng(5), [], []
    for _ in range(count):
        centre, covariance = laws[int(rng.random() < chance)]
        path = centre + np.linalg.cholesky(covariance) @ rng.standard_normal(T)
        found = redraw_from_mixture(pair, path[:, None], prior_odds + shift, 4, rng)
        paths.append(found.path[:, 0] - mean)
        chances.append(1.0 / (1.0 + np.exp(-found.log_odds)))
    return np.array(paths), np.array(chances) - chance, laws, mean, chance


def test_the_mixture_is_left_as_it_is_with_four_particles(bound):
    paths, chances, laws, mean, chance = _redrawn(bound, 700)
    for column in (*paths.T, chances):
        assert abs(column.mean()) < TOLERANCE * column.std() / np.sqrt(len(column))
    weights = (1.0 - chance, chance)
    variance = sum(w * (np.diag(law[1]) + (law[0] - mean) ** 2) for w, law in zip(weights, laws, strict=True))
    squares = paths**2 - variance
    assert (np.abs(squares.mean(axis=0)) < TOLERANCE * squares.std(axis=0) / np.sqrt(len(squares))).all()
    assert chances.std() / np.sqrt(len(chances)) < 0.02


def test_wrong_odds_are_noticed(bound):
    _, chances, *_ = _redrawn(bound, 300, shift=1.0)
    assert abs(chances.mean()) > TOLERANCE * chances.std() / np.sqrt(len(chances))


@pytest.mark.slow
def test_the_posterior_is_exact():
    bound = rail_model().bind(rail_log(12, seed=3, missing=(7,)))

    def log_prior(q, r):
        return bound.parameters[0].prior.logpdf(q) + bound.parameters[1].prior.logpdf(r)

    exact = kalman.grid_posterior(
        kalman.linear_model(bound.tables(bound.prior_mean())[0]), log_prior, top=(4.0, 4.0)
    )
    method = MarginalGibbs(particles=15, tuning_steps=(50, 100))
    chains = method.run(bound, RunOptions(draws=1500, chains=4, seed=6, trajectories=2))
    z = (chains.theta - exact.mean) / exact.std
    features = np.concatenate([z, z**2 - 1.0, z[..., :1] * z[..., 1:] - exact.correlation], axis=-1)
    error = chain_standard_error(features, batches=5)
    assert error[:2].max() < 0.09
    assert np.abs(features.mean(axis=(0, 1)) / error).max() < TOLERANCE


def test_a_run_has_paths_and_statistics(bound):
    chains = MarginalGibbs(particles=10, tuning_steps=(4, 4)).run(
        bound, RunOptions(draws=12, chains=2, seed=1, trajectories=3)
    )
    assert chains.theta.shape == (2, 12, 2)
    assert chains.trajectories[0].shape[:1] == (2,)
    assert set(chains.statistics) == {"acceptance_rate", "path_update_rate"}
