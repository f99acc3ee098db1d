"""How many logs are simulated before an alarm counts: more where it is in doubt, and the last judgement stands."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from pmcl.criticism import passes

# mypy: disable-error-code="no-untyped-def"

SETTINGS = passes.Settings(
    particles=100, seed=0, level=0.05, simulations=30, paths=5, workers=1, progress=False
)


@pytest.mark.parametrize(
    ("first", "second", "logs"), [(0.4, None, [30]), (1e-3, 0.2, [30, 90]), (0.03, 1e-4, [30, 90]), (1e-9, None, [30])]
)
def test_doubtful_alarms_are_judged_again_by_more_simulated_logs(monkeypatch, first, second, logs):
    asked, seeds = [], []

    def judged(found, null, wanted, split, settings):
        p_value = first if not asked else second
        asked.append(len(null))
        judgement = SimpleNamespace(p_value=p_value, raised=("alarm",) if p_value < 0.05 else ())
        return SimpleNamespace(judgement=judgement, evidence=found, null=null)

    def gather(bound, theta, wanted, *, particles, paths, seed):
        seeds.append(seed.entropy)
        return "evidence"

    monkeypatch.setattr(passes, "_judged", judged)
    monkeypatch.setattr(passes, "gather", gather)
    monkeypatch.setattr(passes, "replicated_log", lambda log, tables, path, rng: log)
    bound = SimpleNamespace(model=SimpleNamespace(bind=lambda log: bound))
    fit = SimpleNamespace(bound=bound, theta=np.zeros(4), tables=None, path=None)
    last = passes.criticised("log", fit, (), 10, SETTINGS)
    if passes.in_doubt(last.judgement):
        last = passes.looked_again(last, "log", fit, (), 10, SETTINGS)
    assert asked == logs
    assert last.judgement.p_value == (first if second is None else second)
    assert len(set(seeds)) == len(seeds) == 1 + logs[-1]
