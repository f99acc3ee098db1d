from __future__ import annotations

from pathlib import Path

import arviz
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from synthetic_posterior import NAMES, fake_case

from pmcl.errors import PosteriorError
from pmcl.posterior import files
from pmcl.posterior.access import parameter_names, trajectory_draws
from pmcl.posterior.compat import assemble, find_group, group_names
from pmcl.posterior.convert import to_arviz
from pmcl.posterior.files import read_posterior, write_posterior
from pmcl.posterior.settings import settings
from pmcl.whole_file import replacing


@pytest.fixture(scope="module")
def written(data, tmp_path_factory):
    path = tmp_path_factory.mktemp("posterior") / "posterior.nc"
    write_posterior(data, path)
    return path


def test_everything_comes_back_bit_for_bit(data, written):
    back = read_posterior(written)
    assert set(group_names(back)) == set(group_names(data))
    for name in group_names(data):
        xr.testing.assert_identical(find_group(back, name).drop_attrs(), find_group(data, name).drop_attrs())
        for key, values in find_group(data, name).variables.items():
            assert {k: str(v) for k, v in find_group(back, name)[key].attrs.items()} == {
                k: str(v) for k, v in values.attrs.items()
            }
    assert settings(back) == settings(data)
    assert parameter_names(back) == NAMES


def test_arviz_itself_reads_the_file(data, written):
    tree = arviz.from_netcdf(str(written))
    for name in NAMES:
        np.testing.assert_array_equal(tree.posterior[name].values, find_group(data, "posterior")[name].values)
    stored = find_group(data, "trajectories")["trajectory"]
    assert tree["trajectories"]["trajectory"].shape == stored.shape
    assert float(tree.constant_data["true_sigma_range"]) == 0.098
    table = arviz.summary(tree)
    assert list(table.index) == list(NAMES)


def test_several_logs_survive_the_file(tmp_path):
    case = fake_case(n_draws=20, n_logs=3, n_states=5)
    data = to_arviz(case.chains, case.parameters, case.logs)
    write_posterior(data, tmp_path / "p.nc")
    back = read_posterior(tmp_path / "p.nc")
    xr.testing.assert_equal(find_group(back, "trajectories"), find_group(data, "trajectories"))
    xr.testing.assert_equal(find_group(back, "observed_data"), find_group(data, "observed_data"))


def test_trajectories_are_found_where_older_files_hold_them(data):
    groups = {name: find_group(data, name) for name in group_names(data)}
    moved = xr.merge([groups["posterior"], groups.pop("trajectories")], combine_attrs="override")
    older = assemble({**groups, "posterior": moved}, {})
    assert parameter_names(older) == NAMES
    xr.testing.assert_equal(trajectory_draws(older), trajectory_draws(data))


def test_xarray_alone_opens_the_file(data, written):
    with xr.open_dataset(written, group="posterior") as posterior:
        assert posterior["sigma_turn"].attrs["units"] == "rad"
        assert "sigma_turn" in posterior["sigma_turn"].attrs["long_name"]
        np.testing.assert_array_equal(posterior["sigma_turn"], find_group(data, "posterior")["sigma_turn"])
    with xr.open_datatree(written) as tree:
        assert set(tree.children) == set(group_names(data))


def test_plots_of_arviz_need_no_arguments(data):
    drawn = arviz.plot_trace(data)
    assert drawn is not None
    plt.close("all")


def test_a_read_posterior_can_be_written_over_itself(written, tmp_path):
    path = tmp_path / "p.nc"
    path.write_bytes(written.read_bytes())
    write_posterior(read_posterior(path), path)
    assert parameter_names(read_posterior(path)) == NAMES
    assert [one.name for one in tmp_path.iterdir()] == ["p.nc"]


def test_a_failure_leaves_the_old_file_and_no_rest(data, tmp_path, monkeypatch):
    path = tmp_path / "p.nc"
    path.write_text("old")

    def half(_, target):
        Path(target).write_text("half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files, "save_netcdf", half)
    with pytest.raises(PosteriorError, match="No space left") as caught:
        write_posterior(data, path)
    assert str(path) in str(caught.value)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_missing_folder_is_named(data, tmp_path):
    with pytest.raises(PosteriorError, match="folder exists") as caught:
        write_posterior(data, tmp_path / "nowhere" / "p.nc")
    assert "\n" not in str(caught.value)


def test_other_errors_pass_and_leave_no_rest(tmp_path):
    def fail():
        with replacing(tmp_path / "p.nc") as temporary:
            temporary.write_text("half")
            raise KeyError("x")

    with pytest.raises(KeyError):
        fail()
    assert list(tmp_path.iterdir()) == []


def _truncated(path, written):
    path.write_bytes(written.read_bytes()[: written.stat().st_size // 2])


def _damaged(path, written):
    content = bytearray(written.read_bytes())
    content[2000:6000] = b"\xff" * 4000
    path.write_bytes(content)


def _observed_only(path, written):
    write = find_group(read_posterior(written), "observed_data")
    files.save_netcdf(assemble({"observed_data": write}, {}), path)


def _without_draws(path, written):
    posterior = find_group(read_posterior(written), "posterior").isel(draw=slice(0, 0))
    files.save_netcdf(assemble({"posterior": posterior}, {}), path)


BAD = {
    "missing": (lambda path, written: None, "no such file"),
    "folder": (lambda path, written: path.mkdir(), "a folder"),
    "empty": (lambda path, written: path.touch(), "an empty file"),
    "truncated": (_truncated, "damaged"),
    "damaged": (_damaged, "damaged"),
    "text": (lambda path, written: path.write_text("hello\nworld\n"), "damaged or of another format"),
    "not a posterior": (_observed_only, "group 'posterior'"),
    "a plain NetCDF file": (
        lambda path, written: xr.Dataset({"x": ("n", [1.0])}).to_netcdf(path, engine="h5netcdf"),
        "group 'posterior'",
    ),
    "no draws": (_without_draws, "0 draws"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_refused_in_one_line_that_names_it(name, written, tmp_path):
    spoil, place = BAD[name]
    path = tmp_path / "bad.nc"
    spoil(path, written)
    with pytest.raises(PosteriorError) as caught:
        read_posterior(path)
    message = str(caught.value)
    assert place in message
    assert str(path) in message
    assert "\n" not in message


def test_what_is_no_posterior_is_not_written(tmp_path):
    with pytest.raises(PosteriorError, match="InferenceData or DataTree"):
        write_posterior({"posterior": 1}, tmp_path / "p.nc")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e308])
def test_draws_that_are_no_numbers_are_refused(data, written, wrong, tmp_path):
    name = parameter_names(data)[0]
    changed = find_group(data, "posterior").copy(deep=True)
    changed[name].values[0, 3] = wrong
    write_posterior(assemble({"posterior": changed}, {}), tmp_path / "wrong.nc")
    with pytest.raises(PosteriorError, match=rf"wrong.nc: expected draws of {name} within .* in draw 3 of chain 0"):
        read_posterior(tmp_path / "wrong.nc")
