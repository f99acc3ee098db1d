"""Tables of many parameter draws at once: each particle moves with a draw of its own, readings average over some draws.

K draws of the parameters give K sets of tables that differ in few fields. A *stack* is one set of tables in which only
those fields have a leading axis of length K; all others are shared. :func:`~pmcl.engine.views.take` gives
back the tables of one draw, of exactly the type of the ordinary ones, so that every motion and sensor works with draws
as it is. Numbers in brackets are the equations of Kaboli, Bowling and Musilek (2006).
"""

from __future__ import annotations

import numpy as np

from pmcl.engine.compile import generic, kernel, overload_for_types
from pmcl.engine.contract import propagate, reading_logpdf
from pmcl.engine.sensor_tuples import is_empty, sum_logpdf
from pmcl.engine.vector_math import exp_into, log_into
from pmcl.engine.views import columns, take

__all__ = [
    "is_shared",
    "log_likelihood",
    "move_by_draws",
    "propagate_draws",
    "reading_logpdf_draws",
    "sum_draws",
]


def is_shared(base, stack):
    """Return whether a stack has no field that differs between draws."""
    if isinstance(base, tuple):
        return all(is_shared(b, s) for b, s in zip(base, stack, strict=True))
    return np.ndim(stack) == np.ndim(base)


@overload_for_types(is_shared)
def _is_shared(base, stack):
    # Equal types: no field has an axis more.
    if base == stack:
        return lambda base, stack: True
    return lambda base, stack: False


@generic
def propagate_draws(motion, stack, t, rng, which, previous, current, scratch, order, counts, gathered):
    """Draw states at time t, each with the parameters of its own draw (eq. 21).

    Parameters
    ----------
    motion, stack : NamedTuple
        The table of one draw, and the stack of K.
    t : int
        Time.
    rng : numpy.random.Generator
        Source of randomness.
    which : ndarray of int, shape (n,)
        The draw of each particle.
    previous, current : ndarray, shape (D, n)
        States at t - 1; states at t, filled.
    scratch : ndarray, shape (rows, n)
        Work space, with the rows that the motion asks for.
    order, counts : ndarray of int, shape (n,) and (K + 1,)
        Work space.
    gathered : ndarray, shape (2 D n,)
        Work space.
    """


@propagate_draws.register(object)
def _draw_by_draw(motion, stack, t, rng, which, previous, current, scratch, order, counts, gathered):
    """Sort the particles by their draw, and move those of each draw together as the motion itself does."""
    size, n = previous.shape
    for k in range(counts.size):
        counts[k] = 0
    for i in range(n):
        counts[which[i] + 1] += 1
    for k in range(1, counts.size):
        counts[k] += counts[k - 1]
    for i in range(n):
        order[counts[which[i]]] = i
        counts[which[i]] += 1
    begin = 0
    work = scratch.reshape(scratch.size)
    for k in range(counts.size - 1):
        end = counts[k]
        m = end - begin
        if m == 0:
            continue
        before = columns(gathered, size, m)
        after = columns(gathered[size * m :], size, m)
        for d in range(size):
            for j in range(m):
                before[d, j] = previous[d, order[begin + j]]
        rows = columns(work, scratch.shape[0], m)
        propagate(take(motion, stack, k), t, rng, before, after, rows)
        for d in range(size):
            for j in range(m):
                current[d, order[begin + j]] = after[d, j]
        begin = end


@kernel
def move_by_draws(motion, stack, n_draws, t, rng, which, previous, current, scratch, order, counts, gathered):
    """Move all particles; choose a draw for each only where the motion differs between draws."""
    if is_shared(motion, stack):
        propagate(motion, t, rng, previous, current, scratch)
        return
    for i in range(which.size):
        which[i] = min(int(rng.random() * n_draws), n_draws - 1)
    propagate_draws(motion, stack, t, rng, which, previous, current, scratch, order, counts, gathered)


@generic
def reading_logpdf_draws(sensor, stack, picks, t, previous, current, log_densities, scratch):
    """Add the log density of the readings at t under each picked draw to `log_densities` (k, n).

    Optional: by default each of the k draws in `picks` is evaluated by itself. A sensor whose draws have the
    geometry in common can do that part once.
    """


@reading_logpdf_draws.register(object)
def _reading_by_reading(sensor, stack, picks, t, previous, current, log_densities, scratch):
    for j in range(picks.size):
        reading_logpdf(take(sensor, stack, picks[j]), t, previous, current, log_densities[j], scratch)


def sum_draws(sensors, stacks, picks, t, previous, current, common, log_densities, scratch):
    """Add the log densities of all readings at t: under each pick to `log_densities` (k, n), if shared to `common`."""
    for sensor, stack in zip(sensors, stacks, strict=True):
        if is_shared(sensor, stack):
            reading_logpdf(sensor, t, previous, current, common, scratch)
        else:
            reading_logpdf_draws(sensor, stack, picks, t, previous, current, log_densities, scratch)


@overload_for_types(sum_draws)
def _sum_draws(sensors, stacks, picks, t, previous, current, common, log_densities, scratch):
    if is_empty(sensors):
        return lambda sensors, stacks, picks, t, previous, current, common, log_densities, scratch: None

    def both(sensors, stacks, picks, t, previous, current, common, log_densities, scratch):
        if is_shared(sensors[0], stacks[0]):
            reading_logpdf(sensors[0], t, previous, current, common, scratch)
        else:
            reading_logpdf_draws(sensors[0], stacks[0], picks, t, previous, current, log_densities, scratch)
        sum_draws(sensors[1:], stacks[1:], picks, t, previous, current, common, log_densities, scratch)

    return both


@kernel
def _average_of_draws(log_densities, logp, scratch):
    """Add the log of the mean of exp(`log_densities` (k, n)) over the k draws to `logp` (n,) (eq. 24).

    `scratch` has three rows. The greatest of each column is taken out first, so that nothing vanishes or overflows.
    """
    k, n = log_densities.shape
    greatest, difference, sums = scratch[0], scratch[1], scratch[2]
    for i in range(n):
        greatest[i] = log_densities[0, i]
        sums[i] = 0.0
    for j in range(1, k):
        row = log_densities[j]
        for i in range(n):
            greatest[i] = row[i] if row[i] > greatest[i] else greatest[i]
    for i in range(n):
        # Impossible under every draw: the logarithm of a sum of zeros, without subtracting infinities.
        greatest[i] = greatest[i] if greatest[i] > -np.inf else 0.0
    for j in range(k):
        row = log_densities[j]
        for i in range(n):
            difference[i] = row[i] - greatest[i]
        exp_into(difference, 0.0, difference)
        for i in range(n):
            sums[i] += difference[i]
    log_into(sums, difference)
    log_k = np.log(k)
    for i in range(n):
        logp[i] += greatest[i] + difference[i] - log_k


@kernel
def log_likelihood(tables, stack, row, picks, before, current, out, log_densities, scratch):
    """Write the log density of all readings at `row` into `out` (n,): eq. 24 where sensors differ between draws."""
    for i in range(out.size):
        out[i] = 0.0
    if is_shared(tables.sensors, stack.sensors):
        sum_logpdf(tables.sensors, row, before, current, out, scratch)
        return
    flat = log_densities.reshape(log_densities.size)
    for i in range(flat.size):
        flat[i] = 0.0
    sum_draws(tables.sensors, stack.sensors, picks, row, before, current, out, log_densities, scratch)
    _average_of_draws(log_densities, out, scratch)
