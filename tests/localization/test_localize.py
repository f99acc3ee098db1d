"""Localization against the Kalman filter, and what each method does with a posterior."""

from __future__ import annotations

import json

import numpy as np
import pytest
from localization.posteriors import around, made_posterior
from oracles import kalman
from oracles.monte_carlo import assert_agrees
from oracles.random_walk_model import rail_log, rail_model

import pmcl
from pmcl.errors import FilterError, LogError, ModelError, PosteriorError
from pmcl.filtering.particle_filter import make_rng
from pmcl.localization.many import localize_many, run_seeds
from pmcl.localization.options import FilterOptions
from pmcl.localization.setup import prepare

T = 12
RAIL = {"process_std": 0.5, "reading_std": 0.4}
RUNS, MANY = 4000, 1000


@pytest.fixture(scope="module")
def rail():
    """The cart's log with one reading missing, and what the Kalman filter knows about it."""
    log = rail_log(T, seed=3, missing=(3,))
    tables = rail_model().bind(log).tables(np.array(list(RAIL.values())))[0]
    return log, kalman.filtered(kalman.linear_model(tables), *RAIL.values())


def run_rail(log, rng, theta=RAIL, **options):
    """Means, variances and log scores (RUNS, T) of many runs of MANY particles."""
    prepared = prepare(log, rail_model(), None, "mean", theta, MANY, FilterOptions(**options))
    found = np.empty((3, RUNS, T))
    for r in range(RUNS):
        prepared.tracker.forget()
        seed = int(rng.integers(2**62))
        beliefs = prepared.tracker.run(0, T, prepared.counts, make_rng(seed), "test")
        found[:, r] = beliefs.mean[:, 0], beliefs.covariance[:, 0, 0], beliefs.log_score
    return found


def check_against_kalman(found, exact):
    """Evidence times moment is unbiased for any number of particles, so there is no bias to allow for."""
    mean, variance, log_score = found
    ratio = np.exp((log_score - exact.log_score).cumsum(axis=1))
    deviation = (mean - exact.mean) / np.sqrt(exact.variance)
    assert_agrees(ratio, 1.0, matters=0.05)
    assert_agrees(ratio * deviation, 0.0, matters=0.05)
    assert_agrees(ratio * (variance / exact.variance + deviation**2), 1.0, matters=0.1)
    assert (log_score[:, 3] == 0.0).all()


@pytest.mark.parametrize("scheme", ["multinomial", "systematic"])
@pytest.mark.parametrize("threshold", [1.0, 0.5])
def test_beliefs_and_scores_agree_with_the_kalman_filter(rail, scheme, threshold, rng):
    log, exact = rail
    check_against_kalman(run_rail(log, rng, scheme=scheme, threshold=threshold), exact)


def test_a_wrong_noise_would_be_seen(rail, rng):
    log, exact = rail
    with pytest.raises(AssertionError, match="off by"):
        check_against_kalman(run_rail(log, rng, RAIL | {"reading_std": 0.42}), exact)


def test_a_log_without_a_posterior_uses_the_prior_mean(room_log):
    bound = pmcl.default_model(room_log).bind(room_log)
    given = dict(zip(bound.names, bound.prior_mean().tolist(), strict=True))
    prior = pmcl.localize(room_log, method="prior", seed=4)
    assert json.loads(prior.dataset.attrs["theta"]) == given
    np.testing.assert_array_equal(prior.pose_mean, pmcl.localize(room_log, theta=given, seed=4).pose_mean)


def test_mean_and_map_are_those_of_the_posterior(room_log, theta):
    names = tuple(theta)
    centre = np.array(list(theta.values()))
    draws = np.array([[0.9 * centre, 1.3 * centre, 0.8 * centre]])
    data = made_posterior(names, draws, lp=[[-5.0, -1.0, np.nan]])
    tracks = {method: pmcl.localize(room_log, None, data, method) for method in ("mean", "map")}
    for method, expected in (("mean", centre), ("map", 1.3 * centre)):
        told = json.loads(tracks[method].dataset.attrs["theta"])
        np.testing.assert_allclose([told[name] for name in names], expected, rtol=1e-12)
        again = pmcl.localize(room_log, theta=told)
        np.testing.assert_array_equal(tracks[method].pose_mean, again.pose_mean)
    # A given value stands in place of the posterior's.
    mixed = pmcl.localize(room_log, None, data, "map", theta={"sigma_range": 0.2})
    assert json.loads(mixed.dataset.attrs["theta"])["sigma_range"] == 0.2
    assert mixed.dataset.attrs["method"] == "map"


def test_the_order_of_a_posteriors_parameters_does_not_matter(room_log, theta):
    turned = dict(reversed(theta.items()))
    first, second = (pmcl.localize(room_log, None, around(t, 0.0), "mean") for t in (theta, turned))
    # The mean of equal numbers may be off in the last bit.
    np.testing.assert_allclose(first.pose_mean, second.pose_mean, atol=1e-6)


@pytest.mark.parametrize("method", ["mean", "posterior"])
def test_many_runs_are_the_single_runs(room_log, theta, method):
    data = around(theta, 0.1)
    runs = localize_many(room_log, None, data, method, repetitions=5, particles=60, seed=9, threads=2)
    assert runs.seeds == run_seeds(9, 5)
    for r in (0, 3, 4):
        track = pmcl.localize(room_log, None, data, method, particles=60, seed=runs.seeds[r])
        np.testing.assert_array_equal(runs.pose_mean[r], track.pose_mean)
        np.testing.assert_array_equal(runs.log_score[r], track.log_score)
        np.testing.assert_array_equal(runs.position_error[r], track.dataset["position_error"])
        assert runs.position_rmse[r] == pytest.approx(track.position_rmse)
        assert runs.heading_rmse[r] == pytest.approx(track.heading_rmse)
    alone = localize_many(room_log, None, data, method, repetitions=5, particles=60, seed=9, threads=1)
    np.testing.assert_array_equal(runs.pose_mean, alone.pose_mean)


def test_the_reference_is_only_used_for_scores(room_log, theta):
    track, blind = (pmcl.localize(log, theta=theta) for log in (room_log, room_log.without_truth()))
    np.testing.assert_array_equal(track.pose_mean, blind.pose_mean)
    assert blind.position_rmse is blind.heading_rmse is blind.coverage_95 is None
    assert 0.0 < track.position_rmse < 0.1
    assert 0.0 < track.heading_rmse < 0.1
    assert track.coverage_95 > 0.7


def test_the_filter_is_better_than_odometry_and_noise_matters(room_log, theta):
    from pmcl.geometry import compose
    from pmcl.localization.metrics import pose_errors, rmse

    poses = [room_log.start_mean]
    for increment in room_log.odometry[1:]:
        poses.append(compose(poses[-1], increment))
    dead_reckoning = float(rmse(pose_errors(np.array(poses), room_log.true_poses).position))
    right = localize_many(room_log, theta=theta, repetitions=20).position_rmse.mean()
    wrong = localize_many(room_log, theta=theta | {"sigma_range": 1.0}, repetitions=20).position_rmse.mean()
    assert right < 0.5 * dead_reckoning
    assert right < 0.7 * wrong


BAD = {
    "no posterior": ({"method": "map"}, PosteriorError, "expects a posterior for sigma_forward"),
    "unknown method": ({"method": "median"}, PosteriorError, "'mean', 'map', 'posterior', 'prior'"),
    "unknown name": ({"theta": {"sigma_trun": 0.1}}, ModelError, "did you mean 'sigma_turn'"),
    "outside its prior": ({"theta": {"sigma_turn": -1.0}}, ModelError, "within its prior"),
    "no noise": ({"theta": {"sigma_turn": 0.0}}, ModelError, "sigma_turn > 0"),
    "one particle": ({"method": "prior", "particles": 1}, FilterError, "particles of at least 2"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_settings(name, room_log):
    settings, kind, message = BAD[name]
    with pytest.raises(kind, match=message):
        pmcl.localize(room_log, **settings)


def test_a_foreign_posterior_names_both_sides(room_log, theta):
    others = {"sigma_forward": 0.1, "sigma_bearing": 0.1}
    with pytest.raises(PosteriorError) as caught:
        pmcl.localize(room_log, None, around(others, 0.1))
    assert "sigma_left" in str(caught.value)
    assert "sigma_bearing" in str(caught.value)
    assert room_log.where in str(caught.value)


def test_more_draws_than_there_are(room_log, theta):
    data = around(theta, 0.1, shape=(2, 4))
    for options, name in ((FilterOptions(draws_per_reading=9), "draws_per_reading"), (FilterOptions(draws=9), "draws")):
        with pytest.raises(PosteriorError, match=f"expected {name} of at most 8, .* but got 9"):
            pmcl.localize(room_log, None, data, "posterior", options=options)
    few = pmcl.localize(room_log, None, data, "posterior", particles=20)
    assert (few.dataset.attrs["draws"], few.dataset.attrs["draws_per_reading"]) == (8, 8)


def test_posteriors_without_draws(room_log, theta):
    with pytest.raises(PosteriorError, match="at least one draw"):
        pmcl.localize(room_log, None, made_posterior(tuple(theta), np.empty((1, 0, 4))))
    with pytest.raises(PosteriorError, match="'lp'"):
        pmcl.localize(room_log, None, made_posterior(tuple(theta), np.full((1, 2, 4), 0.1)), "map")


def test_a_log_without_readings(room_log, theta):
    silent = room_log.dataset.assign(range=room_log.dataset["range"] * np.nan)
    silent["range"].attrs = room_log.dataset["range"].attrs
    with pytest.raises(LogError, match="missing"):
        pmcl.localize(pmcl.RobotLog.from_dataset(silent), theta=theta)
