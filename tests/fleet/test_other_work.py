"""The critic and many runs of a filter work in the same places, with the same results."""

from __future__ import annotations

import numpy as np
import pytest
from fleets import SHORT, Parcels, assert_same, small_fleet

from pmcl.calibration.workflow import calibrate
from pmcl.criticism.workflow import criticize
from pmcl.errors import CriticismError, FilterError
from pmcl.fleet.critic_run import criticize_elsewhere, criticize_fleet, findings_file
from pmcl.fleet.places import HerePlace, as_place
from pmcl.localization.many import localize_many
from pmcl.simulations.amigobot import simulate_amigobot


def test_runs_of_a_filter_in_a_pool_are_those_of_threads():
    (log,) = small_fleet(1).values()
    settings = {"method": "prior", "repetitions": 7, "particles": 40, "seed": 5}
    here, there = localize_many(log, **settings), localize_many(log, pool=Parcels(), threads=3, **settings)
    assert here.seeds == there.seeds
    for name in ("pose_mean", "log_score", "effective_size", "lost_at", "position_error", "heading_error", "nees"):
        np.testing.assert_array_equal(getattr(here, name), getattr(there, name))
    assert np.isfinite(there.pose_mean).all()
    with pytest.raises(FilterError, match="expected pool with a method map"):
        localize_many(log, pool=3, **settings)


def test_chains_in_a_pool_are_those_of_threads():
    (log,) = small_fleet(1).values()
    assert_same(calibrate(log, pool=Parcels(), check=False, **SHORT), calibrate(log, check=False, **SHORT))


@pytest.mark.slow
def test_the_critic_elsewhere_says_what_it_says_here(tmp_path):
    log = simulate_amigobot(80.0, 2)
    settings = {"simulations": 15, "paths": 4, "particles": 100, "rounds": 1, "joint": False, "seed": 1}
    here = criticize(log, effects=(), workers=1, **settings)
    there = criticize_elsewhere(as_place(Parcels()), log, effects=(), workers=1, **settings)
    assert there.to_json() == here.to_json()


def test_what_the_critic_cannot_do_is_told_and_stops_no_other(tmp_path):
    log = simulate_amigobot(20.0, 2)
    with pytest.raises(CriticismError, match="expected at least 60 rows"):
        criticize_elsewhere(HerePlace(), log)
    told = []
    findings, errors = criticize_fleet(
        {"short": log}, tmp_path, None, HerePlace(), lambda *words: told.append(words), run=True, seed=1
    )
    assert not findings
    assert "expected at least 60 rows" in errors["short"]
    assert told[-1] == ("short", "the critic failed")
    assert not findings_file(tmp_path, "short").exists()
