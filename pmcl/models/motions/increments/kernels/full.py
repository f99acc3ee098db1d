"""Full kernels of :class:`~pmcl.models.motions.increments.table.IncrementMotion`, for tables with extras."""

from __future__ import annotations

import math

from pmcl.engine.compile import generic, kernel
from pmcl.engine.contract import (
    deviation_of_state,
    draw_precision,
    linearise_transition,
    path_transition_logpdf,
    propagate,
    propagate_widely,
    scratch_rows,
    state_of_deviation,
    state_size,
    transition_logpdf,
    widens,
)
from pmcl.engine.random_numbers import normals_into, students_into
from pmcl.engine.scalars import HALF_LOG_2PI, log_sum
from pmcl.engine.student import (
    LEAST_INVERSE,
    logs_of_deviations,
    student_constant,
    student_deviation,
    student_logpdf,
)
from pmcl.engine.vector_math import exp_into, log_into, mix_into, sincos_into
from pmcl.models.motions.increments.kernels.plain import bend, unbend
from pmcl.models.motions.increments.table import IncrementMotion, MotionExtras, WanderingExtras

# A filter stretches one deviate of this share of its particles by so much, where noise has heavy tails. With four
# degrees of freedom a step that goes 20 standard deviations astray then finds 100 times as many particles, at the price
# of a quarter of them elsewhere.
_STRETCHED, _STRETCHED_BY = 0.25, 10.0
# A particle whose density falls by more than the inverse of the exponential of this weighs nothing.
_GREATEST_EXPONENT = 700.0


@state_size.register(IncrementMotion, MotionExtras)
def _three(motion):
    return 3


@state_size.register(IncrementMotion, WanderingExtras)
def _four(motion):
    return 4


@generic
def _memory_of_turn(extras, t):
    """Return (turn per unit of u, correlation of u with its value before) at row t; zeros where nothing wanders."""


@_memory_of_turn.register(MotionExtras)
def _no_memory(extras, t):
    return 0.0, 0.0


@_memory_of_turn.register(WanderingExtras)
def _memory(extras, t):
    return extras.wander[t], extras.keep[t]


@kernel
def _grip(patches, x, y):
    """Return the share of its mean translation that a step from (x, y) makes."""
    value = 1.0
    for k in range(patches.shape[0]):
        dx, dy, radius = x - patches[k, 0], y - patches[k, 1], patches[k, 2]
        if dx * dx + dy * dy < radius * radius:
            value *= 1.0 - patches[k, 3]
    return value


@kernel
def _tail(motion):
    """Return the inverse of the noise's degrees of freedom; zero where nothing tells it from normal noise."""
    return motion.extras.tail if motion.extras.tail >= LEAST_INVERSE else 0.0


@kernel
def _widen(rng, noise, tail, log_weights, scratch):
    """Stretch one of the three deviates (3, n) of some particles; add what they weigh to `log_weights` (n,).

    The density of the deviates over that of the mixture is 1 / (1 - s + s r), where s is the share of the stretched
    ones and r the mean, over the three deviates, of the stretched density over the other.
    """
    power, narrower = 0.5 * (1.0 + 1.0 / tail), 1.0 / (_STRETCHED_BY * _STRETCHED_BY)
    ratio, logs, total_ratio = scratch[0], scratch[1], scratch[2]
    for i in range(log_weights.size):
        if rng.random() < _STRETCHED:
            noise[int(3.0 * rng.random()), i] *= _STRETCHED_BY
        total_ratio[i] = 0.0
    for d in range(3):
        for i in range(log_weights.size):
            square = tail * noise[d, i] * noise[d, i]
            ratio[i] = (1.0 + square) / (1.0 + narrower * square)
        log_into(ratio, logs)
        for i in range(log_weights.size):
            logs[i] = min(power * logs[i], _GREATEST_EXPONENT)
        exp_into(logs, 0.0, ratio)
        for i in range(log_weights.size):
            total_ratio[i] += ratio[i]
    for i in range(log_weights.size):
        total_ratio[i] = 1.0 - _STRETCHED + _STRETCHED / (3.0 * _STRETCHED_BY) * total_ratio[i]
    log_into(total_ratio, logs)
    for i in range(log_weights.size):
        log_weights[i] -= logs[i]


@kernel
def _move(motion, t, rng, previous, current, widely, log_weights, scratch):
    """Draw the pose; the turn may follow the fourth component of the state before."""
    mean, std, tail = motion.mean, motion.std, motion.extras.tail
    sine, cosine, noise = scratch[0], scratch[1], scratch[3:6]
    wanders, wander = previous.shape[0] > 3, _memory_of_turn(motion.extras, t)[0]
    if tail > 0.0:
        students_into(rng, noise, tail, scratch[:3])
        if widely:
            _widen(rng, noise, tail, log_weights, scratch)
    else:
        normals_into(rng, noise, sine)
    sincos_into(previous[2], sine, cosine)
    for i in range(current.shape[1]):
        grip = _grip(motion.extras.patches, previous[0, i], previous[1, i])
        if motion.extras.slip_weight > 0.0 and rng.random() < motion.extras.slip_weight:
            grip *= 1.0 - motion.extras.slip_share
        f = grip * mean[t, 0] + std[t, 0] * noise[0, i]
        g = grip * mean[t, 1] + std[t, 1] * noise[1, i]
        turn = mean[t, 2] + std[t, 2] * noise[2, i]
        if wanders:
            turn += wander * previous[3, i]
        current[0, i] = previous[0, i] + f * cosine[i] - g * sine[i]
        current[1, i] = previous[1, i] + f * sine[i] + g * cosine[i]
        current[2, i] = previous[2, i] + turn


@propagate.register(IncrementMotion, MotionExtras)
def _propagate(motion, t, rng, previous, current, scratch):
    _move(motion, t, rng, previous, current, False, scratch[0], scratch)


@widens.register(IncrementMotion, MotionExtras, WanderingExtras)
def _widens(motion):
    return motion.extras.tail > 0.0


@propagate_widely.register(IncrementMotion, MotionExtras)
def _propagate_widely(motion, t, rng, previous, current, log_weights, scratch):
    _move(motion, t, rng, previous, current, True, log_weights, scratch)


@kernel
def _wander(motion, t, rng, previous, current, scratch):
    """Draw the fourth component of the state."""
    keep, noise = motion.extras.keep[t], scratch[2:3]
    spread = math.sqrt(1.0 - keep * keep)
    normals_into(rng, noise, scratch[0])
    for i in range(current.shape[1]):
        current[3, i] = keep * previous[3, i] + spread * noise[0, i]


@propagate.register(IncrementMotion, WanderingExtras)
def _propagate_wandering(motion, t, rng, previous, current, scratch):
    _move(motion, t, rng, previous, current, False, scratch[0], scratch)
    _wander(motion, t, rng, previous, current, scratch)


@propagate_widely.register(IncrementMotion, WanderingExtras)
def _propagate_wandering_widely(motion, t, rng, previous, current, log_weights, scratch):
    _move(motion, t, rng, previous, current, True, log_weights, scratch)
    _wander(motion, t, rng, previous, current, scratch)


@kernel
def _log_slip(motion):
    """Return the logs of the probabilities that a step slips, and that it does not."""
    slip = motion.extras.slip_weight
    return (math.log(slip) if slip > 0.0 else -math.inf), (math.log1p(-slip) if slip < 1.0 else -math.inf)


@kernel
def _translation_logpdf(motion, t, ahead, aside, grip, constant, log_slip):
    """Return the log density of a displacement in the robot frame, slips included, but for the noise's scale."""
    mean, std, tail, slip = motion.mean, motion.std, motion.extras.tail, motion.extras.slip_weight
    f, g = (ahead - grip * mean[t, 0]) / std[t, 0], (aside - grip * mean[t, 1]) / std[t, 1]
    value = student_logpdf(f, tail, constant) + student_logpdf(g, tail, constant)
    if slip > 0.0:
        grip *= 1.0 - motion.extras.slip_share
        f, g = (ahead - grip * mean[t, 0]) / std[t, 0], (aside - grip * mean[t, 1]) / std[t, 1]
        slipped = student_logpdf(f, tail, constant) + student_logpdf(g, tail, constant) + log_slip[0]
        if slip < 1.0:
            value += log_slip[1]
            value = log_sum(value, slipped)
        else:
            value = slipped
    return value


@kernel
def _pose_logpdf(motion, t, previous, current, logp, scratch):
    n = logp.size
    sine, cosine, held, slipped, draft = scratch[0, :n], scratch[1, :n], scratch[2, :n], scratch[3, :n], scratch[4, :n]
    sincos_into(previous[2, :n], sine, cosine)
    wanders, wander = previous.shape[0] > 3, _memory_of_turn(motion.extras, t)[0]
    tail, slip = _tail(motion), motion.extras.slip_weight
    w_forward, w_left, w_turn = 1.0 / motion.std[t, 0], 1.0 / motion.std[t, 1], 1.0 / motion.std[t, 2]
    mean_forward, mean_left, mean_turn = motion.mean[t, 0], motion.mean[t, 1], motion.mean[t, 2]
    constant = 3.0 * student_constant(tail) + math.log(w_forward * w_left * w_turn)
    for i in range(n):
        dx, dy = current[0] - previous[0, i], current[1] - previous[1, i]
        ahead, aside = dx * cosine[i] + dy * sine[i], dy * cosine[i] - dx * sine[i]
        turn = current[2] - previous[2, i] - mean_turn
        if wanders:
            turn -= wander * previous[3, i]
        grip = _grip(motion.extras.patches, previous[0, i], previous[1, i])
        f, g, h = (ahead - grip * mean_forward) * w_forward, (aside - grip * mean_left) * w_left, turn * w_turn
        held[i] = student_deviation(f, g, h, tail)
        if slip > 0.0:
            grip *= 1.0 - motion.extras.slip_share
            f, g = (ahead - grip * mean_forward) * w_forward, (aside - grip * mean_left) * w_left
            slipped[i] = student_deviation(f, g, h, tail)
    logs_of_deviations(held, tail, constant, draft)
    if slip > 0.0:
        logs_of_deviations(slipped, tail, constant, draft)
        log_slip = _log_slip(motion)
        mix_into(held, slipped, log_slip[0], log_slip[1], draft)
    for i in range(n):
        logp[i] += held[i]


@transition_logpdf.register(IncrementMotion, MotionExtras)
def _transition_logpdf(motion, t, previous, current, logp, scratch):
    _pose_logpdf(motion, t, previous, current, logp, scratch)


@transition_logpdf.register(IncrementMotion, WanderingExtras)
def _wandering_logpdf(motion, t, previous, current, logp, scratch):
    _pose_logpdf(motion, t, previous, current, logp, scratch)
    keep = motion.extras.keep[t]
    spread = math.sqrt(1.0 - keep * keep)
    constant = -math.log(spread) - HALF_LOG_2PI
    for i in range(logp.size):
        r = (current[3] - keep * previous[3, i]) / spread
        logp[i] += constant - 0.5 * r * r


@kernel
def _along_path(motion, n_steps, path, logp, scratch):
    """Add the density of each step; without a fourth component u is integrated out by a scalar Kalman filter."""
    sine, cosine = scratch[0], scratch[1]
    sincos_into(path[2], sine, cosine)
    constant, log_slip = student_constant(motion.extras.tail), _log_slip(motion)
    wanders = path.shape[0] > 3
    guess, variance = 0.0, 1.0  # belief about u[t-1]
    for t in range(1, n_steps):
        dx, dy = path[0, t] - path[0, t - 1], path[1, t] - path[1, t - 1]
        c, s = cosine[t - 1], sine[t - 1]
        grip = _grip(motion.extras.patches, path[0, t - 1], path[1, t - 1])
        value = _translation_logpdf(motion, t, dx * c + dy * s, dy * c - dx * s, grip, constant, log_slip)
        value -= math.log(motion.std[t, 0] * motion.std[t, 1])
        turn, std = path[2, t] - path[2, t - 1] - motion.mean[t, 2], motion.std[t, 2]
        wander, keep = _memory_of_turn(motion.extras, t)
        if wanders:
            spread = math.sqrt(1.0 - keep * keep)
            r = (path[3, t] - keep * path[3, t - 1]) / spread
            value -= math.log(spread) + HALF_LOG_2PI + 0.5 * r * r
            turn -= wander * path[3, t - 1]
        elif wander != 0.0 or keep != 0.0:
            turn -= wander * guess
            total = wander * wander * variance + std * std
            gain = wander * variance / total
            guess = keep * (guess + gain * turn)
            variance = keep * keep * variance * (1.0 - gain * wander) + 1.0 - keep * keep
            std = math.sqrt(total)
        logp[t] += value + student_logpdf(turn / std, motion.extras.tail, constant) - math.log(std)


@draw_precision.register(IncrementMotion, MotionExtras, WanderingExtras)
def _draw_precision(motion, t, before, after, rng, precision):
    tail, mean, std = motion.extras.tail, motion.mean, motion.std
    if tail <= 0.0:
        return False
    c, s = math.cos(before[2]), math.sin(before[2])
    dx, dy = after[0] - before[0], after[1] - before[1]
    ahead, aside, turn = dx * c + dy * s, dy * c - dx * s, after[2] - before[2] - mean[t, 2]
    if before.shape[0] > 3:
        turn -= _memory_of_turn(motion.extras, t)[0] * before[3]
    grip = _grip(motion.extras.patches, before[0], before[1])
    if motion.extras.slip_weight > 0.0:
        constant, log_slip = student_constant(tail), _log_slip(motion)
        f, g = (ahead - grip * mean[t, 0]) / std[t, 0], (aside - grip * mean[t, 1]) / std[t, 1]
        held = student_logpdf(f, tail, constant) + student_logpdf(g, tail, constant) + log_slip[1]
        if math.log(rng.random()) > held - _translation_logpdf(motion, t, ahead, aside, grip, constant, log_slip):
            grip *= 1.0 - motion.extras.slip_share
    f, g = (ahead - grip * mean[t, 0]) / std[t, 0], (aside - grip * mean[t, 1]) / std[t, 1]
    h, half = turn / std[t, 2], 0.5 / tail
    precision[0] = rng.standard_gamma(half + 0.5) / (half + 0.5 * f * f)
    precision[1] = rng.standard_gamma(half + 0.5) / (half + 0.5 * g * g)
    precision[2] = rng.standard_gamma(half + 0.5) / (half + 0.5 * h * h)
    return True


@kernel
def _linearise_pose(motion, t, before, after, jacobian, offset, precision):
    size = offset.size
    for i in range(size):
        offset[i] = 0.0
        for j in range(size):
            jacobian[i, j] = 1.0 if i == j else 0.0
            precision[i, j] = 0.0
    c, s = math.cos(before[2]), math.sin(before[2])
    grip = _grip(motion.extras.patches, before[0], before[1])
    grip *= 1.0 - motion.extras.slip_weight * motion.extras.slip_share
    f, g = grip * motion.mean[t, 0], grip * motion.mean[t, 1]
    jacobian[0, 2], jacobian[1, 2] = before[1] - after[1], after[0] - before[0]
    offset[0] = before[0] + c * f - s * g - after[0]
    offset[1] = before[1] + s * f + c * g - after[1]
    offset[2] = before[2] + motion.mean[t, 2] - after[2]
    # Rare slips widen the scatter; a Student t is as wide as a Gaussian of half as much again variance.
    lost = motion.extras.slip_share * grip
    spread = motion.extras.slip_weight * (1.0 - motion.extras.slip_weight) * lost * lost
    wide = 1.0 + min(2.0 * motion.extras.tail, 1.0)
    a = 1.0 / (wide * motion.std[t, 0] ** 2 + spread * motion.mean[t, 0] ** 2)
    b = 1.0 / (wide * motion.std[t, 1] ** 2 + spread * motion.mean[t, 1] ** 2)
    precision[0, 0] = c * c * a + s * s * b
    precision[1, 1] = s * s * a + c * c * b
    precision[0, 1] = precision[1, 0] = c * s * (a - b)
    precision[2, 2] = 1.0 / (wide * motion.std[t, 2] ** 2)


@linearise_transition.register(IncrementMotion, MotionExtras)
def _linearise(motion, t, before, after, jacobian, offset, precision):
    _linearise_pose(motion, t, before, after, jacobian, offset, precision)


@linearise_transition.register(IncrementMotion, WanderingExtras)
def _linearise_wandering(motion, t, before, after, jacobian, offset, precision):
    _linearise_pose(motion, t, before, after, jacobian, offset, precision)
    wander, keep = motion.extras.wander[t], motion.extras.keep[t]
    jacobian[2, 3], jacobian[3, 3] = wander, keep
    offset[2] += wander * before[3]
    offset[3] = keep * before[3] - after[3]
    precision[3, 3] = 1.0 / (1.0 - keep * keep)


# The rest is the same for both, or is that of the plain motion for the first three components.


@scratch_rows.register(IncrementMotion, MotionExtras, WanderingExtras)
def _rows(table):
    return 6


@state_of_deviation.register(IncrementMotion, MotionExtras, WanderingExtras)
def _bent_state(motion, t, reference, after, deviation, out):
    bend(reference, t, after, deviation, out)
    for d in range(3, out.size):
        out[d] = reference[t, d] + deviation[d]


@deviation_of_state.register(IncrementMotion, MotionExtras, WanderingExtras)
def _bent_deviation(motion, t, reference, after, state, deviation):
    unbend(reference, t, after, state, deviation)
    for d in range(3, deviation.size):
        deviation[d] = state[d] - reference[t, d]


@path_transition_logpdf.register(IncrementMotion, MotionExtras, WanderingExtras)
def _path_logpdf(motion, n_steps, path, logp, scratch):
    _along_path(motion, n_steps, path, logp, scratch)
