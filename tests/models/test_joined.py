"""Several logs joined to one: densities, evidence and simulation are those of the logs by themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.effect_logs import path_of

from pmcl.criticism.scoring.simulated_logs import replicated_log
from pmcl.errors import LogError
from pmcl.filtering.linearised_evidence import LinearisedEvidence
from pmcl.filtering.particle_filter import draw_paths, log_joint, make_rng, run_filter
from pmcl.logs.joined import first_rows, join_logs, joints_of
from pmcl.logs.robot_log import RobotLog
from pmcl.maps.occupancy_grid import OCCUPIED, OccupancyGrid
from pmcl.models.effects.selection import effect_named
from pmcl.models.robot_model import default_model
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field

# mypy: disable-error-code="no-untyped-def"

# Of means, a place of the map, slips, tails, a further component of the state, a late and a turned sensor.
EFFECTS = (
    "", "odometry-turn-scale", "slippery-patch", "wheel-slip", "heavy-tailed-motion-noise", "turn-noise-correlated",
    "sensor-latency", "sensor-yaw",
)  # fmt: skip


def bound_to(log, name):
    model = default_model(log)
    return replace(model, effects=(effect_named(name, log),) if name else ()).bind(log)


def values_of(bound, name):
    theta = bound.prior_mean()
    if name:
        theta[-len(bound.effects[0].null) :] = bound.effects[0].magnitude("clear")
    return theta


def paths_of(logs, size):
    paths = [path_of(log) for log in logs]
    rng = np.random.default_rng(1)
    return [np.hstack([path, rng.standard_normal((len(path), size - 3))]) for path in paths]


@pytest.fixture(scope="module")
def rooms():
    return [simulate_amigobot(duration, seed) for duration, seed in ((40.0, 1), (30.0, 2), (50.0, 3))]


@pytest.mark.parametrize(
    "name", [name if not name else pytest.param(name, marks=pytest.mark.slow) for name in EFFECTS]
)
def test_density_of_joined_logs_is_the_product_of_theirs(rooms, name):
    bounds = [bound_to(log, name) for log in rooms]
    joined = bound_to(join_logs(rooms), name)
    theta = values_of(joined, name)
    size = joined.tables(theta)[0].start.mean.size
    paths = paths_of(rooms, size)
    single = sum(log_joint(bound.tables(theta)[0], path) for bound, path in zip(bounds, paths, strict=True))
    assert log_joint(joined.tables(theta)[0], np.concatenate(paths)) == pytest.approx(single, rel=1e-12)


@pytest.mark.parametrize("name", ["odometry-turn-scale", "range-bias", "turn-noise-correlated"])
def test_an_effect_edits_tables_of_joined_logs_and_leaves_the_seams(rooms, name):
    """As the critic does to score candidates; a motion that stays as it is stays the same object, scored only once."""
    log = join_logs(rooms)
    plain, bound = bound_to(log, ""), bound_to(log, name)
    theta = values_of(bound, name)
    (before,), (expected,) = plain.tables(theta[:4]), bound.tables(theta)
    effect = bound.effects[0]
    without = effect.edit(before, effect.null, log)
    # An effect that adds a component to the state adds it each time.
    for start in (before,) if name == "turn-noise-correlated" else (before, without):
        tables = effect.edit(start, theta[4:], log)
        assert type(tables.motion) is type(expected.motion)
        for found, right in zip(tables.motion.seams[2:], expected.motion.seams[2:], strict=True):
            np.testing.assert_array_equal(found, right)
        np.testing.assert_array_equal(tables.motion.seams.row, first_rows(log))
        np.testing.assert_array_equal(tables.motion.motion.mean, expected.motion.motion.mean)
        assert (tables.motion is before.motion) == (name == "range-bias")


@pytest.mark.parametrize("somewhere", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_evidence_of_joined_logs_is_the_product_of_theirs(somewhere):
    """A smooth map, where the linearised evidence is nearly exact; one of the starts may be anywhere."""
    logs = [simulate_landmark_field(60, seed, bearings=True) for seed in (1, 2)]
    if somewhere:
        logs[1] = logs[1].select(0, 60, start_mean=np.zeros(3), start_std=np.full(3, np.inf))
    paths = [path_of(log) for log in logs]
    joined = join_logs(logs)
    theta = default_model(joined).bind(joined).prior_mean()
    evidence = [
        LinearisedEvidence(default_model(log).bind(log), theta, [path])
        for log, path in zip([*logs, joined], [*paths, np.concatenate(paths)], strict=True)
    ]
    other = 0.7 * theta
    for value in (theta, other):
        first, second, both = (each(value) for each in evidence)
        assert both == pytest.approx(first + second, abs=1e-6)
        means = np.concatenate([each.mean_path(value) for each in evidence[:2]])
        np.testing.assert_allclose(evidence[2].mean_path(value), means, atol=1e-9)


@pytest.mark.slow
def test_filters_of_joined_logs_begin_anew(rooms):
    joined = bound_to(join_logs(rooms), "")
    theta = np.array([0.03, 0.02, 0.03, 0.1])
    rng = make_rng(3)
    filtered = run_filter(joined.tables(theta)[0], sum(log.n_steps for log in rooms), 2000, rng)
    singles = [
        [run_filter(bound_to(log, "").tables(theta)[0], log.n_steps, 2000, rng).log_evidence for log in rooms]
        for _ in range(8)
    ]
    sums = np.sum(singles, axis=1)
    assert abs(filtered.log_evidence - sums.mean()) < 5.0 * sums.std() + 0.5
    path = draw_paths(joined.tables(theta)[0], filtered, 1, rng)[0]
    truth = np.concatenate([path_of(log) for log in rooms])
    assert np.hypot(*(path - truth)[:, :2].T).max() < 0.5


@pytest.mark.slow
def test_a_simulated_robot_begins_anew_where_a_log_does(rooms):
    log = join_logs(rooms)
    bound = bound_to(log, "")
    reference = np.concatenate([path_of(log) for log in rooms])
    replica = replicated_log(log, bound.tables(np.array([0.03, 0.02, 0.03, 0.1]))[0], reference, make_rng(1))
    assert np.hypot(*(replica.path - reference)[:, :2].T).max() < 0.6
    assert np.abs(replica.log.odometry - log.odometry)[first_rows(log)].max() == 0.0
    np.testing.assert_array_equal(first_rows(replica.log), first_rows(log))


def test_a_joined_log_tells_what_it_consists_of(rooms):
    log = join_logs(rooms)
    np.testing.assert_array_equal(first_rows(log), np.cumsum([rooms[0].n_steps, rooms[1].n_steps]))
    joints = joints_of(log)
    assert [joint.where for joint in joints] == [log.where for log in rooms]
    np.testing.assert_array_equal([joint.time for joint in joints[1:]], log.times[first_rows(log)])
    assert joints_of(rooms[0]) == ()
    assert join_logs(rooms[:1]) is rooms[0]
    assert (np.diff(log.times) > 0.0).all()


def test_logs_that_do_not_belong_together_are_refused(rooms):
    with pytest.raises(LogError, match="given twice"):
        join_logs([rooms[0], rooms[0]])
    with pytest.raises(LogError, match="same sensors"):
        join_logs([rooms[0], simulate_landmark_field(60, 1)])
    with pytest.raises(LogError, match="landmark_position"):
        join_logs([simulate_landmark_field(60, 1), simulate_landmark_field(60, 2, n_landmarks=9)])
    with pytest.raises(LogError, match="at least one"):
        join_logs([])
    other = rooms[1].dataset.copy(deep=True)
    other["range"].attrs["max_range"] = 9.0
    with pytest.raises(LogError, match=r"the max_range of 'range' .*, but got 9.0; join logs of one robot"):
        join_logs([rooms[0], RobotLog.from_dataset(other)])


@pytest.mark.parametrize("change", [{"resolution": 0.2}, {"origin": (1.0, 0.0, 0.0)}, {"cells": "other"}, None])
def test_logs_on_different_grid_maps_are_refused(rooms, change):
    cells = np.zeros((80, 80), dtype=np.uint8)
    cells[0] = OCCUPIED
    grid = OccupancyGrid(cells, 0.1, (-2.0, -2.0, 0.0))
    if change == {"cells": "other"}:
        change = {"cells": cells.T}
    other = None if change is None else replace(grid, **change)
    logs = [RobotLog.trusted(log.dataset, log.where, of) for log, of in zip(rooms[:2], (grid, other), strict=True)]
    with pytest.raises(LogError, match="expected the grid map"):
        join_logs(logs)
    assert join_logs([RobotLog.trusted(log.dataset, log.where, grid) for log in rooms[:2]]).grid_map is grid
