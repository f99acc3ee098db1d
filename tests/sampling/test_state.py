"""A blob holds every field of the state and of the report of a sweep, and gives the state back."""

from __future__ import annotations

import numpy as np
from oracles.random_walk_model import rail_log, rail_model

from pmcl.sampling.state import ChainState, SweepInfo, blob_dtype, from_blob, into_blob, mean_info

T = 7


def _state(rng):
    return ChainState(
        theta=rng.normal(size=2), log_joint=-3.5, path=rng.normal(size=(T, 1)), log_step=rng.normal(size=2),
        log_scale=0.25, rows=5, failed_updates=2,
    )  # fmt: skip


def _info(rng):
    return SweepInfo(rng.random(2), *rng.random(6))


def test_a_blob_gives_the_state_back(rng):
    bound = rail_model().bind(rail_log(T, seed=1))
    dtype = blob_dtype(bound, 1)
    assert set(dtype.names) == {*ChainState._fields, *SweepInfo._fields} - {"theta"}
    assert dtype.names[0] == "path"
    state, info = _state(rng), _info(rng)
    blob = np.array([into_blob(state, info, dtype)], dtype=dtype)[0]
    back = from_blob(state.theta, blob)
    for name, value in state._asdict().items():
        np.testing.assert_array_equal(getattr(back, name), value, err_msg=name)
        assert type(getattr(back, name)) is type(value), name
    for name, value in info._asdict().items():
        np.testing.assert_array_equal(blob[name], value, err_msg=name)
    back.path[:] = 0.0
    assert (blob["path"] == state.path).all(), "the state has arrays of its own"


def test_the_info_of_several_sweeps_is_their_mean(rng):
    infos = [_info(rng) for _ in range(3)]
    mean = mean_info(infos)
    for name in SweepInfo._fields:
        np.testing.assert_allclose(getattr(mean, name), sum(getattr(info, name) for info in infos) / 3.0)
    assert mean_info(infos[:1]) is infos[0]


def test_what_a_sweep_did_not_do_does_not_count(rng):
    infos = [_info(rng) for _ in range(3)]
    infos[0] = infos[0]._replace(transport_jump_rate=np.nan, acceptance_rate=np.array([np.nan, 0.5]))
    mean = mean_info(infos)
    assert mean.transport_jump_rate == np.mean([info.transport_jump_rate for info in infos[1:]])
    np.testing.assert_allclose(mean.acceptance_rate[0], np.mean([info.acceptance_rate[0] for info in infos[1:]]))
    np.testing.assert_allclose(mean.acceptance_rate[1], np.mean([info.acceptance_rate[1] for info in infos]))
    assert np.isnan(mean_info([infos[0], infos[0]]).transport_jump_rate)
