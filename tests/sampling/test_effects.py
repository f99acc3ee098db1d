"""Parameters of effects in the sampler: Metropolis, transport, and short calibrations that find them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.effect_logs import (
    BY_NAME,
    base_tables,
    instance,
    log_for,
    model_with,
    path_of,
    simulated,
    true_values,
)
from oracles.monte_carlo import chain_standard_error

import pmcl
from pmcl.filtering.particle_filter import log_joint, make_rng
from pmcl.filtering.statistics import block_statistics, trajectory_statistics
from pmcl.geometry import late_poses
from pmcl.localization.model_choice import model_for
from pmcl.models.robot_model import default_model
from pmcl.models.sensor import sensor_of
from pmcl.models.sensors.range_beams.linearisation import beam_lengths
from pmcl.posterior.access import parameter_names, theta_draws
from pmcl.posterior.files import read_posterior, write_posterior
from pmcl.sampling.metropolis import update_theta
from pmcl.sampling.transforms import Unconstrained
from pmcl.sampling.transport import Proposal, linearised_at, transport_moves

# One of every kind: means, mounts, map, noise, mixture, memory, delay, a further state, places.
KINDS = [
    "odometry-turn-scale", "odometry-latency", "range-bias", "sensor-yaw", "beam-yaw", "wall-moved",
    "range-bias-drifts",
    "short-readings", "range-noise-correlated", "sensor-latency", "turn-noise-correlated", "slippery-patch",
    "beam-width", "heavy-tailed-motion-noise", "unmapped-obstacle", "landmark-moved", "landmark-misread",
    "bearing-bias", "range-is-depth", "landmark-range-noise-grows-with-range", "landmark-noise-correlated",
]  # fmt: skip
# Transport of each of the others takes many seconds to compile.
ALWAYS = ("sensor-yaw",)


def bound_with(name, n_steps=60):
    """A log with the effect in it, the model that has it, and the truth."""
    effect = instance(BY_NAME[name], log_for(BY_NAME[name]))
    log = simulated(effect, effect.magnitude("clear"), 6, n_steps)
    bound = model_with(log, effect).bind(log)
    theta = np.concatenate([true_values(log), effect.magnitude("clear")])
    path = path_of(log)
    if bound.tables(theta)[0].start.mean.size > 3:
        path = np.column_stack([path, np.zeros(len(path))])
    return bound, theta, path


# Kernels of their own take long to compile: those of a state of four components, and of these mixtures.
COMPILED_ALONE = ("range-bias-drifts", "short-readings", "landmark-misread")


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=pytest.mark.slow if one in COMPILED_ALONE else ()) for one in KINDS]
)
def test_metropolis_updates_every_parameter_from_its_conditional(name, rng):
    """Statistics cover what no effect touches; the joint density moves the rest, the effect's own among them."""
    bound, theta, path = bound_with(name)
    tables = bound.tables(theta)
    statistics, covered = block_statistics(bound, theta, tables, [path])
    assert trajectory_statistics(bound, theta, tables, [path]) is None
    effect = bound.effects[0]
    free = bound.dimension - len(effect.parameters)
    touched = {"motion": [0, 1, 2], "sensor": range(3, free), "range": range(3, free), "landmark": range(3, free)}
    lost = () if effect.means_only else touched[effect.carrier if effect.carrier != "map" else "range"]
    assert sorted(covered) == [k for k in range(free) if k not in lost]
    assert len(statistics) >= (covered.size > 0)
    sfc = make_rng(int(rng.integers(2**62)))
    new, _, accepted = update_theta(bound, theta, tables, [path], np.log(0.04 * np.abs(theta)), 25, 0.0, sfc)
    assert (new != theta).all()
    assert ((accepted > 0.0) & (accepted < 1.0 + 1e-9)).all()
    assert np.isfinite(bound.log_prior(new) + log_joint(bound.tables(new)[0], path))


def test_statistics_with_moved_means_are_those_of_the_density():
    """Differences of the density of the statistics are differences of the joint density, effects in place."""
    from pmcl.engine.residuals import theta_logpdf

    for name in ("odometry-arc", "range-scale", "sensor-offset", "wall-moved"):
        bound, theta, path = bound_with(name)
        statistics, covered = block_statistics(bound, theta, bound.tables(theta), [path])
        np.testing.assert_array_equal(covered, np.arange(4))
        other = theta.copy()
        other[:4] *= [1.3, 0.8, 1.2, 0.9]
        found = sum(theta_logpdf(part, other[covered]) - theta_logpdf(part, theta[covered]) for part in statistics)
        exact = log_joint(bound.tables(other)[0], path) - log_joint(bound.tables(theta)[0], path)
        assert found == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize(
    "name", [name if name in ALWAYS else pytest.param(name, marks=pytest.mark.slow) for name in KINDS]
)
def test_transport_moves_carry_parameters_and_path_together(name, rng):
    """Some are accepted, and what they return belongs together."""
    bound, theta, path = bound_with(name)
    transform = Unconstrained(bound.parameters)
    u = transform.to_line(theta)
    transport = linearised_at(bound, theta, [path], Proposal(0.03 * np.eye(theta.size)))
    assert transport is not None
    sfc = make_rng(int(rng.integers(2**62)))
    tables = bound.tables(theta)
    assert transport_moves(bound, theta, tables, [path], transport, transform, 20, 0.0, sfc).walk_acceptance_rate == 1.0
    made = transport_moves(bound, theta, tables, [path], transport, transform, 150, 1.0, sfc)
    assert made.walk_acceptance_rate > 0.01
    assert made.redraw_rate >= 0.0
    assert (transform.to_line(made.theta) != u).all()
    exact = bound.log_prior(made.theta) + log_joint(bound.tables(made.theta)[0], made.paths[0])
    assert made.log_joint == pytest.approx(exact, rel=1e-10)


@pytest.mark.parametrize("name", ["sensor-yaw", "beam-yaw", "wall-moved", "sensor-offset", "landmark-moved"])
def test_a_moved_sensor_or_map_moves_the_linearised_readings(name):
    """Ideal values follow the table; with them frozen a change of the mount would not carry the path at all."""
    bound, theta, path = bound_with(name)
    (then,) = bound.tables(theta)
    null = np.concatenate([theta[: -len(bound.effects[0].null)], bound.effects[0].null])
    (now,) = bound.tables(null)
    sensor = now.sensors[0]
    made = sensor_of(sensor).linearise(sensor, path)
    assert sensor_of(sensor).moved_linearisation(sensor, sensor, made, path) is made
    moved = sensor_of(sensor).moved_linearisation(then.sensors[0], sensor, made, path)
    assert np.abs(moved.value - made.value).max() > 0.02
    time = np.repeat(np.arange(len(path)), np.diff(made.first))
    if name == "landmark-moved":
        np.testing.assert_allclose(moved.value, sensor_of(sensor).linearise(then.sensors[0], path).value, atol=1e-12)
    elif name == "wall-moved":
        np.testing.assert_allclose(moved.value, beam_lengths(then.sensors[0], path)[time, made.channel], atol=1e-12)
    else:
        # Along the slopes: rays are cast for a thousandth of the move, with which no beam meets another wall.
        poses = sensor.beam_pose + 1e-3 * (then.sensors[0].beam_pose - sensor.beam_pose)
        lengths = beam_lengths(sensor._replace(beam_pose=poses), path)[time, made.channel]
        np.testing.assert_allclose(moved.value - made.value, 1e3 * (lengths - made.value), rtol=0.02, atol=0.002)
    np.testing.assert_array_equal(moved.reading, made.reading)


@pytest.mark.parametrize("name", ["beam-yaw", "landmark-moved"])
def test_late_readings_are_linearised_at_the_poses_where_they_were_taken(name):
    """Less lag times velocity, values are the ideal ones at the late poses, also after the map or a mount has moved."""
    moved, _, path = bound_with(name)
    bound = replace(moved.model, effects=(BY_NAME["sensor-latency"], *moved.effects)).bind(moved.logs[0])
    base = bound.prior_mean()[: -1 - len(moved.effects[0].null)]
    late = [*base, 0.3, *moved.effects[0].null]
    (table,) = bound.tables(np.array(late))[0].sensors
    made = sensor_of(table).linearise(table, path)
    time = np.repeat(np.arange(len(path)), np.diff(made.first))
    poses = late_poses(path, table.extras.lag)
    assert np.abs(poses[:, 2] - path[:, 2]).max() > 0.05
    if name == "landmark-moved":
        made_there = sensor_of(table).linearise(without_lag(table), poses).value
        (other,) = bound.tables(np.array([*base, 0.3, *moved.effects[0].magnitude("clear")]))[0].sensors
        after = sensor_of(table).moved_linearisation(other, table, made, path)
        np.testing.assert_allclose(
            after.value - after.extras.velocity * table.extras.lag[time],
            sensor_of(table).linearise(without_lag(other), poses).value,
            atol=1e-9,
        )
    else:
        made_there = beam_lengths(table, poses)[time, made.channel]
    np.testing.assert_allclose(made.value - made.extras.velocity * table.extras.lag[time], made_there, atol=1e-9)


def without_lag(table):
    """The table of a sensor whose readings are not late."""
    return table._replace(extras=table.extras._replace(lag=np.zeros_like(table.extras.lag)))


def test_without_the_moved_readings_moves_of_the_mount_are_hardly_accepted(rng):
    bound, theta, path = bound_with("sensor-yaw", 200)
    step = np.zeros((theta.size, theta.size))
    step[-1, -1] = 0.02
    transform = Unconstrained(bound.parameters)
    transport = linearised_at(bound, theta, [path], Proposal(step))
    shares = []
    for one in (transport, replace(transport, sensors=())):
        sfc = make_rng(7)
        made = transport_moves(bound, theta, bound.tables(theta), [path], one, transform, 300, 1.0, sfc)
        shares.append(made.walk_acceptance_rate)
    assert shares[0] > 3.0 * shares[1]
    assert shares[0] > 0.1


def _calibrated(log, *effects, **settings):
    model = replace(default_model(log), effects=effects)
    data = pmcl.calibrate(log, model, draws=300, chains=2, seed=1, **settings)
    return data, dict(zip(parameter_names(data), np.moveaxis(theta_draws(data), -1, 0), strict=True))


@pytest.mark.parametrize(
    "given",
    [
        pytest.param(("beam-bias@2=0.12",), marks=pytest.mark.slow),
        pytest.param(("odometry-turn-scale=0.12",), marks=pytest.mark.long),
        pytest.param(("sensor-yaw=0.1", "short-readings=0.1"), marks=pytest.mark.long),
    ],
)
def test_effects_are_calibrated_jointly(given, tmp_path):
    """The posterior holds the truth; files bring model and posterior back."""
    log = pmcl.simulate_amigobot(200.0, 5, {"sigma_range": 0.05, "sigma_turn": 0.04}, effects=given)
    told = [text.partition("=")[0] for text in given]
    effects = [
        BY_NAME["beam-bias"].instances(log)[2] if name == "beam-bias@2" else BY_NAME[name] for name in told
    ]
    data, draws = _calibrated(log, *effects)
    for name, truth in log.true_theta.items():
        # Some 15 numbers in all: by chance one is as far off as this in a log of a thousand.
        assert abs(truth - draws[name].mean()) < 4.0 * draws[name].std(), name
        assert chain_standard_error(draws[name][..., None], 5)[0] < 0.5 * draws[name].std()
    write_posterior(data, tmp_path / "posterior.nc")
    back = read_posterior(tmp_path / "posterior.nc")
    model = model_for(log, back)
    assert [(one.name, one.where) for one in model.effects] == [(one.name, one.where) for one in effects]
    scores = []
    for method in ("mean", "posterior"):
        track = pmcl.localize(log, model, back, method=method, particles=300)
        scores.append(np.sum(track.log_score))
    plain = {name: float(np.mean(values)) for name, values in draws.items() if name.startswith("sigma_")}
    without = pmcl.localize(log, default_model(log), theta=plain, particles=300)
    assert min(scores) > np.sum(without.log_score) + 10.0


@pytest.mark.slow
def test_calibrating_with_an_effect_resumes_and_tells_its_place(tmp_path):
    log = base_log()
    beams = BY_NAME["beam-bias"].instances(log)
    checkpoint = tmp_path / "run.h5"
    method = pmcl.ParticleGibbs(burn_in_particles=100)
    settings = {"method": method, "draws": 6, "chains": 2, "seed": 3, "checkpoint": checkpoint}
    model = replace(default_model(log), effects=(beams[2],))
    first = theta_draws(pmcl.calibrate(log, model, **settings))
    again = theta_draws(pmcl.calibrate(log, model, **settings, resume=True))
    np.testing.assert_array_equal(first, again)
    with pytest.raises(pmcl.PmclError, match="another run"):
        pmcl.calibrate(log, replace(model, effects=(beams[3],)), **settings, resume=True)


def base_log():
    log = log_for(BY_NAME["beam-bias"], 60)
    assert base_tables(log).sensors
    return log
