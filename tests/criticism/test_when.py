"""When an effect acts: the posterior over windows, and simulated logs in which an effect begins or ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.effect_logs import BY_NAME, sonar_log
from test_verdict import found
from windowed_logs import SIGHTS, unwrapped, windowed

from pmcl.criticism.findings.json_text import effect_entry
from pmcl.criticism.findings.parts import Estimate
from pmcl.criticism.findings.verdict import finding_of, window_of
from pmcl.criticism.fitting.quick_fit import BRIEF, quick_fit
from pmcl.criticism.fitting.when import Acting, Moment, acting, window_posterior
from pmcl.criticism.workflow import criticize
from pmcl.models.effects.effect import CARRIERS
from pmcl.models.effects.formula import formula_effect
from pmcl.models.robot_model import default_model
from pmcl.reports.criticism_report import write_criticism_report

# mypy: disable-error-code="no-untyped-def"

ROWS = 160


def gaussian(size, first, last, rng, rows=ROWS):
    """Score differences of a shift of unit noise in some rows, fitted as if it acted in all of them."""
    inside = (np.arange(rows) >= first) & (np.arange(rows) < last)
    readings = size * inside + rng.standard_normal(rows)
    shifts = readings.mean() * np.array([1.0, 1.4, 2.0, 2.8, 4.0])
    return shifts[:, None] * readings - 0.5 * shifts[:, None] ** 2


def test_probabilities_are_those_of_all_windows_one_by_one():
    rng = np.random.default_rng(5)
    differences = 0.3 + rng.standard_normal((2, 40))
    first = range(2, 39)
    windows = {
        "throughout": [(0, 40)],
        "onward": [(a, 40) for a in first],
        "until": [(0, b) for b in first],
        "between": [(a, b) for a in first for b in first if b - a >= 2],
    }
    evidence = {
        kind: np.mean([np.exp(row[a:b].sum()) for row in differences for a, b in members])
        for kind, members in windows.items()
    }
    weight = {kind: (0.5 if kind == "throughout" else 1.0 / 6.0) * value for kind, value in evidence.items()}
    posterior = window_posterior(differences)
    for kind, value in weight.items():
        assert getattr(posterior, kind) == pytest.approx(value / sum(weight.values()), rel=1e-9)
    onset = {a: np.mean([np.exp(row[a:].sum()) for row in differences]) for a in first}
    if posterior.onward > max(posterior.until, posterior.between):
        np.testing.assert_allclose(posterior.first, np.array(list(onset.values())) / sum(onset.values()), rtol=1e-9)


def test_the_distribution_of_an_onset_is_that_of_all_onsets_one_by_one():
    noise = 0.3 * np.random.default_rng(6).standard_normal((1, 60))
    differences = np.where(np.arange(60) < 35, -0.4, 0.5)[None] + noise
    posterior = window_posterior(differences)
    assert posterior.onward > 0.8
    assert np.isnan(posterior.last).all()
    weights = np.array([np.exp(differences[0, a:].sum()) for a in posterior.points])
    np.testing.assert_allclose(posterior.first, weights / weights.sum(), rtol=1e-9)
    assert posterior.points[posterior.first.argmax()] == 35


@pytest.mark.parametrize(("first", "last", "kind"), [(70, 160, "onward"), (0, 90, "until"), (50, 110, "between")])
def test_windows_of_a_shift_are_found(first, last, kind):
    rng = np.random.default_rng(7)
    named, close = 0, 0
    for _ in range(20):
        posterior = window_posterior(gaussian(1.0, first, last, rng))
        named += getattr(posterior, kind) > 0.5
        for distribution, truth in ((posterior.first, first), (posterior.last, last)):
            known = not np.isnan(distribution).any()
            middle = posterior.points[np.searchsorted(np.cumsum(distribution), 0.5)] if known else np.inf
            close += truth in (0, ROWS) or abs(middle - truth) <= 0.05 * ROWS
    assert named >= 18
    assert close >= 36


def test_a_lasting_shift_is_not_cut():
    rng = np.random.default_rng(8)
    throughout = np.array([window_posterior(gaussian(1.0, 0, ROWS, rng)).throughout for _ in range(100)])
    assert np.mean(throughout < 0.05) <= 0.02
    assert np.mean(throughout > 0.5) >= 0.9


def test_change_points_of_a_long_log_are_no_more_than_can_be_summed_over():
    differences = np.where(np.arange(20_000) < 9_000, -0.01, 0.02)[None]
    posterior = window_posterior(differences)
    assert posterior.points.size == 400
    assert abs(posterior.points[posterior.first.argmax()] - 9_000) <= 50


def fitted(text, first, last, seed=3, rows=240):
    """The right effect fitted to a log of the landmark field in which it acts in some rows."""
    log = windowed("field", text, first, last, rows, seed)
    effect = BY_NAME[text.partition("=")[0]]
    bound = replace(default_model(log), effects=(effect,)).bind(log.without_truth())
    theta = np.array([SIGHTS.get(name, 0.01) for name in bound.names])
    return quick_fit(bound, seed, theta=theta, path=unwrapped(log.true_poses), effort=BRIEF), effect


@pytest.mark.slow
@pytest.mark.parametrize(("first", "last"), [(100, 240), (0, 240)])
def test_an_effect_that_begins_has_an_onset_and_a_lasting_one_has_none(first, last):
    fit, effect = fitted("landmark-range-bias=0.2", first, last)
    acts = acting(fit, effect, seed=1)
    if first == 0:
        assert acts is None
        return
    assert acts is not None
    assert acts.end is None
    assert acts.begin.low <= 100.0 <= acts.begin.high
    assert abs(acts.begin.time - 100.0) <= 12.0
    assert acts.probability > 0.95
    # The model has it throughout, and so too small; while it acts its size is right.
    assert fit.values()["landmark_range_bias"] < 0.16
    mean, sd = acts.values["landmark_range_bias"]
    assert abs(mean - 0.2) < 5.0 * sd
    assert sd < 0.02


def test_what_is_about_time_or_a_place_has_no_window():
    lasting = {name for name, effect in BY_NAME.items() if not effect.may_begin}
    assert lasting == {
        "range-noise-changes-in-time", "range-bias-drifts", "slippery-patch", "landmark-moved", "wall-moved",
        "unmapped-obstacle",
    }  # fmt: skip
    assert {BY_NAME[name].carrier for name in lasting} <= set(CARRIERS)
    assert formula_effect("turn", ["cos(heading)"]).may_begin
    assert not formula_effect("turn", ["sin(2*pi*time/60)"]).may_begin
    assert not formula_effect("turn", ["inside(x, 1, 2)"]).may_begin


def told(begin, end):
    effect = found(BY_NAME["range-bias"], [0.03])
    acts = Acting(begin, end, 0.99, {"range_bias": (0.06, 0.003)})
    return replace(effect, acting=acts, while_acting={"range_bias": Estimate(0.06, 0.003, "m")})


def test_a_sentence_says_when_and_how_much_while_it_acts():
    since = told(Moment(312.0, 310.0, 318.0), None)
    assert finding_of(since, sonar_log()) == (
        "all beams read 0.0600 ± 0.0030 m too long since t = 312 s (310 to 318 s) (range-bias; the model has it "
        "throughout the log, with range_bias = 0.0300 ± 0.0015 m)"
    )
    assert window_of(told(None, Moment(44.52, 44.1, 45.0))) == "until t = 44.5 s (44.1 to 45.0 s)"
    assert window_of(told(Moment(100.0, 99.0, 102.0), Moment(160.0, 158.0, 161.0))) == (
        "between t = 100 s (99 to 102 s) and t = 160 s (158 to 161 s)"
    )
    assert window_of(found(BY_NAME["range-bias"], [0.03])) == ""


def test_the_file_holds_the_window():
    entry = effect_entry(told(Moment(312.0, 310.0, 318.0), None), (0.0, 599.0))
    assert entry["window"] == [312.0, 599.0]
    assert entry["window_intervals"] == [[310.0, 318.0], None]
    assert entry["window_probability"] == 0.99
    assert entry["window_parameters"] == {"range_bias": {"mean": 0.06, "sd": 0.003, "unit": "m"}}
    assert entry["parameters"]["range_bias"]["mean"] == 0.03
    assert effect_entry(found(BY_NAME["range-bias"], [0.03]), (0.0, 599.0))["window"] is None


@pytest.mark.long
def test_the_critic_says_when_what_it_found_begins(tmp_path):
    log = windowed("field", "landmark-range-bias=0.2", 90, 240, 240, 4)
    result = criticize(log, simulations=20, joint=False, rounds=1, seed=1, workers=1)
    (effect,) = result.effects
    assert effect.name == "landmark-range-bias"
    assert abs(effect.acting.begin.time - 90.0) <= 12.0
    assert effect.acting.end is None
    assert "since t = " in result.sentence
    (entry,) = result.to_dict()["effects"]
    assert entry["window"][1] == 239.0
    assert abs(entry["window_parameters"]["landmark_range_bias"]["mean"] - 0.2) < 0.06
    write_criticism_report(result, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "It acts since t = " in page
    assert "while it acts: landmark_range_bias = " in page
