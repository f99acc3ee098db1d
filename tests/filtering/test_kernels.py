"""Every implementation of the contract, compiled and as plain Python, against densities written again with scipy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from oracles import densities, made_tables
from scipy import optimize, stats

from pmcl.engine import contract
from pmcl.engine.compile import entry
from pmcl.engine.student import log_normal_tail
from pmcl.filtering.kernels import smc  # noqa: F401  (smc imports the implementations)
from pmcl.maps.walls import WallMap
from pmcl.models.sensor import sensor_of

# mypy: disable-error-code="no-untyped-def"


@entry
def compiled_start(start, current, logp):
    contract.start_logpdf(start, current, logp)


@entry
def compiled_draw_start(start, rng, current):
    contract.draw_start(start, rng, current)


@entry
def compiled_propagate(motion, t, rng, previous, current, scratch):
    contract.propagate(motion, t, rng, previous, current, scratch)


@entry
def compiled_transition(motion, t, previous, current, logp, scratch):
    contract.transition_logpdf(motion, t, previous, current, logp, scratch)


@entry
def compiled_transition_path(motion, n_steps, path, logp, scratch):
    contract.path_transition_logpdf(motion, n_steps, path, logp, scratch)


@entry
def compiled_readings(sensor, t, previous, current, logp, scratch):
    contract.reading_logpdf(sensor, t, previous, current, logp, scratch)


@entry
def compiled_reading_path(sensor, n_steps, path, logp, scratch):
    contract.path_reading_logpdf(sensor, n_steps, path, logp, scratch)


# Each implementation both ways; the numbers must be the same.
BOTH = pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "plain"])


def _scratch(table, columns):
    return np.full((contract.scratch_rows(table) + 3, columns), np.nan)


def _start_at(start, states, compiled):
    logp = np.zeros(len(states))
    (compiled_start if compiled else contract.start_logpdf)(start, np.ascontiguousarray(states.T), logp)
    return logp


def _transition_at(motion, t, before, after, compiled=True):
    logp = np.zeros(len(before))
    function = compiled_transition if compiled else contract.transition_logpdf
    function(motion, t, np.ascontiguousarray(before.T), np.array(after), logp, _scratch(motion, len(before)))
    return logp


def _readings_at(sensor, t, states, compiled=True):
    logp = np.zeros(len(states))
    current = np.ascontiguousarray(states.T)
    function = compiled_readings if compiled else contract.reading_logpdf
    function(sensor, t, current, current, logp, _scratch(sensor, len(states)))
    return logp


def _along(function, table, path):
    logp = np.zeros(len(path))
    function(table, len(path), np.ascontiguousarray(path.T), logp, _scratch(table, max(len(path), 3)))
    return logp


# Start


@BOTH
@pytest.mark.parametrize("kind", ["gaussian", "room", "box", "known place", "known heading"])
def test_start_density(kind, compiled, rng):
    start = {
        "gaussian": made_tables.gaussian_start(),
        "room": made_tables.pose_start("room"),
        "box": made_tables.pose_start("box"),
        "known place": made_tables.pose_start("gaussian"),
        "known heading": made_tables.pose_start("room", 0.3),
    }[kind]
    states = rng.uniform([-0.5, -0.5, -4.0], [4.5, 3.5, 4.0], (60, 3))
    expected = np.array([densities.start(start, state) for state in states])
    np.testing.assert_allclose(_start_at(start, states, compiled), expected, rtol=1e-12)
    if kind in ("room", "box"):
        assert np.isinf(expected).any()
        assert np.isfinite(expected).any()


def test_start_density_is_added_to_what_is_there():
    logp = np.array([5.0])
    contract.start_logpdf(made_tables.gaussian_start(), np.array([[1.2], [1.4], [0.3]]), logp)
    start = made_tables.gaussian_start()
    assert logp[0] == pytest.approx(5.0 - np.log(start.std).sum() - 1.5 * math.log(2.0 * math.pi))


def test_gaussian_start_draws(rng):
    start, current = made_tables.gaussian_start(), np.empty((3, 20_000))
    compiled_draw_start(start, rng, current)
    for d in range(3):
        assert stats.kstest((current[d] - start.mean[d]) / start.std[d], "norm").pvalue > 1e-5


@pytest.mark.parametrize("position", ["room", "box"])
def test_start_anywhere_covers_the_map_evenly(position, rng):
    start, current = made_tables.pose_start(position), np.empty((3, 20_000))
    compiled_draw_start(start, rng, current)
    assert np.isfinite(_start_at(start, current.T, True)).all()
    # Above x = 2.5 the room is 1.5 m high, the box 3 m.
    share = {"room": 1.5 * 1.5 / 9.75, "box": 1.5 / 4.0}[position]
    right = np.count_nonzero(current[0] > 2.5)
    assert abs(right - 20_000 * share) < 5.0 * math.sqrt(20_000 * share * (1.0 - share))
    assert stats.kstest(current[2], stats.uniform(-np.pi, 2.0 * np.pi).cdf).pvalue > 1e-5


def test_partly_known_start_draws(rng):
    start, current = made_tables.pose_start("gaussian", 0.3), np.empty((3, 20_000))
    compiled_draw_start(start, rng, current)
    for d in range(3):
        assert stats.kstest((current[d] - start.mean[d]) / start.std[d], "norm").pvalue > 1e-5


# Motion


@BOTH
def test_transition_density(compiled, rng):
    motion, before = made_tables.increment_motion(rng), rng.normal(0.0, [1.0, 1.0, 4.0], (9, 3))
    for t in range(1, 6):
        after = before[4] + rng.normal(0.0, 0.3, 3)
        expected = [densities.transition(motion, t, state, after) for state in before]
        np.testing.assert_allclose(_transition_at(motion, t, before, after, compiled), expected, rtol=1e-10)


def test_transition_density_of_one_particle(rng):
    motion, before = made_tables.increment_motion(rng), rng.normal(size=(1, 3))
    after = before[0] + 0.1
    assert _transition_at(motion, 2, before, after)[0] == pytest.approx(
        densities.transition(motion, 2, before[0], after)
    )


@BOTH
def test_propagated_states_have_the_transition_density(compiled, rng):
    """Pulled back through the motion, draws are standard normal, and independent between components."""
    motion, n = made_tables.increment_motion(rng), 20_000
    before = np.repeat([[0.5], [-0.3], [2.2]], n, axis=1)
    current = np.empty((3, n))
    function = compiled_propagate if compiled else contract.propagate
    function(motion, 3, rng, before, current, _scratch(motion, n))
    c, s = math.cos(2.2), math.sin(2.2)
    dx, dy = current[0] - 0.5, current[1] + 0.3
    moved = np.stack([c * dx + s * dy, c * dy - s * dx, current[2] - 2.2], axis=-1)
    z = (moved - motion.mean[3]) / motion.std[3]
    for d in range(3):
        assert stats.kstest(z[:, d], "norm").pvalue > 1e-5
    assert np.abs(np.corrcoef(z.T) - np.eye(3)).max() < 5.0 / math.sqrt(n)


@BOTH
def test_transitions_along_a_path(compiled, rng):
    motion, path = made_tables.increment_motion(rng), np.cumsum(rng.normal(0.0, 0.3, (6, 3)), axis=0)
    function = compiled_transition_path if compiled else contract.path_transition_logpdf
    expected = [0.0] + [densities.transition(motion, t, path[t - 1], path[t]) for t in range(1, 6)]
    np.testing.assert_allclose(_along(function, motion, path), expected, rtol=1e-10)
    row_by_row = contract.path_transition_logpdf.implementations[object, None]
    np.testing.assert_allclose(_along(row_by_row, motion, path), expected, rtol=1e-10)
    # While data is being included a path is shorter than the log.
    np.testing.assert_allclose(_along(function, motion, path[:3]), expected[:3], rtol=1e-10)


# Range readings


@BOTH
@pytest.mark.parametrize("outliers", [False, True])
def test_range_density(outliers, compiled, rng):
    """Readings of every kind, rays that meet nothing among them."""
    states = made_tables.poses_in_room(rng, 21)
    beams = made_tables.range_beams(states[:6], rng, outliers=outliers)
    lost = [
        np.isinf(densities.ray_length(beams, densities.place(pose, beams.beam_pose[b])))
        for pose in states
        for b in range(5)
    ]
    assert 5 < sum(lost) < 60
    for t in range(6):
        expected = [densities.range_readings(beams, t, pose) for pose in states]
        np.testing.assert_allclose(_readings_at(beams, t, states, compiled), expected, rtol=1e-9, atol=1e-12)
        assert contract.has_reading(beams, t) == (t != 3)


@BOTH
@pytest.mark.parametrize("outliers", [False, True])
def test_range_density_along_a_path(outliers, compiled, rng):
    path = made_tables.poses_in_room(rng, 6)
    beams = made_tables.range_beams(path, rng, outliers=outliers)
    expected = [densities.range_readings(beams, t, path[t]) for t in range(6)]
    function = compiled_reading_path if compiled else contract.path_reading_logpdf
    with np.errstate(divide="ignore"):  # a ray that meets nothing has length 1 / 0
        np.testing.assert_allclose(_along(function, beams, path), expected, rtol=1e-9, atol=1e-12)
    row_by_row = contract.path_reading_logpdf.implementations[object, None]
    with np.errstate(divide="ignore"):
        np.testing.assert_allclose(_along(row_by_row, beams, path), expected, rtol=1e-9, atol=1e-12)
    with np.errstate(divide="ignore"):
        np.testing.assert_allclose(_along(function, beams, path[:4]), expected[:4], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("outlier_weight", [0.0, 0.2])
def test_probability_of_a_range_reading_adds_up_to_one(outlier_weight, rng):
    """Density between the limits, and the two point masses at them.

    The share of gross errors lies strictly between the limits, so it takes part in the integral.
    """
    pose = np.array([[1.0, 1.0, 0.2]])
    beams = made_tables.range_beams(pose.repeat(6, axis=0), rng, outliers=False)
    beams = beams._replace(outlier_weight=np.full(5, outlier_weight), std=np.full(5, 1.2))
    grid = np.linspace(0.0, beams.max_range, 4001)

    def density(z):
        row = np.full((1, 5), np.nan)
        row[0, 2] = z
        return math.exp(_readings_at(beams._replace(reading=row, measured=np.ones(1, np.int64)), 0, pose)[0])

    inner = [density(z) for z in grid[1:-1]]
    integral = (sum(inner) + 0.5 * (inner[0] + inner[-1])) * (grid[1] - grid[0])
    assert integral + density(0.0) + density(beams.max_range) == pytest.approx(1.0, abs=2e-4)


def test_log_of_the_normal_tail_over_its_switch_point():
    x = np.concatenate([np.linspace(-40.0, 60.0, 2001), [24.999999, 25.0, 25.000001, 300.0]])
    np.testing.assert_allclose([log_normal_tail(v) for v in x], stats.norm.logsf(x), rtol=1e-7, atol=1e-15)


# Landmarks


@BOTH
@pytest.mark.parametrize("outliers", [False, True])
@pytest.mark.parametrize("mount", [(0.0, 0.0, 0.0), (0.1, -0.2, 0.5)])
def test_landmark_density(mount, outliers, compiled, rng):
    states = rng.uniform([0.5, 0.5, -9.0], [3.5, 3.5, 9.0], (13, 3))
    seen = made_tables.sightings(10, rng, outliers=outliers, mount=mount)
    for t in range(10):
        expected = [densities.landmark_readings(seen, t, pose) for pose in states]
        np.testing.assert_allclose(_readings_at(seen, t, states, compiled), expected, rtol=1e-9, atol=1e-11)
        assert contract.has_reading(seen, t) == (seen.first[t + 1] > seen.first[t])


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_landmark_density_of_one_channel(channel, rng):
    """Sensors with one kind of reading take short cuts of their own."""
    states = rng.uniform([0.5, 0.5, -9.0], [3.5, 3.5, 9.0], (5, 3))
    seen = made_tables.sightings(5, rng, channels=tuple(k == channel for k in range(3)), mount=(0.0, 0.0, 0.7))
    for t in range(5):
        expected = [densities.landmark_readings(seen, t, pose) for pose in states]
        np.testing.assert_allclose(_readings_at(seen, t, states), expected, rtol=1e-9, atol=1e-11)


@BOTH
@pytest.mark.parametrize("outliers", [False, True])
def test_landmark_density_along_a_path(outliers, compiled, rng):
    path = rng.uniform([0.5, 0.5, -9.0], [3.5, 3.5, 9.0], (10, 3))
    seen = made_tables.sightings(10, rng, outliers=outliers)
    expected = [densities.landmark_readings(seen, t, path[t]) for t in range(10)]
    function = compiled_reading_path if compiled else contract.path_reading_logpdf
    np.testing.assert_allclose(_along(function, seen, path), expected, rtol=1e-9, atol=1e-11)
    row_by_row = contract.path_reading_logpdf.implementations[object, None]
    np.testing.assert_allclose(_along(row_by_row, seen, path), expected, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(_along(function, seen, path[:4]), expected[:4], rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("outliers", [False, True])
@pytest.mark.parametrize("sensor", ["range beams", 0, 1, 2])
def test_a_pose_that_is_no_number_gives_no_density(sensor, outliers, rng):
    """NaN must reach the filter, which reports it; an ordinary number would hide a broken table."""
    broken = np.array([[np.nan, 1.0, 0.0], [1.0, np.nan, 0.0], [1.0, 1.0, np.nan]])
    if sensor == "range beams":
        table = made_tables.range_beams(made_tables.poses_in_room(rng, 6), rng, outliers=outliers)
        table = table._replace(outlier_weight=np.full(5, 0.1 if outliers else 0.0))
    else:
        table = made_tables.sightings(5, rng, channels=tuple(k == sensor for k in range(3)))
        table = table._replace(outlier_weight=np.full(4, 0.1 if outliers else 0.0))
    assert np.isnan(_readings_at(table, 0, broken)).all()


@pytest.mark.parametrize("outliers", [False, True])
@pytest.mark.parametrize("name", ["bias", "scale", "std"])
def test_a_beam_coefficient_that_is_no_number_gives_no_density(name, outliers, rng):
    poses = made_tables.poses_in_room(rng, 6)
    beams = made_tables.range_beams(poses, rng, outliers=False)
    beams = beams._replace(outlier_weight=np.full(5, 0.1 if outliers else 0.0), **{name: np.full(5, np.nan)})
    assert np.isnan(_readings_at(beams, 0, poses)).all()


@pytest.mark.parametrize("outliers", [False, True])
@pytest.mark.parametrize(
    ("name", "channel"), [("range_bias", 0), ("range_std", 0), ("bearing_bias", 1), ("size_std", 2)]
)
def test_a_landmark_coefficient_that_is_no_number_gives_no_density(name, channel, outliers, rng):
    seen = made_tables.sightings(5, rng, channels=tuple(k == channel for k in range(3)))
    seen = seen._replace(outlier_weight=np.full(4, 0.1 if outliers else 0.0), **{name: np.full(4, np.nan)})
    assert np.isnan(_readings_at(seen, 1, made_tables.poses_in_room(rng, 6))).all()


# Linearisations: gradients and curvatures of the log densities, by numerical differentiation


def _gradient(function, at):
    return optimize.approx_fprime(at, function, 1e-6)


def _curvature(function, at, step=1e-4):
    size = at.size
    out = np.empty((size, size))
    unit = np.eye(size) * step
    for i in range(size):
        for j in range(size):
            plus = function(at + unit[i] + unit[j]) - function(at + unit[i] - unit[j])
            minus = function(at - unit[i] + unit[j]) - function(at - unit[i] - unit[j])
            out[i, j] = (plus - minus) / (4.0 * step * step)
    return out


@pytest.mark.parametrize("kind", ["gaussian", "known place"])
def test_linearised_start(kind, rng):
    start = made_tables.gaussian_start() if kind == "gaussian" else made_tables.pose_start("gaussian", 0.3)
    reference, precision, shift = rng.normal(size=3) * 0.2, np.zeros((3, 3)), np.zeros(3)
    contract.linearise_start(start, reference, precision, shift)
    np.testing.assert_allclose(shift, _gradient(lambda x: densities.start(start, x), reference), rtol=1e-4)
    np.testing.assert_allclose(
        precision, -_curvature(lambda x: densities.start(start, x), reference), rtol=1e-4, atol=1e-4
    )


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_linearised_transition(noise, rng):
    """The gradient is right anywhere, the curvature where the reference made exactly the mean increment."""
    motion, before = made_tables.increment_motion(rng), np.array([0.4, -0.2, 2.2])
    c, s = math.cos(before[2]), math.sin(before[2])
    f, g, h = motion.mean[4] + noise * motion.std[4]
    after = before + np.array([c * f - s * g, s * f + c * g, h])
    jacobian, offset, precision = np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    contract.linearise_transition(motion, 4, before, after, jacobian, offset, precision)

    def density(both):
        return densities.transition(motion, 4, both[:3], both[3:])

    both = np.concatenate([before, after])
    gradient = np.concatenate([-jacobian.T @ precision @ offset, precision @ offset])
    np.testing.assert_allclose(gradient, _gradient(density, both), rtol=2e-3, atol=2e-3)
    if noise == 0.0:
        slope = np.concatenate([-jacobian, np.eye(3)], axis=1)
        curvature = -_curvature(density, both)
        np.testing.assert_allclose(
            slope.T @ precision @ slope, curvature, rtol=1e-3, atol=1e-3 * np.abs(curvature).max()
        )


def test_bent_deviations_have_an_inverse_and_keep_volume(rng):
    """The map from deviation to state given the next state: undone exactly, with a Jacobian determinant of one."""
    motion = made_tables.increment_motion(rng)
    reference = np.cumsum(rng.normal(0.0, 0.3, (6, 3)), axis=0)
    for t in range(5):
        after = reference[t + 1] + rng.normal(0.0, 0.2, 3)

        def state(deviation, t=t, after=after):
            out = np.empty(3)
            contract.state_of_deviation(motion, t, reference, after, deviation, out)
            return out

        deviation, back = rng.normal(0.0, 0.2, 3), np.empty(3)
        contract.deviation_of_state(motion, t, reference, after, state(deviation), back)
        np.testing.assert_allclose(back, deviation, atol=1e-12)
        columns = [(state(deviation + unit) - state(deviation - unit)) / 2e-5 for unit in 1e-5 * np.eye(3)]
        assert np.linalg.det(np.array(columns)) == pytest.approx(1.0, abs=1e-8)


def test_linearised_range_readings(rng):
    """The shift is the gradient of the log density at the reference, row by row."""
    reference = made_tables.poses_in_room(rng, 6)
    beams = made_tables.range_beams(reference, rng, outliers=False, open_room=False)
    linear = sensor_of(beams).linearise(beams, reference)
    assert linear.reading.size > 10
    for t in range(6):
        precision, shift = np.zeros((3, 3)), np.zeros(3)
        contract.linear_information(beams, linear, t, precision, shift)
        # Only the beams that were linearised: clipped ones and those on the wrong side of an edge were left out.
        row = np.full_like(beams.reading, np.nan)
        used = linear.channel[linear.first[t] : linear.first[t + 1]]
        row[t, used] = beams.reading[t, used]
        alone = beams._replace(reading=row)
        np.testing.assert_allclose(
            shift,
            _gradient(lambda x, alone=alone, t=t: densities.range_readings(alone, t, x), reference[t]),
            rtol=1e-3,
            atol=1e-3,
        )
        assert np.linalg.eigvalsh(precision).min() > -1e-9


@pytest.mark.parametrize(("lateral", "reading", "kept"), [
    (0.01, 1.02, True),
    (-0.01, 2.97, True),  # the ray passes the wall's end and meets the wall behind
    (0.01, 2.97, False),  # the reading is that of the other side
    (-0.01, 1.02, False),
    (0.0, 1.0, False),  # on the edge itself there is no slope
])  # fmt: skip
def test_a_beam_at_an_edge_is_linearised_on_the_side_where_its_reading_fits(lateral, reading, kept, rng):
    """A wall ahead at 1 m ends beside the ray, one at 3 m does not."""
    walls = WallMap(np.array([[[1.0, -2.0], [1.0, lateral]], [[3.0, -2.0], [3.0, 2.0]]]))
    vertices, start, stop = walls.vertices_and_edges()
    reference = np.zeros((5, 3))
    beams = made_tables.range_beams(reference, rng)._replace(
        vertices=vertices.copy(), wall_start=start, wall_stop=stop, beam_pose=np.zeros((1, 3)),
        reading=np.full((5, 1), reading), bias=np.zeros(1), scale=np.ones(1), std=np.full(1, 0.02),
        outlier_weight=np.zeros(1), max_range=10.0,
    )  # fmt: skip
    linear = sensor_of(beams).linearise(beams, reference)
    assert linear.reading.size == (5 if kept else 0)
    if kept:
        np.testing.assert_allclose(linear.jacobian[0], [-1.0, 0.0, 0.0], atol=1e-4)


def test_fitted_readings_follow_a_corner_on_both_sides(rng):
    """Straight ahead the wall is level left of the ray and slanted right of it; paths lie on both sides."""
    walls = WallMap(np.array([[[1.0, 0.0], [1.0, 2.0]], [[1.0, 0.0], [2.0, -1.0]]]))
    vertices, start, stop = walls.vertices_and_edges()
    reference = np.tile([0.0, 0.02, 0.0], (5, 1))
    beams = made_tables.range_beams(reference, rng)._replace(
        vertices=vertices.copy(), wall_start=start, wall_stop=stop, beam_pose=np.zeros((1, 3)),
        reading=np.full((5, 1), 1.02), bias=np.zeros(1), scale=np.ones(1), std=np.full(1, 0.05),
        outlier_weight=np.zeros(1), max_range=10.0,
    )  # fmt: skip
    sensor = sensor_of(beams)
    linear = sensor.linearise(beams, reference)
    assert linear.reading.size == 5
    np.testing.assert_allclose(linear.jacobian[:, 1], 0.0, atol=1e-6)

    def drawn(count):
        shift = np.zeros((count, 5, 3))
        shift[..., 1] = 0.1 * rng.standard_normal((count, 5))
        return reference + shift

    fitted = sensor.fitted_linearisation(beams, linear, reference, drawn(60))
    # To the right the ray gets as much longer as the robot is aside, to the left it does not.
    assert (fitted.jacobian[:, 1] < -0.3).all()
    assert (fitted.jacobian[:, 1] > -0.7).all()
    there = drawn(2000)
    lengths = sensor.ideal_readings(beams, there.reshape(-1, 3)).reshape(2000, 5)
    error = [
        lengths - one.value - np.einsum("nmi,mi->nm", there - reference, one.jacobian) for one in (linear, fitted)
    ]
    assert (error[1] ** 2).mean() < 0.5 * (error[0] ** 2).mean()
    assert abs(error[1].mean()) < 0.02 < error[0].mean()
    assert sensor.fitted_linearisation(beams, linear, reference, drawn(9)) is linear
    # Where all paths are alike, there is nothing to fit.
    alike = sensor.fitted_linearisation(beams, linear, reference, np.tile(reference, (20, 1, 1)))
    np.testing.assert_allclose(alike.jacobian, linear.jacobian)
    np.testing.assert_allclose(alike.value, linear.value)


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_fitted_landmark_readings_have_the_slopes_of_the_reference_where_paths_are_near(channel, rng):
    """And those of a regression, found by other means, where they are not."""
    reference = rng.uniform([0.5, 0.5, -3.0], [3.5, 3.5, 3.0], (5, 3))
    seen = made_tables.sightings(5, rng, outliers=False, channels=tuple(k == channel for k in range(3)))
    sensor = sensor_of(seen)
    linear = sensor.linearise(seen, reference)
    paths = reference + 1e-4 * rng.standard_normal((30, 5, 3))
    near = sensor.fitted_linearisation(seen, linear, reference, paths)
    np.testing.assert_allclose(near.jacobian, linear.jacobian, atol=2e-2 * max(1.0, np.abs(linear.jacobian).max()))
    paths = reference + 0.1 * rng.standard_normal((200, 5, 3))
    far = sensor.fitted_linearisation(seen, linear, reference, paths)
    times = np.repeat(np.arange(5), np.diff(linear.first))
    for k, t in enumerate(times):
        ideal = np.array([sensor.linearise(seen, path).value[k] for path in paths])
        if channel == 1:
            ideal = linear.value[k] + densities.wrapped(ideal - linear.value[k])
        regressors = np.column_stack([np.ones(200), (paths - reference)[:, t]])
        value, *slope = np.linalg.lstsq(regressors, ideal, rcond=None)[0]
        scale = max(1.0, np.abs(far.jacobian[k]).max())
        np.testing.assert_allclose(far.jacobian[k], slope, atol=0.01 * scale)
        assert far.value[k] == pytest.approx(value, abs=0.002 * scale)


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_linearised_landmark_readings(channel, rng):
    """Without noise, gradient zero and exact curvature (of the residual, where a size's noise depends on the pose)."""
    reference = rng.uniform([0.5, 0.5, -3.0], [3.5, 3.5, 3.0], (5, 3))
    seen = made_tables.sightings(5, rng, outliers=False, channels=tuple(k == channel for k in range(3)))
    for k in range(seen.time.size):
        sensor = densities.place(reference[seen.time[k]], seen.sensor_pose)
        delta, j = seen.position[seen.landmark[k]] - sensor[:2], seen.landmark[k]
        distance = np.hypot(*delta)
        seen.range[k] = seen.range_scale[j] * distance + seen.range_bias[j] if channel == 0 else np.nan
        bearing = densities.wrapped(np.arctan2(delta[1], delta[0]) - sensor[2] + seen.bearing_bias[j])
        seen.bearing[k] = bearing if channel == 1 else np.nan
        seen.size[k] = seen.size_constant[j] / distance**2 if channel == 2 else np.nan
    linear = sensor_of(seen).linearise(seen, reference)

    def density(x, t):
        value = densities.landmark_readings(seen, t, x)
        if channel == 2:
            # The log of the pixels' scale changes with the pose too; the linearisation leaves that out.
            sensor = densities.place(x, seen.sensor_pose)
            rows = seen.landmark[seen.first[t] : seen.first[t + 1]]
            value -= 2.0 * np.log(np.hypot(*(seen.position[rows] - sensor[:2]).T)).sum()
        return value

    for t in range(5):
        precision, shift = np.zeros((3, 3)), np.zeros(3)
        contract.linear_information(seen, linear, t, precision, shift)
        np.testing.assert_allclose(shift, np.zeros(3), atol=1e-9)
        curvature = -_curvature(lambda x, t=t: density(x, t), reference[t])
        # Only the lower triangle is read, so only that is promised.
        scale = max(1.0, np.abs(curvature).max())
        np.testing.assert_allclose(np.tril(precision), np.tril(curvature), rtol=1e-3, atol=1e-3 * scale)


@pytest.mark.parametrize("channel", [0, 1])
def test_gradient_of_linearised_landmark_readings(channel, rng):
    reference = rng.uniform([0.5, 0.5, -3.0], [3.5, 3.5, 3.0], (5, 3))
    seen = made_tables.sightings(5, rng, outliers=False, channels=tuple(k == channel for k in range(3)))
    linear = sensor_of(seen).linearise(seen, reference)
    for t in range(5):
        precision, shift = np.zeros((3, 3)), np.zeros(3)
        contract.linear_information(seen, linear, t, precision, shift)
        slope = _gradient(lambda x, t=t: densities.landmark_readings(seen, t, x), reference[t])
        np.testing.assert_allclose(shift, slope, rtol=1e-3, atol=1e-3 * max(1.0, np.abs(slope).max()))
