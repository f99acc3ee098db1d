"""Simulated paths and readings against the densities that pmcl infers with: scores at the truth have mean zero."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from oracles import made_tables

from pmcl.engine import contract
from pmcl.errors import ModelError
from pmcl.geometry import compose, wrap
from pmcl.models.motions.increments.table import IncrementMotion
from pmcl.models.parameters import Parameter, gamma_prior
from pmcl.models.sensor import sensor_of
from pmcl.models.starts.table import GaussianStart
from pmcl.simulations.simulate import draw_theta, simulate_path

N_ROWS = 4000
STANDARD_ERRORS = 5.0


def row_terms(kernel, table, path):
    """Log density of each row by the kernel's own code."""
    scratch = np.empty((int(contract.scratch_rows(table)), len(path)))
    terms = np.zeros(len(path))
    with np.errstate(divide="ignore"):  # a ray that meets nothing has 1 / length = 0
        kernel(table, len(path), np.ascontiguousarray(path.T), terms, scratch)
    return terms


def score(kernel, table, field, path, step=1e-4):
    """Mean over rows of d log density / d coefficient, in its own standard errors; all entries moved together."""
    up, down = (table._replace(**{field: getattr(table, field) + h}) for h in (step, -step))
    slope = (row_terms(kernel, up, path) - row_terms(kernel, down, path)) / (2.0 * step)
    return slope.mean() / (slope.std() / np.sqrt(len(slope)))


def beams_at(path, rng, **changes):
    """Beams of which all are read at every row; the greatest range lies within reach, so that readings are clipped."""
    table = made_tables.range_beams(path[:6], rng)
    n_beams = table.beam_pose.shape[0]
    return table._replace(
        reading=np.zeros((len(path), n_beams)),
        measured=np.full(len(path), n_beams),
        outlier_weight=np.full(n_beams, 0.12),
        max_range=2.6,
        **changes,
    )


@pytest.mark.parametrize("field", ["bias", "scale", "std", "outlier_weight"])
def test_range_readings_have_the_density_of_the_kernel(rng, field):
    path = made_tables.poses_in_room(rng, N_ROWS)
    table = beams_at(path, rng)
    drawn = sensor_of(table).simulate(table, path, rng)
    assert abs(score(contract.path_reading_logpdf, drawn, field, path)) < STANDARD_ERRORS
    clipped = np.mean((drawn.reading == 0.0) | (drawn.reading == table.max_range))
    assert 0.02 < clipped < 0.6


def test_the_score_notices_a_wrong_simulator(rng):
    path = made_tables.poses_in_room(rng, N_ROWS)
    table = beams_at(path, rng)
    for field, change in (("bias", 0.1), ("std", 0.1), ("outlier_weight", 0.08)):
        wrong = table._replace(**{field: getattr(table, field) + change})
        drawn = sensor_of(wrong).simulate(wrong, path, rng)._replace(**{field: getattr(table, field)})
        assert abs(score(contract.path_reading_logpdf, drawn, field, path)) > STANDARD_ERRORS


def test_what_was_not_measured_stays_missing(rng):
    path = made_tables.poses_in_room(rng, 6)
    table = made_tables.range_beams(path, rng)
    drawn = sensor_of(table).simulate(table, path, rng)
    np.testing.assert_array_equal(np.isnan(drawn.reading), np.isnan(table.reading))
    sightings = made_tables.sightings(6, rng)
    seen = sensor_of(sightings).simulate(sightings, path, rng)
    for name in ("range", "bearing", "size"):
        np.testing.assert_array_equal(np.isnan(getattr(seen, name)), np.isnan(getattr(sightings, name)))


FIELDS = ["range_scale", "range_bias", "range_std", "bearing_bias", "bearing_std", "size_constant", "size_std"]


@pytest.mark.parametrize("field", FIELDS)
def test_sightings_have_the_density_of_the_kernel(rng, field):
    # All three readings of every sighting, no gross errors: whole sightings are then independent.
    path = rng.uniform([1.0, 1.0, -3.0], [3.0, 3.0, 3.0], (N_ROWS, 3))
    table = made_tables.sightings(N_ROWS, rng, outliers=False)
    full = np.ones(table.time.size)
    table = table._replace(range=full, bearing=full, size=full, size_std=np.full(4, 0.2), bearing_std=np.full(4, 0.3))
    drawn = sensor_of(table).simulate(table, path, rng)
    assert abs(score(contract.path_reading_logpdf, drawn, field, path)) < STANDARD_ERRORS
    wrong = sensor_of(table).simulate(table._replace(**{field: 1.1 * getattr(table, field) + 0.02}), path, rng)
    wrong = wrong._replace(**{field: getattr(table, field)})
    assert abs(score(contract.path_reading_logpdf, wrong, field, path)) > STANDARD_ERRORS


def test_gross_errors_spoil_whole_sightings_at_their_rate(rng):
    path = rng.uniform([1.0, 1.0, -3.0], [3.0, 3.0, 3.0], (N_ROWS, 3))
    table = made_tables.sightings(N_ROWS, rng)
    full = np.ones(table.time.size)
    table = table._replace(range=full, bearing=full, size=full * np.nan, outlier_weight=np.full(4, 0.2))
    exact = {"range_std": np.full(4, 1e-9), "bearing_std": np.full(4, 1e-9)}
    drawn = sensor_of(table).simulate(table._replace(**exact), path, rng)
    clean = sensor_of(table).simulate(table._replace(**exact, outlier_weight=np.zeros(4)), path, rng)
    bad_range = np.abs(drawn.range - clean.range) > 1e-6
    bad_bearing = np.abs(wrap(drawn.bearing - clean.bearing)) > 1e-6
    np.testing.assert_array_equal(bad_range, bad_bearing)
    assert abs(bad_range.mean() - 0.2) < STANDARD_ERRORS * np.sqrt(0.16 / bad_range.size)
    assert drawn.range[bad_range].min() >= 0.0
    assert drawn.range[bad_range].max() <= table.max_range


def test_a_path_without_noise_follows_its_odometry(rng):
    motion = made_tables.increment_motion(rng, 50)
    motion = IncrementMotion(motion.mean, np.full((50, 3), 1e-13))
    start = GaussianStart(np.array([1.0, -2.0, 0.7]), np.full(3, 1e-13))
    path = simulate_path(motion, start, rng)
    pose = start.mean
    for t in range(1, 50):
        pose = compose(pose, motion.mean[t])
        np.testing.assert_allclose(path[t, :2], pose[:2], atol=1e-10)
        assert abs(wrap(path[t, 2] - pose[2])) < 1e-10


@pytest.mark.parametrize("field", ["mean", "std"])
@pytest.mark.parametrize("component", [0, 1, 2])
def test_paths_have_the_density_of_the_kernel(rng, field, component):
    motion = IncrementMotion(
        rng.normal(0.0, [0.3, 0.1, 0.5], (N_ROWS, 3)), np.tile([0.05, 0.03, 0.1], (N_ROWS, 1))
    )  # fmt: skip
    path = simulate_path(motion, made_tables.gaussian_start(), rng)
    step = np.zeros(3)
    step[component] = 1e-5
    up, down = (motion._replace(**{field: getattr(motion, field) + sign * step}) for sign in (1.0, -1.0))
    above, below = (row_terms(contract.path_transition_logpdf, table, path) for table in (up, down))
    slope = (above - below)[1:]
    assert slope.std() > 0.0
    assert abs(slope.mean()) < STANDARD_ERRORS * slope.std() / np.sqrt(slope.size)


class Drift(NamedTuple):
    """A motion that pmcl does not know: one number that moves on by its mean."""

    mean: np.ndarray


def test_a_motion_of_ones_own_is_simulated_by_its_own_kernel(rng):
    contract.state_size.register(Drift)(lambda motion: 1)
    contract.scratch_rows.register(Drift)(lambda table: 0)

    def move(motion, t, rng, previous, current, scratch):
        current[0, :] = previous[0, :] + motion.mean[t]

    contract.propagate.register(Drift)(move)
    path = simulate_path(Drift(np.arange(5.0)), GaussianStart(np.array([2.0]), np.array([1e-12])), rng)
    np.testing.assert_allclose(path[:, 0], [2.0, 3.0, 5.0, 8.0, 12.0], atol=1e-9)


def test_a_sensor_of_ones_own_is_asked_for(rng):
    with pytest.raises(ModelError, match="Drift"):
        sensor_of(Drift).simulate(Drift(np.zeros(2)), np.zeros((2, 3)), rng)


PARAMETERS = (Parameter("sigma_a", "m", gamma_prior(0.1), role="noise"), Parameter("sigma_b", "m", gamma_prior(0.2)))


def test_giving_one_parameter_leaves_the_others_as_they_were():
    free = draw_theta(PARAMETERS, None, np.random.default_rng(1))
    given = draw_theta(PARAMETERS, {"sigma_a": 0.5}, np.random.default_rng(1))
    assert given == {"sigma_a": 0.5, "sigma_b": free["sigma_b"]}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"sigma_c": 0.1}, "did you mean 'sigma_"),
        ({"sigma_a": -0.1}, "within its prior, 0 to inf, but got -0.1"),
        ({"sigma_a": np.inf}, "but got inf"),
        ({"sigma_a": 0.0}, "sigma_a > 0, but got 0"),
    ],
)
def test_impossible_parameters_are_refused(given, message):
    with pytest.raises(ModelError, match=message):
        draw_theta(PARAMETERS, given, np.random.default_rng(1))
