"""How many logs are simulated before an alarm counts: more where it is in doubt, and the last judgement stands."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from pmcl.criticism.judging import judged_log
from pmcl.criticism.scoring.simulated_logs import Replica
from pmcl.criticism.settings import Settings
from pmcl.errors import FilterError

# mypy: disable-error-code="no-untyped-def"

SETTINGS = Settings(
    particles=100, seed=0, level=0.05, simulations=30, paths=5, workers=1, progress=False
)


@pytest.mark.parametrize(
    "p_values",
    [
        {14: 1e-9},  # beyond doubt at the first look
        {14: 0.01, 30: 0.4},
        {14: 0.01, 30: 1e-9},
        {14: 0.9, 30: 1e-3, 60: 0.2},  # a doubtful alarm that is none with twice as many
        {14: 0.01, 30: 1e-3, 60: 1e-6},
        {14: 0.01, 30: 1e-3, 60: 0.04, 90: 0.2},
        {14: 0.01, 30: 0.03, 60: 1e-3, 90: 1e-4},  # in doubt to the end: the last judgement counts
    ],
)
def test_logs_are_simulated_until_an_alarm_is_beyond_doubt_or_none(monkeypatch, p_values):
    asked, seeds = [], []

    def judged(scored, simulated, directions, settings):
        asked.append(len(simulated))
        p_value = p_values[len(simulated)]
        judgement = SimpleNamespace(p_value=p_value, raised=("alarm",) if p_value < 0.05 else ())
        return SimpleNamespace(judgement=judgement, scored=scored, simulated=simulated)

    def score_log(bound, theta, directions, *, path, particles, paths, seed, statistics):
        seeds.append((seed.entropy, seed.spawn_key))
        return "scored"

    monkeypatch.setattr(judged_log, "_judged", judged)
    monkeypatch.setattr(judged_log, "score_log", score_log)
    monkeypatch.setattr(judged_log, "replicated_log", lambda log, tables, path, rng, by_turning: Replica(log, path))
    bound = SimpleNamespace(model=SimpleNamespace(bind=lambda log: bound, motion=None))
    fit = SimpleNamespace(bound=bound, theta=np.zeros(4), tables=None, path=None, drawn_path=None)
    last = judged_log.judge_log("log", fit, (), SETTINGS)
    if judged_log.in_doubt(last.judgement):
        last = judged_log.with_more_simulations(last, "log", fit, (), SETTINGS)
    assert asked == list(p_values)
    assert last.judgement.p_value == list(p_values.values())[-1]
    assert len(set(seeds)) == len(seeds) == 1 + asked[-1]


def test_a_judgement_stands_where_further_logs_lose_the_robot(monkeypatch):
    def with_further(before, log, fit, directions, count, settings):
        if count > 60:
            raise FilterError("the filter loses the robot of one log after another", row=3)
        return SimpleNamespace(judgement=judgement, simulated=range(count))

    judgement = SimpleNamespace(p_value=1e-3, raised=("alarm",))
    monkeypatch.setattr(judged_log, "_with_further", with_further)
    before = SimpleNamespace(judgement=judgement, simulated=range(14))
    last = judged_log.with_more_simulations(before, "log", SimpleNamespace(theta=np.zeros(4)), (), SETTINGS)
    assert last.judgement is judgement
    assert len(last.simulated) == 60
