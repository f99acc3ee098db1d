"""Tables with extras: plain where those are neutral, normalised with every effect in them, as their definitions say."""

from __future__ import annotations

import math

import numpy as np
import pytest
from oracles import densities, made_tables
from scipy import integrate, stats

from pmcl.engine import contract
from pmcl.engine.compile import entry
from pmcl.engine.tables import FieldView, with_extras, with_fields
from pmcl.filtering.kernels import smc
from pmcl.models.sensors.range_beams.kernels.components.noise import draw_echo, echo_below, echo_logpdf
from pmcl.models.sensors.range_beams.table import ring_neighbours
from pmcl.models.starts.table import WiderStart, wider_start
from pmcl.models.tables import Tables

# mypy: disable-error-code="no-untyped-def"

# Most of their time is compiling: each of them has kernels of its own.
pytestmark = pytest.mark.slow


@entry
def compiled_readings(sensor, t, previous, current, logp, scratch):
    contract.reading_logpdf(sensor, t, previous, current, logp, scratch)


@entry
def compiled_one(sensor, t, slot, previous, current, logp, low, high, memory, scratch):
    return contract.one_reading(sensor, t, slot, previous, current, logp, low, high, memory, scratch)


@entry
def compiled_transition(motion, t, previous, current, logp, scratch):
    contract.transition_logpdf(motion, t, previous, current, logp, scratch)


@entry
def compiled_propagate(motion, t, rng, previous, current, scratch):
    contract.propagate(motion, t, rng, previous, current, scratch)


def scratch_for(table, columns):
    return np.full((contract.scratch_rows(table) + 3, columns), np.nan)


def along(table, path):
    """Log density of the readings at each row of a path, compiled."""
    return smc.sensor_terms(table, np.ascontiguousarray(path.T)[None])[0]


def everything(beams, rng):
    """Beams with all effects at once."""
    n_steps, n_beams = beams.reading.shape
    return with_fields(beams, {
        "bias_at": rng.normal(0.0, 0.1, (n_steps, n_beams)),
        "std_factor": rng.uniform(0.5, 2.0, n_steps),
        "growth": rng.uniform(0.0, 0.5, n_beams),
        "tail": 0.2,
        "width": rng.uniform(0.0, 0.4, n_beams),
        "short_weight": rng.uniform(0.0, 0.2, n_beams),
        "short_length": 0.7,
        "no_echo_weight": rng.uniform(0.0, 0.2, n_beams),
        "specular_weight": rng.uniform(0.0, 0.5, n_beams),
        "specular_angle": 0.6,
        "talk_weight": rng.uniform(0.0, 0.3, n_beams),
        "correlation": rng.uniform(-0.3, 0.8, n_beams),
        "lag": rng.uniform(-0.2, 0.6, n_steps),
        "obstacles": np.array([[1.5, 1.0, 0.3, 0.4], [2.5, 0.7, 0.4, 0.6]]),
    })


ALONE = {
    "bias_at": lambda t, b: {"bias_at": np.full((t, b), 0.2)},
    "growth": lambda t, b: {"growth": np.full(b, 0.4)},
    "tail": lambda t, b: {"tail": 0.3},
    "step": lambda t, b: {"step": 0.17},
    "step and tail": lambda t, b: {"step": 0.3, "tail": 0.2},
    "width": lambda t, b: {"width": np.full(b, 0.5)},
    "short": lambda t, b: {"short_weight": np.full(b, 0.3), "short_length": 0.5},
    "no echo": lambda t, b: {"no_echo_weight": np.full(b, 0.3)},
    "specular": lambda t, b: {"specular_weight": np.full(b, 0.8), "specular_angle": 0.4},
    "talk": lambda t, b: {"talk_weight": np.full(b, 0.5)},
    "correlation": lambda t, b: {"correlation": np.full(b, 0.7)},
    "lag": lambda t, b: {"lag": np.full(t, 0.5)},
    "obstacle": lambda t, b: {"obstacles": np.array([[1.8, 0.8, 0.4, 0.7]])},
}


def rounded_or_not(beams, name, rng):
    if name == "everything":
        return everything(beams, rng)
    if name == "everything rounded":
        return with_fields(everything(beams, rng), {"step": 0.2})
    return with_fields(beams, ALONE[name](*beams.reading.shape))


BEAM_CASES = pytest.mark.parametrize("name", [*ALONE, "everything", "everything rounded"])


def test_beams_at_their_nulls_are_plain(rng):
    states = made_tables.poses_in_room(rng, 30)
    beams = made_tables.range_beams(states, rng)
    np.testing.assert_allclose(along(with_extras(beams), states), along(beams, states), rtol=1e-12, atol=1e-12)
    assert with_extras(with_extras(beams)).reading is beams.reading
    assert not contract.looks_back(with_extras(beams))


@BEAM_CASES
def test_one_row_compiled_and_plain_and_the_whole_path_agree(name, rng):
    path = made_tables.poses_in_room(rng, 6)
    path = 0.5 * path + 0.5 * path[2]
    table = rounded_or_not(made_tables.range_beams(path, rng), name, rng)
    whole = along(table, path)
    for t in range(6):
        before = path[max(t - 1, 0)][:, None].copy()
        results = []
        for function in (compiled_readings, contract.reading_logpdf):
            logp = np.zeros(1)
            with np.errstate(all="ignore"):
                function(table, t, before, path[t][:, None].copy(), logp, scratch_for(table, 1))
            results.append(logp[0])
        np.testing.assert_allclose(results, whole[t], rtol=1e-9, atol=1e-12)
    # A path shorter than the log, and one of fewer rows than a pose has components.
    np.testing.assert_allclose(along(table, path[:4]), whole[:4], rtol=1e-10)
    short = np.array(smc.joint_terms(_tables(path, table), path[:2])[1])
    alone = np.array(smc.joint_terms(_tables(path, ()), path[:2])[1])
    np.testing.assert_allclose(short - alone, whole[:2], rtol=1e-9, atol=1e-9)


def _tables(path, sensor):
    motion = made_tables.increment_motion(np.random.default_rng(1), len(path))
    return Tables(made_tables.gaussian_start(), motion, (sensor,) if sensor != () else ())


@BEAM_CASES
def test_readings_have_the_density_of_their_definition(name, rng):
    path = made_tables.poses_in_room(rng, 6)
    path = 0.5 * path + 0.5 * path[2]
    table = rounded_or_not(made_tables.range_beams(path, rng), name, rng)
    expected = [densities.range_readings_with_extras(table, t, path[max(t - 1, 0)], path[t]) for t in range(6)]
    np.testing.assert_allclose(along(table, path), expected, rtol=1e-7, atol=1e-9)


def test_the_probabilities_of_everything_that_a_rounding_sensor_prints_add_up_to_one():
    """Steps that divide the greatest range and others; an echo of 3.95 m is printed as 4.0 m from 3.875 m on."""
    for step, longest in ((0.25, 4.0), (0.3, 4.0), (0.7, 4.0)):
        table = with_extras(made_tables.range_beams(made_tables.poses_in_room(np.random.default_rng(1), 6),
                                                    np.random.default_rng(1), outliers=False))  # fmt: skip
        table = with_fields(table._replace(max_range=longest), {"step": step})
        draws = draw_echo(table, np.full(40000, 3.95), np.full(40000, 0.15), np.random.default_rng(2))
        printed, counts = np.unique(np.round(draws, 9), return_counts=True)
        multiples = np.append(np.arange(0.0, longest - 1e-9, step), longest)
        assert np.isin(printed, np.round(multiples, 9)).all()
        for centre, std in ((3.95, 0.15), (0.1, 0.3), (2.0, 1.0)):
            logs = np.array([echo_logpdf(table, z, centre, std) for z in multiples])
            widths = [min(z + 0.5 * step, longest) - (z - 0.5 * step) for z in multiples]
            widths[0] = widths[-1] = 1.0
            assert np.sum(np.exp(logs) * widths) == pytest.approx(1.0, abs=1e-9)
            low, high = np.array([echo_below(table, z, centre, std) for z in multiples]).T
            np.testing.assert_allclose(high - low, np.exp(logs) * widths, atol=1e-9)
            np.testing.assert_allclose(low[1:], high[:-1], atol=1e-12)
        expected = np.exp(echo_logpdf(table, longest, 3.95, 0.15))
        share = counts[-1] / counts.sum()
        assert abs(share - expected) < 5.0 * np.sqrt(expected * (1.0 - expected) / counts.sum())
        if step == 0.25:
            assert expected == pytest.approx(stats.norm.sf(-0.5), abs=1e-9)


# Off its steps a rounded reading counts as the one that it would be rounded to, which the ends hold as probabilities.
@pytest.mark.parametrize("name", [name for name in (*ALONE, "everything") if not name.startswith("step")])
def test_the_density_of_a_reading_integrates_to_one(name, rng):
    """Over all lengths, with the probabilities of the two clipped ones; each beam, at several poses."""
    n = 6001
    pair = made_tables.poses_in_room(rng, 2)
    pair[1] = 0.8 * pair[0] + 0.2 * pair[1]
    base = made_tables.range_beams(made_tables.poses_in_room(rng, 6), rng, open_room=False)
    longest, n_beams = base.max_range, base.reading.shape[1]
    grid = np.concatenate([np.linspace(0.0, longest, n)[1:-1], [0.0, longest]])
    reading = np.full((2 * grid.size, n_beams), 1.0)
    reading[1::2] = grid[:, None]  # every second row; the rows between are the echoes before
    base = base._replace(reading=reading, measured=np.full(2 * grid.size, n_beams))
    table = rounded_or_not(base, name, rng)
    extras = table.extras
    table = with_fields(table, {
        "bias_at": np.tile(extras.bias_at[1], (2 * grid.size, 1)),
        "std_factor": np.full(2 * grid.size, extras.std_factor[1]),
        "lag": np.full(2 * grid.size, extras.lag[1]),
    })  # fmt: skip
    path = np.tile(pair, (grid.size, 1))
    for beam in range(n_beams):
        # Only this beam is read at the rows in question.
        only = np.full_like(reading, np.nan)
        only[:, beam] = reading[:, beam]
        density = np.exp(along(table._replace(reading=only), path)[1::2])
        edges = np.linspace(0.0, longest, n)[1:-1]
        total = integrate.simpson(density[:-2], x=edges) + density[-2] + density[-1]
        assert total == pytest.approx(1.0, abs=5e-3)


@BEAM_CASES
def test_single_readings_add_up_and_know_their_distribution(name, rng):
    """Slot by slot: densities add up to the row's, and the probability of less grows as the density says."""
    n_particles = 7
    current = made_tables.poses_in_room(rng, n_particles).T.copy()
    previous = current + 0.05 * rng.standard_normal(current.shape)
    base = made_tables.range_beams(made_tables.poses_in_room(rng, 6), rng)
    table = rounded_or_not(base, name, rng)
    n_beams, t = base.reading.shape[1], 2
    reading = table.reading.copy()
    reading[1] = 1.0
    table = table._replace(reading=reading)
    draft, memory = np.zeros((3, n_particles)), np.zeros((3, n_particles))
    whole, added = np.zeros(n_particles), np.zeros(n_particles)
    compiled_readings(table, t, previous, current, whole, scratch_for(table, n_particles))
    scratch = scratch_for(table, n_particles)
    for slot in range(*contract.reading_slots(table, t)):
        seen = compiled_one(table, t, slot, previous, current, *draft, memory, scratch)
        if seen:
            added += draft[0]
            assert (draft[1] <= draft[2] + 1e-12).all()
    np.testing.assert_allclose(added, whole, rtol=1e-9)
    longest = table.max_range
    edges = np.linspace(0.0, longest, 4001)
    for beam in range(0, n_beams, 2):
        low, high, density = [], [], []
        for z in edges:
            other = reading.copy()
            other[t, beam] = z
            asked = table._replace(reading=other)
            for slot in sorted({t * n_beams, t * n_beams + beam}):  # the first slot of a row prepares the others
                compiled_one(asked, t, slot, previous, current, *draft, memory, scratch)
            density.append(np.exp(draft[0]))
            low.append(draft[1].copy())
            high.append(draft[2].copy())
        low, high, density = np.array(low), np.array(high), np.array(density)
        np.testing.assert_allclose(low[0], 0.0, atol=1e-12)
        np.testing.assert_allclose(high[-1], 1.0, atol=1e-12)
        np.testing.assert_allclose(high[0], density[0], rtol=1e-9)
        np.testing.assert_allclose(high[-1] - low[-1], density[-1], rtol=1e-7, atol=1e-9)
        inner = integrate.cumulative_trapezoid(density[1:-1], edges[1:-1], axis=0, initial=0.0)
        if table.extras.step == 0.0:
            np.testing.assert_allclose(low[1:-1] - low[1], inner, atol=1e-2)
        else:
            # Rounded: within a cell the two are the cell's edges, and their difference is the cell's probability.
            middle = np.arange(1, len(edges) - 1)
            step = table.extras.step
            centre = np.floor(edges[middle] / step + 0.5) * step
            width = np.minimum(centre + 0.5 * step, longest) - (centre - 0.5 * step)
            shortest, last = densities.rounding_ends(FieldView(table))
            # Readings that are printed as 0 or as the greatest range have probabilities.
            width = np.where((edges[middle] >= shortest) & (edges[middle] < last), width, 1.0)
            if name.startswith("step"):
                plain = base.outlier_weight[beam] == 0.0
                if plain:
                    np.testing.assert_allclose((high - low)[middle] / width[:, None], density[middle], rtol=1e-6)


def test_neighbours_are_those_by_direction():
    pose = np.zeros((5, 3))
    pose[:, 2] = [0.1, 3.0, -1.0, 1.5, -2.5]
    np.testing.assert_array_equal(ring_neighbours(pose), [[3, 2], [4, 3], [0, 4], [1, 0], [2, 1]])


# Motion


def far_tables(rng, **changes):
    return with_fields(with_extras(made_tables.increment_motion(rng)), changes)


MOTIONS = {
    "plain": {},
    "tail": {"tail": 0.3},
    "slip": {"slip_weight": 0.3, "slip_share": 0.8},
    "patches": {"patches": np.array([[0.5, -0.3, 0.4, 0.6], [0.4, -0.2, 0.5, 0.3], [9.0, 9.0, 1.0, 0.5]])},
    "all": {
        "tail": 0.2, "slip_weight": 0.4, "slip_share": 0.9, "patches": np.array([[0.5, -0.3, 0.4, 0.6]]),
    },
}  # fmt: skip


def step_logpdf(motion, t, before, after):
    """The density of a step written again from the definition."""
    motion = FieldView(motion)
    grip = np.prod([1.0 - e for x, y, r, e in motion.patches if math.hypot(before[0] - x, before[1] - y) < r])
    c, s = math.cos(before[2]), math.sin(before[2])
    dx, dy = after[0] - before[0], after[1] - before[1]
    moved = np.array([c * dx + s * dy, c * dy - s * dx, after[2] - before[2]])
    law = stats.norm if motion.tail == 0.0 else stats.t(1.0 / motion.tail)

    def density(share):
        mean = motion.mean[t] * np.array([share, share, 1.0])
        if before.size > 3:
            mean[2] += motion.wander[t] * before[3]
        return float((law.logpdf((moved - mean) / motion.std[t]) - np.log(motion.std[t])).sum())

    weight = motion.slip_weight
    value = density(grip)
    if weight > 0.0:
        value = np.logaddexp(math.log1p(-weight) + value, math.log(weight) + density(grip * (1.0 - motion.slip_share)))
    if before.size > 3:
        keep = motion.keep[t]
        value += stats.norm.logpdf(after[3], keep * before[3], math.sqrt(1.0 - keep**2))
    return value


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("wanders", [False, True])
@pytest.mark.parametrize("name", MOTIONS)
def test_transitions_have_the_density_of_their_definition(name, wanders, compiled, rng):
    motion = far_tables(rng, **MOTIONS[name])
    if wanders:
        motion = with_fields(motion, {"wander": np.full(6, 0.3), "keep": np.full(6, 0.8)})
    size = 4 if wanders else 3
    before = np.array([0.5, -0.3, 2.0, 0.7])[:size] + rng.normal(0.0, 0.3, (9, size))
    after = before[4] + rng.normal(0.0, 0.3, size)
    expected = [step_logpdf(motion, 3, state, after) for state in before]
    logp = np.zeros(9)
    function = compiled_transition if compiled else contract.transition_logpdf
    function(motion, 3, np.ascontiguousarray(before.T), after, logp, scratch_for(motion, 9))
    np.testing.assert_allclose(logp, expected, rtol=1e-9)
    path = np.cumsum(rng.normal(0.0, 0.3, (6, size)), axis=0)
    terms = smc.motion_terms(start_of(size), motion, np.ascontiguousarray(path.T)[None])[0]
    expected = [step_logpdf(motion, t, path[t - 1], path[t]) for t in range(1, 6)]
    np.testing.assert_allclose(terms[1:], expected, rtol=1e-9)


def start_of(size):
    start = made_tables.gaussian_start()
    return start if size == 3 else wider_start(start, 0.0, 1.0)


def test_motion_at_its_nulls_is_plain(rng):
    plain, path = made_tables.increment_motion(rng), np.cumsum(rng.normal(0.0, 0.3, (6, 3)), axis=0)
    columns = np.ascontiguousarray(path.T)[None]
    expected = smc.motion_terms(start_of(3), plain, columns)[0]
    np.testing.assert_allclose(smc.motion_terms(start_of(3), with_extras(plain), columns)[0], expected, rtol=1e-12)
    # A fourth component that nothing depends on is integrated out to nothing.
    wandering = with_fields(plain, {"keep": np.full(6, 0.9)})
    np.testing.assert_allclose(smc.motion_terms(start_of(4), wandering, columns)[0], expected, rtol=1e-12)


def test_a_wandering_turn_rate_is_integrated_out_exactly(rng):
    """The collapsed density of a pose path, against the dense Gaussian of all its turns."""
    n = 12
    plain = made_tables.increment_motion(rng, n)
    keep, wander = rng.uniform(0.6, 0.95, n), rng.uniform(0.1, 0.5, n)
    motion = with_fields(plain, {"keep": keep, "wander": wander})
    path = np.cumsum(rng.normal(0.0, 0.3, (n, 3)), axis=0)
    # u[0] is standard normal; turn t follows u[t - 1].
    covariance_u = np.eye(n)
    for i in range(n):
        for j in range(i):
            covariance_u[i, j] = covariance_u[j, i] = np.prod(keep[j + 1 : i + 1])
    covariance = np.outer(wander[1:], wander[1:]) * covariance_u[:-1, :-1] + np.diag(plain.std[1:, 2] ** 2)
    turns = np.diff(path[:, 2]) - plain.mean[1:, 2]
    columns = np.ascontiguousarray(path.T)[None]
    found = smc.motion_terms(start_of(4), motion, columns)[0][1:].sum()
    flat = smc.motion_terms(start_of(3), plain, columns)[0][1:].sum()
    alone = stats.norm.logpdf(turns, 0.0, plain.std[1:, 2]).sum()
    exact = flat - alone + stats.multivariate_normal(np.zeros(n - 1), covariance).logpdf(turns)
    assert found == pytest.approx(exact, rel=1e-10)


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("name", MOTIONS)
def test_drawn_steps_have_the_transition_density(name, compiled, rng):
    """Importance weights against the plain motion with wider noise have mean one; and moments agree."""
    n = 40_000 if compiled else 4_000
    motion = with_fields(far_tables(rng, **MOTIONS[name]), {"wander": np.full(6, 0.3), "keep": np.full(6, 0.8)})
    before = np.repeat(np.array([[0.5], [-0.3], [2.2], [0.9]]), n, axis=1)
    current = np.empty((4, n))
    function = compiled_propagate if compiled else contract.propagate
    function(motion, 3, rng, before, current, scratch_for(motion, n))
    c, s = math.cos(2.2), math.sin(2.2)
    dx, dy = current[0] - 0.5, current[1] + 0.3
    moved = np.stack([c * dx + s * dy, c * dy - s * dx, current[2] - 2.2], axis=-1)
    motion = FieldView(motion)
    law = stats.norm if motion.tail == 0.0 else stats.t(1.0 / motion.tail)
    grip = np.prod([1.0 - e for x, y, r, e in motion.patches if math.hypot(0.5 - x, -0.3 - y) < r])
    for d in range(3):
        shares = (grip, grip * (1.0 - motion.slip_share)) if d < 2 else (1.0, 1.0)
        wander = motion.wander[3] * 0.9 if d == 2 else 0.0
        weights = (1.0 - motion.slip_weight, motion.slip_weight)

        def cdf(x, d=d, shares=shares, wander=wander, weights=weights):
            return sum(
                weight * law.cdf((x - share * motion.mean[3, d] - wander) / motion.std[3, d])
                for weight, share in zip(weights, shares, strict=True)
            )

        assert stats.kstest(moved[:, d], cdf).pvalue > 1e-5
    assert stats.kstest((current[3] - 0.8 * 0.9) / 0.6, "norm").pvalue > 1e-5


def test_wider_starts(rng):
    start = wider_start(made_tables.pose_start("room"), 0.3, 2.0)
    assert isinstance(start, WiderStart)
    draws = np.empty((4, 5000))
    contract.draw_start(start, rng, draws)
    assert stats.kstest((draws[3] - 0.3) / 2.0, "norm").pvalue > 1e-5
    logp, plain = np.zeros(5000), np.zeros(5000)
    contract.start_logpdf(start, draws, logp)
    contract.start_logpdf(start.pose, draws[:3], plain)
    np.testing.assert_allclose(logp - plain, stats.norm.logpdf(draws[3], 0.3, 2.0), atol=1e-12)
    collapsed = np.zeros(5000)
    contract.start_logpdf(start, draws[:3], collapsed)
    np.testing.assert_array_equal(collapsed, plain)


# Sightings


def sightings_with_extras(n_steps, rng, **changes):
    seen = with_extras(made_tables.sightings(n_steps, rng))
    full = {
        "lag": rng.uniform(-0.2, 0.5, n_steps),
        "range_growth": rng.uniform(0.0, 0.4, 4),
        "bearing_falloff": rng.uniform(0.0, 2.0, 4),
        "depth": 0.6,
        "misread_weight": np.array([0.0, 0.2, 0.5, 0.1]),
        "range_correlation": np.array([0.0, 0.7, 0.3, 0.9]),
        "bearing_correlation": np.array([0.5, 0.6, 0.0, 0.9]),
    }
    return with_fields(seen, {**full, **changes})


def same_landmarks_again(seen):
    """Sightings of which many are of landmarks that the row before saw as well; the first row reads everything."""
    channels = {"range": seen.range.copy(), "bearing": seen.bearing.copy()}
    for values in channels.values():
        values[:2] = np.where(np.isnan(values[:2]), 1.5, values[:2])
    return seen._replace(landmark=np.resize([1, 3, 3, 1, 0], seen.landmark.size).astype(np.int64), **channels)


def wrapped(angle):
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def errors_before(seen, t, named, before):
    """Residual and standard deviation of distance and bearing of a landmark in the row before t; NaN: unrelated."""
    seen, error, spread = FieldView(seen), np.full(2, math.nan), np.ones(2)
    c, s = math.cos(before[2]), math.sin(before[2])
    for k in range(seen.first[max(t - 1, 0)], seen.first[t]):
        if seen.landmark[k] != named:
            continue
        delta = seen.position[named] - before[:2]
        ahead = c * delta[0] + s * delta[1] - seen.sensor_pose[0]
        aside = c * delta[1] - s * delta[0] - seen.sensor_pose[1]
        distance, bearing = math.hypot(ahead, aside), math.atan2(aside, ahead) - seen.sensor_pose[2]
        read = distance * (1.0 - seen.depth + seen.depth * math.cos(bearing))
        error[0] = seen.range[k] - seen.range_scale[named] * read - seen.range_bias[named]
        error[1] = wrapped(seen.bearing[k] - bearing - seen.bearing_bias[named])
        spread[0] = seen.range_std[named] * (1.0 + seen.range_growth[named] * distance)
        spread[1] = seen.bearing_std[named] * (1.0 + seen.bearing_falloff[named] / max(distance, 0.1))
    return np.where(np.abs(error) < 4.0 * spread, error, math.nan)


def sighting_density(seen, t, before, now):
    """The density of a row of sightings written again from the definition."""
    table, seen = seen, FieldView(seen)
    pose = now - seen.lag[t] * (now - before)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    total = 0.0
    for k in range(seen.first[t], seen.first[t + 1]):
        named = seen.landmark[k]
        error = errors_before(table, t, named, before)
        known = ~np.isnan(error)
        last = np.where(known, [seen.range_correlation[named], seen.bearing_correlation[named]], 0.0)
        shift, narrower = np.where(known, last * np.nan_to_num(error), 0.0), np.sqrt(1.0 - last**2)
        hypotheses, outlier = [], 0.0
        for j in range(len(seen.position)):
            delta = seen.position[j] - pose[:2]
            ahead = c * delta[0] + s * delta[1] - seen.sensor_pose[0]
            aside = c * delta[1] - s * delta[0] - seen.sensor_pose[1]
            distance, bearing = math.hypot(ahead, aside), math.atan2(aside, ahead) - seen.sensor_pose[2]
            value = outlier = 0.0
            # Another landmark has no memory of this one's errors.
            by, share = (shift, narrower) if j == named else (np.zeros(2), np.ones(2))
            if not math.isnan(seen.range[k]):
                read = distance * (1.0 - seen.depth + seen.depth * math.cos(bearing))
                expected = seen.range_scale[j] * read + seen.range_bias[j]
                std = seen.range_std[j] * (1.0 + seen.range_growth[j] * distance)
                value += stats.norm.logpdf(seen.range[k], expected + by[0], share[0] * std)
                outlier -= math.log(seen.max_range)
            if not math.isnan(seen.bearing[k]):
                residual = wrapped(wrapped(seen.bearing[k] - bearing - seen.bearing_bias[j]) - by[1])
                std = seen.bearing_std[j] * (1.0 + seen.bearing_falloff[j] / max(distance, 0.1))
                value += stats.norm.logpdf(residual, 0.0, share[1] * std)
                outlier -= math.log(2.0 * math.pi)
            if not math.isnan(seen.size[k]):
                ideal = seen.size_constant[j] / distance**2
                value += stats.norm.logpdf(seen.size[k], ideal, seen.size_std[j] * ideal)
                outlier -= math.log(seen.size_constant[named])
            hypotheses.append(value)
        misread, wild = seen.misread_weight[named], seen.outlier_weight[named]
        weights = np.full(len(hypotheses), misread / (len(hypotheses) - 1))
        weights[named] = 1.0 - misread
        with np.errstate(divide="ignore"):
            sound = np.logaddexp.reduce(np.log(weights) + np.array(hypotheses))
            total += np.logaddexp(math.log1p(-wild) + sound, np.log(wild) + outlier)
    return total


@pytest.mark.parametrize("compiled", [True, False])
def test_sightings_have_the_density_of_their_definition(compiled, rng):
    n_steps = 6
    path = rng.uniform([1.0, 1.0, -3.0], [3.0, 3.0, 3.0], (n_steps, 3))
    seen = same_landmarks_again(sightings_with_extras(n_steps, rng))
    related = [~np.isnan(errors_before(seen, t, j, path[t - 1])) for t in range(1, n_steps) for j in range(4)]
    assert np.any(related, axis=0).all()
    expected = [sighting_density(seen, t, path[max(t - 1, 0)], path[t]) for t in range(6)]
    if compiled:
        np.testing.assert_allclose(along(seen, path), expected, rtol=1e-8)
        np.testing.assert_allclose(along(seen, path[:4]), expected[:4], rtol=1e-8)
    else:
        logp, columns = np.zeros(n_steps), np.ascontiguousarray(path.T)
        contract.path_reading_logpdf(seen, n_steps, columns, logp, scratch_for(seen, n_steps))
        np.testing.assert_allclose(logp, expected, rtol=1e-8)
    one_row = compiled_readings if compiled else contract.reading_logpdf
    for t in range(6):
        logp = np.zeros(1)
        before = path[max(t - 1, 0)][:, None].copy()
        one_row(seen, t, before, path[t][:, None].copy(), logp, scratch_for(seen, 1))
        assert logp[0] == pytest.approx(expected[t], rel=1e-8)


def test_sightings_at_their_nulls_are_plain(rng):
    path = rng.uniform([1.0, 1.0, -3.0], [3.0, 3.0, 3.0], (6, 3))
    seen = made_tables.sightings(6, rng)
    np.testing.assert_allclose(along(with_extras(seen), path), along(seen, path), rtol=1e-9)
    assert not contract.looks_back(with_extras(seen))
    assert contract.looks_back(with_fields(seen, {"bearing_correlation": np.array([0.0, 0.0, 0.0, 0.5])}))


@pytest.mark.parametrize("changes", [{}, {"misread_weight": np.zeros(4)}])
def test_single_channels_of_sightings_add_up_and_know_their_distribution(changes, rng):
    n, t = 5, 1
    current = rng.uniform([1.0, 1.0, -3.0], [3.0, 3.0, 3.0], (n, 3)).T.copy()
    previous = current + 0.1 * rng.standard_normal(current.shape)
    seen = same_landmarks_again(sightings_with_extras(6, rng, **changes))
    draft, memory = np.zeros((3, n)), np.zeros((3, n))
    whole, added = np.zeros(n), np.zeros(n)
    compiled_readings(seen, t, previous, current, whole, scratch_for(seen, n))
    for slot in range(*contract.reading_slots(seen, t)):
        if compiled_one(seen, t, slot, previous, current, *draft, memory, scratch_for(seen, n)):
            added += draft[0]
    np.testing.assert_allclose(added, whole, rtol=1e-8)
    # Distances: the probability of less grows as the density says.
    k = int(np.flatnonzero(~np.isnan(seen.range[seen.first[t] : seen.first[t + 1]]))[0] + seen.first[t])
    edges, low, density = np.linspace(-6.0, 14.0, 4001), [], []
    for z in edges:
        values = seen.range.copy()
        values[k] = z
        table = seen._replace(range=values, outlier_weight=np.zeros(4))
        compiled_one(table, t, 3 * k, previous, current, *draft, memory, scratch_for(seen, n))
        low.append(draft[1].copy())
        density.append(np.exp(draft[0]))
    inner = integrate.cumulative_trapezoid(np.array(density), edges, axis=0, initial=0.0)
    np.testing.assert_allclose(np.array(low), inner, atol=2e-3)
    # Bearings: the same within the turn around what each state expects; where the next turn begins, it starts anew.
    k = int(np.flatnonzero(~np.isnan(seen.bearing[seen.first[t] : seen.first[t + 1]]))[0] + seen.first[t])
    edges, low, density = np.linspace(-math.pi, math.pi, 2001), [], []
    for z in edges:
        values = seen.bearing.copy()
        values[k] = z
        table = seen._replace(bearing=values, range=np.where(np.arange(values.size) == k, np.nan, seen.range))
        compiled_one(table, t, 3 * k + 1, previous, current, *draft, memory, scratch_for(seen, n))
        low.append(draft[1].copy())
        density.append(np.exp(draft[0]))
    rise, density = np.diff(low, axis=0), np.array(density)
    assert ((rise < -1e-3).sum(axis=0) <= 4).all()
    rise = np.where(rise < -1e-3, np.nan, rise) / (edges[1] - edges[0])
    between = np.isnan(rise)
    np.testing.assert_allclose(rise[~between], (0.5 * (density[1:] + density[:-1]))[~between], atol=2e-2)
