"""Calibration by simulated logs: false alarms come at the rate that was asked for, and effects raise alarms."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from pmcl.criticism.judging.alarms import judge
from pmcl.criticism.scoring.features import Feature
from pmcl.criticism.scoring.scores import directions_of
from pmcl.models.effects.effect import Effect
from pmcl.models.parameters import Parameter

# mypy: disable-error-code="no-untyped-def, arg-type"

LOGS, CANDIDATES, FEATURES, OWN = 30, 20, 40, 4


def _directions():
    def nothing(tables, values, log, where):
        return tables

    return directions_of(
        [
            Effect(f"e{k}", ".", (Parameter(f"p{k}", "1", stats.norm()),), (0.0,), nothing, typical={"clear": (1.0,)})
            for k in range(CANDIDATES)
        ]
    )


def _scored_log(rng, shift=0.0, own=0.0):
    """Scores that share a common part, and that the model's own parameters partly explain."""
    base = rng.standard_normal((OWN, 1)) * 3.0 + own
    mixing = np.sin(np.arange(CANDIDATES * OWN).reshape(CANDIDATES, OWN))
    scores = rng.standard_normal((CANDIDATES, 1)) + rng.standard_normal() + mixing @ base
    scores[3] += shift
    families = ("uniformity", "serial", "covariate", "fluctuation")
    features = tuple(Feature(families[k % 4], "range", covariate=str(k)) for k in range(FEATURES))
    numbers = rng.standard_normal(FEATURES) * 2.0 + 5.0
    return SimpleNamespace(parameter_scores=base, scores=scores, features=features, feature_values=numbers)


def test_false_alarms_come_at_the_rate_asked_for(rng):
    directions, runs, alarms, own = _directions(), 400, 0, []
    for _ in range(runs):
        scored, simulated = _scored_log(rng), [_scored_log(rng) for _ in range(LOGS)]
        judged = judge(scored, simulated, directions, level=0.05)
        alarms += bool(judged.raised)
        own.append(judged.z[0])
    # Four binomial standard deviations around 5 %; 9 % would be seen.
    assert abs(alarms / runs - 0.05) < 4.0 * np.sqrt(0.05 * 0.95 / runs)
    assert stats.kstest(own, "norm").pvalue > 1e-3


def test_an_effect_is_seen_and_is_the_worst(rng):
    seen = [
        judge(_scored_log(rng, 9.0), [_scored_log(rng) for _ in range(LOGS)], _directions(), level=0.05)
        for _ in range(20)
    ]
    assert sum(one.raised[0].worst.kind == "e3" if one.raised else False for one in seen) >= 18


def test_what_the_models_own_parameters_explain_is_projected_out(rng):
    """A bad fit of the model's own parameters moves every score, and is no missing effect."""
    simulated = [_scored_log(rng) for _ in range(LOGS)]
    plain = [judge(_scored_log(rng, own=6.0), simulated, _directions(), level=0.05) for _ in range(40)]
    assert sum(bool(one.raised) for one in plain) <= 8


@pytest.mark.parametrize("level", [0.01, 0.2])
def test_level_is_respected(level, rng):
    simulated = [_scored_log(rng) for _ in range(LOGS)]
    judged = judge(_scored_log(rng), simulated, _directions(), level=level)
    for alarm in judged.raised:
        assert alarm.p_value <= level


def _of_a_patch(rng, rows):
    """One candidate that is scored only in rows where the robot is at some place, and one that always is."""
    scores = rng.standard_normal((2, 100))
    scores[0, rows:] = 0.0
    return SimpleNamespace(parameter_scores=np.empty((0, 100)), scores=scores, features=(), feature_values=np.empty(0))


def test_a_place_that_simulated_robots_hardly_visit_raises_no_alarm_by_itself(rng):
    """Of 30 simulated robots one is there for a moment; the log's own robot is there for a while."""
    patch, other = _directions()[:2]
    directions = (replace(patch, effect=replace(patch.effect, where={"place": (1.0, 2.0)})), other)
    z, elsewhere = [], []
    for _ in range(200):
        simulated = [_of_a_patch(rng, int(k == 0)) for k in range(LOGS)]
        scored = _of_a_patch(rng, 8)
        judged = judge(scored, simulated, directions, level=0.05)
        # What simulated logs would say of it: a spread of a fifth of one row's.
        z.append(judged.z)
        elsewhere.append(judge(scored, simulated, (patch, other), level=0.05).z)
    z, elsewhere = np.array(z), np.array(elsewhere)
    assert 0.8 < z[:, 0].std() < 1.2
    assert np.abs(z[:, 0]).max() < 4.0
    assert np.abs(elsewhere[:, 0]).max() > 6.0
    np.testing.assert_array_equal(z[:, 1], elsewhere[:, 1])


def test_a_place_that_half_of_the_simulated_robots_visit_is_judged_by_them(rng):
    patch = _directions()[0]
    directions = (replace(patch, effect=replace(patch.effect, where={"place": (1.0, 2.0)})),)
    simulated = [_one(_of_a_patch(rng, 8 if k % 3 else 0)) for k in range(LOGS)]
    scored = _one(_of_a_patch(rng, 30))
    np.testing.assert_array_equal(
        judge(scored, simulated, directions, level=0.05).z, judge(scored, simulated, (patch,), level=0.05).z
    )


def _one(scored):
    scored.scores = scored.scores[:1]
    return scored
