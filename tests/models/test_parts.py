"""Parameters, motion, sensors and start: tables for given theta, and what cannot be modelled."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from scipy import integrate, stats

from pmcl.errors import LogError, MapError, ModelError
from pmcl.logs.robot_log import RobotLog
from pmcl.maps.walls import WallMap
from pmcl.models.effects import CATALOGUE
from pmcl.models.motions.increments.motion import GrowingIncrementNoise, IncrementNoise, increment_residuals
from pmcl.models.parameters import FAMILIES, Parameter, gamma_prior, log_prior_function, prior_table
from pmcl.models.prior_file import prior_from_table
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.models.sensors.landmarks.sensor import LandmarkNoise
from pmcl.models.sensors.range_beams.sensor import RangeNoise
from pmcl.models.starts.belief import StartBelief
from pmcl.models.starts.table import GaussianStart, PoseStart
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field

INF = float("inf")
PRIORS = [
    stats.norm(0.3, 0.2),
    stats.gamma(2.0, scale=0.05),
    stats.gamma(2.5, loc=0.1, scale=0.05),
    stats.lognorm(0.6, scale=0.1),
    stats.uniform(0.1, 0.3),
    stats.beta(1.0, 30.0),
    stats.beta(2.0, 3.0, loc=-0.1, scale=0.5),
    stats.halfnorm(scale=0.2),
    stats.expon(scale=0.1),
    stats.invgamma(3.0, scale=0.2),
    stats.weibull_min(1.7, scale=0.1),
]


@pytest.mark.parametrize("prior", PRIORS, ids=lambda prior: f"{prior.dist.name}{prior.args}")
def test_log_priors_agree_with_scipy(prior):
    log_prior = log_prior_function((Parameter("a", "m", prior), Parameter("b", "m", stats.expon())))
    for x in (-0.05, 0.0, 1e-3, 0.05, 0.15, 0.2, 0.39, 0.41, 1.5):
        expected = float(prior.logpdf(x)) if np.isfinite(prior.logpdf(x)) else -INF
        # At the edge of a support densities may be anything: it has no mass.
        if x != prior.support()[0]:
            assert log_prior(np.array([x, 0.5])) == pytest.approx(expected - 0.5, abs=1e-10)


def test_priors_unknown_to_compiled_code_have_no_table():
    known = [Parameter("p", "1", prior) for prior in PRIORS if prior.dist.name in FAMILIES]
    table = prior_table(known)
    np.testing.assert_array_equal(table.family, [FAMILIES[parameter.prior.dist.name] for parameter in known])
    assert prior_table([*known, Parameter("q", "1", PRIORS[-1])]) is None


def test_a_prior_must_be_a_distribution():
    with pytest.raises(ModelError, match=r"prior of sigma must be a frozen continuous .* but got float"):
        Parameter("sigma", "m", 0.1)


def test_gamma_prior_has_the_mean_asked_for():
    assert gamma_prior(0.07).mean() == pytest.approx(0.07)


@pytest.fixture(scope="module")
def log():
    return simulate_amigobot(30.0)


def test_constant_noise_is_the_same_in_every_row(log):
    table = IncrementNoise().bind(log).table(np.array([0.1, 0.2, 0.3]))
    np.testing.assert_array_equal(table.mean, log.odometry)
    np.testing.assert_array_equal(table.std, np.tile([0.1, 0.2, 0.3], (30, 1)))


def test_growing_noise_adds_variances(log):
    theta = np.array([0.1, 0.2, 0.3, 0.5, 0.6, 0.7])
    table = GrowingIncrementNoise().bind(log).table(theta)
    t = int(np.argmax(np.abs(log.odometry[:, 0] * log.odometry[:, 2])))
    forward, _, turn = log.odometry[t]
    assert forward > 0.0
    assert turn != 0.0
    assert table.std[t, 0] == pytest.approx(math.sqrt(0.1**2 + (0.5 * forward) ** 2))
    assert table.std[t, 1] == 0.2
    assert table.std[t, 2] == pytest.approx(math.sqrt(0.3**2 + (0.6 * turn) ** 2 + (0.7 * forward) ** 2))


def test_increment_residuals_are_the_noise_of_the_path(rng):
    mean, noise = rng.normal(size=(20, 3)), rng.normal(size=(20, 3))
    path = np.zeros((20, 3))
    for t in range(1, 20):
        f, g, h = mean[t] + noise[t]
        c, s = math.cos(path[t - 1, 2]), math.sin(path[t - 1, 2])
        path[t] = path[t - 1] + [c * f - s * g, s * f + c * g, h]
    np.testing.assert_allclose(increment_residuals(mean, path), noise[1:], atol=1e-12)


def rebuilt(log, **changes):
    """The Amigobot's log with something else in it."""
    content = {
        "time": log.times, "odometry": log.odometry, "ranges": log.ranges, "beam_poses": log.beam_poses,
        "max_range": log.max_range, "walls": log.walls, "start_mean": log.start_mean, "start_std": log.start_std,
    }  # fmt: skip
    return RobotLog.build(**{**content, **changes}, where="made log")


def test_growing_noise_needs_a_robot_that_moves(log):
    with pytest.raises(ModelError, match="needs a robot that moves"):
        GrowingIncrementNoise().bind(rebuilt(log, odometry=np.zeros((30, 3))))


def test_models_ask_for_what_the_log_lacks(log):
    with pytest.raises(MapError, match="made log: expected walls"):
        RobotModel(sensors=(RangeNoise(),)).bind(rebuilt(log, walls=None))
    with pytest.raises(ModelError, match="the model uses landmark_range"):
        RobotModel(sensors=(LandmarkNoise(),)).bind(log)
    with pytest.raises(ModelError, match="the model has range beams"):
        RobotModel(sensors=(RangeNoise(),)).bind(simulate_landmark_field(5))
    with pytest.raises(ModelError, match="at least one of range, bearing and size"):
        RobotModel(sensors=(LandmarkNoise(range=False, bearing=False),)).bind(log)
    with pytest.raises(LogError, match="at least one log"):
        RobotModel().bind([])
    with pytest.raises(LogError, match=r"missing \(NaN\)"):
        RobotModel(sensors=(RangeNoise(),)).bind(rebuilt(log, ranges=np.full((30, 8), np.nan)))


def test_models_refuse_unknown_names_and_impossible_values():
    with pytest.raises(ModelError, match=r"priors names \['sigma_x'\]"):
        RobotModel(priors={"sigma_x": gamma_prior(0.1)})
    with pytest.raises(ModelError, match=r"fixed names \['sigma_x'\]"):
        RobotModel(fixed={"sigma_x": 0.1})
    with pytest.raises(ModelError, match="sigma_left is fixed at 0"):
        RobotModel(fixed={"sigma_left": 0.0})
    with pytest.raises(ModelError, match="sigma_left is fixed at -1, outside"):
        RobotModel(fixed={"sigma_left": -1.0})
    with pytest.raises(ModelError, match="occur twice"):
        RobotModel(sensors=(RangeNoise(), RangeNoise()))


def test_the_default_model_takes_what_the_log_holds(log):
    assert default_model(log).sensors == (RangeNoise(),)
    assert default_model(log, outliers=True).sensors == (RangeNoise(outliers=True),)
    field = simulate_landmark_field(5, ranges=False, bearings=True)
    assert default_model(field).sensors == (LandmarkNoise(range=False),)
    assert default_model(field).bind(field).names == ("sigma_forward", "sigma_left", "sigma_turn", "sigma_bearing")


def test_fixed_parameters_reach_the_tables_and_leave_theta(log):
    bound = RobotModel(sensors=(RangeNoise(),), fixed={"sigma_left": 0.07}).bind(log)
    assert bound.names == ("sigma_forward", "sigma_turn", "sigma_range")
    (tables,) = bound.tables(np.array([0.1, 0.2, 0.3]))
    np.testing.assert_array_equal(tables.motion.std[3], [0.1, 0.07, 0.2])
    np.testing.assert_array_equal(tables.sensors[0].std, np.full(8, 0.3))


def test_a_direction_without_noise_is_told(log):
    bound = RobotModel(sensors=(RangeNoise(),)).bind(log)
    with pytest.raises(ModelError, match="no noise in direction 'left' at row 1"):
        bound.check(np.array([0.1, 0.0, 0.1, 0.1]))


def test_start_beliefs_become_tables(log):
    gaussian = StartBelief().bind(log).table(np.empty(0))
    assert isinstance(gaussian, GaussianStart)
    np.testing.assert_array_equal(gaussian.std, [0.05, 0.05, 0.05])
    anywhere = StartBelief((0.0, 0.0, 0.0), (INF, INF, INF)).bind(log).table(np.empty(0))
    assert isinstance(anywhere, PoseStart)
    # The room is an L of 3 x 2 m and 2 x 1 m; its density integrates to one.
    area = 3.0 * 2.0 + 2.0 * 1.0
    assert anywhere.log_density == pytest.approx(-math.log(area * 2.0 * math.pi), abs=1e-3)


def test_a_known_heading_anywhere_is_uniform_in_position_only(log):
    table = StartBelief((0.0, 0.0, 0.4), (INF, INF, 0.2)).bind(log).table(np.empty(0))
    total, _ = integrate.quad(lambda h: stats.norm(table.mean[2], table.std[2]).pdf(h), -2.0, 3.0)
    assert total == pytest.approx(1.0)
    assert table.log_density == pytest.approx(-math.log(3.0 * 2.0 + 2.0 * 1.0), abs=1e-3)


@pytest.mark.parametrize(
    ("std", "message"),
    [
        ((0.1, 0.1, 0.0), "three positive"),
        ((0.1, INF, 0.1), "in x and y, or in neither"),
        ((0.1, 0.1, math.nan), "three positive"),
    ],
)
def test_impossible_start_beliefs_are_refused(log, std, message):
    with pytest.raises(ModelError, match=message):
        StartBelief((0.9, 0.9, 0.0), std).bind(log)


def test_open_walls_put_the_start_in_their_box(log):
    some = rebuilt(log, walls=WallMap(log.walls.segments[:2]))
    table = StartBelief((0.0, 0.0, 0.0), (INF, INF, INF)).bind(some).table(np.empty(0))
    assert table.segments.shape[0] == 0
    assert table.log_density == pytest.approx(-math.log(3.0 * 2.0 * 2.0 * math.pi))


ROLES = [
    # role, a value that it excludes or None, what its prior must not be, and what is said of it
    ("noise", 0.0, "norm", "numbers >= 0"),
    ("noise growth", None, "norm", "numbers >= 0"),
    ("weight", None, "expon", r"numbers in \[0, 1\]"),
    ("other", None, None, ""),
]


@dataclass(frozen=True)
class Ranging(RangeNoise):
    """Range beams whose parameter may have any role."""

    role: str = "other"

    @property
    def parameters(self):
        return (Parameter("spread", "m", stats.halfnorm(), "noise of a reading", self.role),)


@pytest.mark.parametrize(("role", "excluded", "prior", "message"), ROLES)
def test_the_role_of_a_parameter_decides_its_values(role, excluded, prior, message):
    (parameter,) = Ranging(role=role).parameters
    for value in (0.0, 0.3):
        if value == excluded:
            with pytest.raises(ModelError, match="spread is fixed at 0: without noise"):
                RobotModel(sensors=(Ranging(role=role),), fixed={"spread": value})
        else:
            assert RobotModel(sensors=(Ranging(role=role),), fixed={"spread": value}).fixed == {"spread": value}
    for name in ("norm", "expon", "uniform"):
        if name == prior:
            with pytest.raises(ModelError, match=message):
                prior_from_table("model.toml", parameter, {"distribution": name})
        elif role != "weight" or name == "uniform":
            assert prior_from_table("model.toml", parameter, {"distribution": name}).dist.name == name


def test_unknown_roles_are_refused():
    with pytest.raises(ModelError, match="the role of spread"):
        Parameter("spread", "m", stats.halfnorm(), role="noisy")


def test_parameters_of_pmcl_have_the_roles_of_their_names(log):
    """Whatever a name says of a standard deviation or a weight, the role says, too."""
    field = simulate_landmark_field(5, bearings=True)
    models = [default_model(each, outliers=True) for each in (log, field)] + [RobotModel(GrowingIncrementNoise())]
    parameters = [p for model in models for p in model.parameters]
    parameters += [parameter for effect in CATALOGUE for parameter in effect.parameters]
    assert len(parameters) > 60
    for parameter in parameters:
        if parameter.name.startswith("sigma_"):
            assert parameter.role == ("noise growth" if "_per_" in parameter.name else "noise"), parameter.name
        else:
            assert (parameter.role == "weight") == parameter.name.endswith("_weight"), parameter.name


def test_the_prior_mean_is_the_mean_or_the_median_where_there_is_none():
    log = simulate_landmark_field(5, 1)
    fat = stats.halfcauchy(scale=0.1)  # its mean is infinite
    skew = stats.gamma(2.0, scale=0.03)
    bound = RobotModel(sensors=default_model(log).sensors, priors={"sigma_left": fat, "sigma_turn": skew}).bind(log)
    found = dict(zip(bound.names, bound.prior_mean(), strict=True))
    assert found["sigma_left"] == pytest.approx(0.1)
    assert found["sigma_turn"] == pytest.approx(0.06)
