"""Random walks on theta go on from a checkpoint as if nothing had happened."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.random_walk_model import rail_log, rail_model

from pmcl.calibration import ExtendedKalman, MarginalGibbs, ParticleMetropolis, RunOptions
from pmcl.sampling import marginal_gibbs, random_walk

OPTIONS = RunOptions(draws=10, chains=2, seed=1, trajectories=3)


@pytest.mark.slow
@pytest.mark.parametrize(
    "method",
    [
        ParticleMetropolis(particles=16, blocks=3, tuning_steps=(6, 6)),
        MarginalGibbs(particles=8, tuning_steps=(6, 6)),
        ExtendedKalman(tuning_steps=(6, 6), proposals_per_draw=1),
    ],
    ids=lambda method: method.name,
)
@pytest.mark.parametrize("steps", [15, 31])
def test_a_resumed_run_is_the_uninterrupted_one(method, steps, monkeypatch, tmp_path):
    """Interrupted in the second stage of burn-in, or among the draws."""
    bound = rail_model().bind(rail_log(8, seed=3))
    whole = method.run(bound, OPTIONS)
    calls = 0

    def interrupt():
        nonlocal calls
        calls += 1
        if calls > steps:
            raise KeyboardInterrupt

    kept = replace(OPTIONS, checkpoint=str(tmp_path / "run.h5"))
    with monkeypatch.context() as patched:
        for module in (random_walk, marginal_gibbs):
            patched.setattr(module, "check_interrupt", interrupt)
        with pytest.raises(KeyboardInterrupt, match="the same call with resume goes on"):
            method.run(bound, kept)
    resumed = method.run(bound, replace(kept, resume=True))
    np.testing.assert_array_equal(resumed.theta, whole.theta)
    np.testing.assert_allclose(resumed.trajectories[0], whole.trajectories[0], atol=1e-5)
    np.testing.assert_array_equal(resumed.warmup_theta, whole.warmup_theta)
