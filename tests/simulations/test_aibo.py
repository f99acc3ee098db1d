"""The simulated AIBO: what its camera sees, the noise on what it sees, and that calibration finds that noise."""

from __future__ import annotations

import numpy as np
import pytest

import pmcl
from pmcl.errors import ModelError
from pmcl.geometry import between, wrap
from pmcl.models.robot_model import default_model
from pmcl.posterior.diagnostics import summarize, verdict
from pmcl.simulations.aibo import AIBO_FIELD_OF_VIEW, AIBO_LANDMARKS, AIBO_SIZE_AT_ONE_METRE, simulate_aibo

NAMES = ("sigma_forward", "sigma_left", "sigma_turn", "sigma_bearing", "sigma_size")
STANDARD_ERRORS = 5.0


def ideal(log):
    """Distance and bearing of every landmark from every true pose, by complex numbers."""
    position = log.landmarks.positions @ np.array([1.0, 1.0j])
    place = log.true_poses[:, 0] + 1.0j * log.true_poses[:, 1]
    relative = (position - place[:, None]) * np.exp(-1.0j * log.true_poses[:, 2, None])
    return np.abs(relative), np.angle(relative)


def test_without_noise_the_camera_reads_angle_and_inverse_square_of_distance():
    log = simulate_aibo(200.0, seed=3, theta=dict.fromkeys(NAMES, 1e-9))
    distance, bearing = ideal(log)
    seen = np.isfinite(log.landmark_bearing)
    np.testing.assert_array_equal(seen, np.isfinite(log.landmark_size))
    np.testing.assert_allclose(wrap(log.landmark_bearing - bearing)[seen], 0.0, atol=1e-6)
    np.testing.assert_allclose((log.landmark_size * distance**2)[seen], AIBO_SIZE_AT_ONE_METRE, rtol=1e-6)
    assert log.size_at_one_metre == AIBO_SIZE_AT_ONE_METRE


def test_the_camera_sees_what_lies_ahead_of_it_and_nothing_else():
    log = simulate_aibo(400.0, seed=5, theta={"sigma_size": 0.05})
    _, bearing = ideal(log)
    np.testing.assert_array_equal(np.isfinite(log.landmark_size), np.abs(bearing) <= 0.5 * AIBO_FIELD_OF_VIEW)
    count = np.isfinite(log.landmark_size).sum(axis=1)
    assert 0.1 < np.mean(count == 0) < 0.6
    assert count.max() <= 2


def test_noise_of_angle_and_of_the_ratio_of_pixels_is_theta():
    truth = {"sigma_bearing": 0.05, "sigma_size": 0.15}
    log = simulate_aibo(4000.0, seed=7, theta=truth)
    distance, bearing = ideal(log)
    seen = np.isfinite(log.landmark_size)
    ratio = (log.landmark_size * distance**2 / AIBO_SIZE_AT_ONE_METRE - 1.0)[seen]
    turn = wrap(log.landmark_bearing - bearing)[seen]
    standard_error = 1.0 / np.sqrt(2.0 * seen.sum())
    assert abs(np.sqrt(np.mean(ratio**2)) / 0.15 - 1.0) < STANDARD_ERRORS * standard_error
    assert abs(np.sqrt(np.mean(turn**2)) / 0.05 - 1.0) < STANDARD_ERRORS * standard_error
    assert abs(np.corrcoef(ratio, turn)[0, 1]) < STANDARD_ERRORS / np.sqrt(seen.sum())
    # The same share near and far.
    far = distance[seen] > np.median(distance[seen])
    assert abs(ratio[far].std() / ratio[~far].std() - 1.0) < STANDARD_ERRORS * 2.0 * standard_error


def test_a_landmark_without_pixels_is_not_seen():
    log = simulate_aibo(1000.0, seed=1, theta={"sigma_size": 0.8})
    _, bearing = ideal(log)
    in_view = np.abs(bearing) <= 0.5 * AIBO_FIELD_OF_VIEW
    seen = np.isfinite(log.landmark_size)
    np.testing.assert_array_equal(seen, np.isfinite(log.landmark_bearing))
    assert not (seen & ~in_view).any()
    # A standard normal falls below -1 / 0.8 in 10.6 % of all cases.
    missed = 1.0 - seen.sum() / in_view.sum()
    assert abs(missed - 0.1056) < STANDARD_ERRORS * np.sqrt(0.1056 / in_view.sum())


def test_the_robot_stays_on_the_field_and_odometry_is_its_command():
    outside = []
    for seed in range(20):
        log = simulate_aibo(400.0, seed)
        x, y = log.true_poses[:, 0], log.true_poses[:, 1]
        outside.append(((x < 0.0) | (x > 2.7) | (y < 0.0) | (y > 1.8)).any())
    assert sum(outside) <= 2
    error = between(log.true_poses[:-1], log.true_poses[1:]) - log.odometry[1:]
    truth = [log.true_theta[name] for name in NAMES[:3]]
    np.testing.assert_allclose(error[:, :2].std(axis=0), truth[:2], rtol=STANDARD_ERRORS / np.sqrt(800.0))
    assert log.odometry[:, 2].min() < -0.3
    assert log.odometry[:, 2].max() > 0.3


def test_a_seed_gives_one_log():
    one, again, other = (simulate_aibo(50.0, seed=seed) for seed in (5, 5, 6))
    assert one.fingerprint() == again.fingerprint() != other.fingerprint()
    assert tuple(one.true_theta) == NAMES
    assert tuple(one.landmarks.names) == AIBO_LANDMARKS.names
    assert pmcl.simulate_aibo is simulate_aibo


@pytest.mark.parametrize("wrong", [{"duration": 1.0}, {"duration": np.nan}, {"seed": -1}])
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(ModelError, match=r"simulate_aibo: expected (duration|seed)"):
        simulate_aibo(**wrong)
    with pytest.raises(ModelError, match="did you mean 'sigma_size'"):
        simulate_aibo(theta={"sigma_sice": 0.1})


def test_the_usual_model_has_the_papers_five_parameters():
    model = default_model(simulate_aibo(20.0))
    assert tuple(parameter.name for parameter in model.parameters) == NAMES
    assert {parameter.prior.dist.name for parameter in model.parameters} == {"gamma"}


@pytest.mark.slow
def test_calibration_finds_the_noise_of_the_aibo():
    log = simulate_aibo(400.0, seed=6)
    data = pmcl.calibrate(log, draws=400, seed=1, method=pmcl.ParticleGibbs(burn_in_particles=300))
    summary = summarize(data)
    assert verdict(data).converged, verdict(data).message
    off = (summary["mean"] - summary["truth"]) / summary["sd"]
    assert float(np.abs(off).max()) < 4.0
    # Learnt from the log, not from the prior.
    prior = np.array([parameter.prior.std() for parameter in default_model(log).parameters])
    assert float((summary["sd"] / prior).max()) < 0.35
