"""Online biases of odometry, and the joint mode of path and noise, against closed forms of the linear model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from oracles import kalman
from oracles.random_walk_model import (
    BoundRailMotion,
    RailMotion,
    RailSensor,
    RailStart,
    RandomWalk,
    rail_log,
    rail_model,
)
from scipy import optimize, stats

from pmcl.calibration import RunOptions
from pmcl.calibration.least_squares import LeastSquares
from pmcl.calibration.roy_thrun import OnlineOdometryBias
from pmcl.errors import ModelError
from pmcl.filtering.particle_filter import log_joint
from pmcl.models.parameters import Parameter
from pmcl.models.robot_model import RobotModel
from pmcl.sampling.joint_mode import joint_mode
from pmcl.sampling.online_bias import online_bias
from pmcl.sampling.stopwatch import Stopwatch

pytestmark = pytest.mark.slow  # compiling kernels that no other test needs takes most of the time

PRIOR = 0.5
OPTIONS = RunOptions(draws=10, chains=2, seed=3)


@dataclass(frozen=True)
class DriftingMotion(RailMotion):
    """The rail with a drift [m] that is added to every command."""

    parameters: tuple[Parameter, ...] = (
        Parameter("process_std", "m", stats.gamma(3.0, scale=0.2)),
        Parameter("drift", "m", stats.norm(scale=PRIOR)),
    )

    def bind(self, log):
        return BoundDriftingMotion(self.coefficient, np.array(log.odometry[:, 0]))


@dataclass(frozen=True)
class BoundDriftingMotion(BoundRailMotion):
    def table(self, theta):
        return RandomWalk(self.coefficient, self.control + theta[1], np.full(self.control.size, theta[0]))

    def statistics(self, table, path, ideal, index, theta):
        return None


@pytest.fixture(scope="module")
def drifting():
    return RobotModel(DriftingMotion(), (RailSensor(),), RailStart()).bind(rail_log(70, seed=3, missing=(9,)))


def _exact(bound, rows=None):
    """Mean and standard deviation of the drift, noise at its prior mean: the Kalman evidence is a parabola of it."""
    theta = bound.prior_mean()

    def log_posterior(drift):
        tables = bound.tables(np.array([theta[0], drift, theta[2]]))[0]
        scores = kalman.filtered(kalman.linear_model(tables), theta[0], theta[2]).log_score
        return scores[:rows].sum() - 0.5 * (drift / PRIOR) ** 2

    values = [log_posterior(drift) for drift in (-1.0, 0.0, 1.0)]
    curvature = 2.0 * values[1] - values[0] - values[2]
    return 0.5 * (values[2] - values[0]) / curvature, curvature**-0.5


@pytest.mark.parametrize("window", [7, 1000])
def test_the_recursion_ends_at_the_exact_bias_whatever_the_window(drifting, window):
    mean, std = _exact(drifting)
    found = OnlineOdometryBias(window=window).run(drifting, OPTIONS)
    assert found.theta[1] == pytest.approx(mean, abs=1e-5)
    assert found.standard_error[1] == pytest.approx(std, rel=1e-5)
    np.testing.assert_array_equal(found.theta[[0, 2]], drifting.prior_mean()[[0, 2]])
    assert found.settings["estimated"] == "drift"


def test_each_window_knows_the_readings_up_to_it_and_no_more(drifting):
    history = online_bias(drifting, 10, 1.0, 1).history[:, 0]
    expected = [_exact(drifting, rows)[0] for rows in range(10, 71, 10)]
    np.testing.assert_allclose(history, expected, atol=1e-5)


def test_a_model_without_biases_is_refused():
    with pytest.raises(ModelError, match="expected a model with a systematic error of its odometry") as caught:
        OnlineOdometryBias().run(rail_model().bind(rail_log(20, seed=1)), OPTIONS)
    assert "\n" not in str(caught.value)


def test_the_joint_mode_is_one_and_its_noise_is_too_small():
    """Against a search over path and noise together; and below what is likeliest once the path is integrated out."""
    bound = rail_model().bind(rail_log(60, seed=5))
    theta, error, held, paths = joint_mode(bound, iterations=200, seed=1, stopwatch=Stopwatch())
    model = kalman.linear_model(bound.tables(theta)[0])
    likeliest = np.exp(optimize.minimize(lambda u: -float(kalman.log_evidence(model, *np.exp(u))), [-1.0, -1.0]).x)
    assert (theta < likeliest).any()
    if not held:
        value = log_joint(bound.tables(theta)[0], paths[0])
        rng = np.random.default_rng(1)
        for _ in range(20):
            other = theta * np.exp(0.02 * rng.standard_normal(2))
            path = np.ascontiguousarray(paths[0] + 0.01 * rng.standard_normal(paths[0].shape))
            assert log_joint(bound.tables(other)[0], path) < value + 1e-3
    # Held at a limit, or at a stationary point of the noise given the path.
    residual = np.array([part.reading for part in bound.parts[0][2:]])[0] - paths[0][:, 0]
    if "reading_std" not in held:
        assert theta[1] == pytest.approx(np.sqrt(np.mean(residual**2)), rel=1e-3)
    assert error is None or (error > 0.0).all()
    found = LeastSquares(iterations=3).run(bound, OPTIONS)
    assert "held" in found.settings
