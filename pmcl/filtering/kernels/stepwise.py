"""Filters that Python leads through the log: a few rows at a time, or one row with parameters of each particle's own.

The pass of :mod:`~.forward` is one compiled loop with one generator. Two kinds of calibration need more: those that
compare estimates of the evidence made with the same random numbers, and those in which every particle has a theta of
its own.

Estimates with the same random numbers change little when theta does only if particle i stands for nearly the same state
in both. Resampling therefore takes the particles in the order of a Hilbert curve through their states, systematically
with one uniform (Deligiannidis, Doucet, Pitt, The correlated pseudo-marginal method, JRSS B 80, 2018, section 4.2).
"""

from __future__ import annotations

import math

import numpy as np

from pmcl.engine.compile import entry, kernel
from pmcl.engine.contract import draw_start, propagate, state_size, transition_logpdf
from pmcl.engine.parameter_draws import is_shared, propagate_draws
from pmcl.engine.sensor_tuples import any_reading, sum_logpdf
from pmcl.engine.views import take
from pmcl.filtering.kernels.forward import work_rows
from pmcl.filtering.kernels.resampling import SYSTEMATIC, resample
from pmcl.filtering.kernels.weighing import FINE, normalise

__all__ = ["filter_rows", "hilbert_key", "hilbert_keys", "move_each", "pair_terms", "start_states", "weigh_each"]

# Bits of a Hilbert key that are shared out among the components of a state, and the most that one component gets.
_KEY_BITS, _MOST_BITS = 60, 12
# The curve covers the cloud's mean plus and minus so many of its standard deviations in each component.
_CURVE_REACH = 4.0


@kernel
def hilbert_key(cell, bits):
    """Return the place of a cell along a Hilbert curve; `cell` (D,) of int holds `bits` bits each, and is overwritten.

    Skilling, Programming the Hilbert curve, AIP Conference Proceedings 707, 2004.
    """
    size = cell.size
    if size == 1:
        return cell[0]
    top = 1 << (bits - 1)
    q = top
    while q > 1:
        p = q - 1
        for i in range(size):
            if cell[i] & q:
                cell[0] ^= p
            else:
                swap = (cell[0] ^ cell[i]) & p
                cell[0] ^= swap
                cell[i] ^= swap
        q >>= 1
    for i in range(1, size):
        cell[i] ^= cell[i - 1]
    flip = 0
    q = top
    while q > 1:
        if cell[size - 1] & q:
            flip ^= q - 1
        q >>= 1
    key = 0
    for b in range(bits - 1, -1, -1):
        for i in range(size):
            key = (key << 1) | (((cell[i] ^ flip) >> b) & 1)
    return key


@kernel
def hilbert_keys(states, keys, cell, mean, factor):
    """Write the place of each state (D, n) along the curve into `keys` (n,); the others, (D,), are work space."""
    size, n = states.shape
    bits = min(_KEY_BITS // size, _MOST_BITS)
    cells = 2.0**bits
    for i in range(n):
        keys[i] = 0
    for d in range(size):
        total, square = 0.0, 0.0
        for i in range(n):
            total += states[d, i]
        mean[d] = total / n
        for i in range(n):
            square += (states[d, i] - mean[d]) ** 2
        spread = math.sqrt(square / n)
        factor[d] = 0.5 * cells / (_CURVE_REACH * spread) if spread > 0.0 else 0.0
    for i in range(n):
        for d in range(size):
            place = 0.5 * cells + factor[d] * (states[d, i] - mean[d])
            cell[d] = int(min(max(place, 0.0), cells - 1.0))
        keys[i] = hilbert_key(cell, bits)


@entry
def filter_rows(tables, rng, begin, stop, ordered, weighted, particles, log_weights, ancestors, increments):
    """Run the bootstrap filter over the rows begin ... stop - 1, going on from row ``begin - 1``.

    Parameters
    ----------
    tables : Tables
        Coefficients of the model.
    rng : numpy.random.Generator
        The random numbers of these rows, and of no others.
    begin, stop : int
        Rows.
    ordered : bool
        Whether parents are drawn in the order of a Hilbert curve; without it in the order of the particles.
    weighted : bool
        Whether the weights of row ``begin - 1`` have not been used by a resampling yet.
    particles, log_weights, ancestors : ndarray, shapes (T, D, n), (T, n) and (T, n)
        The history, of which these rows are filled.
    increments : ndarray, shape (T,)
        Filled with the change of the log evidence by each row.

    Returns
    -------
    status, row : int
        How the pass ended, and where.
    weighted : bool
        For the next call.
    """
    size, n = particles.shape[1], particles.shape[2]
    previous, scratch = np.empty((size, n)), np.empty((work_rows(tables), n))
    weights, draft, work = scratch[0], scratch[1:3], scratch[1:]
    keys, cell, sorted_weights = np.empty(n, np.int64), np.empty(size, np.int64), np.empty(n)
    parent, mean, factor = np.empty(n, np.uint32), np.empty(size), np.empty(size)
    for t in range(begin, stop):
        current, logw = particles[t], log_weights[t]
        log_norm = math.log(n)
        if t == 0:
            draw_start(tables.start, rng, current)
            before = current
            for i in range(n):
                logw[i] = 0.0
        else:
            before = particles[t - 1]
            if weighted:
                _, _, weight_sum = normalise(log_weights[t - 1], weights)
                if ordered:
                    hilbert_keys(before, keys, cell, mean, factor)
                    order = np.argsort(keys)
                    for i in range(n):
                        sorted_weights[i] = weights[order[i]]
                    resample(SYSTEMATIC, sorted_weights, weight_sum, rng, parent, draft)
                    for i in range(n):
                        ancestors[t, i] = order[parent[i]]
                else:
                    resample(SYSTEMATIC, weights, weight_sum, rng, ancestors[t], draft)
                for d in range(size):
                    for i in range(n):
                        previous[d, i] = before[d, ancestors[t, i]]
                before = previous
                weighted = False
            else:
                for i in range(n):
                    ancestors[t, i] = i
            propagate(tables.motion, t, rng, before, current, work)
            for i in range(n):
                logw[i] = 0.0
        increments[t] = 0.0
        if any_reading(tables.sensors, t):
            sum_logpdf(tables.sensors, t, before, current, logw, work)
            status, greatest, weight_sum = normalise(logw, weights)
            if status != FINE:
                return status, t, weighted
            increments[t] = greatest + math.log(weight_sum) - log_norm
            weighted = True
    return FINE, stop - 1, weighted


@entry
def start_states(tables, rng, n):
    """Return n draws of the first state, (D, n)."""
    current = np.empty((state_size(tables.motion), n))
    draw_start(tables.start, rng, current)
    return current


@entry
def move_each(tables, stack, t, rng, which, previous):
    """Return states at t, each moved with the parameters of its own draw.

    Parameters
    ----------
    tables, stack : Tables
        The tables of one draw, and the stack of K of them (:mod:`pmcl.engine.parameter_draws`).
    t : int
        Row.
    rng : numpy.random.Generator
        Source of randomness.
    which : ndarray of int, shape (n,)
        The draw of each particle.
    previous : ndarray, shape (D, n)
        States at ``t - 1``.
    """
    size, n = previous.shape
    current, scratch = np.empty((size, n)), np.empty((work_rows(tables), n))
    if is_shared(tables.motion, stack.motion):
        propagate(tables.motion, t, rng, previous, current, scratch)
        return current
    most = 0
    for i in range(n):
        most = max(most, which[i])
    propagate_draws(
        tables.motion, stack.motion, t, rng, which, previous, current, scratch, np.empty(n, np.int64),
        np.zeros(most + 2, np.int64), np.empty(2 * size * n),
    )  # fmt: skip
    return current


@entry
def weigh_each(tables, stack, t, which, previous, current):
    """Return the log density of the readings at t for each particle, (n,), by the parameters of its own draw.

    Parameters
    ----------
    tables, stack, t, which, previous
        As for :func:`move_each`.
    current : ndarray, shape (D, n)
        States at t.
    """
    size, n = previous.shape
    logp = np.zeros(n)
    if not any_reading(tables.sensors, t):
        return logp
    rows = work_rows(tables)
    if is_shared(tables.sensors, stack.sensors):
        sum_logpdf(tables.sensors, t, previous, current, logp, np.empty((rows, n)))
        return logp
    one_before, one_now, value, scratch = np.empty((size, 1)), np.empty((size, 1)), np.empty(1), np.empty((rows, 1))
    for i in range(n):
        for d in range(size):
            one_before[d, 0], one_now[d, 0] = previous[d, i], current[d, i]
        value[0] = 0.0
        sum_logpdf(take(tables.sensors, stack.sensors, which[i]), t, one_before, one_now, value, scratch)
        logp[i] = value[0]
    return logp


@entry
def pair_terms(tables, t, previous, current, with_motion):
    """Return log p(current, readings at t | previous) of each pair of states, (n,).

    Parameters
    ----------
    tables : Tables
        Coefficients.
    t : int
        Row.
    previous, current : ndarray, shape (D, n)
        States at ``t - 1`` and at t.
    with_motion : bool
        Whether the transition counts; without it only the readings do.
    """
    size, n = previous.shape
    rows = work_rows(tables)
    logp = np.zeros(n)
    if any_reading(tables.sensors, t):
        sum_logpdf(tables.sensors, t, previous, current, logp, np.empty((rows, n)))
    if with_motion:
        before, after, value, scratch = np.empty((size, 1)), np.empty(size), np.empty(1), np.empty((rows, 1))
        for i in range(n):
            for d in range(size):
                before[d, 0], after[d] = previous[d, i], current[d, i]
            value[0] = 0.0
            transition_logpdf(tables.motion, t, before, after, value, scratch)
            logp[i] += value[0]
    return logp
