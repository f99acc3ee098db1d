"""What makes chains exact and independent: nothing adapts while drawing, and no two walkers share a seed."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from emcee.state import State
from oracles.random_walk_model import rail_log, rail_model

from pmcl.calibration import ParticleGibbs
from pmcl.sampling import particle_gibbs
from pmcl.sampling.move import ParticleGibbsMove
from pmcl.sampling.options import RunOptions
from pmcl.sampling.tuning import lost_chains, restarted

OPTIONS = RunOptions(draws=12, chains=4, seed=5, trajectories=4)


@pytest.fixture(scope="module")
def bound():
    return rail_model().bind(rail_log(9, seed=2))


@pytest.fixture
def stages(bound):
    return ParticleGibbs().resolved(bound, OPTIONS).stages(9, OPTIONS)


def test_nothing_adapts_while_drawing(stages):
    *burn_in, drawing = stages
    assert drawing.settings.gain == 0.0
    assert drawing.settings.data_rate == 0
    assert drawing.settings.kernel == "conditional"
    assert drawing.steps == OPTIONS.draws
    assert all(stage.settings.gain > 0.0 for stage in burn_in)


def test_chains_are_restarted_only_where_they_can_still_part(stages):
    """Not after the last round of tuning: nothing but the draws would follow a copy then."""
    assert [stage.restart_lost for stage in stages] == [False, True, True, False, False]


class Asked(Exception):
    pass


def _keeping(work):
    def run(function, items):
        work.extend(items)
        raise Asked

    return run


def test_every_chain_begins_with_a_seed_of_its_own(bound, stages):
    seeds = []
    with pytest.raises(Asked):
        particle_gibbs._first_state(bound, stages[0], OPTIONS, SimpleNamespace(map=_keeping(seeds)))
    assert len(set(seeds)) == OPTIONS.chains


def _walkers(move):
    blobs = np.zeros(4, dtype=move.dtype)
    blobs["rows"] = np.arange(4)
    return State(np.arange(4.0 * 2).reshape(4, 2), log_prob=np.arange(4.0), blobs=blobs)


def test_every_walker_of_every_step_has_a_seed_of_its_own(bound):
    move, work, random = ParticleGibbsMove(bound), [], np.random.RandomState(1)
    for _ in range(3):
        with pytest.raises(Asked):
            move.propose(SimpleNamespace(map_fn=_keeping(work), random=random), _walkers(move))
    assert len({seed for *_, seed in work}) == 12
    assert [number for number, *_ in work] == 3 * [0, 1, 2, 3]
    assert [int(blob["rows"]) for _, _, blob, _ in work] == 3 * [0, 1, 2, 3]


def test_a_restarted_chain_is_a_whole_copy(bound):
    before = _walkers(ParticleGibbsMove(bound))
    after = restarted(before, {1: 3})
    np.testing.assert_array_equal(after.coords, before.coords[[0, 3, 2, 3]])
    np.testing.assert_array_equal(after.log_prob, before.log_prob[[0, 3, 2, 3]])
    np.testing.assert_array_equal(after.blobs["rows"], [0, 3, 2, 3])
    after.blobs["rows"][1] = 9
    assert after.blobs["rows"][3] == 3, "two chains share their memory"


def _stage(log_evidence, rows):
    blobs = np.zeros(log_evidence.shape, dtype=[("rows", int), ("log_evidence", float)])
    blobs["log_evidence"], blobs["rows"] = log_evidence, rows
    return SimpleNamespace(get_blobs=lambda: blobs, window=slice(2, None))


def test_lost_chains_are_replaced_by_the_best(stages):
    evidence = np.random.default_rng(1).normal(size=(20, 4)) - np.array([0.0, 300.0, 20.0, 5.0])
    evidence[:2] = 1e6  # before the window
    restarting, other = stages[1], stages[-2]
    assert lost_chains(_stage(evidence, 9), restarting, 9) == {1: 0}
    assert lost_chains(_stage(evidence, 9), other, 9) == {}
    assert lost_chains(_stage(evidence, np.array([9, 9, 8, 9])), other, 9) == {2: 0}


def test_few_noisy_estimates_do_not_make_a_chain_lost(stages):
    """The best chain's two estimates are alike by accident; those of all chains show how noisy they are."""
    evidence = np.full((20, 4), np.nan)
    evidence[[8, 15]] = [[6559.0, 6443.0, 6410.0, 6470.0], [6561.0, 6520.0, 6500.0, 6390.0]]
    assert lost_chains(_stage(evidence, 9), stages[1], 9) == {}
    evidence[:, 3] -= 3000.0
    assert lost_chains(_stage(evidence, 9), stages[1], 9) == {3: 0}
    evidence[8] = np.nan  # one estimate of each chain tells nothing
    assert lost_chains(_stage(evidence, 9), stages[1], 9) == {}
