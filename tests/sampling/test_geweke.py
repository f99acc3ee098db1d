"""Geweke's joint test of the whole sweep: parameters, path and readings together.

Alternately draw new readings given parameters and path, and make one sweep given the readings. If the sweep is right,
the joint law of parameters, path and readings is the model's own, so parameters keep their prior and paths the law that
can be drawn directly. Wall-range model; the sweep is Metropolis, conditional SMC, and transport around a reference that
never changes.
"""

from __future__ import annotations

import sys
import zlib
from functools import partial

import numpy as np
import pytest
from oracles.amigobot_model import amigobot_log, draw_path, draw_readings, reading_array, tight_model
from oracles.monte_carlo import SHARPNESS, TOLERANCE, chain_standard_error
from oracles.sweeps import first_state, run_chains

from pmcl.filtering.particle_filter import log_joint
from pmcl.sampling import transport as transport_module
from pmcl.sampling.sweep import SweepSettings, step
from pmcl.sampling.transforms import Unconstrained
from pmcl.sampling.transport import Proposal, linearised_at

T, BEAMS = 5, 2
# Readings so noisy that new ones let the path go where it likes within a few sweeps.
THETA = np.array([0.05, 0.03, 0.06, 0.3])
SETTINGS = SweepSettings("conditional", 8, 2, 4)
# Independent proposals centred beside the prior: their density must be corrected for.
PROPOSAL = Proposal(0.35 * np.eye(4), np.log(THETA) - 0.5, 0.4 * np.eye(4))
# In units of each quantity's own standard deviation.
MATTERS = 0.4


@pytest.fixture(scope="module")
def bound():
    return tight_model(THETA).bind(amigobot_log(T, seed=2, n_beams=BEAMS))


@pytest.fixture
def seeds(request):
    """Four seeds from the test's name."""
    return [zlib.crc32(f"{request.node.name} {k}".encode()) for k in range(4)]


def _quantities(bound, theta, path):
    """What is compared: parameters, how they go with the path, and where the robot goes."""
    tables = bound.tables(theta)[0]
    noise = np.diff(path[:, 2]) - tables.motion.mean[1:, 2]
    return np.concatenate(
        [np.log(theta / THETA), path[-1], [path[-1, 2] ** 2, noise @ noise, np.log(theta[2]) * (noise @ noise)]]
    )


@pytest.fixture(scope="module")
def direct(bound):
    """Quantities of independent draws of parameters and path."""
    rng, found = np.random.default_rng(1), []
    for _ in range(4000):
        theta = bound.draw_prior(rng)
        found.append(_quantities(bound, theta, draw_path(bound.tables(theta)[0], T, rng)))
    return np.array(found)


def _successive(bound, reference, draws, sweep, seed):
    """The chain over parameters, path and readings."""
    rng, transform = np.random.default_rng(seed), Unconstrained(bound.parameters)
    theta = bound.draw_prior(rng)
    state = first_state(bound, theta, draw_path(bound.tables(theta)[0], T, rng), np.log(0.4 * THETA))
    transport = linearised_at(bound, THETA, [reference], PROPOSAL)
    geometry, readings = transport.geometries[0][0], reading_array(bound)
    times = np.repeat(np.arange(T), np.diff(geometry.first))
    found = []
    for _ in range(draws):
        tables = bound.tables(state.theta)[0]
        draw_readings(tables, state.path, rng)
        # The linearisation may depend on readings and reference, never on parameters or path.
        geometry.reading[:] = readings[times, geometry.channel]
        value = bound.log_prior(state.theta) + log_joint(tables, state.path)
        state, _ = sweep(
            bound, SETTINGS, transport, transform, state._replace(log_joint=value), int(rng.integers(2**62))
        )
        found.append(_quantities(bound, state.theta, state.path))
    return np.array(found)


def _off(bound, direct, draws, seeds, sweep=step):
    """By how many standard errors each quantity is off, and how sharp the comparison is."""
    reference = draw_path(bound.tables(THETA)[0], T, np.random.default_rng(0))
    _successive(bound, reference, 2, sweep, 0)  # compiles here, not in each process
    made = np.array(run_chains(partial(_successive, bound, reference, draws, sweep), seeds))[:, 20:]
    both = np.stack([direct.mean(axis=0), (direct**2).mean(axis=0)])
    found = np.stack([made.mean(axis=(0, 1)), (made**2).mean(axis=(0, 1))])
    of_chain = np.stack([chain_standard_error(made), chain_standard_error(made**2)])
    of_direct = np.stack([direct.std(axis=0), (direct**2).std(axis=0)]) / np.sqrt(len(direct))
    error = np.hypot(of_chain, of_direct)
    sharpness = MATTERS * np.stack([direct.std(axis=0), (direct**2).std(axis=0)]) / error
    return (found - both) / error, sharpness


@pytest.mark.slow
def test_sweeps_keep_the_joint_law_of_parameters_path_and_readings(bound, direct, seeds):
    off, sharpness = _off(bound, direct, 1500, seeds)
    assert sharpness.min() >= SHARPNESS, sharpness.round(1)
    assert np.abs(off).max() <= TOLERANCE, off.round(1)


@pytest.mark.slow
def test_transport_without_its_jacobian_is_noticed(bound, direct, seeds, monkeypatch):
    """Leaving out |L(theta')| / |L(theta)|, as if carrying a path along did not stretch it."""
    real_start, real_trial = transport_module.standardised, transport_module.transport_trial
    monkeypatch.setattr(transport_module, "standardised", lambda *given: (0.0, *real_start(*given)[1:]))

    def trial(*given):
        joint, _, *rest = real_trial(*given)
        return joint, 0.0, *rest

    monkeypatch.setattr(transport_module, "transport_trial", trial)
    off, _ = _off(bound, direct, 600, seeds)
    assert np.abs(off).max() > TOLERANCE, off.round(1)


@pytest.mark.slow
def test_a_proposal_without_the_jacobian_of_its_logarithm_is_noticed(bound, direct, seeds, monkeypatch):
    real = Unconstrained.from_line
    monkeypatch.setattr(Unconstrained, "from_line", lambda self, u: (real(self, u)[0], 0.0))
    off, _ = _off(bound, direct, 700, seeds)
    assert np.abs(off).max() > TOLERANCE, off.round(1)


@pytest.mark.slow
def test_independent_proposals_without_their_density_are_noticed(bound, direct, seeds, monkeypatch):
    monkeypatch.setattr(Proposal, "log_density", lambda self, u: np.zeros(u.shape[:-1]))
    off, _ = _off(bound, direct, 1500, seeds)
    assert np.abs(off).max() > TOLERANCE, off.round(1)


@pytest.mark.slow
def test_forgetting_the_kept_path_is_noticed(bound, direct, seeds, monkeypatch):
    """Plain smoothing with the same few particles is no right sweep."""
    monkeypatch.setattr(sys.modules[__name__], "SETTINGS", SweepSettings("smoothing", 8, 2, 0))
    off, _ = _off(bound, direct, 600, seeds)
    assert np.abs(off).max() > TOLERANCE, off.round(1)
