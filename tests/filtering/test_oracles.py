"""Filter, smoother and conditional SMC against models whose answers are known exactly."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import hidden_markov, kalman
from oracles.monte_carlo import TOLERANCE, assert_agrees, off_by
from oracles.random_walk_model import rail_log, rail_model
from scipy import stats

from pmcl.filtering.particle_filter import draw_paths, make_rng, run_filter, update_path

# Evidence is estimated over the first rows only: the shorter the log, the sharper an estimate can be checked.
T, FEW = 12, 6
THETA = np.array([0.5, 0.4])
SCHEMES_AND_THRESHOLDS = [("multinomial", 0.0)] + [
    (scheme, threshold)
    for scheme in ("multinomial", "systematic", "stratified", "residual")
    for threshold in (0.5, 1.0)
]


@pytest.fixture(scope="module")
def rail():
    """Tables of the cart on a rail, with one reading missing, and the same as a linear model."""
    tables = rail_model().bind(rail_log(T, seed=3, missing=(3,))).tables(THETA)[0]
    return tables, kalman.linear_model(tables)


@pytest.fixture
def sfc(rng):
    """The kernels' own kind of generator, seeded from the test's name."""
    return make_rng(int(rng.integers(2**62)))


# The oracles check each other first.


def test_recursions_agree_with_dense_matrices(rail):
    _, model = rail
    mean, variance = kalman.smoother(model, *THETA)
    dense_mean, covariance = kalman.path_posterior(model, *THETA)
    np.testing.assert_allclose(mean, dense_mean, rtol=1e-12)
    np.testing.assert_allclose(variance, np.diag(covariance), rtol=1e-10)
    seen = ~np.isnan(model.reading)
    difference = np.eye(T) - model.a * np.eye(T, k=-1)
    spread = np.linalg.inv(difference) @ np.diag(np.r_[model.std, np.full(T - 1, THETA[0])])
    prior_mean = np.linalg.solve(difference, np.r_[model.mean, model.control[1:]])
    of_readings = stats.multivariate_normal(
        prior_mean[seen], (spread @ spread.T + THETA[1] ** 2 * np.eye(T))[np.ix_(seen, seen)]
    )
    assert kalman.log_evidence(model, *THETA) == pytest.approx(of_readings.logpdf(model.reading[seen]), rel=1e-12)


# Particle filter


def _begin(model):
    return model._replace(reading=model.reading[:FEW])


def _evidence_ratios(tables, exact, sfc, scheme, threshold, runs=12_000, n=200):
    estimates = [run_filter(tables, FEW, n, sfc, scheme=scheme, threshold=threshold).log_evidence for _ in range(runs)]
    return np.exp(np.array(estimates) - exact)


@pytest.mark.parametrize(("scheme", "threshold"), SCHEMES_AND_THRESHOLDS)
def test_evidence_is_unbiased(rail, scheme, threshold, sfc):
    """The mean of estimate / exact is 1; without resampling the estimate is far noisier, so less can be seen."""
    tables, model = rail
    exact = kalman.log_evidence(_begin(model), *THETA)
    ratios = _evidence_ratios(tables, exact, sfc, scheme, threshold)
    assert_agrees(ratios, 1.0, matters=0.1 if threshold == 0.0 else 0.05)


def test_a_wrong_noise_is_seen_in_the_evidence(rail, sfc):
    tables, model = rail
    exact = kalman.log_evidence(_begin(model), *THETA)
    wrong = tables._replace(sensors=(tables.sensors[0]._replace(std=1.1 * THETA[1]),))
    assert off_by(_evidence_ratios(wrong, exact, sfc, "multinomial", 1.0), 1.0) > TOLERANCE


def test_thresholds_decide_when_ancestors_are_drawn(rail, sfc):
    """Never resampling keeps the weights' product; always resampling starts each row's weights anew."""
    tables, _ = rail
    never = run_filter(tables, T, 50, sfc, threshold=0.0)
    always = run_filter(tables, T, 50, sfc, threshold=1.0)
    assert np.ptp(never.log_weights[-1]) > np.ptp(always.log_weights[-1])
    assert never.effective_size[-1] < always.effective_size[-1]
    np.testing.assert_allclose(never.log_increments.sum(), never.log_evidence)
    np.testing.assert_array_equal(always.log_weights[3], 0.0)  # nothing was measured there


def test_filtered_and_smoothed_means(rail, sfc):
    """Last filtered mean, and means of trajectories drawn backward, against Kalman and Rauch-Tung-Striebel.

    Both have a bias of the order of 1 / n: at n = 500 it is six standard errors of 1500 runs, here two.
    """
    tables, model = rail
    mean, variance = kalman.smoother(model, *THETA)
    filtered, smoothed = np.empty(1500), np.empty((1500, T))
    for k in range(1500):
        done = run_filter(tables, T, 4000, sfc)
        filtered[k] = done.mean()[-1, 0]
        smoothed[k] = draw_paths(tables, done, 1, sfc)[0, :, 0]
    assert_agrees(filtered, mean[-1], matters=0.02)
    assert_agrees(smoothed, mean, matters=0.25 * np.sqrt(variance))
    assert_agrees((smoothed - mean) ** 2, variance, matters=0.35 * variance)


def test_many_paths_of_one_pass_agree_with_one_by_one_sweeps(rail, sfc):
    tables, model = rail
    mean, variance = kalman.smoother(model, *THETA)
    paths = draw_paths(tables, run_filter(tables, T, 20_000, sfc), 400, sfc)
    assert paths.shape == (400, T, 1)
    assert np.all(np.abs(paths[:, :, 0].mean(axis=0) - mean) < TOLERANCE * np.sqrt(variance / 400))


# Conditional SMC. Started from an exact draw of the path's posterior, any number of sweeps must leave it an exact draw.


def _after_sweeps(tables, model, sfc, kernel, n, sweeps=2, runs=40_000):
    mean, covariance = kalman.path_posterior(model, *THETA)
    root = np.linalg.cholesky(covariance)
    paths = mean + sfc.standard_normal((runs, T)) @ root.T
    for k in range(runs):
        path = np.ascontiguousarray(paths[k, :, None])
        for _ in range(sweeps):
            update_path(tables, path, T, n, sfc, kernel)
        paths[k] = path[:, 0]
    return paths


def _moments(paths, mean, covariance):
    """Draws of deviation, its square, and its product with the next one; their exact means; and biases that matter."""
    x = paths - mean
    variance, lagged = np.diag(covariance), np.diag(covariance, 1)
    spread = np.sqrt(variance)
    return [
        (x, 0.0 * mean, 0.1 * spread),
        (x**2, variance, 0.15 * variance),
        (x[:, 1:] * x[:, :-1], lagged, 0.15 * spread[1:] * spread[:-1]),
    ]


@pytest.mark.parametrize("n", [5, *(pytest.param(n, marks=pytest.mark.slow) for n in (10, 20)), 40])
def test_conditional_sweeps_keep_the_exact_smoother(rail, n, sfc):
    tables, model = rail
    mean, covariance = kalman.path_posterior(model, *THETA)
    paths = _after_sweeps(tables, model, sfc, "conditional", n)
    for draws, exact, matters in _moments(paths, mean, covariance):
        assert_agrees(draws, exact, matters)


@pytest.mark.parametrize("n", [pytest.param(5, marks=pytest.mark.slow), 10])
def test_plain_smoothing_with_few_particles_does_not(rail, n, sfc):
    """What forgets the kept trajectory fails the very comparison above."""
    tables, model = rail
    mean, covariance = kalman.path_posterior(model, *THETA)
    paths = _after_sweeps(tables, model, sfc, "smoothing", n)
    assert max(np.max(off_by(draws, exact)) for draws, exact, _ in _moments(paths, mean, covariance)) > TOLERANCE


def _inverse_ratios(tables, model, sfc, kernel, n=50, runs=20_000):
    begin = _begin(model)._replace(control=model.control[:FEW])
    mean, covariance = kalman.path_posterior(begin, *THETA)
    paths = mean + sfc.standard_normal((runs, FEW)) @ np.linalg.cholesky(covariance).T
    estimates = [
        update_path(tables, np.ascontiguousarray(path[:, None]), FEW, n, sfc, kernel).log_evidence for path in paths
    ]
    return np.exp(kalman.log_evidence(begin, *THETA) - np.array(estimates))


def test_inverse_of_the_conditional_evidence_is_unbiased(rail, sfc):
    """Under the law of conditional SMC from an exact path, 1 / estimate is unbiased for 1 / evidence."""
    assert_agrees(_inverse_ratios(*rail, sfc, "conditional"), 1.0, matters=0.05)


def test_inverse_of_the_plain_evidence_is_not(rail, sfc):
    assert off_by(_inverse_ratios(*rail, sfc, "smoothing"), 1.0) > TOLERANCE


def test_conditional_sweeps_forget_where_they_began(rail, sfc):
    tables, model = rail
    mean, _ = kalman.path_posterior(model, *THETA)
    ends = np.empty((1000, T))
    for k in range(1000):
        path = np.ascontiguousarray((mean + 2.0)[:, None])
        for _ in range(15):
            update_path(tables, path, T, 20, sfc, "conditional")
        ends[k] = path[:, 0]
    assert np.all(off_by(ends, mean) < TOLERANCE)


# A chain of few states: here the law of whole paths can be compared, cell by cell. Readings look back.

STEPS = 4


@pytest.fixture(scope="module")
def chain():
    tables = hidden_markov.chain_tables(STEPS)
    return tables, *hidden_markov.enumerate_paths(tables, STEPS)


def _p_value(found, paths, probability):
    """Chi-square test of path counts; cells with fewer than ten expected are put together."""
    code = 3 ** np.arange(STEPS)
    counts = np.bincount(found.astype(np.int64) @ code, minlength=3**STEPS)[paths @ code]
    assert counts[probability == 0.0].sum() == 0
    expected = probability * len(found)
    small = expected < 10.0
    observed = np.append(counts[~small], counts[small].sum())
    return stats.chisquare(observed, np.append(expected[~small], expected[small].sum())).pvalue


def test_evidence_where_readings_look_back(chain, sfc):
    tables, _, _, exact = chain
    estimates = [run_filter(tables, STEPS, 200, sfc).log_evidence for _ in range(3000)]
    assert_agrees(np.exp(np.array(estimates) - exact), 1.0, matters=0.05)


def test_backward_sampling_has_the_exact_law_of_paths(chain, sfc):
    tables, paths, probability, _ = chain
    found = [draw_paths(tables, run_filter(tables, STEPS, 1000, sfc), 1, sfc)[0, :, 0] for _ in range(6000)]
    assert _p_value(np.array(found), paths, probability) > 1e-5


@pytest.mark.parametrize("n", [2, 3, 8, 40])
def test_conditional_sweeps_keep_the_exact_law_of_paths(chain, n, sfc):
    tables, paths, probability, _ = chain
    assert _p_value(_swept(tables, paths, probability, n, "conditional", sfc), paths, probability) > 1e-5


def test_plain_smoothing_breaks_the_law_of_paths(chain, sfc):
    tables, paths, probability, _ = chain
    assert _p_value(_swept(tables, paths, probability, 8, "smoothing", sfc), paths, probability) < 1e-12


def _swept(tables, paths, probability, n, kernel, sfc, runs=40_000):
    found = paths[sfc.choice(len(paths), size=runs, p=probability)].astype(float)
    for k in range(runs):
        path = np.ascontiguousarray(found[k, :, None])
        info = update_path(tables, path, STEPS, n, sfc, kernel)
        assert info.succeeded or kernel == "smoothing"
        found[k] = path[:, 0]
    return found
