"""Weighing particles by readings: all at once, or one reading after another with a record of how each was foreseen.

The second way is what criticism looks at. Between two readings the particles are reweighted, so each reading is
compared with what was to be expected of it given everything before it, the readings of the same row included. When
the model is right, the resulting probability integral transforms are independent uniforms across channels and time
(Rosenblatt 1952); those from one common prior per row would share the error of the pose.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types
from numpy.typing import NDArray

from pmcl.engine.compile import generic, kernel, overload_for_types
from pmcl.engine.contract import NOT_ASKED, one_reading, reading_count, reading_exponent, reading_slots, states_asked
from pmcl.engine.sensor_tuples import sum_logpdf
from pmcl.engine.vector_math import exp_into, maximum, total

__all__ = ["ALL_ZERO", "FINE", "NOT_A_NUMBER", "NO_ANCESTOR", "AllAtOnce", "OneByOne", "normalise", "weigh"]

Float = NDArray[np.float64]

# Outcomes of a pass. They are numbers because compiled loops cannot raise with details.
FINE, ALL_ZERO, NOT_A_NUMBER, NO_ANCESTOR = 0, 1, 2, 3


class AllAtOnce(NamedTuple):
    """Nothing is recorded (numba wants at least one field)."""

    nothing: float


class OneByOne(NamedTuple):
    """Where the record of single readings goes.

    Attributes
    ----------
    n_steps : int
        Rows T.
    log_score, low, high : ndarray, shape (N,)
        For each slot of all sensors: log predictive density of the reading, and the predictive probabilities of a
        smaller and of a smaller or equal one. Slots that were not measured are left as they are.
    draft : ndarray, shape (7, n)
        Work space.
    alone : bool
        Whether each reading of a sensor is foreseen as if the sensor had read nothing else at that time.
    """

    n_steps: int
    log_score: Float
    low: Float
    high: Float
    draft: Float
    alone: bool


@kernel
def normalise(log_weights, weights):
    """Write exp(log_weights - max) into `weights`; return (status, max, sum). `log_weights` stay as they are."""
    if not total(log_weights) < np.inf:
        return NOT_A_NUMBER, 0.0, 0.0
    greatest = maximum(log_weights)
    if greatest == -np.inf:
        return ALL_ZERO, greatest, 0.0
    exp_into(log_weights, greatest, weights)
    return FINE, greatest, total(weights)


@kernel(reorder=True)
def _inner(x, y):
    value = 0.0
    for i in range(x.size):
        value += x[i] * y[i]
    return value


@generic
def weigh(record, sensors, t, previous, current, log_weights, weights, scratch):
    """Add the log densities of all readings at t to `log_weights` (n,); `weights` (n,) is work space."""


@weigh.register(AllAtOnce)
def _all_at_once(record, sensors, t, previous, current, log_weights, weights, scratch):
    sum_logpdf(sensors, t, previous, current, log_weights, scratch)


@weigh.register(OneByOne)
def _one_by_one(record, sensors, t, previous, current, log_weights, weights, scratch):
    _sensor_by_sensor(sensors, 0, record, t, previous, current, log_weights, weights, scratch)


def _sensor_by_sensor(sensors, offset, record, t, previous, current, log_weights, weights, scratch):
    for sensor in sensors:
        _slot_by_slot(sensor, offset, record, t, previous, current, log_weights, weights, scratch)
        offset += reading_count(sensor, record.n_steps)


@overload_for_types(_sensor_by_sensor)
def _compiled_sensor_by_sensor(sensors, offset, record, t, previous, current, log_weights, weights, scratch):
    if isinstance(sensors, types.BaseTuple) and len(sensors) == 0:
        return lambda sensors, offset, record, t, previous, current, log_weights, weights, scratch: None

    def run(sensors, offset, record, t, previous, current, log_weights, weights, scratch):
        _slot_by_slot(sensors[0], offset, record, t, previous, current, log_weights, weights, scratch)
        after = offset + reading_count(sensors[0], record.n_steps)
        _sensor_by_sensor(sensors[1:], after, record, t, previous, current, log_weights, weights, scratch)

    return run


@kernel
def _log_mean(weights, weight_sum, logp, draft):
    """Return the log of the weighted mean of exp(`logp`); `draft` (n,) is work space."""
    greatest = maximum(logp)
    if not abs(greatest) < np.inf:
        return greatest
    exp_into(logp, greatest, draft)
    return greatest + math.log(_inner(weights, draft) / weight_sum)


@kernel
def _ask_few(weights, weight_sum, count, asked, low):
    """Choose some states in proportion to their weights, by a comb of `count` teeth.

    `asked` (n,) receives the number of teeth that fall on each state, and `low` of the other states the mark
    that they are not asked.
    """
    step, reached, tooth = weight_sum / count, 0.0, 0
    for i in range(weights.size):
        reached += weights[i]
        before = tooth
        while tooth < count and (tooth + 0.5) * step < reached:
            tooth += 1
        asked[i] = float(tooth - before)
        low[i] = 0.0 if tooth > before else NOT_ASKED


@kernel
def _mean_of_asked(asked, values):
    """Return the mean of `values` over the teeth that fall on their states."""
    value, count = 0.0, 0.0
    for i in range(asked.size):
        if asked[i] > 0.0:
            value += asked[i] * values[i]
            count += asked[i]
    return value / count


@kernel
def _slot_by_slot(sensor, offset, record, t, previous, current, log_weights, weights, scratch):
    draft = record.draft
    logp, low, high, memory, asked = draft[0], draft[1], draft[2], draft[3:6], draft[6]
    status, greatest, weight_sum = normalise(log_weights, weights)
    exponent = reading_exponent(sensor)
    count = states_asked(sensor)
    few = 0 < count < logp.size
    for i in range(low.size):
        low[i] = 0.0  # all are asked for
    first, stop = reading_slots(sensor, t)
    for slot in range(first, stop):
        if few and status == FINE:
            _ask_few(weights, weight_sum, count, asked, low)
        if not one_reading(sensor, t, slot, previous, current, logp, low, high, memory, scratch):
            continue
        if status == FINE:
            if few:
                record.low[offset + slot] = _mean_of_asked(asked, low)
                record.high[offset + slot] = _mean_of_asked(asked, high)
            else:
                record.low[offset + slot] = _inner(weights, low) / weight_sum
                record.high[offset + slot] = _inner(weights, high) / weight_sum
            before = greatest + math.log(weight_sum)
            if exponent != 1.0 or record.alone:
                record.log_score[offset + slot] = _log_mean(weights, weight_sum, logp, low)
        for i in range(logp.size):
            log_weights[i] += exponent * logp[i]
        if status == FINE and not record.alone:
            status, greatest, weight_sum = normalise(log_weights, weights)
            if status != FINE:
                record.log_score[offset + slot] = -np.inf
            elif exponent == 1.0:
                record.log_score[offset + slot] = greatest + math.log(weight_sum) - before
