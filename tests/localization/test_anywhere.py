"""A robot that may be anywhere: the annealed first reading, recovery after being carried away, adaptive numbers."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.monte_carlo import assert_agrees
from oracles.random_walk_model import rail_log, rail_model
from scipy import stats

import pmcl
from pmcl.errors import FilterError, ModelError
from pmcl.filtering.kernels.tracking import recovery
from pmcl.filtering.kernels.tracking.adapt import _is_new, particles_needed
from pmcl.filtering.kernels.tracking.state import SUSPICION
from pmcl.filtering.particle_filter import make_rng
from pmcl.filtering.tracker import Options, Tracker
from pmcl.localization.metrics import pose_errors
from pmcl.localization.options import FilterOptions
from pmcl.models.starts.table import GaussianStart
from pmcl.simulations.amigobot import simulate_amigobot

# Converged: within this of the truth, for good.
NEAR, AIMED = 0.3, 0.3
LEVELS = {
    "usual noise": {"sigma_forward": 0.05, "sigma_left": 0.03, "sigma_turn": 0.05, "sigma_range": 0.1},
    "sharp readings": {"sigma_forward": 0.02, "sigma_left": 0.01, "sigma_turn": 0.03, "sigma_range": 0.02},
}


def converged_at(track, log):
    """Row from which on the pose is right, or None."""
    errors = pose_errors(track.pose_mean, log.true_poses)
    wrong = np.flatnonzero((errors.position > NEAR) | (np.abs(errors.heading) > AIMED))
    first = int(wrong[-1]) + 1 if wrong.size else 0
    return first if first < log.n_steps - 10 else None


# Annealing against an exact answer


def _rail_tracker(reading_std, anywhere=None, n=400):
    log = rail_log(3, seed=4)
    tables = rail_model().bind(log).tables(np.array([0.5, reading_std]))[0]
    wide = GaussianStart(np.array([50.0]), np.array([20.0]))
    options = Options(n, n, n, 1, 1, 0, 1.0, 1, True, 0.5, 0.1, 1.0, 2.0, 0.2, 0.3, 0.05, 2.33)
    tables = tables._replace(start=wide)
    exact = stats.norm(50.0, np.hypot(20.0, reading_std)).logpdf(tables.sensors[0].reading[0])
    gain = 20.0**2 / (20.0**2 + reading_std**2)
    mean, std = 50.0 + gain * (tables.sensors[0].reading[0] - 50.0), np.sqrt(1.0 - gain) * 20.0
    return Tracker([tables], anywhere, options), (float(exact), mean, std)


@pytest.mark.slow
def test_annealing_gives_belief_and_evidence_of_a_sharp_reading():
    """A reading 400 times sharper than the start: of 400 particles drawn anywhere hardly one would survive it."""
    tracker, (evidence, mean, std) = _rail_tracker(0.05)
    found = []
    for seed in range(600):
        tracker.forget()
        beliefs = tracker.run(0, 1, np.ones(1, dtype=np.int64), make_rng(seed), "test")
        found.append((beliefs.log_score[0], beliefs.mean[0, 0], beliefs.covariance[0, 0, 0]))
    score, means, variances = np.array(found).T
    assert_agrees(np.exp(score - evidence), 1.0, matters=0.1)
    # The moments have a small bias, as all ratios of estimates do.
    assert abs((means - mean).mean()) < 0.05 * std
    assert variances.mean() == pytest.approx(std**2, rel=0.05)


@pytest.mark.slow
def test_annealing_agrees_with_many_plain_particles(room_log, theta):
    """Somewhere in the room: the same evidence and the same belief as by drawing a hundred times as many poses."""
    start = room_log.select(0, 2, start_mean=np.zeros(3), start_std=np.full(3, np.inf))
    coarse = theta | {"sigma_range": 0.3}
    annealed = [pmcl.localize(start, theta=coarse, particles=2000, seed=seed) for seed in range(40)]
    plain = [
        pmcl.localize(start, theta=coarse, particles=200_000, seed=seed, options=FilterOptions(annealed=False))
        for seed in range(4)
    ]
    for track in plain:
        assert track.ess[0] > 500.0
    scores = np.array([track.log_score[0] for track in annealed])
    assert scores.mean() == pytest.approx(np.mean([track.log_score[0] for track in plain]), abs=0.15)
    spread = np.sqrt(np.mean([np.diag(track.pose_cov[0]) for track in plain], axis=0))
    means = [np.mean([track.pose_mean[0, :2] for track in tracks], axis=0) for tracks in (annealed, plain)]
    assert (np.abs(means[0] - means[1]) < 0.25 * spread[:2]).all()


def test_the_belief_after_looking_elsewhere_is_the_mixture(rng):
    """With probability 0.3 anywhere: weights are those of the two evidences."""
    wide = GaussianStart(np.array([50.0]), np.array([20.0]))
    tracker, (evidence, mean, _) = _rail_tracker(0.05, wide)
    scores = []
    for seed in range(300):
        tracker.forget()
        generator = make_rng(seed)
        tracker.run(0, 1, np.ones(1, dtype=np.int64), generator, "test")
        state = tracker._state
        state.particles[:400] = mean + 3.0
        state.numbers[SUSPICION] = 0.3
        old = evidence - 1.0
        moments, told = (np.empty(1), np.empty((1, 1))), np.array([old, 0.0, 0.0])
        status = recovery.look_elsewhere(
            tracker.tables, tracker.stack, wide, tracker.options, 0, generator, state, *moments, told
        )
        assert status == 0
        share = 0.3 / (0.3 + 0.7 * np.exp(-1.0))
        assert moments[0][0] == pytest.approx(mean + 3.0 * (1.0 - share), abs=0.5)
        scores.append(told[0])
    assert_agrees(np.exp(np.array(scores) - evidence), 0.3 + 0.7 * np.exp(-1.0), matters=0.1)


# Global localization


def global_starts(theta, count):
    """Logs of sixty rows that begin at random rows of longer drives, with nothing known about where."""
    rng = np.random.default_rng(7)
    drives = [simulate_amigobot(600.0, seed, theta) for seed in range(5)]
    for k in range(count):
        row = int(rng.integers(0, 540))
        yield drives[k % 5].select(row, row + 60)


@pytest.mark.slow
@pytest.mark.parametrize("level", LEVELS)
def test_global_starts_converge(level, capsys):
    """The particle number that the documentation recommends for a start anywhere is the default, 500."""
    theta = LEVELS[level]
    rows = [
        converged_at(pmcl.localize(log, theta=theta, seed=seed), log)
        for seed, log in enumerate(global_starts(theta, 100))
    ]
    done = [row for row in rows if row is not None]
    with capsys.disabled():
        print(f"\nglobal starts, {level}, n=500: {len(done)} of 100 converge, on average at row {np.mean(done):.1f}")
    assert len(done) >= 95


@pytest.mark.slow
def test_plain_particles_would_need_to_be_many(capsys):
    """What annealing is for: without it the same starts fail."""
    theta = LEVELS["sharp readings"]
    plain = FilterOptions(annealed=False)
    found = [
        converged_at(pmcl.localize(log, theta=theta, seed=seed, options=plain), log) is not None
        for seed, log in enumerate(global_starts(theta, 40))
    ]
    assert sum(found) < 36


# Recovery


def carried_away(theta, seed, rows=40):
    """A log in which the robot is picked up half-way and put down at least a metre off; odometry does not see it."""
    rng = np.random.default_rng(seed)
    drive = simulate_amigobot(400.0, seed, theta)
    while True:
        first, second = rng.integers(0, 400 - rows, 2)
        jump = drive.true_poses[first + rows - 1, :2] - drive.true_poses[second, :2]
        if np.hypot(*jump) > 1.0:
            break
    kept = np.r_[first : first + rows, second : second + rows]
    return pmcl.RobotLog.build(
        time=np.arange(2.0 * rows),
        odometry=drive.odometry[kept],
        ranges=drive.ranges[kept],
        beam_poses=drive.beam_poses,
        max_range=drive.max_range,
        walls=drive.walls,
        start_mean=drive.true_poses[first],
        start_std=[0.05, 0.05, 0.05],
        true_poses=drive.true_poses[kept],
    )


@pytest.mark.slow
@pytest.mark.parametrize("level", LEVELS)
def test_a_robot_that_was_carried_away_is_found_again(level):
    theta, late, lost = LEVELS[level], [], 0
    for seed in range(20):
        log = carried_away(theta, seed)
        found = converged_at(pmcl.localize(log, theta=theta, seed=seed, options=FilterOptions(recover=True)), log)
        late.append(np.inf if found is None else found - 40)
        lost += converged_at(pmcl.localize(log, theta=theta, seed=seed), log) is None
    assert np.count_nonzero(np.array(late) <= 10) >= 19
    # Without recovery most stay lost, or the test would test nothing.
    assert lost >= 10


def test_recovery_costs_nothing_when_all_is_well(theta):
    log = simulate_amigobot(200.0, 11, theta)
    plain, ready = (
        pmcl.localize_many(log, theta=theta, repetitions=20, options=FilterOptions(recover=recover))
        for recover in (False, True)
    )
    assert ready.position_rmse.mean() == pytest.approx(plain.position_rmse.mean(), rel=0.03)


def test_a_filter_without_any_plausible_particle_recovers_or_says_so(rng):
    """Particles that all are impossible: with recovery the belief is drawn anew, without it there is an error."""
    log = rail_log(6, seed=1)
    bound = rail_model().bind(log)
    tables = bound.tables(np.array([0.5, 1e-200]))[0]
    options = Options(9, 9, 9, 1, 1, 0, 1.0, 0, False, 0.5, 0.1, 1.0, 2.0, 0.2, 0.3, 0.05, 2.33)
    tracker = Tracker([tables], None, options)
    with pytest.raises(FilterError, match="row 0 every particle has weight zero"):
        tracker.run(0, 6, np.ones(6, dtype=np.int64), make_rng(1), "rail")
    tracker.forget()
    beliefs, lost_at = tracker.run_until_lost(0, 6, np.ones(6, dtype=np.int64), make_rng(1), "rail")
    assert lost_at == 0
    assert np.isnan(beliefs.mean).all()
    assert np.isnan(beliefs.log_score).all()


def test_recovery_needs_somewhere_to_look():
    with pytest.raises(ModelError, match="recovery expects a robot whose start is a pose"):
        pmcl.localize(rail_log(5, 1), rail_model(), method="prior", options=FilterOptions(recover=True))


# Adaptive numbers


@pytest.mark.parametrize("bins", [2, 5, 50, 1000])
def test_particles_needed_follow_the_chi_square_quantile(bins):
    exact = stats.chi2.ppf(0.99, bins - 1) / (2.0 * 0.05)
    assert particles_needed(bins, 0.05, stats.norm.ppf(0.99)) == pytest.approx(exact, rel=0.03, abs=1.0)


def test_one_bin_needs_one_particle():
    assert particles_needed(1, 0.05, 2.33) == 1


def test_the_set_of_bins_is_a_set(rng):
    bins, known = np.zeros(64, dtype=np.int64), set()
    for key in rng.integers(1, 40, 200):
        assert _is_new(bins, int(key)) == (int(key) not in known)
        known.add(int(key))
    assert set(bins[bins != 0]) == known


def test_the_number_of_particles_follows_the_belief(theta):
    log = next(global_starts(theta, 1))
    options = FilterOptions(least_particles=50, annealed=False)
    track = pmcl.localize(log, theta=theta, particles=5000, seed=1, options=options)
    numbers = track.dataset["particles"].values
    assert numbers[0] == 5000
    assert numbers.min() >= 50
    assert np.median(numbers[-20:]) < 500
    assert converged_at(track, log) is not None
    fixed = pmcl.localize(log, theta=theta, particles=5000, seed=1, options=FilterOptions(annealed=False))
    np.testing.assert_allclose(track.pose_mean[-20:, :2], fixed.pose_mean[-20:, :2], atol=0.1)


def test_more_particles_at_the_start(theta):
    log = next(global_starts(theta, 1))
    options = FilterOptions(start_particles=3000, annealed=False)
    numbers = pmcl.localize(log, theta=theta, particles=200, options=options).dataset["particles"].values
    assert numbers[0] == 3000
    assert (numbers[2:] == 200).all()


def test_options_are_checked():
    for options, message in (
        ({"scheme": "fair"}, "scheme as one of"),
        ({"threshold": 1.5}, "threshold as a number of at least 0 and at most 1"),
        ({"draws": 0}, "draws of at least 1"),
        ({"least_particles": 1}, "least_particles of at least 2"),
    ):
        with pytest.raises(FilterError, match=message):
            FilterOptions(**options)
