"""How long the critic takes: one scored pass, the name of a hidden effect, and the final verdict."""

from __future__ import annotations

import logging

import numpy as np
import pytest

from pmcl.criticism.fitting.quick_fit import quick_fit
from pmcl.criticism.scoring.scored_log import score_log
from pmcl.criticism.scoring.scores import applicable, directions_of
from pmcl.criticism.workflow import criticize
from pmcl.models.effects.registry import candidates
from pmcl.models.robot_model import default_model
from pmcl.simulations.amigobot import simulate_amigobot

THETA = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.05}
CANDIDATES = 50


@pytest.fixture(scope="module")
def log():
    return simulate_amigobot(600.0, 1, THETA, effects=("beam-bias@2=clear",), hide_effects=True)


def test_a_scored_pass_of_600_rows_8_beams_500_particles_50_candidates(benchmark, log):
    bound = default_model(log).bind(log)
    theta = np.array([THETA[name] for name in bound.names])
    effects = [effect for effect in candidates(log) if applicable(effect, bound.tables(theta)[0], log)]
    directions = directions_of(effects)[:CANDIDATES]
    settings = {"particles": 500, "paths": 15, "seed": 1}
    found = benchmark.pedantic(score_log, (bound, theta, directions), settings, rounds=5, warmup_rounds=1)
    assert found.scores.shape == (CANDIDATES, 600)


def test_a_quick_fit_of_600_rows(benchmark, log):
    bound = default_model(log).bind(log)
    found = benchmark.pedantic(quick_fit, (bound, 1), rounds=2, warmup_rounds=1)
    assert np.isfinite(found.theta).all()


@pytest.mark.parametrize("joint", [False, True], ids=["one core, quick", "all cores, joint"])
def test_from_a_log_to_the_final_verdict(benchmark, log, joint, caplog):
    if not joint:
        criticize(log, joint=False)  # compile
    settings = {"joint": joint, "workers": None if joint else 1, "progress": True}
    caplog.clear()
    with caplog.at_level(logging.INFO, "pmcl.criticism"):
        found = benchmark.pedantic(criticize, (log,), settings, rounds=1)
    (begin, *_), (named, *_) = (
        [record.created for record in caplog.records if record.message.startswith(start)]
        for start in ("fitting the base model", "added")
    )
    benchmark.extra_info["seconds_to_the_name"] = named - begin
    print(f"\nname after {named - begin:.1f} s, verdict after {benchmark.stats['min']:.1f} s")
    assert found.effects[0].name == "beam-bias"
