"""The quick fit: right numbers from one short chain, on a whole log and on its first rows."""

from __future__ import annotations

import numpy as np
import pytest

from pmcl.criticism.fitting import quick_fit as quick_fit_module
from pmcl.criticism.fitting.quick_fit import BRIEF, THOROUGH, quick_fit
from pmcl.errors import ModelError
from pmcl.models.effects.selection import effect_named
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field

# mypy: disable-error-code="no-untyped-def"

NOISE = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.05}


@pytest.fixture(scope="module", params=["walls", pytest.param("landmarks", marks=pytest.mark.slow)])
def log(request):
    if request.param == "walls":
        return simulate_amigobot(120.0, 3, NOISE)
    return simulate_landmark_field(120, 3, bearings=True, reach=12.0)


@pytest.mark.slow
def test_parameters_and_path_are_recovered(log):
    bound = default_model(log).bind(log)
    found = quick_fit(bound, 1)
    true = np.array([log.true_theta[name] for name in bound.names])
    assert np.all(np.abs(found.theta - true) < 4.5 * found.std)
    assert np.all(found.std < 0.5 * true)
    error = np.abs(found.path[:, :2] - log.true_poses[:, :2])
    assert np.mean(error) < 3.0 * np.mean(found.path_std[:, :2])


def test_the_same_seed_gives_the_same_draws(log):
    bound = default_model(log).bind(log)
    first, second = (quick_fit(bound, 1, effort=THOROUGH._replace(draws=5)) for _ in range(2))
    np.testing.assert_array_equal(first.draws, second.draws)


def test_first_rows_of_a_log_are_the_log_cut_there(log):
    model = default_model(log)
    whole, cut = model.bind(log), model.bind(log.select(0, 70))
    theta = np.array([log.true_theta[name] for name in whole.names])
    path = np.array(log.true_poses)
    path[:, 2] = np.unwrap(path[:, 2])
    ours = quick_fit(whole.restricted(70), 5, theta=theta, path=path[:70], effort=THOROUGH._replace(draws=20))
    theirs = quick_fit(cut, 5, theta=theta, path=path[:70], effort=THOROUGH._replace(draws=20))
    np.testing.assert_allclose(ours.draws, theirs.draws, rtol=1e-9)
    assert whole.lengths == (120,)


def test_shares_of_a_log_keep_their_meaning_in_its_first_rows():
    log = simulate_amigobot(100.0, 3, NOISE)
    drift = effect_named("range-bias-drifts")
    bound = RobotModel(sensors=default_model(log).sensors, effects=(drift,)).bind(log)
    theta = np.append([NOISE[name] for name in bound.names[:4]], 0.2)
    bias = bound.restricted(60).tables(theta)[0].sensors[0].extras.bias_at
    np.testing.assert_array_equal(bias[:60], bound.tables(theta)[0].sensors[0].extras.bias_at[:60])
    assert 0.1 < bias[59].max() < 0.13


@pytest.mark.slow
def test_a_component_that_the_path_lacks_starts_at_zero():
    log = simulate_amigobot(60.0, 3, NOISE)
    wandering = RobotModel(sensors=default_model(log).sensors, effects=(effect_named("turn-noise-correlated"),))
    bound = wandering.bind(log)
    theta = np.append([NOISE[name] for name in bound.names[:4]], [0.02, 20.0])
    path = np.array(log.true_poses)
    path[:, 2] = np.unwrap(path[:, 2])
    found = quick_fit(bound, 1, theta=theta, path=path, effort=THOROUGH._replace(draws=20))
    assert found.path.shape == (60, 4)
    assert np.ptp(found.path[:, 3]) > 0.0


@pytest.mark.slow
def test_a_fit_that_goes_on_from_draws_finds_the_same_in_fewer_sweeps(log, monkeypatch):
    swept = []
    step = quick_fit_module.step
    monkeypatch.setattr(quick_fit_module, "step", lambda *given: swept.append(1) or step(*given))
    bound = default_model(log).bind(log)
    before = quick_fit(bound, 1, effort=BRIEF)
    swept.clear()
    long = THOROUGH._replace(draws=400)
    afresh = quick_fit(bound, 2, theta=before.theta, path=before.path, effort=long)
    whole, _ = len(swept), swept.clear()
    going_on = quick_fit(bound, 3, path=before.path, draws=before.draws, effort=long)
    assert whole - len(swept) == THOROUGH.settling + sum(THOROUGH.rounds[:-1])
    # Effective sample sizes of some tens: means within a standard deviation's half, widths within their third.
    np.testing.assert_array_less(np.abs(going_on.theta - afresh.theta), 0.5 * afresh.std)
    np.testing.assert_allclose(going_on.std, afresh.std, rtol=0.35)


@pytest.mark.parametrize("rows", [60, 180])
def test_a_path_that_is_not_as_long_as_the_log_is_refused(log, rows):
    """Kernels would read past the end of the shorter of the two."""
    bound = default_model(log).bind(log)
    with pytest.raises(ModelError, match=f"a path of 120 rows to start from, but got {rows}"):
        quick_fit(bound, 1, theta=bound.prior_mean(), path=np.zeros((rows, 3)))
