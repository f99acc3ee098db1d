"""Global localization with scans on grid maps: particles by the area, recovery of tempered scans, where a log began."""

from __future__ import annotations

import numpy as np
import pytest
from localization.test_anywhere import converged_at

import pmcl
from pmcl.errors import FilterError
from pmcl.localization.beginning import with_found_start
from pmcl.localization.options import FilterOptions
from pmcl.localization.setup import independent_readings, prepare
from pmcl.logs.wean import read_wean
from pmcl.maps.wean import read_wean_map
from pmcl.models.robot_model import default_model
from pmcl.simulations.lidar_room import simulate_lidar_room

ANYWHERE = {"start_mean": np.zeros(3), "start_std": np.full(3, np.inf)}
# Where the robot of the Wean recording ends [m]: in a door. Its scans fit the walls along the whole path to there.
END = (39.8, 41.2)


@pytest.fixture(scope="module")
def room():
    return simulate_lidar_room(120, 5)


@pytest.mark.slow
def test_particles_by_the_area_that_the_robot_may_be_on(room):
    grid = room.grid_map
    area = np.count_nonzero(grid.cells == 0) * grid.resolution**2
    log = room.select(0, 30, **ANYWHERE)
    numbers = pmcl.localize(log, method="prior").dataset["particles"].values
    assert numbers[0] == round(50 * area) > 5000
    assert numbers.min() == np.median(numbers) == 500
    fixed = pmcl.localize(log, method="prior", options=FilterOptions(start_particles=500)).dataset["particles"].values
    assert (fixed == 500).all()
    known = pmcl.localize(room.select(0, 30), method="prior").dataset["particles"].values
    assert (known == 500).all()


def test_a_tempered_scan_is_worth_two_readings(room):
    tables = prepare(room, None, None, "prior", None, 10, None).tracker.tables
    worth = independent_readings(tables, room.n_steps)
    read = tables.sensors[0].reading < tables.sensors[0].max_range
    np.testing.assert_allclose(worth, np.count_nonzero(read, axis=1) * tables.sensors[0].exponent)
    assert 1.0 < worth.mean() <= 2.0


def carried_away(room):
    """A log in which the robot is carried to where it was fifty rows before, and odometry does not see it."""
    kept = np.r_[0:100, 50:120]
    dataset = room.dataset.isel(time=kept).assign_coords(time=("time", np.arange(len(kept), dtype=float)))
    return pmcl.RobotLog.from_dataset(dataset, grid_map=room.grid_map)


@pytest.mark.slow
def test_a_robot_with_a_lidar_that_was_carried_away_is_found_again(room):
    log, found, lost = carried_away(room), 0, 0
    jump = log.true_poses[100, :2] - log.true_poses[99, :2]
    assert np.hypot(*jump) > 3.0
    for seed in range(8):
        for recover in (False, True):
            track = pmcl.localize(log, method="prior", seed=seed, options=FilterOptions(recover=recover))
            row = converged_at(track, log)
            if recover:
                found += row is not None and row < 140
            else:
                lost += row is None
    assert (found, lost) == (8, 8)


@pytest.mark.slow
def test_recovery_is_quiet_while_the_robot_drives_on(room):
    for seed in range(5):
        tracks = [
            pmcl.localize(room, method="prior", seed=seed, options=FilterOptions(recover=recover, start_particles=500))
            for recover in (False, True)
        ]
        np.testing.assert_array_equal(tracks[0].pose_mean, tracks[1].pose_mean)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_where_a_log_began_is_found_from_its_end(room, seed):
    log = room.select(20, 80)
    track = pmcl.localize(log, method="prior", seed=seed)
    assert np.sqrt(track.pose_cov[0, 0, 0]) > 0.5
    started = with_found_start(log, track, method="prior", seed=seed)
    error = np.abs(started.start_mean - room.true_poses[20])
    assert (error[:2] < 0.15).all()
    assert error[2] < 0.1
    assert (started.start_std < 0.5).all()
    assert started.dataset.drop_vars(["start_mean", "start_std"]).identical(
        log.dataset.drop_vars(["start_mean", "start_std"])
    )


@pytest.mark.slow
def test_a_track_that_never_knows_the_place_tells_no_start(room):
    log = room.select(20, 22)
    track = pmcl.localize(log, default_model(log), method="prior", options=FilterOptions(annealed=False))
    with pytest.raises(FilterError, match="expected a track that gets to a known place"):
        with_found_start(log, track, method="prior")


@pytest.mark.slow
def test_the_robot_of_wean_hall_is_found(shared_data, capsys):
    """A corridor of 50 m with doors and alcoves that look alike every 6 m: few readings tell where the robot is."""
    source = shared_data / "wean"
    log = read_wean(source / "robotdata1.log", grid_map=read_wean_map(source / "wean.dat.gz"))
    runs = pmcl.localization.localize_many(log, method="prior", repetitions=24, seed=1)
    off = np.hypot(*(runs.pose_mean[:, -1, :2] - END).T)
    few = pmcl.localization.localize_many(
        log, method="prior", repetitions=24, seed=1, options=FilterOptions(start_particles=500)
    )
    off_few = np.hypot(*(few.pose_mean[:, -1, :2] - END).T)
    with capsys.disabled():
        print(f"\nWean Hall: {np.sum(off < 1.0)} of 24 starts anywhere end within 1 m; with 500 particles "
              f"{np.sum(off_few < 1.0)}")  # fmt: skip
    assert np.sum(off < 1.0) >= 22
    assert np.sum(off_few < 1.0) <= 15
