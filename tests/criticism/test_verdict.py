"""What is told of a finding: one sentence with what was measured, rounded by its uncertainty."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from oracles.effect_logs import BY_NAME, NAMES, field_log, instance, log_for, sonar_log

from pmcl.criticism.conclusion import _something_missing
from pmcl.criticism.findings.json_text import effect_entry
from pmcl.criticism.findings.parts import Alternative, Estimate, FoundEffect, Unexplained
from pmcl.criticism.findings.verdict import (
    EXPLAINED,
    NOTHING,
    UNKNOWN,
    finding_of,
    sentence_of,
    verdict_of,
    with_place,
)
from pmcl.criticism.scoring.scores import directions_of
from pmcl.errors import ModelError
from pmcl.models.effects.effect import Effect

# mypy: disable-error-code="no-untyped-def"


def found(effect: Effect, values, twins=()) -> FoundEffect:
    parameters = {
        p.name: Estimate(value, 0.05 * abs(value), p.unit) for p, value in zip(effect.parameters, values, strict=True)
    }
    return FoundEffect(
        effect.name, effect.summary, effect.where, parameters, 1e-6, 9.0, 2.0, twins, (), effect.finding
    )  # fmt: skip


@pytest.mark.parametrize(
    ("mean", "sd", "unit", "wanted", "text"),
    [
        (0.06162, 0.003056, "m", "", "0.0616 ± 0.0031 m"),
        (-0.06162, 0.003056, "m", "", "0.0616 ± 0.0031 m"),
        (-0.06162, 0.003056, "m", "+", "-0.0616 ± 0.0031 m"),
        (0.0412, 0.0021, "1", "%", "4.12 ± 0.21 %"),
        (0.5, 0.09, "1", "+", "0.500 ± 0.090"),
        (712.3, 45.0, "s", "", "712 ± 45 s"),
        (0.25, 0.0, "m", "", "0.25 m"),
        (-0.1, 0.05, "rad", "left|right", "right"),
        (0.1, 0.05, "rad", "left|right", "left"),
    ],
)
def test_estimates_are_rounded_by_their_uncertainty(mean, sd, unit, wanted, text):
    assert format(Estimate(mean, sd, unit), wanted) == text


@pytest.mark.parametrize("name", NAMES)
def test_every_effect_of_the_catalogue_says_what_was_measured(name):
    log = log_for(BY_NAME[name])
    effect = instance(BY_NAME[name], log)
    values = effect.magnitude("large")
    text = finding_of(found(effect, values), log)
    assert effect.finding, "an effect of the catalogue says what it found"
    assert not re.search(r"[{}|]", text)
    assert text.endswith(f" ({name})")
    assert "±" in text
    # A size that may have either sign is told with its direction.
    for k in effect.strengths:
        if not effect.one_sided(k):
            turned = values.copy()
            turned[k] = -values[k]
            assert finding_of(found(effect, turned), log) != text


def test_a_finding_names_its_place_and_its_twins():
    log = sonar_log()
    effect = BY_NAME["beam-bias"].at({"beams": (2,)}, log)
    assert with_place(effect) == "beam-bias (beam 2)"
    text = finding_of(found(effect, [-0.06], ("beam-yaw (beam 2)",)), log)
    assert text == (
        "beam 2 reads 0.0600 ± 0.0030 m too short (beam-bias; this log cannot tell it from beam-yaw (beam 2))"
    )


def test_a_finding_says_how_probable_it_is():
    log = sonar_log()
    effect = BY_NAME["beam-bias"].at({"beams": (2,)}, log)
    told = {p: finding_of(replace(found(effect, [-0.06]), probability=p), log) for p in (0.876, 0.9999, 0.004, np.nan)}
    assert told[0.876].endswith("(beam-bias, probability 88 %)")
    assert told[0.9999].endswith("(beam-bias, probability above 99 %)")
    assert told[0.004].endswith("(beam-bias, probability below 1 %)")
    assert told[np.nan].endswith("(beam-bias)")


def test_what_looks_alike_is_not_called_undecided_when_it_is_improbable():
    log = sonar_log()
    bias = found(BY_NAME["range-bias"], [0.05], ("range-scale", "beam-bias (beam 2)"))
    sure = replace(bias, probability=0.97, alternatives=(Alternative("beam-bias", {"beams": (2,)}, 0.03),))
    assert finding_of(sure, log).endswith(
        "(range-bias, probability 97 %; this log cannot tell it from beam-bias (beam 2); "
        "range-scale would look much alike)"
    )
    undecided = "(range-bias; this log cannot tell it from range-scale or beam-bias (beam 2))"
    assert finding_of(bias, log).endswith(undecided)


def test_the_json_file_holds_the_probabilities():
    effect = replace(
        found(BY_NAME["range-bias"], [0.05]), probability=0.7,
        alternatives=(Alternative("beam-bias", {"beams": (2,)}, 0.2), Alternative("unknown effect", {}, 0.1)),
    )  # fmt: skip
    entry = effect_entry(effect, (0.0, 599.0))
    assert entry["probability"] == 0.7
    assert entry["alternatives"] == [
        {"name": "beam-bias", "where": {"beams": [2]}, "probability": 0.2},
        {"name": "unknown effect", "where": {}, "probability": 0.1},
    ]


def test_landmarks_are_called_by_their_names_in_the_log():
    log = field_log()
    names = [f"L{k}" for k in range(len(log.dataset.landmark))]
    named = replace(log, dataset=log.dataset.assign_coords(landmark=names))
    effect = BY_NAME["landmark-moved"].at({"landmarks": (3,)}, log)
    assert finding_of(found(effect, [0.3, -0.2]), named).startswith(
        "landmark L3 stands 0.300 ± 0.015 m along x and -0.200 ± 0.010 m along y from its place on the map"
    )


def test_landmarks_without_names_are_counted():
    log = field_log()
    nameless = replace(log, dataset=log.dataset.drop_vars("landmark", errors="ignore"))
    effect = BY_NAME["landmark-moved"].at({"landmarks": (3,)}, log)
    assert finding_of(found(effect, [0.3, -0.2]), nameless).startswith("landmark 3 stands")


@pytest.mark.parametrize("finding", ["all beams read {1} too long", "{0} of {7:%}", "beam {beams} reads {0}"])
def test_a_finding_about_what_is_not_there_is_refused_at_once(finding):
    with pytest.raises(ModelError, match="expected a finding about 0, but got"):
        replace(BY_NAME["range-bias"], finding=finding)
    with pytest.raises(ModelError, match="expected a finding about 0, beams, but got beam;"):
        replace(BY_NAME["beam-bias"], finding="beam {beam} reads {0}").instances(sonar_log())


def test_an_effect_without_a_finding_is_told_by_summary_and_values():
    effect = replace(BY_NAME["range-bias"], finding="")
    assert finding_of(found(effect, [-0.04]), sonar_log()) == (
        "range-bias: All beams read too long (or too short) by the same length (range_bias = -0.0400 ± 0.0020 m)"
    )


@pytest.mark.parametrize(
    ("channel", "beams", "told_as"),
    [("range", (2,), "range of beam 2"), ("range", (), "range"), ("cross-talk", (), "the score of cross-talk")],
)
def test_what_nothing_explains_is_told_with_its_place(channel, beams, told_as):
    rest = Unexplained(channel, beams, "", "mean", (0.0, 1.0), (10, 20), 1e-9)
    assert sentence_of(UNKNOWN, (), (rest,), (), {}, {}, sonar_log()) == (
        f"Something is missing that no known effect explains: it shows in {told_as}, "
        "most in rows 10 to 20 (p = 1.0e-09)"
    )


@pytest.mark.parametrize(
    ("found", "raised", "missing", "verdict"),
    [
        (False, True, 0.6, UNKNOWN),
        (False, True, 0.4, NOTHING),  # an alarm by chance is more probable
        (False, False, 0.6, NOTHING),
        (True, True, 0.6, UNKNOWN),
        (True, True, 0.4, EXPLAINED),
        (True, False, 0.6, EXPLAINED),
    ],
)
def test_an_alarm_counts_if_something_missing_is_more_probable_than_chance(found, raised, missing, verdict):
    judgement = SimpleNamespace(raised=("an alarm",) if raised else ())
    assert verdict_of([None] if found else [], judgement, missing) == verdict


def test_what_is_missing_follows_from_alarms_only_beside_an_accepted_effect():
    """Of a model without one, every effect that was tried has a part in the probability of nothing."""
    directions = directions_of([BY_NAME["odometry-turn-scale"]])
    judged = SimpleNamespace(judgement=SimpleNamespace(p_value=1e-6))
    alone = SimpleNamespace(answers=(), judged=judged, nothing_probability=0.7)
    assert _something_missing(alone, directions) == pytest.approx(0.3)
    beside = SimpleNamespace(answers=("an answer",), judged=judged, nothing_probability=0.7)
    assert _something_missing(beside, directions) > 0.99
    judged.judgement.p_value = 0.1
    assert _something_missing(beside, directions) < 0.5
