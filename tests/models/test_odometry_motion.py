"""AMCL's odometry models: densities against their definition, draws against densities, statistics, refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from oracles import odometry
from oracles.made_tables import gaussian_start
from scipy import optimize, stats

from pmcl.engine import contract
from pmcl.engine.compile import entry
from pmcl.engine.residuals import theta_logpdf
from pmcl.errors import ModelError
from pmcl.filtering.particle_filter import make_rng
from pmcl.geometry import wrap
from pmcl.logs.robot_log import RobotLog
from pmcl.maps.landmarks import LandmarkMap
from pmcl.models.effects import CATALOGUE
from pmcl.models.motions.increments.motion import IncrementNoise
from pmcl.models.motions.odometry.kernels.residuals import DifferentialResiduals, differential_steps
from pmcl.models.motions.odometry.motion import Differential, Omni
from pmcl.models.motions.odometry.table import DifferentialMotion, OmniMotion
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.models.sensors.landmarks.sensor import LandmarkNoise
from pmcl.models.tables import Tables
from pmcl.simulations.lidar_room import simulate_lidar_room

# Odometry of one step (forward, left, turn) and alphas. Between them are nav2's default, a good robot, wheels so bad
# that directions wrap, a robot that reverses, turns on the spot, creeps below the threshold, and stands.
STEPS = {
    "nav2's default": ((0.25, 0.02, 0.1), (0.2, 0.2, 0.2, 0.2)),
    "good robot": ((0.3, 0.05, 0.3), (0.01, 0.004, 0.003, 0.002)),
    "bad wheels": ((0.2, 0.3, -1.2), (1.5, 4.0, 0.5, 0.3)),
    "reverses": ((-0.25, 0.03, -0.2), (0.1, 0.05, 0.1, 0.05)),
    "turns on the spot": ((0.0, 0.0, 0.8), (0.1, 0.1, 0.1, 0.02)),
    "creeps": ((-0.004, 0.003, 0.2), (0.2, 0.2, 0.2, 0.2)),
    "stands": ((0.0, 0.0, 0.0), (0.2, 0.2, 0.2, 0.2)),
}
BEFORE = np.array([0.7, -0.4, 2.5])


@pytest.fixture
def sfc(rng):
    """The kernels' own kind of generator, seeded from the test's name."""
    return make_rng(int(rng.integers(2**62)))


def differential(mean, alpha):
    return DifferentialMotion(np.array([[np.nan] * 3, mean]), np.array(alpha, dtype=float))


def omni(mean, alpha):
    return OmniMotion(np.array([[np.nan] * 3, mean]), np.array([*alpha, 0.07]))


@entry
def _weigh(motion, before, after, logp, scratch):
    contract.transition_logpdf(motion, 1, before, after, logp, scratch)


@entry
def _draw(motion, rng, before, after, scratch):
    contract.propagate(motion, 1, rng, before, after, scratch)


def log_density(motion, before, after):
    """Log density of one pose after each of `before` (3, n)."""
    logp = np.zeros(before.shape[1])
    _weigh(motion, np.ascontiguousarray(before), after, logp, np.empty((5, logp.size)))
    return logp


def drawn(motion, n, rng):
    current = np.empty((3, n))
    _draw(motion, rng, np.tile(BEFORE[:, None], n), current, np.empty((5, n)))
    return current


def seen_from(before, after):
    """Length and direction of steps in the robot's frame, and their turns."""
    dx, dy = after[0] - before[0], after[1] - before[1]
    return np.hypot(dx, dy), np.arctan2(dy, dx) - before[2], after[2] - before[2]


@pytest.mark.parametrize("case", STEPS)
def test_the_density_of_a_step_is_that_of_the_turns_and_the_drive(case, rng):
    mean, alpha = STEPS[case]
    motion = differential(mean, alpha)
    for after in odometry.differential_draws(mean, alpha, BEFORE, 4, rng):
        before = BEFORE[:, None] + rng.normal(0.0, [[0.02], [0.02], [0.1]], (3, 5)) * [0, 1, 1, 1, 1]
        found = log_density(motion, before, after)
        expected = [odometry.differential_density(mean, alpha, each, after) for each in before.T]
        likely = np.array(expected) > 1e-60
        assert likely[0]
        np.testing.assert_allclose(found[likely], np.log(np.array(expected)[likely]), atol=1e-7)


@pytest.mark.parametrize("case", STEPS)
def test_the_density_of_an_omnidirectional_step_is_gaussian_along_its_direction(case, rng):
    mean, alpha = STEPS[case]
    motion = omni(mean, alpha)
    after = drawn(motion, 1, make_rng(3))[:, 0]
    before = BEFORE[:, None] + rng.normal(0.0, 1e-3, (3, 5))
    expected = [math.log(odometry.omni_density(mean, motion.alpha, each, after)) for each in before.T]
    np.testing.assert_allclose(log_density(motion, before, after), expected, rtol=1e-9)


@pytest.mark.parametrize("case", STEPS)
@pytest.mark.parametrize("kind", [differential, omni])
def test_a_path_and_one_state_have_the_densities_of_many(case, kind):
    motion = kind(*STEPS[case])
    after = drawn(motion, 9, make_rng(5))
    for each in after.T:
        path, logp = np.column_stack([BEFORE, each]), np.zeros(2)
        contract.path_transition_logpdf(motion, 2, path, logp, np.empty((5, 2)))
        many = log_density(motion, np.tile(BEFORE[:, None], 3), np.ascontiguousarray(each))
        np.testing.assert_allclose(logp[1], many, atol=1e-9)
    # Exactly where it was, a robot has a great but finite density.
    assert np.isfinite(log_density(motion, BEFORE[:, None], BEFORE)).all()


def polar_masses(mean, alpha, edges):
    """Probabilities of the cells between `edges` of length, direction and turn, by quadrature of the density.

    The measure is D dD dbeta dturn. Previous poses are moved instead of the next one: the density depends only on one
    seen from the other.
    """
    motion, points = differential(mean, alpha), []
    for axis in edges:
        nodes, weights = np.polynomial.legendre.leggauss(8)
        low, high = np.array(axis[:-1]), np.array(axis[1:])
        half = 0.5 * (high - low)
        points.append(((low + half)[:, None] + half[:, None] * nodes, half[:, None] * weights))
    (length, w1), (direction, w2), (turn, w3) = ((p.ravel(), w.ravel()) for p, w in points)
    d, b, h = (grid.ravel() for grid in np.meshgrid(length, direction, turn, indexing="ij"))
    before = np.array([-d * np.cos(b - h), -d * np.sin(b - h), -h])
    density = np.exp(log_density(motion, before, np.zeros(3))) * d
    mass = density.reshape(length.size, direction.size, turn.size)
    mass = mass * w1[:, None, None] * w2[None, :, None] * w3[None, None, :]
    shape = [size for axis in edges for size in (len(axis) - 1, 8)]
    return mass.reshape(shape).sum(axis=(1, 3, 5))


def cells(mean, alpha):
    """Edges of cells that follow the density's own scales, from which little is left out."""
    first, distance, second, std = odometry.differential_noise(mean, alpha)
    spread = math.hypot(std[0], std[3])
    turn = first + second + math.hypot(std[0], std[2]) * np.array([-7.0, -3.0, -1.0, 0.0, 1.0, 3.0, 7.0])
    ahead = np.array([s for s in (-7.0, -3.0, -1.0, 0.0, 1.0, 3.0, 7.0) if abs(s * spread) < 0.5 * math.pi]) * spread
    around = first + np.unique(
        np.concatenate([[-0.5 * math.pi], ahead, [0.5 * math.pi], ahead + math.pi, [1.5 * math.pi]])
    )
    length = distance + std[1] * np.array([-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 7.0])
    return np.concatenate([[0.0], length[length > 0.0]]), around, turn


@pytest.mark.parametrize("case", STEPS)
def test_the_density_of_a_step_integrates_to_one(case):
    mean, alpha = STEPS[case]
    assert polar_masses(mean, alpha, cells(mean, alpha)).sum() == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("case", STEPS)
def test_draws_have_the_density_of_a_step(case, sfc):
    mean, alpha = STEPS[case]
    edges, n = cells(mean, alpha), 20_000
    length, direction, turn = seen_from(BEFORE, drawn(differential(mean, alpha), n, sfc))
    direction = edges[1][0] + (direction - edges[1][0]) % (2.0 * math.pi)
    counts, _ = np.histogramdd(np.column_stack([length, direction, turn]), edges)
    expected = n * polar_masses(mean, alpha, edges)
    common = expected > 5.0
    observed = np.append(counts[common], n - counts[common].sum())
    wanted = np.append(expected[common], n - expected[common].sum())
    assert common.sum() > 20
    statistic = float(((observed - wanted) ** 2 / wanted).sum())
    assert stats.chi2.sf(statistic, common.sum()) > 1e-4
    # The same draws are none of a robot whose alphas are a quarter greater.
    other = n * polar_masses(mean, 1.25 * np.array(alpha), edges)
    if case != "stands":
        assert stats.chi2.sf(float(((counts - other)[common] ** 2 / other[common]).sum()), common.sum()) < 1e-4


@pytest.mark.parametrize("case", ["nav2's default", "good robot", "reverses", "bad wheels"])
def test_draws_are_those_of_nav2_where_the_robot_drives(case, rng, sfc):
    mean, alpha = STEPS[case]
    ours = drawn(differential(mean, alpha), 20_000, sfc)
    theirs = odometry.differential_draws(mean, alpha, BEFORE, 20_000, rng, floors=odometry.NO_FLOORS).T
    for direction in rng.normal(size=(4, 3)):
        assert stats.ks_2samp(direction @ ours, direction @ theirs).pvalue > 1e-4
    wider = odometry.differential_draws(mean, 1.3 * np.array(alpha), BEFORE, 20_000, rng, floors=odometry.NO_FLOORS).T
    assert stats.ks_2samp(ours[2], wider[2]).pvalue < 1e-4


@pytest.mark.parametrize("case", ["nav2's default", "reverses", "turns on the spot"])
def test_omnidirectional_draws_have_their_noise_along_the_step(case, sfc):
    motion = omni(*STEPS[case])
    mean = np.array(STEPS[case][0])
    length, direction, turn = seen_from(BEFORE, drawn(motion, 20_000, sfc))
    bearing = direction - math.atan2(mean[1], mean[0])
    distance = math.hypot(mean[0], mean[1])
    errors = [length * np.cos(bearing) - distance, length * np.sin(bearing), turn - mean[2]]
    for error, std in zip(errors, odometry.omni_noise(mean, motion.alpha), strict=True):
        assert stats.kstest(error / std, "norm").pvalue > 1e-4
        assert stats.kstest(error / (1.1 * std), "norm").pvalue < 1e-4


def driving_log(n_steps=30, seed=4):
    """A log that drives, turns on the spot, reverses and rests, with one landmark."""
    rng = np.random.default_rng(seed)
    odometry_ = rng.normal(0.0, [0.2, 0.02, 0.3], (n_steps, 3))
    odometry_[5:9, :2], odometry_[9:11] = 0.0, 0.0
    return RobotLog.build(
        time=np.arange(n_steps) * 1.0, odometry=odometry_, landmarks=LandmarkMap(np.array([[1.0, 2.0]])),
        landmark_range=np.full((n_steps, 1), 1.0), start_mean=(0.0, 0.0, 0.0), start_std=(0.1, 0.1, 0.1),
        where="made log",
    )  # fmt: skip


@pytest.mark.parametrize("motion", [Differential(), Omni()], ids=["differential", "omni"])
def test_statistics_tell_the_density_of_the_path(motion, rng):
    log = driving_log()
    bound = motion.bind(log)
    names = len(motion.parameters)
    theta = rng.uniform(0.01, 0.3, names)
    table = bound.table(theta)
    path = np.cumsum(rng.normal(0.0, [0.2, 0.2, 0.3], (30, 3)), axis=0)

    def density(values):
        logp = np.zeros(30)
        contract.path_transition_logpdf(bound.table(values), 30, np.ascontiguousarray(path.T), logp, np.empty((5, 30)))
        return logp.sum()

    index = np.arange(names)
    index[1] = -1  # one is fixed
    statistics = bound.statistics(table, path, None, index, theta)
    other = theta * rng.uniform(0.5, 2.0, names)
    other[1] = theta[1]
    change = theta_logpdf(statistics, other) - theta_logpdf(statistics, theta)
    assert change == pytest.approx(density(other) - density(theta), rel=1e-9)


def test_a_robot_that_never_moves_is_refused():
    log = driving_log()
    resting = RobotLog.build(
        time=log.times, odometry=np.zeros((30, 3)), landmarks=log.landmarks, landmark_range=np.full((30, 1), 1.0),
        start_mean=(0.0, 0.0, 0.0), start_std=(0.1, 0.1, 0.1), where="made log",
    )  # fmt: skip
    for motion in (Differential(), Omni()):
        with pytest.raises(ModelError, match="made log: noise by alphas needs a robot that moves"):
            motion.bind(resting)


def test_robots_with_a_lidar_have_alphas_by_default():
    assert default_model(simulate_lidar_room(3)).motion == Differential()
    assert default_model(driving_log()).motion == IncrementNoise()


@pytest.mark.parametrize("motion", [Differential(), Omni()], ids=["differential", "omni"])
def test_effects_change_the_mean_or_say_why_they_cannot(motion):
    log = driving_log()
    bound = RobotModel(motion, (LandmarkNoise(bearing=False),)).bind(log)
    (tables,) = bound.tables(bound.prior_mean())
    changed, refused = set(), {}
    for effect in CATALOGUE:
        if effect.carrier != "motion":
            continue
        for instance in effect.instances(log)[:1]:
            try:
                edited = instance.edit(tables, instance.typical["clear"], log)
                assert (edited.motion.mean[1:] != tables.motion.mean[1:]).any()
                changed.add(effect.name)
            except ModelError as error:
                refused[effect.name] = str(error)
    assert {"odometry-forward-scale", "odometry-turn-scale", "odometry-side-drift", "odometry-latency"} <= changed
    assert {"wheel-slip", "turn-noise-grows-with-turn", "heavy-tailed-motion-noise"} <= set(refused)
    for name, message in refused.items():
        assert f"effect {name}: expected increments with a noise of their own" in message


def test_a_scaled_odometry_has_the_noise_of_the_scaled_step():
    log = driving_log()
    motion = Differential().bind(log).table(np.array([0.1, 0.05, 0.02, 0.01]))
    tables = Tables(gaussian_start(), motion, ())
    (effect,) = (each for each in CATALOGUE if each.name == "odometry-forward-scale")
    edited = effect.edit(tables, [1.0], log).motion
    np.testing.assert_allclose(edited.mean[1:, :2], 2.0 * log.odometry[1:, :2])
    after = np.array([0.5, 0.1, 0.4])
    found = np.zeros(1)
    contract.transition_logpdf(edited, 1, np.zeros((3, 1)), after, found, np.empty((5, 1)))
    expected = odometry.differential_density(edited.mean[1], motion.alpha, np.zeros(3), after)
    assert found[0] == pytest.approx(math.log(expected), rel=1e-7)


def likeliest_alphas(log_likelihood, start):
    found = optimize.minimize(lambda log_alpha: -log_likelihood(np.exp(log_alpha)), np.log(start), method="Nelder-Mead",
                              options={"xatol": 1e-4, "fatol": 1e-5, "maxiter": 2000})  # fmt: skip
    assert found.success
    return np.exp(found.x)


def test_floors_leave_alphas_of_a_thousandth_as_they_are(rng):
    # Steps that AMCL's defaults gather: 0.25 m or 0.2 rad. The path is known, and drawn without floors.
    alpha, n = np.full(4, 1e-3), 1500
    mean = np.column_stack([np.full(n, 0.25), np.zeros(n), rng.normal(0.0, 0.2, n)])
    mean[1::3] = [0.0, 0.0, 0.25]
    mean[2::3, 1] = rng.normal(0.0, 0.1, n // 3)
    poses = np.zeros((n, 3))
    for t in range(1, n):
        poses[t] = odometry.differential_draws(mean[t], alpha, poses[t - 1], 1, rng, floors=odometry.NO_FLOORS)[0]
    steps, index = differential_steps(mean, poses), np.arange(4)
    found = likeliest_alphas(lambda values: theta_logpdf(DifferentialResiduals(index, values, steps), values), alpha)
    # Without floors the errors of turn, drive and turn are known where there is a direction, and independent.
    drives = steps[:, 0] > 0.01
    distance, a, b, length, direction, heading = steps.T
    direction = wrap(direction)

    def without_floors(values):
        of_first, of_second = (values[0] * fold + values[1] * distance**2 for fold in (a, b))
        std = np.sqrt([of_first[drives], of_second[drives]])
        errors = np.array([direction[drives], (heading - direction)[drives]])
        value = stats.norm.logpdf(errors, 0.0, std).sum()
        value += stats.norm.logpdf(heading[~drives], 0.0, np.sqrt(of_second[~drives])).sum()
        # Turning on the spot, the robot goes ahead or back by what it should not go at all.
        gone = np.where(drives, length - distance, length)
        return value + stats.norm.logpdf(gone, 0.0, np.sqrt(values[2] * distance**2 + values[3] * (a + b))).sum()

    expected = likeliest_alphas(without_floors, alpha)
    np.testing.assert_allclose(found, expected, rtol=0.03)
    np.testing.assert_allclose(found, alpha, rtol=5.0 * np.sqrt(2.0 / 400))
