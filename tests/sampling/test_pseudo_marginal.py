"""Particle marginal Metropolis-Hastings, plain and correlated, against the exact posterior."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import kalman
from oracles.monte_carlo import TOLERANCE, chain_standard_error
from oracles.random_walk_model import rail_log, rail_model

from pmcl.calibration import RunOptions
from pmcl.calibration.pmmh import ParticleMetropolis
from pmcl.filtering.kernels.stepwise import hilbert_key
from pmcl.filtering.particle_filter import make_rng
from pmcl.models.robot_model import default_model
from pmcl.sampling.near_mode import near_mode
from pmcl.sampling.near_posterior import near_posterior
from pmcl.sampling.pseudo_marginal import (
    BootstrapEvidence,
    GuidedEvidence,
    chosen_particles,
    draw_numbers,
    evidence_filter,
    paths_of,
    redrawn_ratio,
)
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field

# All tests are slow: compiling kernels that no other test needs takes most of the time.

T = 12
# Biases of means, squares and product that matter, in posterior standard deviations.
MATTERS = np.array([0.35, 0.35, 0.7, 0.7, 0.5])
THETA = np.array([0.5, 0.4])


@pytest.fixture(scope="module")
def bound():
    return rail_model().bind(rail_log(T, seed=3, missing=(7,)))


@pytest.fixture(scope="module")
def model(bound):
    return kalman.linear_model(bound.tables(THETA)[0])


@pytest.fixture(scope="module")
def exact(bound, model):
    def log_prior(q, r):
        return bound.parameters[0].prior.logpdf(q) + bound.parameters[1].prior.logpdf(r)

    return kalman.grid_posterior(model, log_prior, top=(4.0, 4.0))


def _off(bound, exact, method, draws):
    chains = method.run(bound, RunOptions(draws=draws, chains=4, seed=5, trajectories=2))
    z = (chains.theta - exact.mean) / exact.std
    features = np.concatenate([z, z**2 - 1.0, z[..., :1] * z[..., 1:] - exact.correlation], axis=-1)
    error = chain_standard_error(features, batches=5)
    return features.mean(axis=(0, 1)) / error, MATTERS / error


@pytest.mark.parametrize(
    ("name", "blocks", "particles"),
    [
        pytest.param("bootstrap", 1, 40, marks=pytest.mark.long),
        pytest.param("bootstrap", 6, 16, marks=pytest.mark.slow),
        pytest.param("guided", 3, 4, marks=pytest.mark.slow),
    ],
)
def test_the_posterior_is_exact_with_few_particles(bound, exact, name, blocks, particles):
    method = ParticleMetropolis(
        particles=particles, filter=name, blocks=blocks, tuning_steps=(50, 100), proposals_per_draw=4
    )
    off, sharpness = _off(bound, exact, method, 800)
    assert sharpness.min() > TOLERANCE, sharpness.round(1)
    assert np.abs(off).max() <= TOLERANCE, off.round(1)


@pytest.mark.long
def test_an_estimate_that_is_drawn_again_for_the_current_state_is_noticed(bound, exact, monkeypatch):
    """Monte Carlo within Metropolis: the classical mistake. Both estimates of a ratio are then drawn anew."""
    real = BootstrapEvidence.__call__

    def biased(this, theta, particles, numbers, **options):
        found = real(this, theta, particles, numbers, **options)
        fresh = numbers.copy()
        fresh[:-1] += np.uint64(1)
        # What a redrawn estimate of the current state would add to the log of the ratio.
        return found._replace(log_evidence=found.log_evidence + 0.5 * real(this, theta, particles, fresh).log_evidence)

    monkeypatch.setattr(BootstrapEvidence, "__call__", biased)
    method = ParticleMetropolis(particles=16, filter="bootstrap", tuning_steps=(50, 100), proposals_per_draw=4)
    off, _ = _off(bound, exact, method, 600)
    assert np.abs(off).max() > TOLERANCE


@pytest.mark.slow
@pytest.mark.parametrize("blocks", [1, 5, 30])
@pytest.mark.parametrize("name", ["bootstrap", "guided"])
def test_the_estimate_is_unbiased_whatever_the_blocks(bound, model, name, blocks):
    """Also with more blocks than rows, and resampled in the order of a curve; a guided filter has no noise here."""
    rng, estimate = make_rng(7), evidence_filter(name, bound, near_mode(bound, 1), 1)
    exact = float(kalman.log_evidence(model, *THETA))
    found = np.array([estimate(THETA, 200, draw_numbers(rng, blocks)).log_evidence for _ in range(800)])
    ratio = np.exp(found - exact)
    error = ratio.std(ddof=1) / np.sqrt(ratio.size)
    assert error < 0.04
    assert abs(ratio.mean() - 1.0) < TOLERANCE * error + 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bootstrap", "guided"])
def test_an_estimate_is_a_function_of_its_numbers(name):
    log = simulate_landmark_field(12, 1)
    bound = default_model(log).bind(log)
    near, rng = near_mode(bound, 1), make_rng(1)
    estimate, theta = evidence_filter(name, bound, near, 1), np.exp(near.centre)
    numbers = draw_numbers(rng, 4)
    first, again = (estimate(theta, 30, numbers) for _ in range(2))
    assert first.log_evidence == again.log_evidence
    np.testing.assert_array_equal(paths_of(first, 3)[0][0], paths_of(again, 3)[0][0])
    numbers[2] += np.uint64(1)
    passes = (first.passes[0], estimate(theta, 30, numbers).passes[0])
    states = [
        one.particles if name == "bootstrap" else np.array([one.row_states(t)[:, :30] for t in range(12)])
        for one in passes
    ]
    # Rows before the third block in the order in which they are drawn are the same, those of the block are not.
    before, block = (slice(0, 6), 6) if name == "bootstrap" else (slice(9, 12), 8)
    np.testing.assert_array_equal(states[0][before], states[1][before])
    assert np.all(states[0][block] != states[1][block])


@pytest.mark.slow
def test_without_a_gaussian_path_the_bootstrap_filter_estimates(monkeypatch, bound):
    """At a theta without one, or throughout."""
    near, numbers = near_mode(bound, 1), draw_numbers(make_rng(3), 1)
    guided, plain = GuidedEvidence(bound, near, 1), BootstrapEvidence(bound)
    assert guided(THETA, 30, numbers).log_evidence != plain(THETA, 30, numbers).log_evidence
    monkeypatch.setattr("pmcl.sampling.pseudo_marginal.guide_along", lambda *_: None)
    assert guided(THETA, 30, numbers).log_evidence == plain(THETA, 30, numbers).log_evidence
    assert isinstance(evidence_filter("guided", bound, near, 1), BootstrapEvidence)


@pytest.mark.slow
def test_correlated_estimates_differ_less_than_independent_ones(bound):
    """By the share of the blocks that is redrawn; so fewer particles will do."""
    rng = make_rng(2)

    def spread(blocks):
        differences = []
        for _ in range(300):
            numbers = draw_numbers(rng, blocks)
            first = BootstrapEvidence(bound)(THETA, 30, numbers).log_evidence
            numbers[rng.integers(blocks)] = draw_numbers(rng, 0)[0]
            differences.append(BootstrapEvidence(bound)(1.01 * THETA, 30, numbers).log_evidence - first)
        return float(np.std(differences))

    assert spread(T) < 0.5 * spread(1)
    estimate = BootstrapEvidence(bound)
    plain, correlated = (chosen_particles(redrawn_ratio(estimate, THETA, blocks), 0) for blocks in (1, T))
    assert plain >= correlated


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bootstrap", "guided"])
def test_impossible_parameters_have_no_evidence(bound, name):
    numbers, estimate = draw_numbers(make_rng(1), 1), evidence_filter(name, bound, near_mode(bound, 1), 1)
    assert estimate(np.array([-0.5, 0.4]), 20, numbers).log_evidence == -np.inf


@pytest.mark.slow
@pytest.mark.parametrize("size", [1, 2, 3, 4])
def test_the_hilbert_curve_visits_every_cell_once_and_goes_from_neighbour_to_neighbour(size):
    bits = 3
    cells = np.stack(np.meshgrid(*[np.arange(2**bits)] * size, indexing="ij"), axis=-1).reshape(-1, size)
    keys = np.array([hilbert_key(cell.astype(np.int64), bits) for cell in cells])
    assert sorted(keys) == list(range(len(cells)))
    steps = np.abs(np.diff(cells[np.argsort(keys)], axis=0)).sum(axis=1)
    assert (steps == 1).all()


@pytest.mark.slow
def test_some_sweeps_find_the_noise_of_a_robot_between_walls():
    """The mode of the linearised model has too much; with the path found, few guided particles do for many others."""
    truth = {"sigma_forward": 0.02, "sigma_left": 0.01, "sigma_turn": 0.1, "sigma_range": 0.04}
    log = simulate_amigobot(150.0, 3, truth)
    bound = default_model(log).bind(log)
    near = near_posterior(bound, 4)
    theta = np.exp(near.centre)
    assert theta[-1] == pytest.approx(0.04, rel=0.12)
    rng, guided = make_rng(5), GuidedEvidence(bound, near, 4)
    large = [BootstrapEvidence(bound)(theta, 20_000, draw_numbers(rng, 1)).log_evidence for _ in range(6)]
    small = np.array([guided(theta, 100, draw_numbers(rng, 1)).log_evidence for _ in range(20)])
    assert small.std() < 1.5
    assert small.mean() == pytest.approx(np.mean(large), abs=2.0)
