"""Calibration by simulated logs: false alarms come at the rate that was asked for, and effects raise alarms."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from pmcl.criticism.judging.alarms import judge
from pmcl.criticism.judging.deviations import BlockSums, deviations, sums_of_rows
from pmcl.criticism.naming.probability import suspects
from pmcl.criticism.scoring.features import Feature
from pmcl.criticism.scoring.scores import directions_of
from pmcl.filtering.paired_scores import block_sums
from pmcl.models.effects.effect import Effect
from pmcl.models.parameters import Parameter

# mypy: disable-error-code="no-untyped-def, arg-type"

LOGS, CANDIDATES, FEATURES, OWN, ROWS = 30, 20, 40, 4, 120


def _directions():
    def nothing(tables, values, log, where):
        return tables

    return directions_of(
        [
            Effect(f"e{k}", ".", (Parameter(f"p{k}", "1", stats.norm()),), (0.0,), nothing, typical={"clear": (1.0,)})
            for k in range(CANDIDATES)
        ]
    )


def _rows(rng, *shape):
    """Return rows whose sum is a standard normal."""
    return rng.standard_normal((*shape, ROWS)) / np.sqrt(ROWS)


def _scored_log(rng, shift=0.0, own=0.0):
    """Scores that share a common part, and that the model's own parameters partly explain."""
    base = _rows(rng, OWN) * 3.0 + own / ROWS
    mixing = np.sin(np.arange(CANDIDATES * OWN).reshape(CANDIDATES, OWN))
    scores = _rows(rng, CANDIDATES) + _rows(rng, 1) + mixing @ base
    scores[3] += shift / ROWS
    families = ("uniformity", "serial", "covariate", "fluctuation")
    features = tuple(Feature(families[k % 4], "range", covariate=str(k)) for k in range(FEATURES))
    # Residual numbers come first; fluctuations have a mean.
    features = tuple(sorted(features, key=lambda feature: feature.family == "fluctuation"))
    count = sum(feature.family == "fluctuation" for feature in features)
    return SimpleNamespace(
        parameter_scores=base, scores=scores, features=features, fluctuations=rng.standard_normal(count) * 2.0 + 5.0,
        residual_blocks=block_sums(2.0 * _rows(rng, FEATURES - count)),
    )  # fmt: skip


@pytest.mark.slow
def test_false_alarms_come_at_the_rate_asked_for(rng):
    directions, runs, alarms, own = _directions(), 200, 0, []
    for _ in range(runs):
        scored, simulated = _scored_log(rng), [_scored_log(rng) for _ in range(LOGS)]
        judged = judge(scored, simulated, directions, level=0.05)
        alarms += bool(judged.raised)
        own.append(judged.z[0])
    # Four binomial standard deviations around 5 %; 9 % would be seen.
    assert abs(alarms / runs - 0.05) < 4.0 * np.sqrt(0.05 * 0.95 / runs)
    # Single deviations are conservative: the largest block of each is bounded.
    assert 0.5 < np.std(own) < 1.0
    assert stats.kstest(own, "norm", alternative="less").statistic < 0.5


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
    # The robot comes back to the place time and again.
    scores[0, ~np.isin(np.arange(100), np.arange(rows) * 37 % 100)] = 0.0
    return SimpleNamespace(
        parameter_scores=np.empty((0, 100)), scores=scores, features=(), fluctuations=np.empty(0),
        residual_blocks=np.empty((0, 6)),
    )  # fmt: skip


def test_a_place_that_simulated_robots_hardly_visit_raises_no_alarm_by_itself(rng):
    """Of 30 simulated robots one is there for a moment; the log's own robot is there for a while."""
    z, by_others = [], []
    for _ in range(60):
        logs = [_of_a_patch(rng, 8), *(_of_a_patch(rng, int(k == 0)) for k in range(LOGS))]
        sums = [sums_of_rows(log.scores, log.parameter_scores) for log in logs]
        z.append(deviations(sums, np.zeros(2, dtype=bool)).z[0])
        # What simulated logs would say of it: a spread of a fifth of one row's.
        by_others.append(deviations([one._replace(spread=None) for one in sums], np.zeros(2, dtype=bool)).z[0])
    z, by_others = np.array(z), np.array(by_others)
    assert 0.3 < z[:, 0].std() < 1.1
    assert np.abs(z[:, 0]).max() < 4.0
    assert np.abs(by_others[:, 0]).max() > 6.0


def _with_rare_rows(rng):
    """Scores of a gross error's weight with the filter exact: one row in 5000 counts 70 times as much as others."""
    rare = rng.random((1, 1000)) < 2e-4
    scores = np.where(rare, 70.0, -70.0 * 2e-4 / (1.0 - 2e-4)) + rng.standard_normal((1, 1000))
    return sums_of_rows(scores, np.empty((0, 1000)))


def test_rare_rows_that_simulated_logs_do_not_have_raise_no_alarm(rng):
    """A log has such a row with probability 0.18; a spread from other logs alone often calls it impossible."""
    bounded, by_others, whole = [], [], []
    for _ in range(80):
        logs = [_with_rare_rows(rng) for _ in range(1 + LOGS)]
        # The log with a rare row that is judged by logs most of which have none.
        logs.sort(key=lambda log: -np.abs(log.blocks).max())
        few = logs[:1] + logs[8:]
        z = deviations(few, np.zeros(1, dtype=bool)).z
        bounded.append(z[0, 0])
        by_others.append(deviations([one._replace(spread=None) for one in few], np.zeros(1, dtype=bool)).z[0, 0])
        alone = [BlockSums(one.blocks.sum(axis=1, keepdims=True), np.empty((0, 1))) for one in few]
        whole.append(deviations(alone, np.zeros(1, dtype=bool)).z[0, 0])
    assert np.max(np.abs(bounded)) < 3.0
    # Two such rows survive the bound on the largest block; the log's own spread is needed as well.
    assert np.mean(np.abs(whole) > 3.5) > 0.05
    assert np.max(np.abs(bounded)) <= np.max(np.abs(by_others))


def test_no_single_block_makes_an_alarm(rng):
    """The same sum from all rows, from two distant blocks, and from one row."""
    z = {}
    for name, rows in (("all", slice(None)), ("two blocks", [10, 90]), ("one row", [50])):
        scored = _rows(rng, 1)
        scored[0, rows] += 12.0 / scored[0, rows].size
        logs = [scored, *(_rows(rng, 1) for _ in range(LOGS))]
        sums = [BlockSums(block_sums(log), np.empty((0, 8))) for log in logs]
        z[name] = deviations(sums, np.zeros(1, dtype=bool)).z[0, 0]
    assert z["all"] > 6.0
    assert 3.0 < z["two blocks"] < z["all"]
    assert abs(z["one row"]) < 3.0


def test_a_score_from_one_row_raises_no_alarm_and_makes_its_effect_a_suspect(rng):
    """Half of its nats would be enough if they came from all rows."""
    directions, quiet, suspected, of_sound_logs = _directions(), 0, 0, 0
    for _ in range(10):
        scored, simulated = _scored_log(rng), [_scored_log(rng) for _ in range(LOGS)]
        scored.scores[5, 50] += 12.0
        judged = judge(scored, simulated, directions, level=0.05)
        quiet += not judged.raised
        assert judged.plain_z[5] > judged.z[5]
        suspected += [one.name for one in suspects(judged, directions)] == ["e5"]
        scored.scores[5, 50] -= 12.0
        of_sound_logs += bool(suspects(judge(scored, simulated, directions, level=0.05), directions))
    assert quiet >= 8
    assert suspected >= 8
    assert of_sound_logs <= 3


def test_numbers_that_are_no_sums_keep_all_they_have(rng):
    values = rng.standard_normal((1 + LOGS, 1))
    values[0] = 8.0
    sums = [BlockSums(value[:, None], np.empty((0, 1))) for value in values]
    assert deviations(sums, np.zeros(1, dtype=bool)).z[0, 0] > 5.0


def test_a_weight_that_never_wins_in_simulated_logs_is_not_unusual_where_it_wins_once():
    """Its score loses the same at every reading; the spread of such sums says nothing of a reading that wins."""
    rows = np.full((31, 1, 300), -0.045)
    rows[0, 0, 25] = 0.17
    parameters = np.random.default_rng(1).standard_normal((31, 2, 300))
    rows += 1e-4 * np.random.default_rng(2).standard_normal(rows.shape)
    sums = [sums_of_rows(*log) for log in zip(rows, parameters, strict=True)]
    weight = np.ones(1, dtype=bool)
    # The winning row is bounded by the others of the log, which win nothing here unless some of them do.
    rows[0, 0, 25:200:15] += 0.1
    sums[0] = sums_of_rows(rows[0], parameters[0])
    assert deviations(sums, weight).z[0, 0] > 4.0
    assert deviations(sums, weight, weight).z[0, 0] < 3.0
    # It is where it wins often.
    rows[0, 0, ::10] = 0.3
    sums[0] = sums_of_rows(rows[0], parameters[0])
    assert deviations(sums, weight, weight).z[0, 0] > 4.0
