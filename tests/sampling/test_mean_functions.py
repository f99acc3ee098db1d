"""Mean functions of motion and sensor against the exact answer of generalised least squares."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.random_walk_model import RailMotion, RailSensor, RailStart, rail_log, rail_model
from scipy import stats

from pmcl.calibration import MeanFunctions, RunOptions
from pmcl.errors import ModelError
from pmcl.models.effects import Effect, effect_named
from pmcl.models.parameters import Parameter
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.sampling import mean_functions
from pmcl.simulations import simulate_landmark_field

OPTIONS = RunOptions(draws=10, chains=2, seed=3, attributes={"note": "kept"})
PRIORS = (stats.norm(0.0, 0.3), stats.norm(0.0, 0.1), stats.norm(0.0, 1.0))
# How far the cart is pushed and what it reads: 1 + 0.1, 0.02 and 0.5 in place of 1, 0 and 0.
TRUE = np.array([0.1, 0.02, 0.5])
T = 80


def _pushed(tables, values, log, where):
    control = tables.motion.control
    return tables._replace(motion=tables.motion._replace(control=control * (1.0 + values[0] + values[1] * control)))


def _read(tables, values, log, where):
    sensor = tables.sensors[0]
    return tables._replace(sensors=(sensor._replace(reading=sensor.reading - values[0]),))


def _model():
    """The cart with a polynomial of degree two for its motion and one of degree zero for its readings."""
    names = (("push_linear", "1"), ("push_quadratic", "1/m"), ("reading_offset", "m"))
    linear, quadratic, offset = (
        Parameter(name, unit, prior) for (name, unit), prior in zip(names, PRIORS, strict=True)
    )
    return RobotModel(
        RailMotion(),
        (RailSensor(),),
        RailStart(),
        effects=(
            Effect("push", "The push is a polynomial.", (linear, quadratic), (0.0, 0.0), _pushed, carrier="motion"),
            Effect("offset", "Readings have an offset.", (offset,), (0.0,), _read),
        ),
    )


@pytest.fixture(scope="module")
def bound():
    log = rail_log(T, seed=5, missing=(3, 20))
    control = np.array(log.odometry[:, 0])
    # The simulated cart moved by its log's control: the log gets one from which the polynomial gives it back.
    told = (-(1.0 + TRUE[0]) + np.sqrt((1.0 + TRUE[0]) ** 2 + 4.0 * TRUE[1] * control)) / (2.0 * TRUE[1])
    dataset = log.dataset.copy(deep=True)
    dataset["odometry"][:, 0] = told
    dataset["landmark_range"][:, 0] = log.landmark_range[:, 0] + TRUE[2]
    return _model().bind(type(log).from_dataset(dataset, "pushed cart"))


@pytest.fixture(scope="module")
def exact(bound):
    """Posterior mean and standard deviation of the coefficients at the prior mean of the noise, by dense algebra."""
    theta = bound.prior_mean()
    q, r = theta[:2]
    start, motion, (sensor,) = bound.tables(theta)[0]
    carry = np.linalg.inv(np.eye(T) - motion.coefficient * np.eye(T, k=-1))
    noise = np.r_[float(start.std[0]), np.full(T - 1, q)] ** 2
    control = np.r_[0.0, motion.control[1:]]
    seen = ~np.isnan(sensor.reading)
    base = (carry @ (np.r_[float(start.mean[0]), np.zeros(T - 1)] + control))[seen]
    design = np.column_stack([(carry @ control)[seen], (carry @ control**2)[seen], np.ones(seen.sum())])
    covariance = ((carry * noise) @ carry.T)[np.ix_(seen, seen)] + r**2 * np.eye(seen.sum())
    weighted = np.linalg.solve(covariance, design)
    precision = design.T @ weighted + np.diag([prior.std() ** -2 for prior in PRIORS])
    mean = np.linalg.solve(precision, weighted.T @ (sensor.reading[seen] - base))
    return mean, np.sqrt(np.diag(np.linalg.inv(precision)))


def test_polynomials_of_motion_and_sensor_are_those_of_generalised_least_squares(bound, exact):
    found = MeanFunctions().run(bound, OPTIONS)
    mean, error = exact
    np.testing.assert_allclose(found.theta[2:], mean, atol=1e-3 * error.min())
    np.testing.assert_allclose(found.standard_error[2:], error, rtol=1e-4)
    np.testing.assert_array_equal(found.theta[:2], bound.prior_mean()[:2])
    assert found.settings["estimated"] == "push_linear, push_quadratic, reading_offset"
    assert found.settings["note"] == "kept"
    assert (np.abs(found.theta[2:] - TRUE) < 4.0 * error).all()
    # The acceleration ends after few turns what plain alternation would not.
    assert found.settings["turns"] <= 10


def test_plain_alternation_is_not_there_yet(bound, exact, monkeypatch):
    """The negative control: the path absorbs what the coefficients do, so few turns without acceleration end short."""
    def plain(function, start, iterations, stopwatch):
        here = start
        for _ in range(iterations):
            here = function(here)
        return here, iterations

    monkeypatch.setattr(mean_functions, "_accelerated", plain)
    found = MeanFunctions(iterations=5).run(bound, OPTIONS)
    assert np.abs((found.theta[2:] - exact[0]) / exact[1]).max() > 0.1


def test_two_logs_tell_more_than_one():
    log = simulate_landmark_field(60, seed=2)
    other = simulate_landmark_field(60, seed=3)
    effects = (effect_named("odometry-forward-scale"), effect_named("landmark-range-bias"))
    model = RobotModel(sensors=default_model(log).sensors, effects=effects)
    one, two = (MeanFunctions().run(model.bind(logs), OPTIONS) for logs in ([log], [log, other]))
    assert one.settings["estimated"] == "odometry_forward_scale, landmark_range_bias"
    ratio = two.standard_error[-2:] / one.standard_error[-2:]
    np.testing.assert_allclose(ratio, np.sqrt(0.5), rtol=0.15)


def test_errors_of_a_simulated_robot_are_found():
    log = simulate_landmark_field(150, seed=4, effects=["odometry-forward-scale=0.1", "landmark-range-bias=0.2"])
    effects = (effect_named("odometry-forward-scale"), effect_named("landmark-range-bias"))
    model = RobotModel(sensors=default_model(log).sensors, effects=effects)
    found = MeanFunctions().run(model.bind(log), OPTIONS)
    z = (found.theta[-2:] - [0.1, 0.2]) / found.standard_error[-2:]
    assert np.abs(z).max() < 4.0
    # Both are told from zero.
    assert (found.theta[-2:] / found.standard_error[-2:]).min() > 4.0


def test_a_model_without_mean_functions_is_refused():
    with pytest.raises(ModelError, match="none of process_std, reading_std is one") as caught:
        MeanFunctions().run(rail_model().bind(rail_log(20, seed=1)), OPTIONS)
    assert "\n" not in str(caught.value)
