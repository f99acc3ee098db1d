"""The functions that a motion, start or sensor table implements: the extension points of pmcl.

Arrays are laid out for vector instructions: a set of n states of D components is an array of shape (D, n). Log
densities are *added* to `logp`. `scratch` is a work array of shape (rows, n) whose contents are undefined; its rows
are the most that any part asks for with :func:`scratch_rows`. Implementations are plain functions that numba can
compile, registered with ``@propagate.register(MyTable)``. All of them must cope with n = 1.
"""

from __future__ import annotations

import numpy as np

from pmcl.engine.compile import generic

__all__ = [
    "NOT_ASKED",
    "deviation_of_state",
    "draw_precision",
    "draw_start",
    "has_reading",
    "linear_information",
    "linearise_start",
    "linearise_transition",
    "looks_back",
    "one_reading",
    "path_reading_logpdf",
    "path_transition_logpdf",
    "propagate",
    "propagate_widely",
    "reading_count",
    "reading_exponent",
    "reading_logpdf",
    "reading_slots",
    "scratch_rows",
    "start_logpdf",
    "state_of_deviation",
    "state_size",
    "states_asked",
    "transition_logpdf",
    "widens",
]

# Marks states whose distribution function is not asked for. No probability, and nothing that unwritten memory holds.
NOT_ASKED = -1e300


@generic
def state_size(motion):
    """Return D, the number of components of a state (3 for a pose)."""


@generic
def scratch_rows(table):
    """Return how many rows of scratch space the functions of this table need."""


@generic
def draw_start(start, rng, current):
    """Fill `current` (D, n) with draws of the first state."""


@generic
def start_logpdf(start, current, logp):
    """Add the log density of each first state in `current` (D, n) to `logp` (n,)."""


@generic
def propagate(motion, t, rng, previous, current, scratch):
    """Draw states at time t into `current` (D, n) given the states at time t - 1 in `previous` (D, n)."""


@generic
def widens(motion):
    """Return whether :func:`propagate_widely` draws states that weigh unequally. Optional, False by default."""


@generic
def propagate_widely(motion, t, rng, previous, current, log_weights, scratch):
    """Draw states at time t so that rare steps are not left to chance, and weigh them.

    Like :func:`propagate`, but from a wider distribution; the log of the transition density over that of this
    distribution is added to `log_weights` (n,). Optional: by default it is the transition itself, and nothing is added.
    Motion whose noise has heavy tails needs it: a filter would else have no particle where a step goes far astray.
    """


@generic
def transition_logpdf(motion, t, previous, current, logp, scratch):
    """Add log p(current | previous) for each of `previous` (D, n) to `logp` (n,); `current` (D,) is one state at t."""


@generic
def draw_precision(motion, t, before, after, rng, precision):
    """Draw the precision of each component of the noise of one step, relative to its scale, given the step.

    Of motion whose noise is a scale mixture of Gaussians, such as Student's t; `before` (D,) and `after` (D,) are the
    states at t - 1 and t. Returns whether the step has precisions; optional, by default none has.
    """


@generic
def has_reading(sensor, t):
    """Return whether the sensor measured anything at time t."""


@generic
def looks_back(sensor):
    """Return True when the density of a reading depends on the previous state as well as the current one."""


@generic
def reading_logpdf(sensor, t, previous, current, logp, scratch):
    """Add log p(readings at t | current, previous) to `logp` (n,).

    `previous` (D, n) are the states at t - 1 (at t = 0 the same array as `current`); only sensors that look back
    read them.
    """


@generic
def linearise_start(start, reference, precision, shift):
    """Add the Gaussian information of the start belief about the deviation from `reference` (D,).

    `precision` (D, D) gains the inverse covariance, `shift` (D,) the inverse covariance times the mean deviation. Only
    the lower triangle of `precision` is read.
    """


@generic
def linearise_transition(motion, t, before, after, jacobian, offset, precision):
    """Linearise the transition around `before` (D,) at t - 1 and `after` (D,) at t.

    deviation[t] = jacobian @ deviation[t-1] + offset + noise of inverse covariance `precision`; all three are filled.
    """


@generic
def linear_information(sensor, linear, t, precision, shift):
    """Add the information of the readings at t about the deviation from the reference.

    Only the lower triangle of `precision` is read. `linear` is what the sensor's Python side prepared at the reference
    trajectory: mostly :class:`pmcl.engine.linear_readings.LinearReadings`, but a sensor may have a type of its own.
    """


@generic
def path_transition_logpdf(motion, n_steps, path, logp, scratch):
    """Add log p(path[:, t] | path[:, t - 1]) to ``logp[t]`` for t = 1 ... n_steps - 1; `path` is (D, T).

    Optional: by default each row is evaluated by itself. `scratch` has T columns here.
    """


@generic
def path_reading_logpdf(sensor, n_steps, path, logp, scratch):
    """Add the log density of the readings at each row of one trajectory `path` (D, T) to ``logp[t]``.

    Optional: by default each row is evaluated by itself. `scratch` has T columns here.
    """


@generic
def reading_count(sensor, n_steps):
    """Return how many single readings (slots) the sensor has over `n_steps` rows, measured or not.

    Optional, with the next two: by default all that a sensor reads at a row is one slot, and no distribution function
    is known.
    """


@generic
def reading_slots(sensor, t):
    """Return (first, stop): the slots of row t, numbered on from those of the row before."""


@generic
def reading_exponent(sensor):
    """Return the exponent of each reading's density in the density of its row: 1 where readings are independent.

    Optional, 1 by default. With a smaller one :func:`reading_logpdf` tempers what its readings say together; the record
    of single readings still foresees each by its own density.
    """


@generic
def one_reading(sensor, t, slot, previous, current, logp, low, high, memory, scratch):
    """Write what each state says about one single reading, given the earlier readings of the same row.

    `logp` (n,) receives the log density; over all slots of a row, times :func:`reading_exponent`, it adds up to that of
    :func:`reading_logpdf`;
    `low` and `high` (n,) the probabilities of a smaller, and of a smaller or equal reading (they differ where the
    reading has a probability of its own, as a clipped one does; NaN when the distribution function is not known).
    `memory` (3, n) and `scratch` are kept from slot to slot of one row; every slot is asked for, in order. Returns
    whether the slot was measured.

    Of a sensor that registers :func:`states_asked` the caller wants `low` and `high` of some states only: it puts
    :data:`NOT_ASKED` into `low` of the others, which may stay.
    """


@generic
def states_asked(sensor):
    """Return for how many states :func:`one_reading` is asked for `low` and `high`; 0 stands for all of them.

    Few are enough for their mean. A sensor registers a number if they cost it much more than the density.
    """


@widens.register(object)
def _as_wide_as_noise(motion):
    return False


@propagate_widely.register(object)
def _propagate_as_is(motion, t, rng, previous, current, log_weights, scratch):
    propagate(motion, t, rng, previous, current, scratch)


@draw_precision.register(object)
def _no_mixture(motion, t, before, after, rng, precision):
    return False


@reading_count.register(object)
def _one_slot_per_row(sensor, n_steps):
    return n_steps


@reading_exponent.register(object)
def _independent(sensor):
    return 1.0


@states_asked.register(object)
def _all_states(sensor):
    return 0


@reading_slots.register(object)
def _slot_of_row(sensor, t):
    return t, t + 1


@one_reading.register(object)
def _whole_row(sensor, t, slot, previous, current, logp, low, high, memory, scratch):
    if not has_reading(sensor, t):
        return False
    for i in range(logp.size):
        logp[i] = 0.0
        low[i] = np.nan
        high[i] = np.nan
    reading_logpdf(sensor, t, previous, current, logp, scratch)
    return True


@path_transition_logpdf.register(object)
def _transition_row_by_row(motion, n_steps, path, logp, scratch):
    size = path.shape[0]
    before, after, value = scratch[0, :size], scratch[1, :size], scratch[2, :1]
    # As wide as one state: functions over whole rows would otherwise do everything T times over.
    rows, columns = scratch_rows(motion), scratch.shape[1]
    work = scratch.reshape(scratch.size)[3 * columns : 3 * columns + rows].reshape(rows, 1)
    for t in range(1, n_steps):
        for d in range(size):
            before[d], after[d] = path[d, t - 1], path[d, t]
        value[0] = 0.0
        transition_logpdf(motion, t, before.reshape(size, 1), after, value, work)
        logp[t] += value[0]


@path_reading_logpdf.register(object)
def _readings_row_by_row(sensor, n_steps, path, logp, scratch):
    size = path.shape[0]
    before, now, value = scratch[0, :size], scratch[1, :size], scratch[2, :1]
    rows, columns = scratch_rows(sensor), scratch.shape[1]
    work = scratch.reshape(scratch.size)[3 * columns : 3 * columns + rows].reshape(rows, 1)
    for t in range(n_steps):
        if not has_reading(sensor, t):
            continue
        for d in range(size):
            before[d], now[d] = path[d, max(t - 1, 0)], path[d, t]
        value[0] = 0.0
        reading_logpdf(sensor, t, before.reshape(size, 1), now.reshape(size, 1), value, work)
        logp[t] += value[0]


@generic
def state_of_deviation(motion, t, reference, after, deviation, out):
    """Turn a deviation at time t, as the linearised model means it, into a state `out` (D,).

    `after` (D,) is the next state. Optional: by default ``reference[t] + deviation``. A motion model may bend the map
    so that its own noise stays Gaussian beyond first order. The map must have unit Jacobian, and
    :func:`deviation_of_state` as its inverse.
    """


@generic
def deviation_of_state(motion, t, reference, after, state, deviation):
    """Do the inverse of :func:`state_of_deviation`: write the deviation (D,) of `state` given the next one."""


@state_of_deviation.register(object)
def _straight_state(motion, t, reference, after, deviation, out):
    for d in range(out.size):
        out[d] = reference[t, d] + deviation[d]


@deviation_of_state.register(object)
def _straight_deviation(motion, t, reference, after, state, deviation):
    for d in range(deviation.size):
        deviation[d] = state[d] - reference[t, d]
