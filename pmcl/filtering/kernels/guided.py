"""A particle filter that runs backward in time, guided by a linearised path: evidence with little noise.

A bootstrap filter draws each state without a look at what is read there and later, so that few particles survive where
sensors are precise or a step goes far astray. Given a path that explains the whole log, the model is nearly linear and
Gaussian around it, and the linearised smoother d[t] | d[t+1] of :mod:`~.factorisation` is nearly the distribution of
each state given all readings and the next state. Particles are drawn from it, the last row first. With the belief
b[t](x) about the state at t that the linearised rows before t leave, the weight of row t is

    g(z[t] | x[t]) b[t](x[t]) p(x[t+1] | x[t]) / (q(x[t] | x[t+1]) b[t+1](x[t+1])).

All b cancel in the product over the rows but for that of row 0, which the start density replaces: the mean of the
product is p(z), whatever the linearisation. In a linear Gaussian model each weight is the predictive density of z[t]
given the readings before, the same for all particles. Such twisted targets are those of Guarniero, Johansen and Lee
(2017, The iterated auxiliary particle filter, J. Am. Stat. Assoc. 112) and Heng et al. (2020, Controlled sequential
Monte Carlo, Annals of Statistics 48).

Where a reading depends on the state before as well, it is weighed one row later, and b holds it linearised meanwhile.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.compile import entry, kernel
from pmcl.engine.contract import (
    linearise_start,
    linearise_transition,
    start_logpdf,
    state_of_deviation,
    state_size,
    transition_logpdf,
)
from pmcl.engine.random_numbers import normals_into
from pmcl.engine.scalars import LOG_2PI
from pmcl.engine.sensor_tuples import any_look_back, any_reading, sum_information, sum_logpdf
from pmcl.filtering.kernels.factorisation import Factors, cholesky, eliminate, solve
from pmcl.filtering.kernels.forward import work_rows
from pmcl.filtering.kernels.resampling import SYSTEMATIC, AnyScheme, draw_parents
from pmcl.filtering.kernels.stepwise import hilbert_keys
from pmcl.filtering.kernels.weighing import FINE, normalise

__all__ = ["Cloud", "Guide", "History", "guide_of", "guided_rows"]

Float = NDArray[np.float64]

# Particles are resampled where fewer than this share of them are effective, as usual.
_RESAMPLED = 0.5


class Guide(NamedTuple):
    """What particles are drawn from, and what is known of each row from those before.

    Attributes
    ----------
    reference : ndarray, shape (T, D)
        The path around which the model is linearised.
    factor, gain : ndarray, shape (T, D * D)
        C[t] and K[t] of :class:`~pmcl.filtering.kernels.factorisation.Factors`.
    centre : ndarray, shape (T, D)
        k[t] of the same.
    root : ndarray, shape (T, D * D)
        Cholesky factor of the precision of the belief b[t] about the deviation from the reference.
    mean : ndarray, shape (T, D)
        Mean of that belief.
    """

    reference: Float
    factor: Float
    gain: Float
    centre: Float
    root: Float
    mean: Float


@kernel
def _beliefs(tables, linear_readings, reference, with_readings, factors, root, mean, work, size):
    """Fill the beliefs about each row that the linearised rows before it leave; return whether there are any.

    With `with_readings` each belief knows the row's own readings, too.
    """
    square = size * size
    jacobian, noise, information = work[0:square], work[square : 2 * square], work[2 * square : 3 * square]
    weighted = work[3 * square : 4 * square]
    offset, shift = work[4 * square : 4 * square + size], work[4 * square + size : 4 * square + 2 * size]
    jacobian_2d, noise_2d = jacobian.reshape(size, size), noise.reshape(size, size)
    information_2d = information.reshape(size, size)
    for t in range(reference.shape[0]):
        for i in range(size):
            shift[i] = 0.0
        for i in range(square):
            information[i] = 0.0
        if t == 0:
            linearise_start(tables.start, reference[0], information_2d, shift)
        else:
            linearise_transition(tables.motion, t, reference[t - 1], reference[t], jacobian_2d, offset, noise_2d)
            gain, centre = factors.gain[t - 1], factors.centre[t - 1]
            for i in range(size):
                for j in range(size):
                    value = 0.0
                    for k in range(size):
                        value += noise[i * size + k] * jacobian[k * size + j]
                    weighted[i * size + j] = value
            for i in range(size):
                value = 0.0
                for k in range(size):
                    value += noise[i * size + k] * offset[k] + weighted[i * size + k] * centre[k]
                shift[i] = value
                for j in range(i + 1):
                    value = noise[i * size + j]
                    for k in range(size):
                        value -= weighted[i * size + k] * gain[k * size + j]
                    information[i * size + j] = value
        if with_readings:
            sum_information(tables.sensors, linear_readings, t, information_2d, shift)
        if not cholesky(information, root[t], size):
            return False
        for i in range(size):
            mean[t, i] = shift[i]
            offset[i] = 1.0 / root[t, i * size + i]
        solve(root[t], offset, mean[t], np.int64(0), np.int64(1), size)
    return True


@entry
def guide_of(tables, linear_readings, reference, with_readings):
    """Return the guide along a path.

    Parameters
    ----------
    tables : Tables
        Coefficients under some theta; of a motion whose noise has heavy tails, with Gaussian noise as wide at each row.
    linear_readings : tuple of LinearReadings
        The readings, linearised at the reference.
    reference : ndarray, shape (T, D)
        The path.
    with_readings : bool
        Whether a belief about a row knows the row's own readings: where a sensor of the model looks back.

    Returns
    -------
    fine : bool
        Whether the linearised model has a Gaussian path.
    factor, gain, centre, root, mean : ndarray
        The further fields of :class:`Guide`.
    """
    n_steps, size = reference.shape[0], state_size(tables.motion)
    factor, gain = np.zeros((n_steps, size * size)), np.zeros((n_steps, size * size))
    centre, work = np.empty((n_steps, size)), np.empty(4 * size * size + 4 * size)
    root, mean = np.zeros((n_steps, size * size)), np.empty((n_steps, size))
    factors = Factors(factor, gain, centre)
    log_determinant = eliminate(
        tables, linear_readings, reference, reference, np.int64(0), n_steps, factors, work, size
    )
    fine = log_determinant > -np.inf and _beliefs(
        tables, linear_readings, reference, with_readings, factors, root, mean, work, size
    )
    return fine, factor, gain, centre, root, mean


@kernel
def _log_determinant(factor, size):
    value = 0.0
    for i in range(size):
        value += math.log(factor[i * size + i])
    return value


@kernel
def _draw_states(motion, t, guide, after, now, log_density, rng, wide_share, wide, weights, work, size):
    """Draw the states at t into `now` (D, n) given those at t + 1 in `after`; fill in their log densities (n,).

    `wide_share` of the states are drawn `wide` times as far from the centre, so that no weight is far above the others
    where the linearised path is too narrow.
    """
    n_steps, n = guide.reference.shape[0], now.shape[1]
    c, k_t, centre, reference = guide.factor[t], guide.gain[t], guide.centre[t], guide.reference
    z, state, following = work[0:size], work[size : 2 * size], work[2 * size : 3 * size]
    inner = t < n_steps - 1
    constant = _log_determinant(c, size) - 0.5 * size * LOG_2PI
    log_share = math.log(wide_share) - size * math.log(wide)
    log_rest, narrower = math.log1p(-wide_share), 1.0 / (wide * wide)
    normals_into(rng, now, weights)
    for m in range(n):
        scale, square = (wide if rng.random() < wide_share else 1.0), 0.0
        for i in range(size):
            z[i] = scale * now[i, m]
            square += z[i] * z[i]
        # The mixture's density; the wide part is never negligible beside the other.
        plain, far = log_rest - 0.5 * square, log_share - 0.5 * square * narrower
        greater, less = max(plain, far), min(plain, far)
        log_density[m] = constant + greater + math.log1p(math.exp(less - greater))
        for i in range(size - 1, -1, -1):
            value = z[i]
            for k in range(i + 1, size):
                value -= c[k * size + i] * z[k]
            z[i] = value / c[i * size + i]
        for i in range(size):
            z[i] += centre[i]
            if inner:
                following[i] = after[i, m]
                for j in range(size):
                    z[i] += k_t[i * size + j] * (after[j, m] - reference[t + 1, j])
        if inner:
            state_of_deviation(motion, t, reference, following, z, state)
        else:
            for i in range(size):
                state[i] = reference[t, i] + z[i]
        for i in range(size):
            now[i, m] = state[i]


@kernel
def _belief_logpdf(guide, t, states, logp, work, size):
    """Write the log density of b[t] at `states` (D, n) into `logp` (n,)."""
    root, constant = guide.root[t], _log_determinant(guide.root[t], size) - 0.5 * size * LOG_2PI
    deviation = work[0:size]
    for m in range(states.shape[1]):
        square = 0.0
        for i in range(size):
            deviation[i] = states[i, m] - guide.reference[t, i] - guide.mean[t, i]
        for i in range(size):
            value = 0.0
            for k in range(i, size):
                value += root[k * size + i] * deviation[k]
            square += value * value
        logp[m] = constant - 0.5 * square


@kernel
def _add_transitions(motion, t, before, after, logp, work, size):
    """Add log p(after | before) of each pair of states (D, n), at t - 1 and t, to `logp` (n,)."""
    first, second, value = work[0:size], work[size : 2 * size], work[2 * size : 2 * size + 1]
    column, scratch = first.reshape(size, 1), work[2 * size + 1 :].reshape(work.size - 2 * size - 1, 1)
    for m in range(logp.size):
        for i in range(size):
            first[i] = before[i, m]
            second[i] = after[i, m]
        value[0] = 0.0
        transition_logpdf(motion, t, column, second, value, scratch)
        logp[m] += value[0]


class Cloud(NamedTuple):
    """The particles of the row that was drawn last, as one part of a pass hands them to the next.

    Attributes
    ----------
    states : ndarray, shape (D * n_most,)
        States (D, n), one component after the other.
    belief, log_weights : ndarray, shape (n_most,)
        Log density of the row's belief at each of them, and what they weigh.
    number : ndarray of int, shape (1,)
        Their number n.
    log_norm : ndarray, shape (1,)
        Log of the sum of their weights before the next row is weighed.
    """

    states: Float
    belief: Float
    log_weights: Float
    number: NDArray[np.int64]
    log_norm: Float


class History(NamedTuple):
    """All particles of a pass, from which a path is drawn; those of row t begin at place ``first[t]``.

    Attributes
    ----------
    states : ndarray, shape (D * N,)
        States: of each row (D, n), one component after the other.
    later : ndarray of uint32, shape (N,)
        For each particle, the one of the row after it that it was drawn from.
    first : ndarray of int, shape (T + 1,)
        Places; none where no particles are kept.
    number : ndarray of int, shape (T,)
        Filled with the number n of each row.
    """

    states: Float
    later: NDArray[np.uint32]
    first: NDArray[np.int64]
    number: NDArray[np.int64]


@entry
def guided_rows(tables, guide, counts, wide_share, wide, begin, stop, ordered, rng, cloud, history, steps):
    """Run the guided filter over the rows stop - 1 ... begin, going on from row `stop`.

    Parameters
    ----------
    tables : Tables
        Coefficients under some theta.
    guide : Guide
        From :func:`guide_of`.
    counts : ndarray of int, shape (T,)
        Particles of each row.
    wide_share, wide : float
        Share of the states that are drawn so many times as far from the centre.
    begin, stop : int
        Rows.
    ordered : bool
        Whether particles are resampled in the order of a Hilbert curve, which correlated estimates need.
    rng : numpy.random.Generator
        The random numbers of these rows, and of no others.
    cloud : Cloud
        The particles of row `stop`; overwritten by those of row `begin`, with their normalised weights if it is 0.
    history : History
        Filled, unless it has no places.
    steps : ndarray, shape (T, 2)
        Filled with the log of the mean weight of each row, which sum to the log of an unbiased estimate of the
        evidence, and with the share of the row's particles that are effective.

    Returns
    -------
    status, time : int
        Outcome, and the row at which it ended.
    """
    n_steps, size, most = guide.reference.shape[0], state_size(tables.motion), cloud.belief.size
    looks_back, told = any_look_back(tables.sensors), history.first.size > 0
    drawn, kept, gathered = np.empty(size * most), cloud.states, np.empty(size * most)
    log_weights, belief_after = cloud.log_weights, cloud.belief
    weights, belief, term, parents = np.empty(most), np.empty(most), np.empty(most), np.empty(most, np.uint32)
    rows = work_rows(tables)
    scratch, work = np.empty(max(rows, 2) * most), np.empty(3 * size + 1 + rows)
    in_order = most if ordered else 0
    keys, sorted_weights, cell = np.empty(in_order, np.int64), np.empty(in_order), np.empty(size, np.int64)
    spread, middle = np.empty(size), np.empty(size)
    if stop == n_steps:
        cloud.number[0] = counts[n_steps - 1]
        cloud.log_norm[0] = math.log(cloud.number[0])
        for m in range(cloud.number[0]):
            log_weights[m] = 0.0
    n, log_norm = cloud.number[0], cloud.log_norm[0]
    for t in range(stop - 1, begin - 1, -1):
        inner = t < n_steps - 1
        now, after = drawn[: size * n].reshape(size, n), kept[: size * n].reshape(size, n)
        logw, density, own, wide_rows = log_weights[:n], term[:n], belief[:n], scratch[: rows * n].reshape(rows, n)
        _draw_states(tables.motion, t, guide, after, now, density, rng, wide_share, wide, weights[:n], work, size)
        _belief_logpdf(guide, t, now, own, work, size)
        for m in range(n):
            logw[m] += own[m] - density[m]
        if inner:
            _add_transitions(tables.motion, t + 1, now, after, logw, work, size)
            for m in range(n):
                logw[m] -= belief_after[m]
        if told:
            place = history.first[t]
            history.number[t] = n
            history.states[size * place : size * (place + n)].reshape(size, n)[:] = now
        # The row whose readings are weighed now.
        row = t
        if looks_back:
            row = t + 1
            if inner and any_reading(tables.sensors, row):
                sum_logpdf(tables.sensors, row, now, after, logw, wide_rows)
        elif any_reading(tables.sensors, row):
            sum_logpdf(tables.sensors, row, now, now, logw, wide_rows)
        resampled = False
        if row < n_steps:
            status, greatest, weight_sum = normalise(logw, weights[:n])
            if status != FINE:
                return status, t
            new_norm, squares = greatest + math.log(weight_sum), 0.0
            for m in range(n):
                squares += weights[m] * weights[m]
            effective = weight_sum * weight_sum / squares
            steps[row, 0], steps[row, 1] = new_norm - log_norm, effective / n
            log_norm = new_norm
            further = counts[max(t - 1, 0)]
            resampled = t > 0 and (effective < _RESAMPLED * n or further != n)
            if resampled:
                parent, draft = parents[:further], scratch[: 2 * most].reshape(2, most)
                if ordered:
                    hilbert_keys(now, keys[:n], cell, spread, middle)
                    order = np.argsort(keys[:n])
                    for m in range(n):
                        sorted_weights[m] = weights[order[m]]
                    draw_parents(AnyScheme(SYSTEMATIC), sorted_weights[:n], weight_sum, rng, parent, draft)
                    for m in range(further):
                        parent[m] = order[parent[m]]
                else:
                    draw_parents(AnyScheme(SYSTEMATIC), weights[:n], weight_sum, rng, parent, draft)
                chosen = gathered[: size * further].reshape(size, further)
                for d in range(size):
                    for m in range(further):
                        chosen[d, m] = now[d, parent[m]]
                for m in range(further):
                    belief_after[m] = own[parent[m]]
                    log_weights[m] = 0.0
                drawn, gathered = gathered, drawn
                n = further
                log_norm = math.log(n)
        if not resampled:
            for m in range(n):
                belief_after[m] = own[m]
        if told and t > 0:
            place = history.first[t - 1]
            for m in range(n):
                history.later[place + m] = parents[m] if resampled else m
        drawn, kept = kept, drawn
    if begin == 0:
        after, logw = kept[: size * n].reshape(size, n), log_weights[:n]
        for m in range(n):
            logw[m] -= belief_after[m]
        start_logpdf(tables.start, after, logw)
        if looks_back and any_reading(tables.sensors, 0):
            sum_logpdf(tables.sensors, 0, after, after, logw, scratch[: rows * n].reshape(rows, n))
        status, greatest, weight_sum = normalise(logw, weights[:n])
        if status != FINE:
            return status, 0
        steps[0, 0] += greatest + math.log(weight_sum) - log_norm
        for m in range(n):
            log_weights[m] = weights[m]
    for i in range(size * n):
        cloud.states[i] = kept[i]
    cloud.number[0], cloud.log_norm[0] = n, log_norm
    return FINE, begin
