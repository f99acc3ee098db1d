"""Simulated effects have exactly the density that a model with the effect infers with."""

from __future__ import annotations

import json

import numpy as np
import pytest
from oracles.effect_logs import (
    BY_NAME,
    NAMES,
    SONAR,
    base_tables,
    instance,
    log_for,
    path_of,
    row_densities,
    simulated,
)

import pmcl
from pmcl.errors import ModelError
from pmcl.models.effects.selection import parse_effect
from pmcl.models.robot_model import default_model

STANDARD_ERRORS = 5.0


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_true_size_of_an_effect_is_more_likely_than_none(name):
    """Summed over seeds, and by more than chance: the effect has the right sign."""
    log = log_for(BY_NAME[name])
    effect = instance(BY_NAME[name], log)
    values, gains = effect.magnitude("clear"), []
    for seed in (1, 2, 3):
        made = simulated(effect, values, seed)
        tables, path = base_tables(made), path_of(made)
        with_it, without = (
            row_densities(effect.edit(tables, v, made), path) for v in (values, np.array(effect.null))
        )
        gains.append(with_it - without)
    gain = np.concatenate(gains)
    assert gain.mean() > 2.0 * gain.std() / np.sqrt(gain.size)


# Rounded readings lie in the middle of their cells, where a density by the step of the rounding has no score.
@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in NAMES if name != "quantized-readings"])
def test_the_score_of_a_simulated_effect_has_mean_zero_at_its_true_size(name):
    """The slope of the log density of each row by the effect's strength, at the truth; elsewhere it is not zero."""
    log = log_for(BY_NAME[name])
    effect = instance(BY_NAME[name], log)
    values = effect.magnitude("large")
    slopes = {k: [] for k in effect.strengths}
    wrong = {k: [] for k in effect.strengths}
    for seed in (4, 5, 6):
        made = simulated(effect, values, seed)
        tables, path = base_tables(made), path_of(made)
        for k in effect.strengths:
            size = max(abs(values[k]), 0.3 * np.abs(effect.magnitude("large")).max())
            for found, centre in ((slopes, values[k]), (wrong, 0.5 * values[k] + 0.5 * effect.null[k])):
                terms = []
                for h in (1e-3 * size, -1e-3 * size):
                    moved = values.copy()
                    moved[k] = centre + h
                    terms.append(row_densities(effect.edit(tables, moved, made), path))
                found[k].append((terms[0] - terms[1]) / (2e-3 * size))
    off = {}
    for k in effect.strengths:
        slope = np.concatenate(slopes[k])
        assert abs(slope.mean()) < STANDARD_ERRORS * slope.std() / np.sqrt(slope.size)
        other = np.concatenate(wrong[k])
        off[k] = abs(other.mean()) / (other.std() / np.sqrt(other.size))
    assert max(off.values()) > STANDARD_ERRORS


@pytest.mark.parametrize("field", ["bias", "scale", "std"])
def test_rounded_readings_have_the_probabilities_of_their_cells(field):
    effect, slopes, wrong = BY_NAME["quantized-readings"], [], []
    for seed in (4, 5, 6):
        made = simulated(effect, [0.15], seed)
        tables, path = effect.edit(base_tables(made), [0.15], made), path_of(made)
        (beams,) = tables.sensors
        assert np.abs(beams.reading / 0.15 - np.round(beams.reading / 0.15)).max() < 1e-9
        for found, off in ((slopes, 0.0), (wrong, 0.1)):
            centre = getattr(beams, field) * (1.0 + off) + 0.1 * off
            terms = [
                row_densities(tables._replace(sensors=(beams._replace(**{field: centre + h}),)), path)
                for h in (1e-5, -1e-5)
            ]
            found.append((terms[0] - terms[1]) / 2e-5)
    slope, other = np.concatenate(slopes), np.concatenate(wrong)
    assert abs(slope.mean()) < STANDARD_ERRORS * slope.std() / np.sqrt(slope.size)
    assert abs(other.mean()) > STANDARD_ERRORS * other.std() / np.sqrt(other.size)


def test_the_digits_of_rounded_readings_tell_their_step():
    effect = BY_NAME["quantized-readings"]
    assert effect.tells(pmcl.simulate_amigobot(100.0, 3)) == {}
    for step in (0.01, 0.08, 0.3):
        told = effect.tells(pmcl.simulate_amigobot(300.0, 3, SONAR, effects=[f"quantized-readings={step}"]))
        assert told["quantized_readings"] == pytest.approx(step, rel=1e-6)


def test_without_effects_nothing_changes():
    plain = pmcl.simulate_amigobot(60.0, 3)
    assert pmcl.simulate_amigobot(60.0, 3, effects=()).fingerprint() == plain.fingerprint()
    assert "effects" not in plain.dataset.attrs


def test_effects_of_readings_leave_the_path_as_it_is():
    plain, biased = pmcl.simulate_amigobot(60.0, 3), pmcl.simulate_amigobot(60.0, 3, effects=["range-bias=0.2"])
    np.testing.assert_array_equal(biased.true_poses, plain.true_poses)
    inside = biased.ranges < biased.max_range
    np.testing.assert_allclose((biased.ranges - plain.ranges)[inside], 0.2, atol=1e-12)


def test_logs_tell_their_effects_unless_they_are_hidden():
    log = pmcl.simulate_amigobot(40.0, 3, effects=["beam-bias@2=0.06", "odometry-turn-scale=large"])
    assert log.true_theta["beam_bias"] == 0.06
    assert log.true_theta["odometry_turn_scale"] == 0.25
    told = json.loads(log.dataset.attrs["effects"])
    assert told[0] == {"name": "beam-bias", "where": {"beams": [2]}, "parameters": {"beam_bias": 0.06}}
    hidden = pmcl.simulate_amigobot(
        40.0, 3, effects=["beam-bias@2=0.06", "odometry-turn-scale=large"], hide_effects=True
    )
    assert hidden.fingerprint() == log.fingerprint()
    assert "effects" not in hidden.dataset.attrs
    assert set(hidden.true_theta) == set(default_model(log).bind(log).names)
    assert "effects" not in log.without_truth().dataset.attrs


def test_the_same_effect_may_be_at_two_places():
    log = pmcl.simulate_amigobot(40.0, 3, effects=["beam-bias@2=0.06", "beam-bias@5=-0.1"])
    assert (log.true_theta["beam_bias_2"], log.true_theta["beam_bias_5"]) == (0.06, -0.1)


def test_a_robot_cannot_follow_commands_that_it_has_not_yet_got():
    with pytest.raises(ModelError, match="choose a delay >= 0"):
        pmcl.simulate_amigobot(40.0, 3, effects=["odometry-latency=-0.3"])


def test_texts_of_effects():
    log = pmcl.simulate_amigobot(40.0)
    rng = np.random.default_rng(1)
    effect, values = parse_effect("sensor-offset=0.2", log, rng)
    np.testing.assert_array_equal(values, [0.2, 0.0])
    effect, values = parse_effect("beam-yaw@3", log, rng)
    assert effect.where == {"beams": (3,)}
    np.testing.assert_array_equal(values, effect.magnitude("clear"))
    places = {parse_effect("beam-yaw", log, rng)[0].where["beams"] for _ in range(40)}
    assert len(places) > 4
    assert parse_effect("range-bias=just-visible", log, rng)[1] == BY_NAME["range-bias"].magnitude("just visible")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("beam-bais", "did you mean 'beam-bias'"),
        ("beam-bias@8", "one of the 8 places that the log has, but got 8; count from 0"),
        ("beam-bias@x", "numbers for the place, but got 'x'"),
        ("range-bias@1", "no place for range-bias, but got '@1'"),
        ("range-bias=big", "just visible or clear or large, but got 'big'"),
        ("range-bias=inf", "but got 'inf'"),
        ("range-bias=0.1,0.2", "at most 1 values"),
        ("random-readings=1.5", "within its prior, 0 to 1, but got 1.5"),
        ("landmark-moved", "no such readings"),
    ],
)
def test_effects_that_cannot_be_simulated_are_told_in_one_line(text, message):
    with pytest.raises(ModelError, match=message) as caught:
        pmcl.simulate_amigobot(40.0, effects=[text])
    assert "\n" not in str(caught.value)
