"""A second log as the held-out part: models are fitted to the first, and gains are shown on the second."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmcl.criticism.fitting.held_out import bound_to_other, predicted_log
from pmcl.criticism.fitting.quick_fit import BRIEF, quick_fit
from pmcl.criticism.workflow import criticize
from pmcl.errors import CriticismError, LogError
from pmcl.filtering.estimated_path import with_estimated_path
from pmcl.filtering.particle_filter import make_rng, run_filter
from pmcl.models.effects.formula import formula_effect
from pmcl.models.robot_model import default_model
from pmcl.simulations.landmark_field import simulate_landmark_field

# mypy: disable-error-code="no-untyped-def"


def field(seed, text="bearing-bias=large", rows=120):
    given = (text,) if text else ()
    return simulate_landmark_field(rows, seed, bearings=True, effects=given, hide_effects=True).without_truth()


@pytest.fixture(scope="module")
def base():
    log = field(1)
    bound = default_model(log).bind(log)
    return log, quick_fit(bound, 1, effort=BRIEF)


@pytest.mark.slow
def test_a_second_log_is_predicted_by_what_was_fitted_to_the_first(base):
    """As the filter of the same parameters predicts it, row by row."""
    _, fit = base
    other = field(2, rows=90)
    told = predicted_log(fit, other, particles=2000, seed=5)
    tables = fit.bound.model.bind(other).tables(fit.theta)[0]
    its_own = run_filter(tables, 90, 4000, make_rng(6)).log_increments
    assert told.rows.shape == (90,)
    assert abs(told.rows.sum() - its_own.sum()) < 10.0
    assert np.corrcoef(told.rows, its_own)[0, 1] > 0.95
    readings = 2 * np.count_nonzero(~np.isnan(other.landmark_range))
    assert told.gap.log_score_per_reading * readings == pytest.approx(told.rows.sum())


def test_what_cannot_confirm_is_refused():
    log = field(1)
    with pytest.raises(CriticismError, match="expected another log to be held out"):
        criticize(log, held_out=field(1))
    with pytest.raises(CriticismError, match="at least 30 rows of a log that is held out, but got 20"):
        criticize(log, held_out=field(2, rows=20))
    sightless = simulate_landmark_field(120, 2).without_truth()
    with pytest.raises(CriticismError, match=r"expected the readings of .*landmark_bearing.*same robot"):
        criticize(log, held_out=sightless)
    more = simulate_landmark_field(120, 2, bearings=True, n_landmarks=9).without_truth()
    with pytest.raises(CriticismError, match=r"expected the channels and walls of .* 8 landmarks, but got 9 landmarks"):
        criticize(log, held_out=more)
    with pytest.raises(LogError, match="held_out"):
        criticize(log, held_out="other.nc")


@pytest.mark.long
@pytest.mark.parametrize(("text", "confirmed"), [("bearing-bias=large", True), ("", False)])
def test_the_critic_tells_whether_the_second_log_confirms(text, confirmed):
    log, other = field(1, rows=160), field(2, text, rows=140)
    result = criticize(log, held_out=other, simulations=20, joint=False, rounds=1, seed=1, workers=1)
    assert result.split == 160
    assert result.held_out.n_steps == 140
    assert {"bearing-bias", "sensor-yaw", "odometry-side-drift"} >= {effect.name for effect in result.effects} != set()
    assert any("gains and gaps are shown on" in note for note in result.notes)
    assert {"log", "held_out"} <= set(result.settings)
    assert not result.effects[0].chosen_on_all_rows
    gain = result.steps[-1].gap.log_score_per_reading - result.steps[0].gap.log_score_per_reading
    assert (gain > 0.0) is confirmed is (result.effects[0].log_score_gain > 0.0)
    assert any("gains nothing on" in note for note in result.notes) is not confirmed


@pytest.mark.slow
def test_a_formula_of_the_first_log_is_evaluated_along_the_path_of_the_second(base):
    log, fit = base
    other = with_estimated_path(field(2, rows=90), fit.bound.model, always=True, seed=1)
    assert other.estimated("path").shape == (90, 3)
    # The critic's formulas hold their values along the path of the first log.
    formula = formula_effect("turn", ["cos(heading)"], features=[np.ones(log.n_steps)])
    tables = bound_to_other(replace(fit.bound.model, effects=(formula,)), other).tables(np.append(fit.theta, 0.1))[0]
    turned = tables.motion.mean[1:, 2] - other.odometry[1:, 2]
    np.testing.assert_allclose(turned, 0.1 * np.cos(other.estimated("path")[1:, 2]), atol=1e-9)
