from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from synthetic_posterior import NAMES, fake_case, true_path

from pmcl.errors import PosteriorError
from pmcl.posterior.compat import assemble
from pmcl.posterior.convert import to_arviz
from pmcl.posterior.estimates import draws, map_estimate, path_summary, posterior_mean


def test_the_mean_is_over_all_chains(case, data):
    expected = case.chains.theta.reshape(-1, 3).mean(axis=0)
    mean = posterior_mean(data)
    assert list(mean) == list(NAMES)
    np.testing.assert_allclose(list(mean.values()), expected)
    assert all(type(value) is float for value in mean.values())


def test_the_map_is_the_draw_with_the_greatest_density(case):
    density = case.chains.log_joint.copy()
    density[2, 17] = density.max() + 1.0
    density[0, 0] = np.nan
    data = to_arviz(replace(case.chains, log_joint=density), case.parameters, case.logs)
    assert list(map_estimate(data).values()) == case.chains.theta[2, 17].tolist()


def test_the_map_needs_a_density():
    other = assemble({"posterior": xr.Dataset({"mu": (("chain", "draw"), np.zeros((2, 5)))})}, {})
    with pytest.raises(PosteriorError, match="'lp'"):
        map_estimate(other)


def test_draws_are_draws_and_repeat_with_the_seed(case, data):
    some = draws(data, 50, seed=3)
    rows = {tuple(row) for row in case.chains.theta.reshape(-1, 3)}
    chosen = {tuple(one.values()) for one in some}
    assert chosen <= rows
    assert len(chosen) == 50, "without repetition"
    assert draws(data, 50, seed=3) == some
    assert draws(data, 50, seed=4) != some


def test_more_draws_than_there_are_repeat():
    case = fake_case(n_draws=5, n_chains=2, n_stored=1)
    data = to_arviz(case.chains, case.parameters, case.logs)
    assert len(draws(data, 25, seed=0)) == 25


def test_all_draws_come_from_all_chains(case, data):
    everything = draws(data, case.chains.theta[..., 0].size, seed=0)
    np.testing.assert_array_equal(
        np.sort([one["sigma_range"] for one in everything]), np.sort(case.chains.theta[..., 2].ravel())
    )


@pytest.mark.parametrize("n", [0, -1])
def test_no_draws_cannot_be_taken(data, n):
    with pytest.raises(PosteriorError, match=f"n={n}"):
        draws(data, n, seed=0)


def test_the_mean_path_does_not_break_where_headings_wrap(case, data):
    path = path_summary(data)
    raw = case.chains.trajectories[0].reshape(-1, 60, 3)
    np.testing.assert_allclose(path.mean[:, :2], raw[..., :2].mean(axis=0))
    np.testing.assert_allclose(path.sd[:, :2], raw[..., :2].std(axis=0))
    # Noise of 0.02 rad about a heading that passes pi: a plain mean would be off by up to pi there.
    assert np.abs(np.exp(1j * path.mean[:, 2]) - np.exp(1j * true_path(60)[:, 2])).max() < 0.02
    np.testing.assert_allclose(path.sd[:, 2], raw[..., 2].std(axis=0), rtol=1e-3)
    np.testing.assert_array_equal(path.times, case.logs[0].dataset["time"])


def test_each_log_has_its_path():
    case = fake_case(n_draws=20, n_logs=2)
    data = to_arviz(case.chains, case.parameters, case.logs)
    assert path_summary(data, 1).mean.shape == (70, 3)
    np.testing.assert_allclose(path_summary(data, 1).mean[:, 0], case.chains.trajectories[1][..., 0].mean(axis=(0, 1)))
    with pytest.raises(PosteriorError, match="got 2"):
        path_summary(data, 2)
