"""A trajectory that is drawn in blocks of rows, for long logs, is the one that is drawn at once."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from pmcl.filtering import particle_filter
from pmcl.filtering.particle_filter import make_rng, run_filter, update_path
from pmcl.logs.robot_log import RobotLog
from pmcl.models.robot_model import default_model
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field


@pytest.fixture(scope="module", params=["landmarks", pytest.param("sonars", marks=pytest.mark.slow)])
def tables_and_path(request):
    """Tables of a log of 60 rows, some without readings, and a trajectory with a positive density."""
    log = simulate_landmark_field(60, 1) if request.param == "landmarks" else simulate_amigobot(60.0, 1)
    bound = default_model(log).bind(log)
    tables = bound.tables(bound.prior_mean())[0]
    path = np.zeros((60, 3))
    assert update_path(tables, path, 60, 300, make_rng(1), "smoothing").succeeded
    return tables, path


@pytest.mark.parametrize("kept", [1, 80, 300, 1100])  # blocks of 7 rows (the root of 60), of 7, 7 and 27
@pytest.mark.parametrize("kernel", ["conditional", "smoothing"])
@pytest.mark.parametrize(("rows", "particles"), [(60, 20), (60, 50), (41, 20)])
def test_blocks_draw_the_same_trajectory(tables_and_path, monkeypatch, kernel, rows, particles, kept):
    tables, start = tables_and_path
    at_once, in_blocks = start.copy(), start.copy()
    rng, rng_of_blocks = make_rng(2), make_rng(2)
    expected = update_path(tables, at_once, rows, particles, rng, kernel)
    monkeypatch.setattr(particle_filter, "MOST_KEPT_STATES", kept)
    found = update_path(tables, in_blocks, rows, particles, rng_of_blocks, kernel)
    assert (at_once != start).any()
    np.testing.assert_array_equal(in_blocks, at_once)
    assert rng.random() == rng_of_blocks.random()
    assert found.changed_share == expected.changed_share
    assert found.log_evidence == pytest.approx(expected.log_evidence, rel=1e-12)
    assert found.effective_share == pytest.approx(expected.effective_share, rel=1e-12)


def test_a_block_goes_on_where_no_reading_was_taken(monkeypatch):
    # Weights that no resampling has used yet must be carried from one block to the next.
    log = simulate_landmark_field(60, 1)
    readings = log.dataset["landmark_range"].copy(deep=True)
    readings.values = np.where((np.arange(60) // 35 == 0)[:, None], np.nan, readings.values)
    log = RobotLog.from_dataset(log.dataset.assign(landmark_range=readings))
    bound = default_model(log).bind(log)
    tables = bound.tables(bound.prior_mean())[0]
    at_once, in_blocks = np.zeros((60, 3)), np.zeros((60, 3))
    update_path(tables, at_once, 60, 50, make_rng(3), "smoothing")
    monkeypatch.setattr(particle_filter, "MOST_KEPT_STATES", 1)
    update_path(tables, in_blocks, 60, 50, make_rng(3), "smoothing")
    np.testing.assert_array_equal(in_blocks, at_once)


def test_a_lost_pass_leaves_the_trajectory(monkeypatch):
    log, start = simulate_landmark_field(60, 1), np.ones((60, 3))
    bound = default_model(log).bind(log)
    tables = bound.tables(bound.prior_mean())[0]
    far = tables._replace(start=tables.start._replace(mean=np.array([1e200, 0.0, 0.0])))
    monkeypatch.setattr(particle_filter, "MOST_KEPT_STATES", 1)
    path = start.copy()
    assert not update_path(far, path, 60, 10, make_rng(4), "smoothing").succeeded
    np.testing.assert_array_equal(path, start)


def test_memory_does_not_grow_with_particles_times_rows(monkeypatch):
    log = simulate_landmark_field(4000, 1)
    bound = default_model(log).bind(log)
    tables = bound.tables(bound.prior_mean())[0]
    path = run_filter(tables, 4000, 50, make_rng(5)).mean()
    monkeypatch.setattr(particle_filter, "MOST_KEPT_STATES", 20_000)
    update_path(tables, path.copy(), 4000, 200, make_rng(6), "conditional")  # compiles
    tracemalloc.start()
    update_path(tables, path, 4000, 200, make_rng(6), "conditional")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4000 * 200 * 36 / 4
