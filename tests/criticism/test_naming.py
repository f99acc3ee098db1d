"""Which candidates are refitted: near twins of the likeliest effect, whatever their own score."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from pmcl.criticism.naming import untried_twins
from pmcl.criticism.scores import directions
from pmcl.models.effects.catalogue import candidates
from pmcl.models.effects.selection import effect_named
from pmcl.robots.landmark_field import simulate_landmark_field

# mypy: disable-error-code="no-untyped-def"


def test_twins_are_refitted_without_a_score_of_their_own():
    log = simulate_landmark_field(60, 1, bearings=True)
    wanted = directions(candidates(log))
    best, nothing = effect_named("odometry-side-drift", log), np.zeros(len(wanted))
    twins = [effect.name for effect, _ in untried_twins(best, wanted, nothing, [])]
    assert "sensor-yaw" in twins
    assert best.name not in twins
    assert len(set(twins)) == len(twins)
    tried = [SimpleNamespace(effect=effect_named("sensor-yaw", log))]
    assert "sensor-yaw" not in [effect.name for effect, _ in untried_twins(best, wanted, nothing, tried)]


def test_of_a_twin_with_many_places_the_likeliest_is_refitted():
    log = simulate_landmark_field(60, 1, bearings=True)
    wanted = directions(candidates(log))
    best = effect_named("landmark-noise-correlated", log)
    z = np.array([3.0 if one.effect.where.get("landmarks") == (5,) else 0.1 for one in wanted])
    places = [(effect.where, value) for effect, value in untried_twins(best, wanted, z, []) if effect.where]
    assert ({"landmarks": (5,)}, 3.0) in [(dict(where), value) for where, value in places]
    assert all(value == 3.0 for where, value in places if "landmarks" in where)
