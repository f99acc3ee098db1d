"""How long the compiled parts take; each benchmark prints its cost per particle-step or per sweep as extra info."""

from __future__ import annotations

import time

import numpy as np
import pytest

from pmcl.engine.tables import axis_sizes, with_extras, with_fields
from pmcl.filtering.kernels import smc
from pmcl.filtering.kernels.metropolis import metropolis_block
from pmcl.filtering.particle_filter import update_path
from pmcl.filtering.statistics import trajectory_statistics
from pmcl.sampling.pool import walker_pool
from pmcl.sampling.sweep import SweepSettings, step
from pmcl.sampling.transforms import Unconstrained
from pmcl.sampling.transport import Proposal, linearised_at


@pytest.mark.parametrize("n", [50, 500])
@pytest.mark.parametrize("ring", ["mounted", "centred"])
def test_filter_and_backward_trajectory_with_eight_beams(benchmark, amigobot, n, ring):
    tables = amigobot.tables[0]
    beams = tables.sensors[0]
    if ring == "centred":  # all beams leave from one point
        mount = beams.beam_pose.copy()
        mount[:, :2] = 0.0
        tables = tables._replace(sensors=(beams._replace(beam_pose=mount),))
    path, n_steps = amigobot.path.copy(), len(amigobot.path)
    benchmark(update_path, tables, path, n_steps, n, amigobot.rng, "smoothing")
    benchmark.extra_info["ns_per_particle_step"] = benchmark.stats["min"] / (n_steps * n) * 1e9


@pytest.mark.parametrize("n", [25, 500])
def test_conditional_sweep_with_eight_landmarks(benchmark, landmarks, n):
    path, n_steps = landmarks.path.copy(), len(landmarks.path)
    benchmark(update_path, landmarks.tables[0], path, n_steps, n, landmarks.rng, "conditional")
    benchmark.extra_info["ns_per_particle_step"] = benchmark.stats["min"] / (n_steps * n) * 1e9


def test_metropolis_block_of_20_rounds(benchmark, amigobot):
    bound, theta = amigobot.bound, amigobot.theta
    statistics = trajectory_statistics(bound, theta, amigobot.tables, [amigobot.path])
    log_step, accepted = np.log(0.05 * theta), np.zeros(theta.size)
    benchmark(
        metropolis_block, amigobot.rng, theta.copy(), log_step, 20, 0.0, 0.44, bound.priors, statistics, accepted
    )


def _walker(case, particles=25):
    """Return a state and the function that makes one step of a walker."""
    from oracles.sweeps import first_state

    bound, theta = case.bound, case.theta
    d = theta.size
    proposal = Proposal(0.05 * np.eye(d), np.log(theta), 0.05 * np.eye(d))
    transport = linearised_at(bound, theta, [case.path], proposal)
    transform, settings = Unconstrained(bound.parameters), SweepSettings(particles=particles)
    return first_state(bound, theta, case.path), lambda state: step(bound, settings, transport, transform, state, 1)[0]


def test_whole_default_sweep(benchmark, landmarks):
    """Conditional SMC with 25 particles, Metropolis, block move, six transport moves."""
    state, move = _walker(landmarks)
    benchmark(move, state)


@pytest.mark.parametrize("n", [25, 500])
def test_two_walkers_on_two_cores(benchmark, landmarks, n):
    """Two walkers step together, as emcee lets them; the speed-up is against one walker by itself."""
    state, move = _walker(landmarks, n)

    def alone() -> float:
        began = time.perf_counter()
        for _ in range(10):
            move(state)
        return (time.perf_counter() - began) / 10.0

    alone()
    one = min(alone() for _ in range(5))
    with walker_pool(None, 2) as pool:
        benchmark(pool.map, move, [state, state])
    benchmark.extra_info["speed_up"] = 2.0 * one / benchmark.stats["min"]


def _with_every_effect(sensor):
    """The table with every component of its mixture."""
    rows, channels = axis_sizes(sensor).get("time"), axis_sizes(sensor)
    if "beam" in channels:
        each = np.ones(channels["beam"])
        changes = {
            "growth": 0.1 * each, "tail": 0.2, "width": 0.1 * each, "short_weight": 0.1 * each, "short_length": 0.7,
            "no_echo_weight": 0.05 * each, "specular_weight": 0.3 * each, "specular_angle": 0.6,
            "talk_weight": 0.1 * each, "correlation": 0.3 * each, "lag": np.full(rows, 0.2),
            "obstacles": np.array([[1.5, 1.0, 0.3, 0.4]]), "outlier_weight": 0.02 * each,
        }  # fmt: skip
    else:
        each = np.ones(channels["landmark"])
        changes = {
            "range_growth": 0.1 * each, "bearing_falloff": 0.1 * each, "depth": 0.3, "misread_weight": 0.05 * each,
            "range_correlation": 0.3 * each, "bearing_correlation": 0.3 * each, "outlier_weight": 0.02 * each,
            "lag": np.full(sensor.first.size - 1, 0.2),
        }  # fmt: skip
    return with_fields(sensor, changes)


@pytest.mark.parametrize("effects", ["neutral", "every effect"])
def test_full_kernels_along_a_path_of_beams(benchmark, amigobot, effects):
    _along_a_path(benchmark, amigobot, effects)


@pytest.mark.parametrize("effects", ["neutral", "every effect"])
def test_full_kernels_along_a_path_of_landmarks(benchmark, landmarks, effects):
    _along_a_path(benchmark, landmarks, effects)


def _along_a_path(benchmark, case, effects):
    (plain,) = case.tables[0].sensors
    sensor = _with_every_effect(plain) if effects == "every effect" else with_extras(plain)
    columns = np.ascontiguousarray(case.path.T)[None]
    terms = benchmark(smc.sensor_terms, sensor, columns)
    assert np.isfinite(terms).all()
