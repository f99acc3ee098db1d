"""Real robots, from the recorded files to a converged posterior, by the commands of the README."""

from __future__ import annotations

import subprocess
import sys
import time

import numpy as np
import pytest

from pmcl.cli.application import DOES_NOT_FIT
from pmcl.geometry import wrap
from pmcl.logs.robot_log import RobotLog
from pmcl.posterior.access import trajectory_draws
from pmcl.posterior.diagnostics import summarize
from pmcl.posterior.files import read_posterior


def run(*arguments, status: int = 0) -> None:
    command = [sys.executable, "-c", "from pmcl.cli import main; main()", *map(str, arguments)]
    finished = subprocess.run(command, capture_output=True, text=True)
    assert finished.returncode == status, finished.stderr


def path_error(data, log: RobotLog) -> tuple[float, float]:
    """RMSE of the mean smoothed trajectory against the reference: position [m], heading [rad]."""
    paths = np.asarray(trajectory_draws(data)).reshape(-1, log.n_steps, 3)
    known = ~np.isnan(log.true_poses).any(axis=1)
    mean = paths[:, :, :2].mean(axis=0)
    heading = np.arctan2(np.sin(paths[:, :, 2]).mean(axis=0), np.cos(paths[:, :, 2]).mean(axis=0))
    position = np.sqrt(((mean - log.true_poses[:, :2])[known] ** 2).sum(axis=1).mean())
    return float(position), float(np.sqrt((wrap(heading - log.true_poses[:, 2])[known] ** 2).mean()))


RECORDINGS = [
    ("mrclam", "mrclam6", ["--robot", "1", "--period", "0.5"], 0.60),
    ("barfoot", "lost_in_the_woods", [], 0.30),
]


# The commands of the README calibrate recorded robots as well, with fewer draws.
@pytest.mark.long
@pytest.mark.parametrize(("source", "folder", "options", "worst_error"), RECORDINGS)
def test_a_recorded_robot_is_calibrated(shared_data, tmp_path, capsys, source, folder, options, worst_error):
    log_file, posterior_file = tmp_path / "run.nc", tmp_path / "post.nc"
    run("convert", source, shared_data / folder, *options, "-o", log_file)
    began = time.perf_counter()
    # The chains converge, and the default model does not fit: errors of the camera and of the laser last.
    run("calibrate", log_file, "-o", posterior_file, status=DOES_NOT_FIT)
    seconds = time.perf_counter() - began
    data, log = read_posterior(posterior_file), RobotLog.read(log_file)
    summary = summarize(data)
    position, heading = path_error(data, log)
    with capsys.disabled():
        print(
            f"\n{folder}: {seconds:.0f} s, R-hat <= {float(summary['r_hat'].max()):.4f}, "
            f"bulk ESS >= {float(summary['ess_bulk'].min()):.0f}; "
            f"smoothed path off by {position:.3f} m and {heading:.4f} rad (RMSE)"
        )
    assert float(summary["r_hat"].max()) <= 1.005
    assert float(summary["ess_bulk"].min()) >= 1000
    # The reference was never read by calibration. A robot that is lost is off by metres.
    assert position < worst_error
