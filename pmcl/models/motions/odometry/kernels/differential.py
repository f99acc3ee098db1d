"""Kernels of :class:`~pmcl.models.motions.odometry.table.DifferentialMotion`."""

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
from pmcl.engine.scalars import HALF_LOG_2PI, LOG_2PI, TURN
from pmcl.engine.vector_math import atan2_into, exp_into, log_into, sincos_into
from pmcl.models.motions.increments.kernels.plain import bend, unbend
from pmcl.models.motions.odometry.kernels.steps import (
    FEW_WRAPS,
    NEAREST,
    differential_spreads,
    measured_step,
    step_logpdf,
)
from pmcl.models.motions.odometry.table import DifferentialMotion

# The linearised model moves the robot aside as if it had gone at least this far [m].
SHORTEST_WAY = 0.01


@state_size.register(DifferentialMotion)
def _state_size(motion):
    return 3


@scratch_rows.register(DifferentialMotion)
def _scratch_rows(table):
    return 5


@kernel
def _step_of(motion, t):
    """Return (first turn, distance, standard deviations and share as from `differential_spreads`) of row t."""
    mean, alpha = motion.mean, motion.alpha
    first, distance, a, b = measured_step(mean[t, 0], mean[t, 1], mean[t, 2])
    along, heading, share, direction = differential_spreads(distance, a, b, alpha[0], alpha[1], alpha[2], alpha[3])
    return first, distance, along, heading, share, direction


@propagate.register(DifferentialMotion)
def _propagate(motion, t, rng, previous, current, scratch):
    first, distance, along, heading_std, share, direction_std = _step_of(motion, t)
    turn = motion.mean[t, 2]
    sine, cosine = scratch[0], scratch[1]
    drive, direction, heading = scratch[2], scratch[3], scratch[4]
    normals_into(rng, scratch[2:5], sine)
    x, y, after = current[0], current[1], current[2]
    before_x, before_y, before = previous[0], previous[1], previous[2]
    n = current.shape[1]
    of_heading = share * heading_std
    # One result per loop: with more the compiler gives up proving that the arrays are distinct.
    for i in range(n):
        direction[i] = before[i] + first + of_heading * heading[i] + direction_std * direction[i]
    sincos_into(direction, sine, cosine)
    for i in range(n):
        x[i] = before_x[i] + (distance + along * drive[i]) * cosine[i]
    for i in range(n):
        y[i] = before_y[i] + (distance + along * drive[i]) * sine[i]
    for i in range(n):
        after[i] = before[i] + turn + heading_std * heading[i]


@transition_logpdf.register(DifferentialMotion)
def _transition_logpdf(motion, t, previous, current, logp, scratch):
    first, distance, along, heading_std, share, direction_std = _step_of(motion, t)
    expected = motion.mean[t, 2]
    dx, dy, angle, high, low = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    x, y, heading = current[0], current[1], current[2]
    before_x, before_y, before = previous[0], previous[1], previous[2]
    n = logp.size
    for i in range(n):
        dx[i] = x - before_x[i]
    for i in range(n):
        dy[i] = y - before_y[i]
    atan2_into(dy, dx, angle)
    if direction_std >= FEW_WRAPS:
        for i in range(n):
            logp[i] += step_logpdf(
                distance, along, heading_std, share, direction_std, math.sqrt(dx[i] * dx[i] + dy[i] * dy[i]),
                angle[i] - before[i] - first, heading - before[i] - expected,
            )  # fmt: skip
        return
    length = dx
    for i in range(n):
        length[i] = max(math.sqrt(dx[i] * dx[i] + dy[i] * dy[i]), NEAREST)
    w_along, w_heading, w_direction = 1.0 / along, 1.0 / heading_std, 1.0 / direction_std
    constant = math.log(w_along * w_heading * w_direction) - LOG_2PI - HALF_LOG_2PI
    # The same as in `step_logpdf`: the likelier of forward and backward, and how much less likely the other one is.
    for i in range(n):
        e = heading - before[i] - expected
        d = angle[i] - before[i] - first - share * e
        d = abs(d - TURN * math.floor(d / TURN + 0.5))
        a, b = (length[i] - distance) * w_along, d * w_direction
        c, f = (length[i] + distance) * w_along, (math.pi - d) * w_direction
        ahead, back = -0.5 * (a * a + b * b), -0.5 * (c * c + f * f)
        high[i] = max(ahead, back)
        low[i] = min(ahead, back) - high[i]
    exp_into(low, 0.0, angle)
    for i in range(n):
        angle[i] = (1.0 + angle[i]) / length[i]
    log_into(angle, low)
    for i in range(n):
        e = (heading - before[i] - expected) * w_heading
        logp[i] += constant - 0.5 * e * e + high[i] + low[i]


@path_transition_logpdf.register(DifferentialMotion)
def _path_transition_logpdf(motion, n_steps, path, logp, scratch):
    x, y, heading = path[0], path[1], path[2]
    for t in range(1, n_steps):
        first, distance, along, heading_std, share, direction_std = _step_of(motion, t)
        dx, dy = x[t] - x[t - 1], y[t] - y[t - 1]
        logp[t] += step_logpdf(
            distance, along, heading_std, share, direction_std, math.sqrt(dx * dx + dy * dy),
            math.atan2(dy, dx) - heading[t - 1] - first, heading[t] - heading[t - 1] - motion.mean[t, 2],
        )  # fmt: skip


@linearise_transition.register(DifferentialMotion)
def _linearise_transition(motion, t, before, after, jacobian, offset, precision):
    first, distance, along, heading_std, share, direction_std = _step_of(motion, t)
    # The heading turns the displacement that the reference really made, noise included.
    dx, dy = after[0] - before[0], after[1] - before[1]
    jacobian[0, 0], jacobian[0, 1], jacobian[0, 2] = 1.0, 0.0, -dy
    jacobian[1, 0], jacobian[1, 1], jacobian[1, 2] = 0.0, 1.0, dx
    jacobian[2, 0], jacobian[2, 1], jacobian[2, 2] = 0.0, 0.0, 1.0
    c, s = math.cos(before[2] + first), math.sin(before[2] + first)
    offset[0] = before[0] + c * distance - after[0]
    offset[1] = before[1] + s * distance - after[1]
    offset[2] = before[2] + motion.mean[t, 2] - after[2]
    # The direction's error moves the robot aside in proportion to the way that it really made; where that is next to
    # nothing, to the way that it makes typically.
    way = math.sqrt(dx * dx + dy * dy + SHORTEST_WAY * SHORTEST_WAY)
    u = 1.0 / (along * along)
    v = 1.0 / (way * direction_std) ** 2
    # Aside given the heading: the error of the direction follows that of the heading by its share.
    slope = way * share
    precision[0, 0] = c * c * u + s * s * v
    precision[1, 1] = s * s * u + c * c * v
    precision[0, 1] = precision[1, 0] = c * s * (u - v)
    precision[0, 2] = precision[2, 0] = s * v * slope
    precision[1, 2] = precision[2, 1] = -c * v * slope
    precision[2, 2] = 1.0 / (heading_std * heading_std) + slope * slope * v


# The noise turns with the heading, as that of increments does.


@state_of_deviation.register(DifferentialMotion)
def _state_of_deviation(motion, t, reference, after, deviation, out):
    bend(reference, t, after, deviation, out)


@deviation_of_state.register(DifferentialMotion)
def _deviation_of_state(motion, t, reference, after, state, deviation):
    unbend(reference, t, after, state, deviation)
