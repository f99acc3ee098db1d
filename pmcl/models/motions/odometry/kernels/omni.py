"""Kernels of :class:`~pmcl.models.motions.odometry.table.OmniMotion`.

Its noise is Gaussian in a frame that is turned against the robot's by the direction of the odometry's step.
"""

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
from pmcl.engine.random_numbers import normals_into
from pmcl.engine.scalars import LOG_2PI
from pmcl.engine.vector_math import sincos_into
from pmcl.models.motions.increments.kernels.plain import bend, unbend
from pmcl.models.motions.odometry.kernels.steps import omni_spreads
from pmcl.models.motions.odometry.table import OmniMotion


@state_size.register(OmniMotion)
def _state_size(motion):
    return 3


@scratch_rows.register(OmniMotion)
def _scratch_rows(table):
    return 5


@kernel
def _step_of(motion, t):
    """Return (bearing [rad], distance [m], standard deviations along, aside [m] and of the turn [rad]) of row t."""
    mean, alpha = motion.mean, motion.alpha
    forward, left, turn = mean[t, 0], mean[t, 1], mean[t, 2]
    along, aside, turning = omni_spreads(forward, left, turn, alpha[0], alpha[1], alpha[2], alpha[3], alpha[4])
    return math.atan2(left, forward), math.sqrt(forward * forward + left * left), along, aside, turning


@propagate.register(OmniMotion)
def _propagate(motion, t, rng, previous, current, scratch):
    bearing, distance, std_along, std_aside, std_turn = _step_of(motion, t)
    turn = motion.mean[t, 2]
    sine, cosine = scratch[0], scratch[1]
    along, aside, noise = scratch[2], scratch[3], scratch[4]
    n = current.shape[1]
    x, y, heading = current[0], current[1], current[2]
    before_x, before_y, before = previous[0], previous[1], previous[2]
    normals_into(rng, scratch[2:5], sine)
    for i in range(n):
        heading[i] = before[i] + bearing
    sincos_into(heading, sine, cosine)
    # One result per loop: with more the compiler gives up proving that the arrays are distinct.
    for i in range(n):
        x[i] = before_x[i] + (distance + std_along * along[i]) * cosine[i] - std_aside * aside[i] * sine[i]
    for i in range(n):
        y[i] = before_y[i] + (distance + std_along * along[i]) * sine[i] + std_aside * aside[i] * cosine[i]
    for i in range(n):
        heading[i] = before[i] + turn + std_turn * noise[i]


@transition_logpdf.register(OmniMotion)
def _transition_logpdf(motion, t, previous, current, logp, scratch):
    bearing, distance, std_along, std_aside, std_turn = _step_of(motion, t)
    turn = motion.mean[t, 2]
    sine, cosine, angle = scratch[0], scratch[1], scratch[2]
    before_x, before_y, before = previous[0], previous[1], previous[2]
    for i in range(logp.size):
        angle[i] = before[i] + bearing
    sincos_into(angle, sine, cosine)
    x, y, heading = current[0], current[1], current[2]
    w_along, w_aside, w_turn = 1.0 / std_along, 1.0 / std_aside, 1.0 / std_turn
    constant = math.log(w_along * w_aside * w_turn) - 1.5 * LOG_2PI
    for i in range(logp.size):
        dx, dy = x - before_x[i], y - before_y[i]
        u = (dx * cosine[i] + dy * sine[i] - distance) * w_along
        v = (dy * cosine[i] - dx * sine[i]) * w_aside
        e = (heading - before[i] - turn) * w_turn
        logp[i] += constant - 0.5 * (u * u + v * v + e * e)


@path_transition_logpdf.register(OmniMotion)
def _path_transition_logpdf(motion, n_steps, path, logp, scratch):
    x, y, heading = path[0], path[1], path[2]
    for t in range(1, n_steps):
        bearing, distance, std_along, std_aside, std_turn = _step_of(motion, t)
        dx, dy = x[t] - x[t - 1], y[t] - y[t - 1]
        c, s = math.cos(heading[t - 1] + bearing), math.sin(heading[t - 1] + bearing)
        u, v = (dx * c + dy * s - distance) / std_along, (dy * c - dx * s) / std_aside
        e = (heading[t] - heading[t - 1] - motion.mean[t, 2]) / std_turn
        logp[t] -= 1.5 * LOG_2PI + math.log(std_along * std_aside * std_turn) + 0.5 * (u * u + v * v + e * e)


@linearise_transition.register(OmniMotion)
def _linearise_transition(motion, t, before, after, jacobian, offset, precision):
    bearing, distance, std_along, std_aside, std_turn = _step_of(motion, t)
    c, s = math.cos(before[2] + bearing), math.sin(before[2] + bearing)
    # The heading turns the displacement that the reference really made, noise included.
    dx, dy = after[0] - before[0], after[1] - before[1]
    jacobian[0, 0], jacobian[0, 1], jacobian[0, 2] = 1.0, 0.0, -dy
    jacobian[1, 0], jacobian[1, 1], jacobian[1, 2] = 0.0, 1.0, dx
    jacobian[2, 0], jacobian[2, 1], jacobian[2, 2] = 0.0, 0.0, 1.0
    offset[0] = before[0] + c * distance - after[0]
    offset[1] = before[1] + s * distance - after[1]
    offset[2] = before[2] + motion.mean[t, 2] - after[2]
    a, b = std_along**-2, std_aside**-2
    precision[0, 0] = c * c * a + s * s * b
    precision[1, 1] = s * s * a + c * c * b
    precision[0, 1] = precision[1, 0] = c * s * (a - b)
    precision[0, 2] = precision[1, 2] = precision[2, 0] = precision[2, 1] = 0.0
    precision[2, 2] = std_turn**-2


# The noise turns with the heading, as that of increments does.


@state_of_deviation.register(OmniMotion)
def _state_of_deviation(motion, t, reference, after, deviation, out):
    bend(reference, t, after, deviation, out)


@deviation_of_state.register(OmniMotion)
def _deviation_of_state(motion, t, reference, after, state, deviation):
    unbend(reference, t, after, state, deviation)
