"""Eqs. 21 and 24: each particle moves with a draw of its own, readings average over draws; against a plain twin."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from localization.posteriors import around
from oracles import densities
from oracles.monte_carlo import assert_agrees
from oracles.random_walk_model import rail_log, rail_model
from scipy import special

import pmcl
from pmcl.engine.compile import entry
from pmcl.engine.parameter_draws import is_shared, log_likelihood
from pmcl.engine.random_numbers import normals_into
from pmcl.engine.views import columns, take
from pmcl.errors import ModelError
from pmcl.filtering.particle_filter import make_rng
from pmcl.filtering.tracker import Options, Tracker, stack_tables
from pmcl.geometry import circular_mean, wrap
from pmcl.localization.many import localize_many
from pmcl.localization.options import FilterOptions
from pmcl.models.effects.selection import effect_named
from pmcl.models.robot_model import RobotModel
from pmcl.models.sensors.range_beams.sensor import RangeNoise
from pmcl.models.sensors.range_beams.table import RangeBeams
from pmcl.models.tables import Tables

N, ROWS, DRAWS, PICKS = 30, 5, 4, 3


# Stacks


def _tables(count, rng):
    walls = np.zeros((2, 2)), np.zeros(1, dtype=np.int64), np.ones(1, dtype=np.int64)
    reading, mount, flat = np.ones((3, 2)), np.zeros((2, 3)), np.zeros(2)
    return [
        RangeBeams(reading, np.full(3, 2), mount.copy(), flat, flat, rng.uniform(0.1, 1.0, 2), flat, 5.0 + k, *walls)
        for k in range(count)
    ]


@entry
def _taken(base, stack, k):
    one = take(base, stack, k)
    return one.std[1], one.max_range, one.reading[0, 0], one.beam_pose.size, is_shared(base, stack)


def test_a_stack_holds_each_draw_and_shares_what_is_common(rng):
    tables = _tables(3, rng)
    stack = stack_tables(tables)
    assert stack.reading is tables[0].reading
    assert stack.beam_pose is tables[0].beam_pose  # equal, though not the same array
    assert stack.std.shape == (3, 2)
    for k, table in enumerate(tables):
        for one in (take(tables[0], stack, k), take((tables[0],), (stack,), k)[0]):
            assert type(one) is RangeBeams
            for name in RangeBeams._fields:
                np.testing.assert_array_equal(getattr(one, name), getattr(table, name))
        assert _taken(tables[0], stack, k) == (table.std[1], 5.0 + k, 1.0, 6, False)
    assert stack_tables(tables[:1]) is tables[0]
    assert _taken(tables[0], tables[0], 0)[4]
    assert is_shared(tables[0], stack_tables([tables[0], tables[0]]))
    assert not is_shared(tables[0], stack)


def test_draws_of_other_shapes_are_refused(rng):
    first, second = _tables(2, rng)
    with pytest.raises(ModelError, match="one shape for all draws"):
        stack_tables([first, second._replace(reading=np.ones((4, 2)))])


@entry
def _column(flat, rows, n):
    return columns(flat, rows, n)[rows - 1, n - 1], columns(flat, rows, n).sum()


def test_columns():
    flat = np.arange(10.0)
    np.testing.assert_array_equal(columns(flat, 2, 3), [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]])
    assert _column(flat, 2, 3) == (5.0, 15.0)


# The filter against its twin, which uses the same random numbers in the same order


def _options(draws, picks):
    return Options(N, N, N, draws, picks, 0, 0.0, 0, False, 0.5, 0.1, 1.0, 2.0, 0.2, 0.3, 0.05, 2.33)


def _twin(all_tables, picks, rng, move, density, circular):
    """Filter without resampling: (mean, covariance, log score, effective size) of each row."""
    base, draws = all_tables[0], len(all_tables)
    size = base.start.mean.size
    log_weights, shuffled, found = np.full(N, -np.log(N)), list(range(draws)), []
    for t in range(ROWS):
        if picks < draws:
            for j in range(picks):
                other = j + int(rng.random() * (draws - j))
                shuffled[j], shuffled[other] = shuffled[other], shuffled[j]
        if t == 0:
            states = (base.start.mean[:, None] + base.start.std[:, None] * rng.standard_normal((size, N))).T
        else:
            which = (rng.random(N) * draws).astype(int) if draws > 1 else np.zeros(N, dtype=int)
            states = move(all_tables, t, states, which, rng)
        each = [[density(all_tables[k], t, state) for k in shuffled[:picks]] for state in states]
        log_weights = log_weights + special.logsumexp(each, axis=1) - np.log(picks)
        score = special.logsumexp(log_weights)
        log_weights = log_weights - score
        weights = np.exp(log_weights)
        mean = weights @ states
        deviation = states - mean
        if circular:
            mean[2] = circular_mean(states[:, 2], weights)
            deviation[:, 2] = wrap(states[:, 2] - mean[2])
        found.append((mean, (weights[:, None] * deviation).T @ deviation, score, 1.0 / (weights**2).sum()))
    return [np.array(column) for column in zip(*found, strict=True)]


def _assert_twins(all_tables, picks, seed, counts, **plain):
    tracker = Tracker(all_tables, None, _options(len(all_tables), picks))
    beliefs = tracker.run(0, ROWS, counts, make_rng(seed), "test")
    for compiled, expected in zip(beliefs, _twin(all_tables, picks, make_rng(seed), **plain), strict=False):
        np.testing.assert_allclose(compiled, expected, rtol=1e-8, atol=1e-10)


@entry
def draw_normals(rng, n):
    out = np.empty((3, n))
    normals_into(rng, out, np.empty(n))
    return out


def _move_poses(all_tables, t, states, which, rng):
    normals = draw_normals(rng, N).T
    mean = np.array([all_tables[k].motion.mean[t] for k in which])
    std = np.array([all_tables[k].motion.std[t] for k in which])
    forward, left, turn = (mean + std * normals).T
    c, s = np.cos(states[:, 2]), np.sin(states[:, 2])
    return states + np.stack([c * forward - s * left, s * forward + c * left, turn], axis=-1)


def _read_walls(tables, t, state):
    return densities.range_readings(tables.sensors[0], t, state)


EFFECTS = {
    "plain": (),
    "motion mean, noise that only one draw has": ("odometry-turn-scale", "random-readings"),
    "mounts": ("sensor-yaw",),
}


@pytest.mark.slow
@pytest.mark.parametrize("draws", [1, DRAWS])
@pytest.mark.parametrize("effects", EFFECTS)
def test_the_filter_is_its_twin(room_log, theta, effects, draws, rng):
    """Noise alone, effects on motion and mixture, and mounts that differ, for which each draw casts its own rays."""
    model = RobotModel(
        sensors=(RangeNoise(),), effects=tuple(effect_named(name, room_log) for name in EFFECTS[effects])
    )
    bound = model.bind(room_log.select(0, ROWS))
    values = np.abs(rng.normal(0.1, 0.03, (draws, bound.dimension)))
    values[:, :4] = np.array(list(theta.values())) * rng.uniform(0.7, 1.4, (draws, 4))
    tables = [bound.tables(value)[0] for value in values]
    counts = np.full(ROWS, 8, dtype=np.int64)
    picks = min(PICKS, draws)
    _assert_twins(tables, picks, 3, counts, move=_move_poses, density=_read_walls, circular=True)


def _move_cart(all_tables, t, states, which, rng):
    # Particles are moved draw by draw.
    order = np.argsort(which, kind="stable")
    normals = np.empty(N)
    normals[order] = rng.standard_normal(N)
    motion = all_tables[0].motion
    std = np.array([all_tables[k].motion.std[t] for k in which])
    return motion.coefficient * states + motion.control[t] + (std * normals)[:, None]


def _read_position(tables, t, state):
    z, std = tables.sensors[0].reading[t], tables.sensors[0].std
    return -0.5 * ((z - state[0]) / std) ** 2 - np.log(std * np.sqrt(2.0 * np.pi))


@pytest.mark.parametrize(
    "free",
    [
        ("process_std", "reading_std"),
        pytest.param(("process_std",), marks=pytest.mark.slow),
        pytest.param(("reading_std",), marks=pytest.mark.slow),
    ],
)
def test_a_users_own_model_is_its_twin(free, rng):
    """Types that pmcl does not know go the general way, and parts that all draws share are not treated as draws."""
    log = rail_log(ROWS, seed=2)
    values = {"process_std": rng.uniform(0.2, 0.9, DRAWS), "reading_std": rng.uniform(0.2, 0.9, DRAWS)}
    values = {name: given if name in free else np.full(DRAWS, 0.5) for name, given in values.items()}
    bound = rail_model().bind(log)
    tables = [bound.tables(np.array(theta))[0] for theta in zip(*values.values(), strict=True)]
    plain = {"move": _move_cart, "density": _read_position, "circular": False}
    if "process_std" not in free:
        # No draw is chosen for motion then: the twin's choices would use up random numbers.
        plain["move"] = _move_shared
    twin_rng = _Choosy(2) if "process_std" not in free else make_rng(2)
    tracker = Tracker(tables, None, _options(DRAWS, PICKS))
    beliefs = tracker.run(0, ROWS, np.ones(ROWS, dtype=np.int64), make_rng(2), "test")
    for compiled, expected in zip(beliefs, _twin(tables, PICKS, twin_rng, **plain), strict=False):
        np.testing.assert_allclose(compiled, expected, rtol=1e-9, atol=1e-11)


class _Choosy:
    """A generator whose vectors of uniforms, with which draws are chosen for particles, cost nothing."""

    def __init__(self, seed):
        self._rng = make_rng(seed)

    def random(self, n=None):
        return self._rng.random() if n is None else np.zeros(n)

    def standard_normal(self, shape):
        return self._rng.standard_normal(shape)


def _move_shared(all_tables, t, states, which, rng):
    return _move_cart(all_tables, t, states, np.zeros(N, dtype=int), rng)


@entry
def _likelihood(tables, stack, picks, states, out, densities, scratch):
    log_likelihood(tables, stack, 0, picks, states, states, out, densities, scratch)


def test_impossible_and_undefined_readings_of_draws():
    """Weights of zero under some draws or all of them, and NaN, come through the mean of the draws."""
    log = rail_log(ROWS, seed=2)
    bound = rail_model().bind(log)
    tables = [bound.tables(np.array([0.5, std]))[0] for std in (0.4, 0.5, 0.6)]
    stack = stack_tables(tables)
    states = np.array([[50.0, np.inf, np.nan, 1e9]])
    out, work = np.empty(4), np.empty((3, 4))
    _likelihood(tables[0], stack, np.arange(3), states, out, np.empty((3, 4)), work)
    expected = [special.logsumexp([_read_position(one, 0, states[:, 0]) for one in tables]) - np.log(3.0)]
    assert out[0] == pytest.approx(expected[0], rel=1e-12)
    assert out[1] == -np.inf
    assert np.isnan(out[2])
    assert np.isfinite(out[3])


# What it means


@pytest.mark.slow
def test_equal_draws_are_one_draw(room_log, theta):
    """Draws that differ in the tenth digit: the same filter as with their mean, by errors and scores of many runs."""
    data, log = around(theta, 1e-10), room_log.select(0, 30)
    settings = {"repetitions": 300, "particles": 500}
    mean = localize_many(log, None, data, "mean", **settings, seed=1)
    drawn = localize_many(log, None, data, "posterior", **settings, seed=2)
    typical = mean.position_rmse.mean()
    assert_agrees((drawn.position_rmse - mean.position_rmse) / typical, 0.0, matters=0.05)
    assert_agrees(drawn.log_evidence - mean.log_evidence, 0.0, matters=2.0)


def test_draws_that_differ_make_a_belief_wider(room_log, theta):
    """Draws from narrow to wide: the predictive density is a mixture, and its motion has the draws' mean variance."""
    silent = room_log.dataset.copy(deep=True)
    values = room_log.ranges.copy()
    values[1:10] = np.nan
    silent["range"] = silent["range"].copy(data=values)
    silent["range"].attrs = room_log.dataset["range"].attrs
    log = pmcl.RobotLog.from_dataset(silent).select(0, 10)
    data = around(theta, 0.8, shape=(1, 40), seed=3)
    draws = np.asarray(data["posterior"]["sigma_turn"]).ravel()
    track = pmcl.localize(log, None, data, "posterior", particles=20_000, options=FilterOptions(draws=40))
    added = track.pose_cov[9, 2, 2] - track.pose_cov[0, 2, 2]
    assert added == pytest.approx(9.0 * (draws**2).mean(), rel=0.1)
    assert added > 1.3 * 9.0 * draws.mean() ** 2


def test_tables_are_left_as_they_are(room_log, theta):
    data = around(theta, 0.1)
    bound = pmcl.default_model(room_log).bind(room_log)
    tables = [bound.tables(np.array(list(theta.values())) * factor)[0] for factor in (0.9, 1.1)]
    before = copy.deepcopy(tables)
    Tracker(tables, None, _options(2, 2)).run(0, ROWS, np.full(ROWS, 8), make_rng(1), "test")
    for one, kept in zip(tables, before, strict=True):
        assert isinstance(one, Tables)
        np.testing.assert_array_equal(one.motion.std, kept.motion.std)
        np.testing.assert_array_equal(one.sensors[0].std, kept.sensors[0].std)
    assert pmcl.localize(room_log, None, data, "posterior").dataset.attrs["draws"] == 100
