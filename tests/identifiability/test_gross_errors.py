"""Models with gross errors, whose posterior is predicted by one short chain."""

from __future__ import annotations

import numpy as np

from pmcl.filtering.linearised_evidence import LinearisedEvidence
from pmcl.identifiability import identify
from pmcl.models.robot_model import default_model
from pmcl.simulations import simulate_landmark_field


def test_mixtures_are_known_by_the_weights_of_their_readings():
    log = simulate_landmark_field(20, seed=3)
    for outliers in (False, True):
        bound = default_model(log, outliers=outliers).bind(log)
        evidence = LinearisedEvidence(bound, bound.prior_mean(), [np.array(log.true_poses)])
        assert evidence.is_gaussian != outliers


def test_what_a_plain_model_tells_a_model_with_outliers_tells_too():
    log = simulate_landmark_field(60, seed=3)
    plain = identify(log, drives=False)
    found = identify(log, default_model(log, outliers=True), drives=False)
    assert found.predictions[-1].name == "landmark_outlier_weight"
    for one, other in zip(plain.predictions, found.predictions, strict=False):
        assert one.name == other.name
        # 300 draws of a chain, some hundred of them effective, and as many weighted ones.
        assert 0.6 < one.std / other.std < 1.6
        assert abs(one.mean - other.mean) < 0.6 * one.std
    # No reading is a gross error; the share is below a few of 480.
    weight = found.predictions[-1]
    assert weight.limit < 0.03
    assert weight.can_tell
