"""Readings one after another: densities that add up, distribution functions, and PITs that are uniform."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from oracles import kalman, made_tables
from oracles.random_walk_model import rail_log, rail_model
from scipy import integrate, special, stats

from pmcl.engine import contract
from pmcl.engine.compile import entry
from pmcl.engine.tables import with_extras
from pmcl.filtering.kernels import smc
from pmcl.filtering.kernels.weighing import OneByOne, weigh
from pmcl.filtering.one_step_ahead import pooled_increments, predict_by_passes, predict_readings
from pmcl.filtering.particle_filter import draw_paths, draw_paths_beside, log_joint, make_rng, run_filter
from pmcl.models.robot_model import default_model
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field

# mypy: disable-error-code="no-untyped-def"


@entry
def compiled_one(sensor, t, slot, previous, current, logp, low, high, memory, scratch):
    return contract.one_reading(sensor, t, slot, previous, current, logp, low, high, memory, scratch)


def _slots(sensor, t, states, compiled):
    """Log densities, low and high (slots, n) of all measured slots of a row."""
    current = np.ascontiguousarray(states.T)
    n = current.shape[1]
    scratch, memory = np.full((contract.scratch_rows(sensor) + 3, n), np.nan), np.full((3, n), np.nan)
    found = []
    for slot in range(*contract.reading_slots(sensor, t)):
        out = np.full((3, n), np.nan)
        function = compiled_one if compiled else contract.one_reading
        if function(sensor, t, slot, current, current, out[0], out[1], out[2], memory, scratch):
            found.append(out)
    return np.array(found).reshape(-1, 3, n)


@pytest.fixture(params=["beams", "sightings"])
def sensor(request, rng):
    poses = made_tables.poses_in_room(rng, 7)
    if request.param == "beams":
        return made_tables.range_beams(poses, rng)
    return made_tables.sightings(7, rng)


@pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "plain"])
def test_slots_of_a_row_add_up_to_its_density(sensor, compiled, rng):
    states = made_tables.poses_in_room(rng, 9)
    current = np.ascontiguousarray(states.T)
    rows = 0
    for t in range(6):
        slots = _slots(sensor, t, states, compiled)
        expected = np.zeros(9)
        scratch = np.full((contract.scratch_rows(sensor) + 3, 9), np.nan)
        contract.reading_logpdf(sensor, t, current, current, expected, scratch)
        np.testing.assert_allclose(slots[:, 0].sum(axis=0), expected, rtol=1e-9, atol=1e-9)
        rows += len(slots) > 0
    assert rows >= 4


def _with(sensor, t, slot, value):
    """The sensor with another reading in one slot."""
    if hasattr(sensor, "beam_pose"):
        reading = sensor.reading.copy()
        reading[t, slot - t * reading.shape[1]] = value
        return sensor._replace(reading=reading)
    name = ("range", "bearing", "size")[slot % 3]
    values = getattr(sensor, name).copy()
    values[slot // 3] = value
    return sensor._replace(**{name: values})


class Gauge(NamedTuple):
    """One reading a row, of the state's first component plus Gaussian noise of standard deviation 1."""

    reading: np.ndarray
    asked: int


@contract.states_asked.register(Gauge)
def _states_asked(sensor):
    return sensor.asked


@contract.one_reading.register(Gauge)
def _gauge_reading(sensor, t, slot, previous, current, logp, low, high, memory, scratch):
    for i in range(logp.size):
        z = sensor.reading[t] - current[0, i]
        logp[i] = -0.5 * z * z
        if low[i] != contract.NOT_ASKED:
            low[i] = 0.5 * math.erfc(-z * math.sqrt(0.5))
            high[i] = low[i] + 0.1
    return True


@entry
def weighed(record, sensors, previous, current, log_weights, scratch):
    weigh(record, sensors, 0, previous, current, log_weights, np.empty(log_weights.size), scratch)


@pytest.mark.parametrize("asked", [0, 40, 999, 1000])
def test_distribution_functions_are_asked_of_states_in_proportion_to_their_weights(asked, rng):
    n = 1000
    state, log_weights = rng.normal(size=(1, n)), np.log(rng.exponential(size=n) ** 3)
    weights = np.exp(log_weights)
    below = special.ndtr(0.3 - state[0])
    record = OneByOne(1, *np.full((3, 1), np.nan), np.empty((7, n)), False)
    weighed(record, (Gauge(np.array([0.3]), asked),), state, state, log_weights.copy(), np.empty((0, n)))
    if 0 < asked < n:
        teeth = np.searchsorted(np.cumsum(weights) / weights.sum(), (np.arange(asked) + 0.5) / asked)
        expected = below[teeth].mean()
        assert expected == pytest.approx(np.average(below, weights=weights), abs=0.1)
    else:
        expected = np.average(below, weights=weights)
    assert record.low[0] == pytest.approx(expected, rel=1e-9)
    assert record.high[0] == pytest.approx(expected + 0.1, rel=1e-9)
    density = np.exp(-0.5 * (0.3 - state[0]) ** 2)
    assert record.log_score[0] == pytest.approx(np.log(np.average(density, weights=weights)), rel=1e-9)


@pytest.mark.parametrize("step", [0.0, 0.05])
def test_sonars_with_heavy_tails_or_rounding_answer_for_the_states_that_are_asked(step, rng):
    """As they do where all are asked, and with the same density; where neither is costly, all are asked."""
    poses, n = made_tables.poses_in_room(rng, 7), 40
    plain = with_extras(made_tables.range_beams(poses, rng))
    extras = plain.extras._replace(tail=0.0 if step else 0.3, step=step)
    sensor = plain._replace(extras=extras)
    easy = plain._replace(extras=extras._replace(tail=0.0, step=0.0))
    assert contract.states_asked(sensor) == 64
    assert contract.states_asked(easy) == 0
    current, asked = np.ascontiguousarray(made_tables.poses_in_room(rng, n).T), rng.random(n) < 0.3
    scratch, memory = np.full((contract.scratch_rows(sensor) + 3, n), np.nan), np.full((3, n), np.nan)
    compared = 0
    slots = [(t, slot) for t in range(7) for slot in range(*contract.reading_slots(sensor, t))]
    for t, slot in slots:
        every, few = np.zeros((2, 3, n))
        few[1, ~asked] = contract.NOT_ASKED
        for out in (every, few):
            measured = compiled_one(sensor, t, slot, current, current, *out, memory, scratch)
        if measured:
            np.testing.assert_array_equal(few[0], every[0])
            np.testing.assert_array_equal(few[1:, asked], every[1:, asked])
            compared += np.ptp(every[1]) > 0.01
    assert compared >= 4


@pytest.mark.slow
def test_distribution_functions_are_integrals_of_the_densities(sensor, rng):
    states = made_tables.poses_in_room(rng, 4)
    current = np.ascontiguousarray(states.T)
    checked = 0
    for t in (0, 4):
        first, stop = contract.reading_slots(sensor, t)
        for slot in range(first, stop):

            def at(value, t=t, slot=slot):
                changed = _with(sensor, t, slot, value)
                scratch = np.full((contract.scratch_rows(sensor) + 3, 4), np.nan)
                memory, out = np.full((3, 4), np.nan), np.full((3, 4), np.nan)
                for earlier in range(contract.reading_slots(sensor, t)[0], slot + 1):
                    seen = contract.one_reading(
                        changed, t, earlier, current, current, out[0], out[1], out[2], memory, scratch
                    )
                assert seen
                return out

            if hasattr(sensor, "beam_pose"):
                low, high = 0.4, 2.1
            else:
                low, high = ((0.7, 2.9), (-0.4, 0.4), (2.0, 9.0))[slot % 3]
            grid = np.linspace(low, high, 4001)
            density = np.exp([at(z)[0] for z in grid])
            mass = integrate.trapezoid(density, grid, axis=0)
            begin, end = at(low), at(high)
            # A bearing is measured from the opposite of each state's own expectation: compare where none wraps.
            plain = end[1] > begin[1]
            np.testing.assert_allclose((end[1] - begin[1])[plain], mass[plain], atol=2e-5)
            np.testing.assert_allclose(end[1], end[2])
            checked += int(plain.sum())
    assert checked >= 20


def test_clipped_readings_have_a_probability_of_their_own(rng):
    beams = made_tables.range_beams(made_tables.poses_in_room(rng, 7), rng)
    states = made_tables.poses_in_room(rng, 5)
    slots = _slots(beams, 1, states, True)
    # Row 1 begins with a reading of 0, one of the greatest range, and one without echo.
    np.testing.assert_array_equal(slots[0, 1], 0.0)
    np.testing.assert_array_equal(slots[1:3, 2], 1.0)
    np.testing.assert_allclose(np.log((slots[:3, 2] - slots[:3, 1])[[0, 2]]), slots[[0, 2], 0], rtol=1e-9)
    # An outlier lies strictly inside, below the greatest range.
    weight = beams.outlier_weight[1]
    np.testing.assert_allclose((1.0 - slots[1, 1]), np.exp(slots[1, 0]), rtol=1e-9)
    assert weight > 0.0


@pytest.mark.parametrize("kind", ["walls", "landmarks"])
def test_one_by_one_is_the_same_filter(kind):
    log = simulate_amigobot(40.0, 1) if kind == "walls" else simulate_landmark_field(60, 1, bearings=True)
    bound = default_model(log).bind(log)
    tables = bound.tables(bound.prior_mean())[0]
    plain = run_filter(tables, log.n_steps, 300, make_rng(5))
    made = predict_readings(tables, log.n_steps, 300, make_rng(5))
    np.testing.assert_allclose(made.filtered.log_evidence, plain.log_evidence, rtol=1e-10)
    np.testing.assert_allclose(
        np.bincount(made.time, made.log_score, minlength=log.n_steps), plain.log_increments, atol=1e-8
    )
    readings = log.n_readings if kind == "walls" else 2 * log.n_readings
    assert made.log_score.size == readings
    assert np.all(np.diff(made.time) >= 0)
    light = predict_readings(tables, log.n_steps, 300, make_rng(5), keep_particles=False)
    assert len(light.filtered.particles) == len(light.filtered.log_weights) == len(light.filtered.ancestors) == 2
    last = [(t % 2, t) for t in (log.n_steps - 2, log.n_steps - 1)]
    for row, t in last:
        np.testing.assert_array_equal(light.filtered.particles[row], made.filtered.particles[t])
    np.testing.assert_array_equal(light.pit(make_rng(1)), made.pit(make_rng(1)))
    np.testing.assert_array_equal(light.filtered.log_increments, made.filtered.log_increments)
    assert not np.isnan(made.reading).any()


def test_predictions_agree_with_the_kalman_filter():
    log = rail_log(40, seed=3, missing=(3, 17))
    tables = rail_model().bind(log).tables(np.array([0.5, 0.4]))[0]
    model = kalman.linear_model(tables)
    made = [predict_readings(tables, 40, 2000, make_rng(k)) for k in range(20)]
    mean, variance, expected = model.mean, model.std**2, []
    for t, z in enumerate(model.reading):
        if t > 0:
            mean, variance = model.a * mean + model.control[t], model.a**2 * variance + 0.25
        if not np.isnan(z):
            spread = variance + 0.16
            expected.append([stats.norm.cdf(z, mean, math.sqrt(spread)), stats.norm.logpdf(z, mean, math.sqrt(spread))])
            gain = variance / spread
            mean, variance = mean + gain * (z - mean), (1.0 - gain) * variance
    exact = np.array(expected).T
    found = (np.array([m.low for m in made]), np.array([m.log_score for m in made]))
    for draws, right in zip(found, exact, strict=True):
        error = draws.mean(axis=0) - right
        tolerance = 5.0 * draws.std(axis=0, ddof=1) / math.sqrt(len(made)) + 1e-3
        assert np.all(np.abs(error) <= tolerance)


@pytest.mark.parametrize("kind", ["walls", "landmarks"])
def test_pits_are_uniform_and_independent_under_the_true_model(kind, rng):
    """Over some logs, so that the log's own accidents average out; the same test sees a sensor 30 % too noisy."""
    theta = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04}
    noise = {"walls": {"sigma_range": 0.05}, "landmarks": {"sigma_landmark_range": 0.3, "sigma_bearing": 0.05}}[kind]
    right, wrong = [], []
    for seed in range(6):
        if kind == "walls":
            log = simulate_amigobot(150.0, seed, {**theta, **noise})
        else:
            log = simulate_landmark_field(150, seed, {**theta, **noise}, bearings=True)
        bound = default_model(log).bind(log)
        for factor, into in ((1.0, right), (1.3, wrong)):
            values = {**theta, **{name: factor * std for name, std in noise.items()}}
            tables = bound.tables(np.array([values[name] for name in bound.names]))[0]
            made = predict_readings(tables, log.n_steps, 1000, make_rng(seed))
            into.append(stats.norm.ppf(made.pit(rng)))
    xi = np.concatenate(right)
    assert stats.kstest(xi, "norm").pvalue > 1e-4
    assert stats.kstest(np.concatenate(wrong), "norm").pvalue < 1e-6
    # Neighbours in the order of the readings are other beams of the same row: they share the error of the pose.
    assert abs(np.mean(xi[1:] * xi[:-1])) < 4.0 / math.sqrt(xi.size)


def test_part_by_part_is_the_joint_density():
    log = simulate_amigobot(30.0, 2)
    bound = default_model(log).bind(log)
    tables = bound.tables(bound.prior_mean())[0]
    paths = np.array([log.dataset["true_pose"].values + 0.01 * k for k in range(3)])
    columns = np.ascontiguousarray(paths.transpose(0, 2, 1))
    rows = smc.motion_terms(tables.start, tables.motion, columns)
    rows += smc.sensor_terms(tables.sensors[0], columns)
    np.testing.assert_allclose(rows.sum(axis=1), [log_joint(tables, path) for path in paths], rtol=1e-10)
    np.testing.assert_allclose(rows[1], smc.joint_terms(tables, paths[1])[1], rtol=1e-8)


def test_readings_alone_are_foreseen_from_the_rows_before():
    """Each reading's score is that of all particles before the row, which have equal weights; the evidence stays."""
    log = simulate_amigobot(20.0, 3)
    bound = default_model(log).bind(log)
    tables = bound.tables(bound.prior_mean())[0]
    found = predict_readings(tables, log.n_steps, 300, make_rng(1), alone=True)
    in_turn = predict_readings(tables, log.n_steps, 300, make_rng(1))
    assert found.filtered.log_evidence == pytest.approx(in_turn.filtered.log_evidence, rel=1e-12)
    assert in_turn.log_score.sum() == pytest.approx(in_turn.filtered.log_evidence, rel=1e-9)
    for t in np.unique(found.time):
        slots = _slots(tables.sensors[0], t, found.filtered.particles[t].T, True)
        expected = [np.log(np.exp(logp - logp.max()).mean()) + logp.max() for logp in slots[:, 0]]
        np.testing.assert_allclose(found.log_score[found.time == t], expected, rtol=1e-9)
        np.testing.assert_allclose(found.low[found.time == t], slots[:, 1].mean(axis=1), rtol=1e-9)
    # The first reading of a row is the same either way, the others are not.
    first = np.unique(found.time, return_index=True)[1]
    np.testing.assert_allclose(found.log_score[first], in_turn.log_score[first], rtol=1e-9)
    assert np.abs(found.log_score - in_turn.log_score).max() > 0.1


def test_a_pass_that_misses_one_row_does_not_decide_the_mixture():
    good = np.full(60, -2.0)
    bad = np.where(np.arange(60) == 30, -160.0, -2.0)
    found = pooled_increments([good, bad])
    np.testing.assert_allclose(np.delete(found, 30), -2.0, atol=1e-9)
    assert found[30] == pytest.approx(-2.0 - np.log(2.0), abs=1e-9)
    # Lost for good, it counts no more: all rows but the first are those of the other pass.
    lost = np.where(np.arange(60) >= 30, -50.0, -2.0)
    found = pooled_increments([good, lost])
    assert found.sum() == pytest.approx(good.sum() - np.log(2.0), abs=1e-6)
    np.testing.assert_allclose(pooled_increments([good]), good)


def test_mixed_predictions_add_up_row_by_row_and_are_mixtures():
    log = simulate_amigobot(30.0, 2)
    tables = default_model(log).bind(log).tables(np.array([0.05, 0.03, 0.05, 0.05]))[0]
    rng, again = make_rng(5), make_rng(5)
    mixed = predict_by_passes(tables, log.n_steps, 60, rng)
    single = [predict_readings(tables, log.n_steps, 60, again) for _ in range(2)]
    rows = np.bincount(mixed.time, mixed.log_score, log.n_steps)
    np.testing.assert_allclose(rows, mixed.filtered.log_increments, atol=1e-9)
    for name in ("log_score", "low", "high"):
        both = np.sort([getattr(one, name) for one in single], axis=0)
        value = getattr(mixed, name)
        assert ((value >= both[0] - 1e-12) & (value <= both[1] + 1e-12)).all()
    first = mixed.time == mixed.time[0]
    np.testing.assert_allclose(mixed.low[first][0], np.mean([one.low[0] for one in single]), atol=1e-12)


def test_paths_drawn_beside_a_given_one_have_the_smoothers_law_with_few_particles():
    """Five particles, each draw beside the one before: the means and variances of the exact smoother."""
    n_steps, q, r = 12, 0.6, 0.5
    tables = rail_model().bind(rail_log(n_steps, seed=4)).tables(np.array([q, r]))[0]
    mean, variance = kalman.smoother(kalman.linear_model(tables), q, r)
    rng, path, drawn = make_rng(3), np.zeros((n_steps, 1)), []
    for _ in range(6000):
        path = draw_paths_beside(tables, path, 5, 1, rng)[0]
        drawn.append(path[:, 0])
    drawn = np.array(drawn[100:])
    assert (np.abs(drawn.mean(axis=0) - mean) < 0.12 * np.sqrt(variance)).all()
    assert (np.abs(drawn.var(axis=0) / variance - 1.0) < 0.15).all()
    # Negative control: a filter of five particles alone draws other paths.
    alone = [draw_paths(tables, run_filter(tables, n_steps, 5, rng), 1, rng)[0, :, 0] for _ in range(2000)]
    assert np.abs((np.mean(alone, axis=0) - mean) / np.sqrt(variance)).max() > 0.12


def test_a_row_that_all_particles_miss_is_scored_along_the_given_path():
    """A jump of ten standard deviations that the readings show: the least wrong particle stood for the robot."""
    n_steps, q, r, jump = 20, 0.1, 0.02, 10
    tables = rail_model().bind(rail_log(n_steps, seed=4)).tables(np.array([q, r]))[0]
    path = np.full((n_steps, 1), float(tables.start.mean[0]))
    for t in range(1, n_steps):
        path[t] = tables.motion.coefficient * path[t - 1] + tables.motion.control[t] + 10.0 * q * (t == jump)
    (sensor,) = tables.sensors
    tables = tables._replace(sensors=(sensor._replace(reading=path[:, 0].copy()),))
    rng = make_rng(1)
    alone = draw_paths(tables, run_filter(tables, n_steps, 200, rng), 5, rng)
    beside = draw_paths_beside(tables, path, 200, 5, rng)
    columns = [np.ascontiguousarray(paths.transpose(0, 2, 1)) for paths in (alone, beside)]
    densities = [smc.sensor_terms(tables.sensors[0], one)[:, jump].mean() for one in columns]
    assert densities[0] < -100.0
    assert densities[1] > 0.0
