"""Where chains go on after the inclusion of data: the mode of the linearised posterior, if there is more evidence."""

from __future__ import annotations

from dataclasses import replace

import arviz
import numpy as np
import pytest
from oracles import grid_maps, kalman
from oracles.random_walk_model import rail_log, rail_model
from scipy import optimize

from pmcl.calibration.workflow import calibrate
from pmcl.filtering.particle_filter import log_joint, make_rng, update_path
from pmcl.logs import LidarScans, RobotLog
from pmcl.logs.bags.read import read_bag
from pmcl.logs.mrclam import read_mrclam
from pmcl.maps import OccupancyGrid
from pmcl.models.effects.selection import effect_named
from pmcl.models.robot_model import default_model
from pmcl.models.sensors.lidar.geometry import lengths_along
from pmcl.sampling import linearised_start
from pmcl.sampling.linearised_start import ChainAt, LinearisedStarter
from pmcl.sampling.near_mode import mode_around
from pmcl.sampling.schedule import Schedule
from pmcl.sampling.transforms import Unconstrained
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field

# mypy: disable-error-code="no-untyped-def"

T = 30


@pytest.fixture(scope="module")
def bound():
    return rail_model().bind(rail_log(T, seed=3, missing=(7,)))


def chain_at(theta, path, seed=1):
    return ChainAt(np.array(theta), path, path, np.random.SeedSequence(seed))


def exact_density(bound, u):
    """The log posterior density of the logs of both noises, by a Kalman filter."""
    theta, log_jacobian = Unconstrained(bound.parameters).from_line(np.asarray(u))
    model = kalman.linear_model(bound.tables(theta)[0])
    return kalman.log_evidence(model, *theta) + bound.log_prior(theta) + log_jacobian


def test_the_mode_of_a_linear_model_is_found_from_noise_far_away(bound):
    """With the curvature there, both against a Kalman filter."""
    far = np.array([2.0, 3.0])
    found = mode_around(bound, far, [np.full((T, 1), 47.0)])
    start = Unconstrained(bound.parameters).to_line(far)
    exact = optimize.minimize(lambda u: -exact_density(bound, u), start, method="Nelder-Mead", options={"xatol": 1e-6})
    np.testing.assert_allclose(found.centre, exact.x, atol=0.02)
    steps = 0.05 * np.eye(2)
    second = [
        [
            exact_density(bound, found.centre + a + b) - exact_density(bound, found.centre + a - b)
            - exact_density(bound, found.centre - a + b) + exact_density(bound, found.centre - a - b)
            for b in steps
        ]
        for a in steps
    ]  # fmt: skip
    np.testing.assert_allclose(np.linalg.inv(found.covariance), -np.array(second) / (4 * 0.05**2), rtol=0.1, atol=0.1)
    mean, _ = kalman.path_posterior(kalman.linear_model(bound.tables(np.exp(found.centre))[0]), *np.exp(found.centre))
    np.testing.assert_allclose(found.references[0][:, 0], mean, atol=0.01)


@pytest.mark.parametrize("simulate", [simulate_landmark_field, simulate_amigobot])
def test_a_chain_with_too_much_noise_goes_to_the_mode(simulate):
    """Its path, drawn with five times the noise of readings, is replaced; the density is that of both."""
    log = simulate(100, seed=2) if simulate is simulate_landmark_field else simulate(100.0, 2)
    bound = default_model(log).bind(log)
    truth = np.array([log.true_theta[name] for name in bound.names])
    theta = truth * np.where([("range" in name) or ("bearing" in name) for name in bound.names], 5.0, 1.0)
    path = np.zeros((log.n_steps, 3))
    assert update_path(bound.tables(theta)[0], path, log.n_steps, 500, make_rng(3), "smoothing").succeeded
    start = LinearisedStarter(bound, Schedule())(chain_at(theta, path))
    assert start.theta is not None
    spread = np.sqrt(np.diag(start.transport.proposal.spread @ start.transport.proposal.spread.T))
    assert (np.abs(np.log(start.theta) - start.transport.proposal.centre) < 4.0 * spread).all()
    assert (np.abs(start.transport.proposal.centre - np.log(truth)) < 4.0 * spread).all()
    value = log_joint(bound.tables(start.theta)[0], start.path) + bound.log_prior(start.theta)
    assert start.log_joint == pytest.approx(value, rel=1e-12)
    assert value > log_joint(bound.tables(start.theta)[0], path) + bound.log_prior(start.theta)


def test_chains_start_from_draws_of_the_posterior(bound):
    """Their mean and spread, of 200 chains, are those of the Gaussian at the mode, and each follows from its seed."""
    path, starter = np.full((T, 1), 50.0), LinearisedStarter(bound, Schedule())
    near = mode_around(bound, np.array([0.5, 0.4]), [path])
    starts = [starter(chain_at([0.5, 0.4], path, seed)) for seed in range(200)]
    u = np.log([start.theta for start in starts])
    root = np.linalg.cholesky(near.covariance)
    z = np.linalg.solve(root, (u - near.centre).T)
    assert np.abs(z.mean(axis=1)).max() < 4.0 / np.sqrt(200)
    assert np.abs(np.cov(z) - np.eye(2)).max() < 4.0 * np.sqrt(2.0 / 200)
    again = starter(chain_at([0.5, 0.4], path, 7))
    np.testing.assert_array_equal(again.theta, starts[7].theta)
    np.testing.assert_array_equal(again.path, starts[7].path)


def test_the_mode_of_a_scan_with_gross_errors_is_found():
    """A likelihood field with furniture that the map lacks: three readings in ten are short."""
    grid = OccupancyGrid(grid_maps.box(80, 60), 0.1, (0.0, 0.0, 0.0))
    rows, angles = 60, np.linspace(-3.0, 3.0, 40)
    rng = np.random.default_rng(5)
    turn = np.full(rows, 0.1)
    path = np.cumsum(np.column_stack([0.0 * turn, 0.0 * turn, turn]), axis=0) + np.array([4.0, 3.0, 0.0])
    log = RobotLog.build(
        time=np.arange(rows, dtype=float), odometry=np.column_stack([0.0 * turn, 0.0 * turn, turn]),
        lidars={"": LidarScans(np.ones((rows, 40)), angles, 0.05, 12.0, np.zeros(3))}, grid_map=grid,
        start_mean=path[0], start_std=(0.05, 0.05, 0.05), warn=False,
    )  # fmt: skip
    bound = default_model(log).bind(log)
    lengths = lengths_along(bound.tables(bound.prior_mean())[0].sensors[0], path)
    scans = lengths + rng.normal(0.0, 0.05, lengths.shape)
    short = rng.random(lengths.shape) < 0.3
    scans[short] *= rng.uniform(0.2, 0.9, int(short.sum()))
    dataset = log.dataset.assign(scan=log.dataset["scan"].copy(data=scans))
    log = RobotLog.from_dataset(dataset, log.where, log.grid_map)
    bound = default_model(log).bind(log)
    found = mode_around(bound, bound.prior_mean(), [path + rng.normal(0.0, 0.02, path.shape)])
    theta = dict(zip(bound.names, Unconstrained(bound.parameters).from_line(found.centre)[0], strict=True))
    assert 0.03 < theta["sigma_hit"] < 0.12
    assert 0.15 < theta["z_rand"] < 0.5


@pytest.mark.slow
def test_a_step_that_only_a_frozen_linearisation_promises_is_not_made(shared_data):
    """Shares of gross errors are frozen in each step; a robot with a lidar and moved mounts would turn it around."""
    log = read_bag(
        shared_data / "jarvis" / "jarvis_complex_path_fast.bag", scans=("/driver_laser_navigation/laser_scan",),
        truth="/pose_ground_truth", truth_to_map=(14.617, 3.361, -0.033), truth_shift=0.09, update_min_d=0.1,
        update_min_a=0.1, grid_map=OccupancyGrid.read(shared_data / "jarvis" / "i-108_10mm.yaml"),
    )  # fmt: skip
    names = ("sensor-yaw", "sensor-latency", "sensor-offset")
    model = replace(default_model(log), effects=tuple(effect_named(name, log) for name in names))
    bound = model.bind(log.without_truth())
    start = np.array([0.012, 0.0004, 0.002, 0.02, 0.033, 0.085, 1e-4, 1e-4, 1e-4, 1e-4])
    path = np.array(log.true_poses)
    path[:, 2] = np.unwrap(path[:, 2])
    found = Unconstrained(bound.parameters).from_line(mode_around(bound, start, [path]).centre)[0]
    theta = dict(zip(bound.names, found, strict=True))
    assert 0.02 < theta["sigma_hit"] < 0.06
    assert 0.04 < theta["z_rand"] < 0.2
    assert abs(theta["sensor_yaw"]) < 0.1


@pytest.mark.slow
def test_chains_of_a_drive_with_sharp_bearings_agree(shared_data):
    """After the inclusion of data, bearings of this robot seem four times as noisy as they are.

    The chains of a version that went on from there ended with an R-hat of 1.12.
    """
    log = read_mrclam(shared_data / "mrclam7", 3, 0.5)
    posterior = calibrate(log, draws=300, seed=2)
    summary = arviz.summary(posterior)
    assert summary["r_hat"].max() <= 1.03
    assert summary["ess_bulk"].min() > 200
    assert summary.loc["sigma_bearing", "mean"] == pytest.approx(0.0195, abs=0.001)


def test_draws_of_a_linear_model_show_its_evidence_whatever_they_are(bound, rng):
    starter = LinearisedStarter(bound, Schedule())
    transport = starter(chain_at([2.0, 3.0], np.full((T, 1), 50.0))).transport
    noise = rng.standard_normal((4, T, 1))
    found = [
        starter._drawn(np.array(theta), transport, [z])[1]
        for theta, z in zip(([0.5, 0.4], [0.5, 0.4], [1.5, 0.1]), noise[:3], strict=True)
    ]
    exact = [
        kalman.log_evidence(kalman.linear_model(bound.tables(np.array(theta))[0]), *theta)
        for theta in ([0.5, 0.4], [1.5, 0.1])
    ]
    assert found[1] == pytest.approx(found[0], abs=1e-8)
    assert found[2] - found[0] == pytest.approx(exact[1] - exact[0], abs=1e-8)


def test_a_mode_that_the_linearised_model_only_imagines_is_not_taken(bound, monkeypatch):
    """Draws show less evidence there, whatever the linearised model says."""
    path, starter = np.full((T, 1), 50.0), LinearisedStarter(bound, Schedule())
    near = mode_around(bound, np.array([0.5, 0.4]), [path])
    imagined = near._replace(centre=np.log([4.0, 0.01]))
    monkeypatch.setattr(linearised_start, "mode_around", lambda *_: imagined)
    assert starter(chain_at([0.5, 0.4], path)) is None
    monkeypatch.setattr(linearised_start, "mode_around", lambda *_: near)
    assert starter(chain_at([0.5, 0.4], path)) is not None
    assert starter(chain_at(np.exp(near.centre), path)) is not None  # as much as it has itself
