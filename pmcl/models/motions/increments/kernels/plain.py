"""Plain kernels of :class:`~pmcl.models.motions.increments.table.IncrementMotion` without extras."""

from __future__ import annotations

import math

from pmcl.engine.compile import kernel
from pmcl.engine.contract import (
    deviation_of_state,
    linearise_transition,
    path_transition_logpdf,
    propagate,
    scratch_rows,
    state_of_deviation,
    state_size,
    transition_logpdf,
)
from pmcl.engine.parameter_draws import propagate_draws
from pmcl.engine.random_numbers import normals_into
from pmcl.engine.scalars import LOG_2PI
from pmcl.engine.tables import NoExtras
from pmcl.engine.vector_math import log_into, sincos_into
from pmcl.engine.views import take
from pmcl.models.motions.increments.table import IncrementMotion


@state_size.register(IncrementMotion, NoExtras)
def _state_size(motion):
    return 3


@scratch_rows.register(IncrementMotion, NoExtras)
def _scratch_rows(table):
    return 5


@propagate.register(IncrementMotion, NoExtras)
def _propagate(motion, t, rng, previous, current, scratch):
    sine, cosine = scratch[0], scratch[1]
    forward, left, turn = scratch[2], scratch[3], scratch[4]
    n = current.shape[1]
    x, y, heading = current[0], current[1], current[2]
    before_x, before_y, before_heading = previous[0], previous[1], previous[2]
    # Normals are drawn in a loop of their own: it cannot be vectorised, the arithmetic below can.
    normals_into(rng, scratch[2:5], sine)
    sincos_into(before_heading, sine, cosine)
    mean_forward, mean_left, mean_turn = motion.mean[t, 0], motion.mean[t, 1], motion.mean[t, 2]
    std_forward, std_left, std_turn = motion.std[t, 0], motion.std[t, 1], motion.std[t, 2]
    # One result per loop: with more the compiler gives up proving that the arrays are distinct.
    for i in range(n):
        f, g = mean_forward + std_forward * forward[i], mean_left + std_left * left[i]
        x[i] = before_x[i] + f * cosine[i] - g * sine[i]
    for i in range(n):
        f, g = mean_forward + std_forward * forward[i], mean_left + std_left * left[i]
        y[i] = before_y[i] + f * sine[i] + g * cosine[i]
    for i in range(n):
        heading[i] = before_heading[i] + mean_turn + std_turn * turn[i]


@transition_logpdf.register(IncrementMotion, NoExtras)
def _transition_logpdf(motion, t, previous, current, logp, scratch):
    sine, cosine = scratch[0], scratch[1]
    before_x, before_y, before_heading = previous[0], previous[1], previous[2]
    sincos_into(before_heading, sine, cosine)
    x, y, heading = current[0], current[1], current[2]
    mean_forward, mean_left, mean_turn = motion.mean[t, 0], motion.mean[t, 1], motion.mean[t, 2]
    w_forward, w_left, w_turn = 1.0 / motion.std[t, 0], 1.0 / motion.std[t, 1], 1.0 / motion.std[t, 2]
    constant = math.log(w_forward * w_left * w_turn) - 1.5 * LOG_2PI
    for i in range(logp.size):
        dx, dy = x - before_x[i], y - before_y[i]
        f = (dx * cosine[i] + dy * sine[i] - mean_forward) * w_forward
        g = (dy * cosine[i] - dx * sine[i] - mean_left) * w_left
        h = (heading - before_heading[i] - mean_turn) * w_turn
        logp[i] += constant - 0.5 * (f * f + g * g + h * h)


@path_transition_logpdf.register(IncrementMotion, NoExtras)
def _path_transition_logpdf(motion, n_steps, path, logp, scratch):
    sine, cosine, volume, work = scratch[0], scratch[1], scratch[2, :n_steps], scratch[3, :n_steps]
    x, y, heading = path[0], path[1], path[2]
    sincos_into(heading, sine, cosine)
    mean, std = motion.mean, motion.std
    # A logarithm that is called for each row would keep the loop from being vectorised.
    volume[0] = 1.0
    for t in range(1, n_steps):
        volume[t] = std[t, 0] * std[t, 1] * std[t, 2]
    log_into(volume, work)
    for t in range(1, n_steps):
        dx, dy = x[t] - x[t - 1], y[t] - y[t - 1]
        c, s = cosine[t - 1], sine[t - 1]
        f = (dx * c + dy * s - mean[t, 0]) / std[t, 0]
        g = (dy * c - dx * s - mean[t, 1]) / std[t, 1]
        h = (heading[t] - heading[t - 1] - mean[t, 2]) / std[t, 2]
        work[t] += 0.5 * (f * f + g * g + h * h)
    for t in range(1, n_steps):
        logp[t] -= 1.5 * LOG_2PI + work[t]


@linearise_transition.register(IncrementMotion, NoExtras)
def _linearise_transition(motion, t, before, after, jacobian, offset, precision):
    c, s = math.cos(before[2]), math.sin(before[2])
    f, g = motion.mean[t, 0], motion.mean[t, 1]
    # The heading turns the displacement that the reference really made, noise included.
    dx, dy = after[0] - before[0], after[1] - before[1]
    jacobian[0, 0], jacobian[0, 1], jacobian[0, 2] = 1.0, 0.0, -dy
    jacobian[1, 0], jacobian[1, 1], jacobian[1, 2] = 0.0, 1.0, dx
    jacobian[2, 0], jacobian[2, 1], jacobian[2, 2] = 0.0, 0.0, 1.0
    offset[0] = before[0] + c * f - s * g - after[0]
    offset[1] = before[1] + s * f + c * g - after[1]
    offset[2] = before[2] + motion.mean[t, 2] - after[2]
    # The noise covariance is a rotation of a diagonal one, so its inverse needs no factorisation.
    a, b = motion.std[t, 0] ** -2, motion.std[t, 1] ** -2
    precision[0, 0] = c * c * a + s * s * b
    precision[1, 1] = s * s * a + c * c * b
    precision[0, 1] = precision[1, 0] = c * s * (a - b)
    precision[0, 2] = precision[1, 2] = precision[2, 0] = precision[2, 1] = 0.0
    precision[2, 2] = motion.std[t, 2] ** -2


# The noise of an increment is Gaussian in the robot's own frame, which turns with the heading. To first order a heading
# deviation h turns the displacement to the next pose by h; these two maps turn all of it, noise included, by exactly
# h. Without them a small sigma_left could not be told from the forward noise that a turned heading leaks into it.


@kernel
def bend(reference, t, after, deviation, out):
    """Write the pose that an unbent deviation at t stands for into ``out[:3]``; `after` is the next pose."""
    h = deviation[2]
    c, s = math.cos(h), math.sin(h)
    back_x, back_y = reference[t, 0] - reference[t + 1, 0], reference[t, 1] - reference[t + 1, 1]
    u = back_x + deviation[0] - (after[0] - reference[t + 1, 0]) + h * back_y
    v = back_y + deviation[1] - (after[1] - reference[t + 1, 1]) - h * back_x
    out[0] = after[0] + c * u - s * v
    out[1] = after[1] + s * u + c * v
    out[2] = reference[t, 2] + h


@kernel
def unbend(reference, t, after, state, deviation):
    """Do the inverse of :func:`bend`."""
    h = state[2] - reference[t, 2]
    c, s = math.cos(h), math.sin(h)
    back_x, back_y = reference[t, 0] - reference[t + 1, 0], reference[t, 1] - reference[t + 1, 1]
    dx, dy = state[0] - after[0], state[1] - after[1]
    u, v = c * dx + s * dy, c * dy - s * dx
    deviation[0] = u - back_x - h * back_y + (after[0] - reference[t + 1, 0])
    deviation[1] = v - back_y + h * back_x + (after[1] - reference[t + 1, 1])
    deviation[2] = h


@state_of_deviation.register(IncrementMotion, NoExtras)
def _state_of_deviation(motion, t, reference, after, deviation, out):
    bend(reference, t, after, deviation, out)


@deviation_of_state.register(IncrementMotion, NoExtras)
def _deviation_of_state(motion, t, reference, after, state, deviation):
    unbend(reference, t, after, state, deviation)


@propagate_draws.register(IncrementMotion, NoExtras)
def _propagate_draws(motion, stack, t, rng, which, previous, current, scratch, order, counts, gathered):
    """Use the mean and noise of each particle's own draw."""
    sine, cosine, forward, left, turn = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    n = current.shape[1]
    x, y, heading = current[0], current[1], current[2]
    before_x, before_y, before_heading = previous[0], previous[1], previous[2]
    normals_into(rng, scratch[2:5], sine)
    for i in range(n):
        mean, std = take(motion.mean, stack.mean, which[i]), take(motion.std, stack.std, which[i])
        forward[i] = mean[t, 0] + std[t, 0] * forward[i]
        left[i] = mean[t, 1] + std[t, 1] * left[i]
        turn[i] = mean[t, 2] + std[t, 2] * turn[i]
    sincos_into(before_heading, sine, cosine)
    for i in range(n):
        x[i] = before_x[i] + forward[i] * cosine[i] - left[i] * sine[i]
    for i in range(n):
        y[i] = before_y[i] + forward[i] * sine[i] + left[i] * cosine[i]
    for i in range(n):
        heading[i] = before_heading[i] + turn[i]
