"""``pmcl export``: files from a posterior, and one line for what does not fit."""

from __future__ import annotations

import pytest
from exports.made_lidar import lidar_posterior, yaml_content

from pmcl.posterior.files import write_posterior


@pytest.fixture
def posterior(tmp_path):
    path = tmp_path / "posterior.nc"
    write_posterior(lidar_posterior(), path)
    return path


@pytest.mark.parametrize("name", ["nav2", "beluga", "ros1", "json"])
def test_a_file_is_written(run, posterior, name, tmp_path):
    output = tmp_path / "params"
    result = run("export", posterior, "--format", name, "-o", output)
    assert result.exit_code == 0, result.output
    assert yaml_content(output.read_text())
    assert f"{name}: {output}" in result.stdout


def test_what_does_not_fit_is_refused(refused, posterior, tmp_path):
    output = tmp_path / "params.yaml"
    assert str(posterior) in refused("export", posterior, "--format", "ros2_controllers", "-o", output)
    assert "nav3" in refused("export", posterior, "--format", "nav3", "-o", output)
    assert "no such file" in refused("export", tmp_path / "none.nc", "--format", "nav2", "-o", output)
    assert "name another file" in refused("export", posterior, "--format", "nav2", "-o", posterior)
    assert not output.exists()
