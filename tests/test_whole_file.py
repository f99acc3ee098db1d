"""Files are whole or as they were, also where the disk is full: a limit on the size of files acts like a full disk."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from pmcl.errors import LogError, PosteriorError
from pmcl.whole_file import replacing, write_whole


def test_a_file_takes_its_place_when_it_is_complete(tmp_path):
    path = tmp_path / "file"
    path.write_text("before")
    with replacing(path, n_bytes=100) as temporary:
        temporary.write_text("after")
        assert path.read_text() == "before"
    assert path.read_text() == "after"
    assert os.listdir(tmp_path) == ["file"]


def test_an_error_leaves_what_was_there(tmp_path):
    path = tmp_path / "file"
    path.write_text("before")
    with pytest.raises(KeyError), replacing(path, n_bytes=100):
        raise KeyError
    with pytest.raises(LogError, match="expected a place to write"), replacing(path, error=LogError):
        raise OSError(28, "No space left on device")
    assert path.read_text() == "before"
    assert os.listdir(tmp_path) == ["file"]


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "file")
    write_whole(tmp_path / "link", b"content", error=PosteriorError)
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "file").read_bytes() == b"content"


FULL_DISK = """
import logging, resource, sys
import numpy as np
import pmcl
from pmcl.calibration import workflow
from pmcl.errors import PmclError
from pmcl.sampling import checkpoint

logging.basicConfig(stream=sys.stdout, format="%(message)s")
folder = sys.argv[1]
log = pmcl.simulate_amigobot(600.0, seed=1)
method = pmcl.ParticleGibbs(particles=4, burn_in_particles=20, data_rate=200, settling_sweeps=2, tuning_sweeps=(4, 4))
data = pmcl.calibrate(log, method=method, draws=20, chains=2, seed=1)
log.write(f"{folder}/log.nc")
pmcl.write_posterior(data, f"{folder}/posterior.nc")
checkpoint._LEAST_PAUSE = 0.0


def fill(*_):
    # No file may have more than 20 kB from here on.
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))


def fills_later():
    # The disk gets full after a posterior could be written as a trial.
    workflow.rehearse = fill
    return pmcl.calibrate(log, method=method, draws=20, chains=2, seed=1, checkpoint=f"{folder}/run.h5")


fill()
for write in (
    lambda: log.write(f"{folder}/log.nc"),
    lambda: pmcl.write_posterior(data, f"{folder}/posterior.nc"),
    lambda: pmcl.localize(log, method="prior", seed=1).write(f"{folder}/track.nc"),
    lambda: pmcl.calibrate(log, method=method, draws=20, chains=2, seed=1, checkpoint=f"{folder}/run.h5"),
    fills_later,
):
    try:
        result = write()
    except PmclError as error:
        print("refused:", error)
    else:
        same = np.array_equal(result.posterior["sigma_range"], data.posterior["sigma_range"])
        print("finished:", same)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="files have no limits there")
def test_a_full_disk_costs_no_results(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, tmp_path], capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr
    refused = [line for line in done.stdout.splitlines() if line.startswith("refused")]
    assert len(refused) == 4
    for line, name in zip(refused, ("log.nc", "posterior.nc", "track.nc", "run.h5"), strict=True):
        assert name in line
        assert "has space" in line
    assert "nothing was sampled yet" in refused[3]
    assert "run.h5: the checkpoint could not be written" in done.stdout
    assert "finished: True" in done.stdout
    assert sorted(os.listdir(tmp_path)) == ["log.nc", "posterior.nc"]
    import pmcl

    assert pmcl.read_log(tmp_path / "log.nc").n_steps == 600
    assert pmcl.read_posterior(tmp_path / "posterior.nc").posterior.sizes["draw"] == 20
