"""Metropolis with sets of trajectories: the exact posterior with few trajectories and particles."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import kalman
from oracles.monte_carlo import SHARPNESS, TOLERANCE, chain_standard_error
from oracles.random_walk_model import rail_log, rail_model

from pmcl.calibration import RunOptions, TrajectorySets
from pmcl.errors import FilterError, SamplingError
from pmcl.filtering.particle_filter import draw_set, make_rng
from pmcl.sampling import trajectory_sets
from pmcl.sampling.path_walk import path_dtype
from pmcl.sampling.trajectory_sets import exchange

THETAS = np.array([(0.6, 0.3), (0.45, 0.42)])


@pytest.fixture(scope="module")
def bound():
    return rail_model().bind(rail_log(8, seed=3, missing=(4,)))


def _draws_of(bound, theta, count, seed):
    mean, covariance = kalman.path_posterior(kalman.linear_model(bound.tables(theta)[0]), *theta)
    return mean + np.random.default_rng(seed).standard_normal((count, mean.size)) @ np.linalg.cholesky(covariance).T


def test_a_set_has_the_law_of_the_path_that_it_was_made_from(bound):
    """Exact draws in, exact draws out, with four particles; and drawn ones are as far from it as from each other."""
    theta, rng = THETAS[0], make_rng(3)
    mean, covariance = kalman.path_posterior(kalman.linear_model(bound.tables(theta)[0]), *theta)
    tables = bound.tables(theta)[0]
    given = _draws_of(bound, theta, 4000, 1)
    sets = np.array([draw_set(tables, path[:, None], 2, 4, rng)[..., 0] for path in given])
    for drawn in np.moveaxis(sets, 1, 0):
        deviation = drawn - mean
        assert (np.abs(deviation.mean(axis=0)) < TOLERANCE * deviation.std(axis=0) / np.sqrt(len(drawn))).all()
        squares = deviation**2 - np.diag(covariance)
        assert (np.abs(squares.mean(axis=0)) < TOLERANCE * squares.std(axis=0) / np.sqrt(len(drawn))).all()
    apart = ((given - sets[:, 0]) ** 2 - (sets[:, 1] - sets[:, 0]) ** 2).mean(axis=1)
    assert abs(apart.mean()) < TOLERANCE * apart.std() / np.sqrt(len(apart))
    with pytest.raises(FilterError, match="expected 2 to 32 particles"):
        draw_set(tables, given[0][:, None], 2, 33, rng)


@pytest.mark.slow
def test_the_mean_ratio_is_the_ratio_of_evidences(bound):
    """From exact draws at theta, forward ratios have the mean p(z | theta') / p(z | theta), whatever the set's size."""
    model = kalman.linear_model(bound.tables(THETAS[0])[0])
    exact = np.exp(float(kalman.log_evidence(model, *THETAS[1]) - kalman.log_evidence(model, *THETAS[0])))
    rng, middle = make_rng(4), np.sqrt(THETAS[0] * THETAS[1])
    ratios = np.array([
        np.exp(exchange(bound, (THETAS[0], middle, THETAS[1]), path[:, None], 0.0, 3, 6, rng, forward=True).log_ratio)
        for path in _draws_of(bound, THETAS[0], 6000, 2)
    ])  # fmt: skip
    error = ratios.std() / np.sqrt(len(ratios))
    assert error < 0.05 * exact
    assert abs(ratios.mean() - exact) < TOLERANCE * error


@pytest.fixture(scope="module")
def longer():
    return rail_model().bind(rail_log(12, seed=3, missing=(7,)))


def _log_prior(bound):
    return lambda q, r: bound.parameters[0].prior.logpdf(q) + bound.parameters[1].prior.logpdf(r)


@pytest.fixture(scope="module")
def exact(longer):
    model = kalman.linear_model(longer.tables(longer.prior_mean())[0])
    return kalman.grid_posterior(model, _log_prior(longer), top=(4.0, 4.0))


def _posterior_draws(bound, count, seed):
    """Exact draws of theta, and of the path given it."""
    rng, step = np.random.default_rng(seed), 4.0 / 400
    model = kalman.linear_model(bound.tables(bound.prior_mean())[0])
    q, r = np.meshgrid((np.arange(400) + 0.5) * step, (np.arange(400) + 0.5) * step, indexing="ij")
    log_density = kalman.log_evidence(model, q, r) + _log_prior(bound)(q, r)
    chances = np.exp(log_density - log_density.max()).ravel()
    cells = rng.choice(chances.size, size=count, p=chances / chances.sum())
    thetas = np.column_stack([q.ravel()[cells], r.ravel()[cells]]) + step * (rng.random((count, 2)) - 0.5)
    for theta in thetas:
        mean, covariance = kalman.path_posterior(model, *theta)
        yield theta, mean + np.linalg.cholesky(covariance) @ rng.standard_normal(mean.size)


def _features(theta, exact):
    z = (theta - exact.mean) / exact.std
    return np.concatenate([z, z**2 - 1.0, z[..., :1] * z[..., 1:] - exact.correlation], axis=-1)


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [False, True])
def test_one_sweep_leaves_exact_draws_as_they_are(longer, exact, wrong, monkeypatch):
    """The negative control draws sets at a theta that is not the one between."""
    if wrong:
        elsewhere = longer.tables(np.array([1.0, 0.3]))[0]
        monkeypatch.setattr(trajectory_sets, "draw_set", lambda tables, *arguments: draw_set(elsewhere, *arguments))
    move = trajectory_sets._SetMove(longer, 4, 8, 0.8 * np.eye(2), 0.0)
    dtype, changes = path_dtype(longer, trajectory_sets._FIELDS), []
    for seed, (theta, path) in enumerate(_posterior_draws(longer, 3000, 7)):
        blob = np.zeros((), dtype=dtype)
        blob["path"] = path[:, None]
        new, _, _ = move.update((0, theta, blob, seed))
        changes.append(_features(new, exact) - _features(theta, exact))
    changes = np.array(changes)
    error = changes.std(axis=0) / np.sqrt(len(changes))
    # Sharp enough to see a drift of a tenth of a standard deviation in one sweep.
    assert wrong or error[:2].max() < 0.1 / SHARPNESS
    off = np.abs(changes.mean(axis=0) / error).max()
    assert (off > TOLERANCE) == wrong, off


@pytest.mark.slow
def test_the_posterior_is_exact(longer, exact):
    method = TrajectorySets(set_size=4, particles=8, tuning_steps=(100, 200))
    features = _features(method.run(longer, RunOptions(draws=3000, chains=4, seed=6, trajectories=2)).theta, exact)
    error = chain_standard_error(features, batches=10)
    assert error[:2].max() < 0.09
    assert np.abs(features.mean(axis=(0, 1)) / error).max() < TOLERANCE


def test_several_logs_share_theta_and_statistics_are_kept(bound):
    logs = [rail_log(8, seed=3, missing=(4,)), rail_log(5, seed=4)]
    both = rail_model().bind(logs)
    method = TrajectorySets(set_size=3, particles=6, tuning_steps=(4, 4))
    options = RunOptions(draws=20, chains=2, seed=1)
    chains = method.run(both, options)
    assert chains.theta.shape == (2, 20, 2)
    assert [part.shape[2] for part in chains.trajectories] == [8, 5]
    assert set(chains.statistics) == {"acceptance_rate", "path_update_rate"}
    assert 0.0 < chains.statistics["acceptance_rate"].mean() < 1.0
    np.testing.assert_array_equal(chains.theta, method.run(both, options).theta)


def test_more_particles_than_are_exchangeable_are_refused():
    with pytest.raises(SamplingError, match="particles"):
        TrajectorySets(particles=33)
