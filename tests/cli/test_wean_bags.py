"""The Wean recording as a ROS 2 bag: the same log and the same posterior as from its own text."""

from __future__ import annotations

import math

import numpy as np
import pytest
from click.testing import CliRunner
from oracles.made_bags import MadeBag

import pmcl
from pmcl.calibration import ParticleGibbs
from pmcl.cli.commands import pmcl as application
from pmcl.logs.wean import read_wean
from pmcl.models.robot_model import default_model
from pmcl.sampling.options import RunOptions

FIRST, STEP = -math.pi / 2, math.pi / 179
# Without transport moves: the search for a mode on a grid of cells makes much of differences in the last digits.
SHORT = ParticleGibbs(
    particles=10, burn_in_particles=100, data_rate=40, settling_sweeps=2, tuning_sweeps=(4, 4), transport_moves=0
)
# The first 45 s, and where global localization finds that the robot began [m, m, rad].
ROWS = ("--duration", 45, "--start", "40.09,41.43,-1.67")


def run(*arguments):
    result = CliRunner().invoke(application, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output


def draws_of(log):
    """Return some draws of theta (S, d), all of them from one seed."""
    return SHORT.run(default_model(log).bind(log), RunOptions(draws=20, chains=1, seed=6)).theta[0]


@pytest.fixture(scope="module")
def text(shared_data, tmp_path_factory):
    """What 'pmcl convert wean' makes of the recording and its map."""
    path = tmp_path_factory.mktemp("text") / "text.nc"
    source = shared_data / "wean"
    run("convert", "wean", source / "robotdata1.log", "--map", source / "wean.dat.gz", *ROWS, "-o", path)
    return path


@pytest.fixture(scope="module")
def recorded(shared_data):
    """The recording as ROS messages."""
    source = shared_data / "wean" / "robotdata1.log"
    mount, bag = read_wean(source).lidars[""].pose, MadeBag()
    turn = (0.0, 0.0, math.sin(mount[2] / 2), math.cos(mount[2] / 2))
    bag.transform("/tf_static", 0, "base_link", "laser", (*mount[:2], 0.4), turn)
    for line in source.read_text().splitlines():
        kind, *words = line.split()
        numbers = np.array(words, dtype=float)
        stamp = round(numbers[-1] * 1e9)
        bag.odometry("/odom", stamp, numbers[:3] * [0.01, 0.01, 1.0])
        if kind == "L":
            bag.scan("/scan", stamp, 0.01 * numbers[6:-1], first=FIRST, step=STEP, limits=(0.0, 81.83))
    return bag


@pytest.fixture(scope="module")
def draws_of_text(text):
    """Draws of theta for the text's log, with ranges and angles rounded to 32 bits as in a LaserScan."""
    log = pmcl.read_log(text)
    rays = np.rint((log.lidars[""].angles - FIRST) / STEP)
    rounded = log.dataset.copy(deep=True)
    rounded["scan"].values[:] = np.float32(rounded["scan"].values)
    rounded["scan_angle"].values[:] = np.float64(np.float32(FIRST)) + rays * np.float64(np.float32(STEP))
    return draws_of(pmcl.RobotLog.from_dataset(rounded, grid_map=log.grid_map))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sqlite3", "mcap"])
def test_a_bag_of_the_recording_gives_its_log_and_its_posterior(kind, recorded, text, draws_of_text, tmp_path):
    path = text.with_name(f"{kind}.nc")
    run("convert", "bag", recorded.write(tmp_path / "bag", kind), "--map", text.with_name("text_map.yaml"), *ROWS,
        "-o", path)  # fmt: skip
    ours, theirs = pmcl.read_log(text), pmcl.read_log(path)
    assert ours.n_steps == theirs.n_steps > 50
    assert set(ours.dataset.variables) == set(theirs.dataset.variables)
    for name, values in ours.dataset.variables.items():
        if values.dtype.kind == "f":
            found = theirs.dataset[name].values
            np.testing.assert_allclose(found, values.values, rtol=1e-7, atol=1e-6, err_msg=str(name))
    for name in ("min_range", "max_range", "pose"):
        wanted = ours.dataset["scan"].attrs[name]
        np.testing.assert_allclose(theirs.dataset["scan"].attrs[name], wanted, rtol=1e-7, atol=1e-8)
    assert ours.grid_map.fingerprint() == theirs.grid_map.fingerprint()
    assert (np.ptp(draws_of_text, axis=0) > 0.0).all()
    np.testing.assert_allclose(draws_of(theirs), draws_of_text, rtol=1e-6)
