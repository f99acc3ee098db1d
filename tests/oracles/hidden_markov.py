"""A hidden Markov chain of few states, whose paths can all be enumerated, plugged in through the public contract.

States are the floats 0 ... K-1. The reading depends on two states in a row, so it also checks everything that
looks back.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine import contract
from pmcl.models.tables import Tables

Float = NDArray[np.float64]

# mypy: disable-error-code="no-untyped-def"


class StartChain(NamedTuple):
    """Probability of each first state, (K,)."""

    probability: Float


class StepChain(NamedTuple):
    """Probability of each step, (K, K): from, to."""

    probability: Float


class PairReadings(NamedTuple):
    """Log likelihood of the reading at t, (T, K, K): state before, state now; `measured` (T,) is 0 without one."""

    log_likelihood: Float
    measured: NDArray[np.int64]


@contract.state_size.register(StepChain)
def _size(motion):
    return 1


@contract.scratch_rows.register(StartChain)
def _start_rows(table):
    return 0


@contract.scratch_rows.register(StepChain)
def _step_rows(table):
    return 0


@contract.scratch_rows.register(PairReadings)
def _reading_rows(table):
    return 0


@contract.draw_start.register(StartChain)
def _draw_start(start, rng, current):
    for i in range(current.shape[1]):
        u, k = rng.random(), 0
        while k < start.probability.size - 1 and u >= start.probability[k]:
            u -= start.probability[k]
            k += 1
        current[0, i] = k


@contract.start_logpdf.register(StartChain)
def _start_logpdf(start, current, logp):
    for i in range(logp.size):
        logp[i] += np.log(start.probability[int(current[0, i])])


@contract.propagate.register(StepChain)
def _propagate(motion, t, rng, previous, current, scratch):
    for i in range(current.shape[1]):
        row = int(previous[0, i])
        u, k = rng.random(), 0
        while k < motion.probability.shape[1] - 1 and u >= motion.probability[row, k]:
            u -= motion.probability[row, k]
            k += 1
        current[0, i] = k


@contract.transition_logpdf.register(StepChain)
def _transition_logpdf(motion, t, previous, current, logp, scratch):
    for i in range(logp.size):
        logp[i] += np.log(motion.probability[int(previous[0, i]), int(current[0])])


@contract.looks_back.register(PairReadings)
def _looks_back(sensor):
    return True


@contract.has_reading.register(PairReadings)
def _has_reading(sensor, t):
    return sensor.measured[t] > 0


@contract.reading_logpdf.register(PairReadings)
def _reading_logpdf(sensor, t, previous, current, logp, scratch):
    for i in range(logp.size):
        logp[i] += sensor.log_likelihood[t, int(previous[0, i]), int(current[0, i])]


def chain_tables(n_steps: int = 4, n_states: int = 3, seed: int = 1) -> Tables:
    """A chain with a forbidden step, strong readings, and one row without a reading."""
    rng = np.random.default_rng(seed)
    step = rng.dirichlet(np.ones(n_states), n_states)
    step[0, n_states - 1] = 0.0
    step[0] /= step[0].sum()
    likelihood = rng.normal(0.0, 1.2, (n_steps, n_states, n_states))
    measured = np.ones(n_steps, dtype=np.int64)
    measured[1] = 0
    return Tables(StartChain(rng.dirichlet(np.ones(n_states))), StepChain(step), (PairReadings(likelihood, measured),))


def enumerate_paths(tables: Tables, n_steps: int) -> tuple[NDArray[np.int64], Float, float]:
    """All paths (M, T), their posterior probabilities (M,), and the log evidence."""
    start, step, sensor = tables.start.probability, tables.motion.probability, tables.sensors[0]
    paths = np.array(list(product(range(start.size), repeat=n_steps)))
    weight = start[paths[:, 0]]
    for t in range(n_steps):
        before = paths[:, max(t - 1, 0)]
        if t > 0:
            weight = weight * step[before, paths[:, t]]
        if sensor.measured[t]:
            weight = weight * np.exp(sensor.log_likelihood[t, before, paths[:, t]])
    return paths, weight / weight.sum(), float(np.log(weight.sum()))
