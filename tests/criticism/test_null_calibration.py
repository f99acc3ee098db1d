"""Logs in which nothing is hidden, judged by logs of their fitted models: small p-values are as rare as they say."""

from __future__ import annotations

import numpy as np
import pytest

from pmcl.criticism.fitting.quick_fit import BRIEF, quick_fit
from pmcl.criticism.judging.judged_log import judge_log
from pmcl.criticism.scoring.scores import candidate_directions
from pmcl.criticism.settings import Settings
from pmcl.models.effects.registry import candidates
from pmcl.models.robot_model import default_model
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field

# mypy: disable-error-code="no-untyped-def"

NOISE = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.05}
SIGHTS = {"reach": 12.0, "bearings": True, "n_landmarks": 16, "field_of_view": 2.0}
LOGS = 24


def _p_value(log, seed):
    model = default_model(log)
    fit = quick_fit(model.bind(log), seed, effort=BRIEF)
    directions = candidate_directions(model.effects, fit.tables, log, candidates(log))
    settings = Settings(300, seed, 0.05, 24, 8, 1, False)
    return judge_log(log, fit, directions, settings).judgement.p_value


@pytest.mark.long
def test_small_p_values_are_rare_without_a_hidden_effect():
    """Rooms with sonar, and a camera whose view has gaps, in turn."""
    p = []
    for seed in range(LOGS):
        if seed % 2:
            log = simulate_landmark_field(160, 700 + seed, **SIGHTS)
        else:
            log = simulate_amigobot(160.0, 700 + seed, NOISE)
        p.append(_p_value(log.without_truth(), seed))
    p = np.array(p)
    # Of 24 logs, five or more have p < 0.05 with a probability of 0.6 %, and one has p < 1e-5 with 0.02 %.
    assert np.count_nonzero(p < 0.05) <= 4
    assert p.min() > 1e-5


@pytest.mark.slow
def test_a_hidden_effect_has_a_small_p_value():
    log = simulate_amigobot(160.0, 700, NOISE, effects=["range-bias=large"], hide_effects=True)
    assert _p_value(log.without_truth(), 0) < 1e-3
